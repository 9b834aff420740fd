"""A report as one HTML page that needs nothing else: style and pictures are inside."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import assert_never

from vocc_torch.show.report.document import (
    SIGNS,
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
from vocc_torch.show.report.inline import Span, one_line, spans, words
from vocc_torch.show.report.pictures import read_png, relative_url
from vocc_torch.show.report.stylesheet import STYLESHEET

_HEAD = """\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{title}</title>
<style>
{style}</style>
</head>
<body>
<a class="skip" href="#_text">Skip to the text</a>
<header>
<h1>{title}</h1>
{subtitle}</header>
<div class="body">
"""
_WORDY = 40
"""Characters of a cell's text from which a narrow screen shows the rows of its table as cards."""
_PINNED_COLUMNS = 5
"""Most columns of a table of long texts that always fit beside the contents, with its head kept in sight."""
_CONTENTS_DEPTH = 3
"""Deepest level of headings in the table of contents."""

_BETWEEN = " \N{MIDDLE DOT} "
"""What parts the links to a picture's files."""


def as_html(report: Report, base: Path) -> str:
    """Write a report as one HTML page.

    Nothing is loaded from anywhere, and no script runs. Pictures keep their pixels.

    Args:
        report: the report.
        base: the folder where the page will lie; pictures and data are relative to it.

    Raises:
        VoccError: a picture or its data is not in the folder, a picture is no PNG file, or a link leads to
            neither http, https, an anchor nor a relative path.

    Example:
        >>> section = Section("Results", "results", (Paragraph("a < b"),))
        >>> page = as_html(Report("Evidence", "", (section,)), Path())
        >>> "<p>a &lt; b</p>" in page, '<h2 id="results">Results</h2>' in page
        (True, True)
    """
    subtitle = f'<p class="subtitle">{_inline(report.subtitle)}</p>\n' if report.subtitle else ""
    head = _HEAD.format(title=_title(report.title), style=STYLESHEET, subtitle=subtitle)
    body = "\n".join(_section(section, base) for section in report.sections)
    contents = _contents(report.sections)
    return f'{head}{contents}<main id="_text">\n{body}\n</main>\n</div>\n</body>\n</html>\n'


def _contents(sections: Sequence[Section]) -> str:
    """Write the table of contents twice, beside the text and folded above it; the style shows one."""
    entries = "\n".join(
        f'<li class="level-{section.level}"><a href="#{section.anchor}">{_title(section.title)}</a></li>'
        for section in sections
        if section.level <= _CONTENTS_DEPTH
    )
    if not entries:
        return ""
    listed = f"<ol>\n{entries}\n</ol>\n</nav>"
    return (
        f'<nav class="beside" aria-label="Contents">\n<p>Contents</p>\n{listed}\n'
        f'<details class="contents">\n<summary>Contents</summary>\n'
        f'<nav aria-label="Contents">\n{listed}\n</details>\n'
    )


def _section(section: Section, base: Path) -> str:
    """Write a section."""
    heading = f'<h{section.level} id="{section.anchor}">{_title(section.title)}</h{section.level}>'
    return "\n".join(["<section>", heading, *(_block(block, base) for block in section.blocks), "</section>"])


def _block(block: Block, base: Path) -> str:
    """Write a block."""
    match block:
        case Paragraph(text):
            return f"<p>{_inline(text)}</p>"
        case Bullets(items):
            return _list(f"<li>{_inline(item)}</li>" for item in items)
        case Highlights(items):
            return _list(map(_highlight, items), ' class="highlights"')
        case Code(text):
            return f'<pre tabindex="0"><code>{escape(text.rstrip())}</code></pre>'
        case Table():
            return _table(block)
        case Picture():
            return _figure(block, base)
        case Pictures(pictures, columns):
            figures = "\n".join(_figure(picture, base) for picture in pictures)
            return f'<div class="side-by-side columns-{columns}">\n{figures}\n</div>'
        case _:
            assert_never(block)


def _list(items: Iterable[str], attributes: str = "") -> str:
    """Write a list without numbers."""
    lines = "\n".join(items)
    return f"<ul{attributes}>\n{lines}\n</ul>"


