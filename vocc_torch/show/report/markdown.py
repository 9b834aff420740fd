"""A report as GitHub-flavoured Markdown, with its pictures beside it."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator, Sequence
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
from vocc_torch.show.report.pictures import relative_url

_RULES: dict[Align, str] = {"left": ":---", "right": "---:", "center": ":---:"}
_MARKS = re.compile(r"([\\`*\[\]|~$]|(?<![^\W_])_|_(?![^\W_])|!$)")
"""What means something to Markdown in a line; an underscore within a word does not, nor does an exclamation
mark, unless a link follows it."""
_ENTITY = re.compile(r"&(?=#?\w+;)")
_LINE_MARK = re.compile(r"^(\d{1,9}(?=[.)](?: |$))|(?=[#+-]))")
"""What means something to Markdown at the start of a line: headings and lists."""
_BESIDE_BOLD = ("", *" .,;:!?()")
"""What may stand beside a bold text's asterisks, whatever the text begins and ends with."""


def as_markdown(report: Report, base: Path) -> str:
    """Write a report as GitHub-flavoured Markdown.

    Args:
        report: the report.
        base: the folder where the text will lie; pictures and data are relative to it.

    Raises:
        VoccError: a picture or its data is not in the folder, or a link leads to neither http, https, an
            anchor nor a relative path.

    Example:
        >>> section = Section("Results", "results", (Paragraph("BER **falls** for `flda_3`"),))
        >>> print(as_markdown(Report("Evidence", "", (section,)), Path()))
        # Evidence
        <BLANKLINE>
        ## Contents
        <BLANKLINE>
        - [Results](#results)
        <BLANKLINE>
        <a id="results"></a>
        <BLANKLINE>
        ## Results
        <BLANKLINE>
        BER **falls** for `flda_3`
        <BLANKLINE>
    """
    parts = [f"# {_title(report.title)}", _line(report.subtitle)]
    if report.sections:
        parts += ["## Contents", "\n".join(map(_entry, report.sections))]
    for section in report.sections:
        # GitHub makes anchors of its own from headings; ours stay when a heading changes.
        parts += [f'<a id="{section.anchor}"></a>', f"{'#' * section.level} {_title(section.title)}"]
        parts += [text for block in section.blocks for text in _block(block, base)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _entry(section: Section) -> str:
    """Write a line of the table of contents."""
    return f"{'  ' * (section.level - 2)}- [{_title(section.title)}](#{section.anchor})"


def _block(block: Block, base: Path) -> Iterator[str]:
    """Write a block as pieces that blank lines part."""
    match block:
        case Paragraph(text):
            yield _line(text)
        case Bullets(items):
            yield "\n".join(f"- {_line(item)}" for item in items)
        case Highlights(items):
            # Another sign than the bullets', so that a list that follows does not join this one.
            yield "\n".join(f"* {_highlight(item)}" for item in items)
        case Code(text):
            yield _code_block(text)
        case Table():
            yield from _table(block)
        case Picture():
            yield _image(block, base)
            yield _caption(block, base)
        case Pictures(pictures, columns):
            yield _side_by_side(pictures, columns, base)
        case _:
            assert_never(block)


def _highlight(item: Highlight) -> str:
    """Write a summary's number in bold, and what it says."""
    return f"**{_toned(_title(item.value), item.tone)}** {_inline(item.text)}"


def _code_block(text: str) -> str:
    """Write lines as they are, between fences longer than any row of backticks in them."""
    fence = "`" * max(3, 1 + _longest_row(text))
    return f"{fence}text\n{text.rstrip()}\n{fence}"


def _table(table: Table) -> Iterator[str]:
    """Write a table under its caption."""
    lines = [_row(map(_cell, map(Cell, table.header))), _row(_RULES[align] for align in table.alignments)]
    lines += [_row(map(_cell, row)) for row in table.cells]
    if table.folded:
        # Within HTML, Markdown's own marks mean nothing.
        yield f"<details>\n<summary>{html.escape(words(table.caption), quote=False)}</summary>"
    else:
        yield _line(table.caption)
    yield "\n".join(lines)
    if table.folded:
        yield "</details>"


def _row(cells: Iterator[str]) -> str:
    """Write a line of a table."""
    return f"| {' | '.join(cells)} |"


def _cell(cell: Cell) -> str:
    """Write a table's cell."""
    return _toned(_inline(cell.text, in_table=True), cell.tone)


def _toned(text: str, tone: Tone | None) -> str:
    """Put a tone's sign before a text."""
    return f"{SIGNS[tone]} {text}" if tone else text


def _image(picture: Picture, base: Path) -> str:
    """Write a picture without its caption."""
    return f"![{_title(picture.alt)}]({relative_url(base, picture.path)})"


def _caption(picture: Picture, base: Path, in_table: bool = False) -> str:
    """Write a picture's caption with a link to its data."""
    parts = [_inline(picture.caption, in_table) if in_table else _line(picture.caption)]
    if picture.data is not None:
        parts.append(f"[Data (CSV)]({relative_url(base, picture.data)})")
    return " ".join(part for part in parts if part)


def _side_by_side(pictures: Sequence[Picture], columns: int, base: Path) -> str:
    """Write pictures as a table: a row of pictures, the row of their captions, and so on."""
    rows = []
    for start in range(0, len(pictures), columns):
        group = pictures[start : start + columns]
        rest = [""] * (columns - len(group))
        rows.append([*(_image(picture, base) for picture in group), *rest])
        rows.append([*(_caption(picture, base, in_table=True) for picture in group), *rest])
    rows.insert(1, [_RULES["center"]] * columns)
    return "\n".join(_row(iter(row)) for row in rows)


def _line(text: str) -> str:
    """Write inline text that stands at the start of a line."""
    return _LINE_MARK.sub(r"\1\\", _inline(text))


def _inline(text: str, in_table: bool = False) -> str:
    """Write inline text."""
    return _spans(spans(text), in_table)


def _spans(pieces: Sequence[Span], in_table: bool) -> str:
    """Write pieces of inline text."""
    texts = [_span(piece, in_table) for piece in pieces]
    for place, piece in enumerate(pieces):
        if piece.kind == "bold":
            before = "".join(texts[:place])[-1:]
            after = "".join(texts[place + 1 :])[:1]
            clear = before in _BESIDE_BOLD and after in _BESIDE_BOLD
            texts[place] = f"**{texts[place]}**" if clear else f"<strong>{texts[place]}</strong>"
    return "".join(texts)


def _span(piece: Span, in_table: bool) -> str:
    """Write a piece of inline text; a bold one still without its marks."""
    match piece.kind:
        case "text":
            return _escaped(piece.text)
        case "code":
            return _code(piece.text, in_table)
        case "bold":
            return _spans(piece.parts, in_table)
        case "link":
            return f"[{_spans(piece.parts, in_table)}]({_ENTITY.sub('&amp;', piece.url)})"
        case _:
            assert_never(piece.kind)


def _code(text: str, in_table: bool) -> str:
    """Write code between more backticks than it holds in a row."""
    if in_table and "|" in text:
        # A table is parted at every pipe that no backslash stands before, and code keeps its backslashes.
        return f"<code>{_escaped(text)}</code>"
    fence = "`" * (1 + _longest_row(text))
    blank = " " if text.startswith(("`", " ")) or text.endswith(("`", " ")) else ""
    return f"{fence}{blank}{text}{blank}{fence}"


def _longest_row(text: str) -> int:
    """Count the backticks in the longest row of them."""
    return max(map(len, re.findall("`+", text)), default=0)


def _title(text: str) -> str:
    """Write plain words of a single line."""
    return _escaped(one_line(text))


def _escaped(text: str) -> str:
    """Write plain words so that Markdown and HTML leave them as they are."""
    escaped = _ENTITY.sub("&amp;", _MARKS.sub(r"\\\1", text))
    return escaped.replace("<", "&lt;").replace(">", "&gt;")
