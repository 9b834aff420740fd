"""How much of the error rate is location, as a section of the report."""

from __future__ import annotations

from collections.abc import Sequence

from vocc_torch.show.report.document import Align, Block, Paragraph, Section, Table
from vocc_torch.show.report.inline import literal
from vocc_torch.show.styles import receiver_styles
from vocc_torch.studies.paper.report.contents import Shown
from vocc_torch.studies.paper.report.pictures import blocks_of
from vocc_torch.studies.paper.report.rates import PAPER_RECEIVERS
from vocc_torch.studies.paper.report.words import (
    EXPERIMENTS,
    inline,
    listed,
    rate_with,
    share_interval,
    spaced,
)
from vocc_torch.studies.paper.scorecard import LocationSplit
from vocc_torch.studies.paper.scorecard.words import place

_HEADER = ("points", "receiver", "BER, panel located", "BER, true corners", "share that is location")


def location(splits: Sequence[LocationSplit], figure: Shown | None = None) -> Section:
    """Split errors into those of location and those of bit decision.

    Args:
        splits: with the report's own focal length; at least one.
        figure: the picture of the totals, if it was drawn.
    """
    shown = [split for split in splits if split.receiver in PAPER_RECEIVERS]
    totals = [split for split in shown if split.value is None]
    blocks: list[Block] = [
        Paragraph(
            "A receiver first finds the panel in the frame, then decides each LED's bit. To tell the errors "
            "of the one step from those of the other, every frame was read twice: with the panel located as "
            "in section IV-B-2, and with its true corners, which only a simulation knows. What is wrong with "
            "true corners too is **decision error**; what they mend is **location error**. Receivers were "
            "trained with the corners that they are tested with. The paper does not have this split."
        ),
    ]
    if text := totals_text(totals):
        blocks.append(Paragraph(text))
    if figure is not None:
        blocks += blocks_of(figure)
    blocks += [
        _table(totals, "Location error and decision error over all points of each experiment", folded=False),
        _table(
            [split for split in shown if split.value is not None],
            "Location error and decision error, point by point",
            folded=True,
        ),
    ]
    return Section("Location error or bit decision", "location", tuple(blocks))


def totals_text(splits: Sequence[LocationSplit]) -> str:
    """Say as inline text how much of three features' errors is location; empty where nothing is known."""
    parts = [
        f"{literal(share_interval(split.share.gain, split.share.low, split.share.high))} over "
        f"{EXPERIMENTS.get(split.experiment, split.experiment)}"
        for split in splits
        if split.value is None and split.receiver == "flda_3" and split.share is not None
    ]
    if not parts:
        return ""
    return (
        f"**Of the errors of AGR + GRI + NGR, location makes** {listed(parts)}; bit decision makes the rest."
    )


def _table(splits: Sequence[LocationSplit], caption: str, *, folded: bool) -> Table:
    """Lay splits out."""
    labels = {name: style.label for name, style in receiver_styles(PAPER_RECEIVERS).items()}
    rows = []
    for split in splits:
        where = EXPERIMENTS.get(split.experiment, split.experiment)
        if split.value is not None:
            where += f", {place(split.axis, split.value)}".replace(" contrast", "")
        located, truth = split.intervals()
        rates = (rate_with(split.located.ber, located), rate_with(split.truth.ber, truth))
        share = split.share
        told = "no error" if share is None else share_interval(share.gain, share.low, share.high)
        label = literal(labels[split.receiver])
        rows.append((inline(where), label, *(literal(rate) for rate in rates), literal(told)))
    told = caption if folded else f"{caption}. In brackets 95 % intervals; < is a limit without errors"
    align: tuple[Align, ...] = ("left", "left", "right", "right", "right")
    return Table(_HEADER, tuple(rows), align, caption=literal(spaced(told)), folded=folded)