def _highlight(item: Highlight) -> str:
    """Write a summary's number and what it says."""
    tone = f' class="{item.tone}"' if item.tone else ""
    return f"<li{tone}><strong>{_sign(item.tone)}{_title(item.value)}</strong> {_inline(item.text)}</li>"


def _sign(tone: Tone | None) -> str:
    """Write a tone's sign, to stand before a text."""
    return f"{SIGNS[tone]} " if tone else ""


def _table(table: Table) -> str:
    """Write a table."""
    head = "".join(
        f'<th role="columnheader" scope="col"{_align(align)}>{_inline(name)}</th>'
        for name, align in zip(table.header, table.alignments, strict=True)
    )
    rows = "\n".join(_row(table, row) for row in table.cells)
    label = escape(words(table.caption))
    # Cards lose a table's meaning for screen readers, unless the roles are spelt out.
    text = (
        f'<div class="{_table_kind(table)}" role="region" aria-label="{label}" tabindex="0">\n'
        f'<table role="table">\n<caption><span>{_inline(table.caption)}</span></caption>\n'
        f'<thead role="rowgroup"><tr role="row">{head}</tr></thead>\n'
        f'<tbody role="rowgroup">\n{rows}\n</tbody>\n</table>\n</div>'
    )
    if not table.folded:
        return text
    count = f"{len(table.rows)} row{'' if len(table.rows) == 1 else 's'}"
    summary = f"<summary>{label.removesuffix('.')} ({count})</summary>"
    return f'<details class="folded">\n{summary}\n{text}\n</details>'


def _table_kind(table: Table) -> str:
    """Tell the style what to do with a table where room is short: scroll it, or show its rows as cards."""
    if all(len(words(cell.text)) < _WORDY for row in table.cells for cell in row):
        return "table"
    return "table wordy pinned" if len(table.header) <= _PINNED_COLUMNS else "table wordy"


def _row(table: Table, row: Sequence[Cell]) -> str:
    """Write a table's row, whose first cell names it."""
    first, *others = (
        f"{_align(align)}>{_toned(cell)}" for cell, align in zip(row, table.alignments, strict=True)
    )
    labels = (escape(words(name)) for name in table.header[1:])
    cells = (
        f'<td role="cell" data-label="{name}"{cell}</td>' for name, cell in zip(labels, others, strict=True)
    )
    return f'<tr role="row"><th role="rowheader" scope="row"{first}</th>{"".join(cells)}</tr>'


def _align(align: Align) -> str:
    """Write a cell's alignment; left is the style's own."""
    return "" if align == "left" else f' class="{align}"'


def _toned(cell: Cell) -> str:
    """Write a cell's text, with its sign and colour."""
    text = _inline(cell.text)
    return f'<span class="tone {cell.tone}">{_sign(cell.tone)}{text}</span>' if cell.tone else text


def _figure(picture: Picture, base: Path) -> str:
    """Write a picture with its caption and links to its files."""
    url = relative_url(base, picture.path)
    png = read_png(base / picture.path)
    links = [f'<a href="{escape(url)}">Picture (PNG)</a>']
    if picture.data is not None:
        links.append(f'<a href="{escape(relative_url(base, picture.data))}">Data (CSV)</a>')
    content = base64.b64encode(png.content).decode("ascii")
    return (
        f'<figure>\n<img width="{png.width_px}" height="{png.height_px}" alt="{_title(picture.alt)}" '
        f'src="data:image/png;base64,{content}">\n'
        f'<figcaption>{_inline(picture.caption)} <span class="files">{_BETWEEN.join(links)}</span>'
        "</figcaption>\n</figure>"
    )


def _title(text: str) -> str:
    """Write plain words of a single line."""
    return escape(one_line(text))


def _inline(text: str) -> str:
    """Write inline text."""
    return _spans(spans(text))


def _spans(pieces: Sequence[Span]) -> str:
    """Write pieces of inline text."""
    return "".join(map(_span, pieces))


def _span(piece: Span) -> str:
    """Write a piece of inline text."""
    match piece.kind:
        case "text":
            return escape(piece.text)
        case "code":
            return f"<code>{escape(piece.text)}</code>"
        case "bold":
            return f"<strong>{_spans(piece.parts)}</strong>"
        case "link":
            return f'<a href="{escape(piece.url)}">{_spans(piece.parts)}</a>'
        case _:
            assert_never(piece.kind)
