"""What dimming would give, as a section of the report."""

from __future__ import annotations

import math
from collections.abc import Mapping

from vocc_torch.evaluation.dimming import Grid
from vocc_torch.evaluation.optimum_ratio import optimum_ratio
from vocc_torch.evaluation.undimmed import Estimate, undimmed_loss
from vocc_torch.reporting.paper.contents import Shown
from vocc_torch.reporting.paper.pictures import blocks_of
from vocc_torch.reporting.paper.rates import LOCATED, PAPER_RECEIVERS
from vocc_torch.reporting.report.document import Block, Paragraph, Section, Table
from vocc_torch.reporting.report.inline import literal
from vocc_torch.reporting.styles import receiver_styles


def dimming(grids: Mapping[str, Grid], figure: Shown) -> Section:
    """Give the heat maps, the best luminances and the loss of a panel that cannot dim."""
    blocks: list[Block] = [
        Paragraph(
            "The paper asks for it as future work (section IV-D-5): which luminance is best under which "
            "ambient "
            "light, and what does a panel lose that cannot dim?"
        ),
        *blocks_of(figure),
    ]
    for locator, grid in grids.items():
        blocks += [_best(grid, locator), _loss(grid, locator)]
    return Section("Beyond the paper: dimming", "dimming", tuple(blocks))


def _receivers(grid: Grid) -> list[tuple[str, str]]:
    """Give the paper's receivers in the grid, with their labels."""
    names = [name for name in PAPER_RECEIVERS if name in grid.receivers]
    return [(name, style.label) for name, style in receiver_styles(names).items()]


def _best(grid: Grid, locator: str) -> Table:
    """Give the best luminance for each ambient light."""
    rows = []
    for name, label in _receivers(grid):
        loss = undimmed_loss(grid, name)
        slope = optimum_ratio(grid, name).slope
        told = "too few levels" if slope is None else f"{slope.value:.2f} [{slope.low:.2f}, {slope.high:.2f}]"
        rows.append((literal(label), *(literal(best.candidates_text) for best in loss.dimmed), told))
    header = ("receiver", *(f"{value:g} lx" for value in grid.rows), "slope in logarithms")
    caption = (
        f"Best LED luminance (cd/m\u00b2) by ambient light, {LOCATED[locator]}: all that cannot be told "
        f"from the "
        "best at 95 %. A slope of 1 is a constant ratio of luminance to ambient light"
    )
    return Table(header, tuple(rows), caption=caption)


def _loss(grid: Grid, locator: str) -> Table:
    """Give what a panel loses that cannot dim."""
    rows = []
    for name, label in _receivers(grid):
        loss = undimmed_loss(grid, name)
        cells = [literal(label), _rate(loss.dimmed_mean)]
        for panel in (loss.fixed, loss.headlight):
            cells += [f"{panel.luminance_cd_m2:g}: {_rate(panel.mean)}", _ratio(panel.ratio)]
        rows.append(tuple(cells))
    header = ("receiver", "dimmed", "one best luminance", "times", "headlight", "times")
    caption = (
        f"Mean bit error rate over the ambient light, an octave weighing like any other, "
        f"{LOCATED[locator]}: a "
        "panel dimmed to the best, one with the single best luminance (cd/m\u00b2), and one with a "
        "headlight's; "
        "\u201ctimes\u201d is the rate over that of the dimmed panel"
    )
    return Table(header, tuple(rows), caption=caption)


def _rate(rate: Estimate) -> str:
    """Write a rate with its interval."""
    return f"{rate.value:.1e} [{rate.low:.1e}, {rate.high:.1e}]"


def _ratio(ratio: Estimate) -> str:
    """Write a ratio with its interval."""
    value, high = ("\u221e" if math.isinf(end) else f"{end:.3g}" for end in (ratio.value, ratio.high))
    return f"{value} [{ratio.low:.3g}, {high}]"
