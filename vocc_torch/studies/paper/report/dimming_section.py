"""What dimming would give, as a section of the report."""

from __future__ import annotations

from collections.abc import Mapping

from vocc_torch.measure.grid import Grid, best_luminance
from vocc_torch.show.report.document import Block, Paragraph, Section, Table
from vocc_torch.show.report.inline import literal
from vocc_torch.show.styles import LOCATED, receiver_styles
from vocc_torch.studies.paper.report.contents import Shown
from vocc_torch.studies.paper.report.pictures import blocks_of
from vocc_torch.studies.paper.report.rates import PAPER_RECEIVERS
from vocc_torch.studies.paper.report.words import spaced


def dimming(grids: Mapping[str, Grid], figure: Shown) -> Section:
    """Give the heat maps and the best luminances."""
    blocks: list[Block] = [
        Paragraph(
            "The paper asks for it as future work (section IV-D-5): which LED luminance is best under which "
            "ambient light?"
        ),
        *blocks_of(figure),
        *(_best(grid, locator) for locator, grid in grids.items()),
    ]
    return Section("Beyond the paper: dimming", "dimming", tuple(blocks))


def _best(grid: Grid, locator: str) -> Table:
    """Give the best luminance for each ambient light."""
    names = [name for name in PAPER_RECEIVERS if name in grid.receivers]
    rows = tuple(
        (literal(style.label), *(literal(best.candidates_text) for best in best_luminance(grid, name)))
        for name, style in receiver_styles(names).items()
    )
    header = ("receiver", *(spaced(f"{value:g} lx") for value in grid.rows))
    caption = spaced(
        f"Best LED luminance (cd/m\u00b2) by ambient light, {LOCATED[locator]}: all that cannot be told "
        "from the best at 95 %"
    )
    return Table(header, rows, caption=caption)
