"""What dimming would give, as a section of the report."""

from __future__ import annotations

from collections.abc import Mapping

from vocc_torch.measure.grid import Grid
from vocc_torch.measure.optimum_ratio import optimum_ratio
from vocc_torch.measure.undimmed import HEADLIGHT_CD_M2, Estimate, Undimmed, undimmed_loss
from vocc_torch.show.report.document import Block, Paragraph, Section, Table
from vocc_torch.show.report.inline import literal
from vocc_torch.show.styles import LOCATED, receiver_styles
from vocc_torch.studies.paper.report.contents import Shown
from vocc_torch.studies.paper.report.pictures import blocks_of
from vocc_torch.studies.paper.report.rates import PAPER_RECEIVERS
from vocc_torch.studies.paper.report.words import rate_interval, ratio_interval, spaced


def dimming(grids: Mapping[str, Grid], figure: Shown) -> Section:
    """Give the heat maps, the best luminances and the loss of a panel that cannot dim."""
    blocks: list[Block] = [
        Paragraph(
            "The paper asks for it as future work (section IV-D-5): which LED luminance is best under which "
            "ambient light, and what does a panel lose that cannot dim?"
        ),
        *blocks_of(figure),
    ]
    for locator, grid in grids.items():
        blocks += [_best(grid, locator), _loss(grid, locator)]
    return Section("Beyond the paper: dimming", "dimming", tuple(blocks))


def _receivers(grid: Grid) -> list[tuple[str, str]]:
    """Give the paper's receivers in the grid, with their labels."""
    names = [name for name in PAPER_RECEIVERS if name in grid.receivers]
    return [(name, literal(style.label)) for name, style in receiver_styles(names).items()]


def _best(grid: Grid, locator: str) -> Table:
    """Give the best luminance for each ambient light."""
    rows = []
    for name, label in _receivers(grid):
        ranges = (literal(best.candidates_text) for best in undimmed_loss(grid, name).dimmed)
        slope = optimum_ratio(grid, name).slope
        told = "too few levels" if slope is None else ratio_interval(slope.value, slope.low, slope.high)
        rows.append((label, *ranges, literal(told)))
    header = ("receiver", *(spaced(f"{value:g} lx") for value in grid.rows), "slope in logarithms")
    caption = spaced(
        f"Best LED luminance (cd/m\u00b2) by ambient light, {LOCATED[locator]}: all that cannot be told "
        "from the best at 95 %. A slope of 1 is a constant ratio of luminance to ambient light, 0 a constant "
        "luminance"
    )
    return Table(header, tuple(rows), caption=caption)


def _loss(grid: Grid, locator: str) -> Table:
    """Give what a panel loses that cannot dim."""
    rows = []
    for name, label in _receivers(grid):
        loss = undimmed_loss(grid, name)
        cells = [label, _rate(loss.dimmed_mean)]
        for panel in (loss.fixed, loss.headlight):
            cells += [_panel(panel), _ratio(panel.ratio)]
        rows.append(tuple(cells))
    header = ("receiver", "dimmed", "one best luminance", "times", "headlight", "times")
    caption = spaced(
        f"Mean bit error rate over the ambient light, every octave alike, {LOCATED[locator]}: a panel "
        "dimmed to the best, one with the single best luminance, and one with the luminance of the grid that "
        f"is nearest to a headlight's {HEADLIGHT_CD_M2:g} cd/m\u00b2. \u201cTimes\u201d is the rate over "
        "that of the dimmed panel, in brackets 95 % intervals"
    )
    return Table(header, tuple(rows), caption=caption)


def _panel(panel: Undimmed) -> str:
    """Write a panel's luminance and its mean rate."""
    luminance = spaced(f"{panel.luminance_cd_m2:g} cd/m\u00b2")
    return f"{luminance}: {_rate(panel.mean)}"


def _rate(rate: Estimate) -> str:
    """Write a rate with its interval."""
    return literal(rate_interval(rate.value, rate.low, rate.high))


def _ratio(ratio: Estimate) -> str:
    """Write a ratio with its interval."""
    return literal(ratio_interval(ratio.value, ratio.low, ratio.high))
