"""Figures as blocks of the report."""

from __future__ import annotations

from collections.abc import Mapping

from vocc_torch.reporting.paper.contents import Shown
from vocc_torch.reporting.report.document import Block, Picture, Table
from vocc_torch.reporting.report.inline import literal


def blocks_of(figure: Shown) -> list[Block]:
    """Give a figure's pictures, and its numbers where it has some."""
    blocks: list[Block] = []
    for path, caption in figure.pictures:
        text = caption or figure.caption
        blocks.append(Picture(path, literal(text), alt=f"{figure.title}. {text}", data=figure.table))
    if figure.findings:
        blocks.append(_numbers(figure.title, figure.findings))
    return blocks


def _numbers(title: str, findings: Mapping[str, float]) -> Table:
    """Give a figure's numbers by name."""
    rows = tuple((f"`{name}`", f"{value:.4g}") for name, value in findings.items())
    caption = f"Numbers of {literal(title.partition(':')[0])}"
    return Table(("number", "value"), rows, ("left", "right"), caption=caption, folded=True)
