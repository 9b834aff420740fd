"""A report as plain data, whatever it is written as.

Where a field is called inline text, it may hold ``code`` in backticks, ``**bold**`` and ``[links](url)``;
everything else stands for itself (see :mod:`vocc_torch.show.report.inline`). Titles and the words that
stand in for a picture are plain text.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal, TypeAlias, get_args

from vocc_torch.errors import VoccError

Tone = Literal["agree", "differ", "unsure"]
Align = Literal["left", "right", "center"]

SIGNS: dict[Tone, str] = {"agree": "\N{CHECK MARK}", "differ": "\N{BALLOT X}", "unsure": "?"}
"""What stands before a toned text, so that no verdict is told by colour alone."""
_ANCHOR = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_TOP, _DEEPEST = 2, 4
"""Levels of a section's heading; level 1 is the report's title."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A table's cell with a tone.

    Args:
        text: inline text.
        tone: how the cell is coloured, and the sign before its text; None for neither.

    Raises:
        VoccError: an unknown tone.
    """

    text: str
    tone: Tone | None = None

    def __post_init__(self) -> None:
        """Refuse an unknown tone."""
        _check_choice("Cell.tone", self.tone, (None, *get_args(Tone)))


@dataclass(frozen=True, slots=True)
class Highlight:
    """One number of a summary.

    Args:
        value: plain text, shown large: a number or a word or two.
        text: inline text: what the value says.
        tone: how it is coloured, and the sign before it; None for neither.

    Raises:
        VoccError: an unknown tone.
    """

    value: str
    text: str
    tone: Tone | None = None

    def __post_init__(self) -> None:
        """Refuse an unknown tone."""
        _check_choice("Highlight.tone", self.tone, (None, *get_args(Tone)))


@dataclass(frozen=True, slots=True)
class Highlights:
    """A summary's numbers beside each other.

    Args:
        items: the numbers, in order.
    """

    items: tuple[Highlight, ...]


@dataclass(frozen=True, slots=True)
class Paragraph:
    """A paragraph.

    Args:
        text: inline text.
    """

    text: str


@dataclass(frozen=True, slots=True)
class Bullets:
    """A list without numbers.

    Args:
        items: inline texts.
    """

    items: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Code:
    """Lines to be shown as they are, such as commands.

    Args:
        text: the lines; no inline markup.
    """

    text: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table whose first column names its rows.

    Args:
        header: inline texts, one a column.
        rows: rows of cells, as many as the header has; a plain text is a cell without a tone.
        align: one a column; all left by default.
        caption: inline text that says what the table shows.
        folded: shown only when the reader opens it, for long tables.

    Raises:
        VoccError: no column, no caption, a row or ``align`` of another length, or an unknown alignment.

    Example:
        >>> Table(("axis", "BER"), (("8000 lx",),), caption="Rates")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: Table.rows[0] has 1 cells: the header has 2
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str | Cell, ...], ...]
    align: tuple[Align, ...] = ()
    caption: str = ""
    folded: bool = False

    def __post_init__(self) -> None:
        """Refuse a table that has no shape or no caption."""
        if not self.header:
            raise VoccError("Table.header is empty: a table needs at least one column")
        if not self.caption.strip():
            raise VoccError(f"Table.caption is empty: the table of {self.header[0]!r} must say what it shows")
        for number, row in enumerate(self.rows):
            if len(row) != len(self.header):
                raise VoccError(
                    f"Table.rows[{number}] has {len(row)} cells: the header has {len(self.header)}"
                )
        if self.align and len(self.align) != len(self.header):
            raise VoccError(f"Table.align has {len(self.align)} entries: the header has {len(self.header)}")
        for align in self.align:
            _check_choice("Table.align", align, get_args(Align))

    @property
    def alignments(self) -> tuple[Align, ...]:
        """One alignment a column."""
        return self.align or tuple("left" for _ in self.header)

    @property
    def cells(self) -> tuple[tuple[Cell, ...], ...]:
        """The rows, with every plain text as a cell."""
        return tuple(
            tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in row) for row in self.rows
        )


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture with its caption.

    Args:
        path: PNG file, relative to the report's folder.
        caption: inline text below the picture.
        alt: what stands in for the picture where it is not seen; plain text.
        data: CSV file with the picture's data, relative to the report's folder; None without one.

    Raises:
        VoccError: ``alt`` is empty.
    """

    path: Path
    caption: str
    alt: str
    data: Path | None = None

    def __post_init__(self) -> None:
        """Refuse a picture that only eyes can read."""
        if not self.alt.strip():
            raise VoccError(f"Picture.alt is empty: say in words what {self.path} shows")


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures side by side; below each other where the reader's screen is narrow.

    Args:
        pictures: at least one.
        columns: pictures in a row, 1 to 4.

    Raises:
        VoccError: no picture, or ``columns`` outside its range.
    """

    pictures: tuple[Picture, ...]
    columns: int = 2

    def __post_init__(self) -> None:
        """Refuse an empty group and a number of columns out of range."""
        if not self.pictures:
            raise VoccError("Pictures.pictures is empty: it needs at least one")
        _check_choice("Pictures.columns", self.columns, (1, 2, 3, 4))


Block: TypeAlias = Paragraph | Bullets | Highlights | Table | Picture | Pictures | Code


@dataclass(frozen=True, slots=True)
class Section:
    """A heading with what stands under it, up to the next heading.

    Args:
        title: the heading; plain text.
        anchor: its name in links: small letters, digits and single hyphens, a letter first.
        blocks: what stands under it, in order.
        level: 2 for a chapter, 3 and 4 for its parts.

    Raises:
        VoccError: an anchor or a level of another kind, or no title.

    Example:
        >>> Section("Fig. 22", "Fig 22", ())
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: Section.anchor is 'Fig 22': use small letters, digits and single hyphens
    """

    title: str
    anchor: str
    blocks: tuple[Block, ...]
    level: int = _TOP

    def __post_init__(self) -> None:
        """Refuse a heading that cannot be linked to."""
        if not self.title.strip():
            raise VoccError(f"Section.title is empty: the section {self.anchor!r} needs a heading")
        if not _ANCHOR.fullmatch(self.anchor):
            raise VoccError(
                f"Section.anchor is {self.anchor!r}: use small letters, digits and single hyphens"
            )
        _check_choice("Section.level", self.level, tuple(range(_TOP, _DEEPEST + 1)))


@dataclass(frozen=True, slots=True)
class Report:
    """A whole report.

    Args:
        title: its heading; plain text.
        subtitle: inline text below the heading.
        sections: the sections in order; the first has level 2, and no level is skipped on the way down.

    Raises:
        VoccError: no title, two sections of one anchor, or a level that is skipped.

    Example:
        >>> Report("Evidence", "", (Section("A", "a", ()), Section("B", "a", ())))
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: Report.sections has the anchor 'a' twice: each section needs its own
    """

    title: str
    subtitle: str
    sections: tuple[Section, ...]

    def __post_init__(self) -> None:
        """Refuse headings that are not told apart or skip a level."""
        if not self.title.strip():
            raise VoccError("Report.title is empty: a report needs a heading")
        for anchor, times in Counter(section.anchor for section in self.sections).items():
            if times > 1:
                raise VoccError(
                    f"Report.sections has the anchor {anchor!r} twice: each section needs its own"
                )
        levels = [_TOP - 1, *(section.level for section in self.sections)]
        for (above, below), section in zip(pairwise(levels), self.sections, strict=True):
            if below > above + 1:
                raise VoccError(
                    f"Section.level of {section.anchor!r} is {below} after {above}: no level may be skipped"
                )


def _check_choice(name: str, value: object, allowed: Sequence[object]) -> None:
    """Refuse a value that is not among the allowed ones."""
    if value not in allowed:
        raise VoccError(f"{name} is {value!r}: it must be one of {', '.join(map(repr, allowed))}")
