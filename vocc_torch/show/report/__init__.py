"""A run's report: described once as plain data, written as Markdown and as one HTML page."""

from __future__ import annotations

from pathlib import Path

from vocc_torch.files import atomic_file, write_atomically
from vocc_torch.show.report.document import (
    Align,
    Block,
    Bullets,
    Cell,
    Code,
    Highlight,
    Highlights,
    Paragraph,
    Picture,
    Pictures,
    Report,
    Section,
    Table,
    Tone,
)
from vocc_torch.show.report.html import as_html
from vocc_torch.show.report.inline import literal
from vocc_torch.show.report.markdown import as_markdown

__all__ = [
    "Align",
    "Block",
    "Bullets",
    "Cell",
    "Code",
    "Highlight",
    "Highlights",
    "Paragraph",
    "Picture",
    "Pictures",
    "Report",
    "Section",
    "Table",
    "Tone",
    "as_html",
    "as_markdown",
    "literal",
    "write_report",
]


def write_report(report: Report, folder: str | Path) -> tuple[Path, Path]:
    """Write ``report.md`` and ``report.html``, each whole or not at all; neither where one has no room.

    Args:
        report: the report.
        folder: where the two go, with the report's pictures and data in it.

    Returns:
        The Markdown file and the HTML file.

    Raises:
        VoccError: as :func:`as_html`, or a file cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     [path.name for path in write_report(Report("Evidence", "", ()), folder)]
        ['report.md', 'report.html']
    """
    base = Path(folder)
    markdown, page = base / "report.md", base / "report.html"
    text, html = (write(report, base).encode("utf-8", "replace") for write in (as_markdown, as_html))
    with atomic_file(markdown) as temporary:
        temporary.write_bytes(text)
        write_atomically(page, html)  # while the old Markdown file is still in its place
    return markdown, page
