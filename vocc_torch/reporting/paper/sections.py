"""The whole report on the paper."""

from __future__ import annotations

from collections.abc import Sequence

from vocc_torch.evaluation.scorecard import LocationSplit
from vocc_torch.reporting.paper.contents import Contents, Facts
from vocc_torch.reporting.paper.dimming_section import dimming
from vocc_torch.reporting.paper.pictures import blocks_of
from vocc_torch.reporting.paper.rates import PAPER_RECEIVERS
from vocc_torch.reporting.paper.scorecard_section import claims, matrix, summary
from vocc_torch.reporting.report.document import Block, Bullets, Code, Paragraph, Report, Section, Table
from vocc_torch.reporting.report.inline import literal
from vocc_torch.reporting.styles import receiver_styles, value_text

PAPER = (
    "Do and Yoo, [*A Multi-Feature LED Bit Detection Algorithm in Vehicular Optical Camera Communication*]"
    "(https://doi.org/10.1109/ACCESS.2019.2928600), IEEE Access 7, 2019"
)
_RATES = ("fig21", "fig22", "fig23", "fig24")
_GRID = "dimming"


def paper_report(contents: Contents) -> Report:
    """Put the report together; what was not measured is left out.

    Args:
        contents: everything that it shows.
    """
    sections = [Section("Summary", "summary", tuple(_summary(contents)))]
    if contents.scorecard is not None:
        sections += [claims(contents.scorecard), matrix(contents.scorecard)]
    if contents.location:
        sections.append(_location(contents.location))
    by_name = {figure.name: figure for figure in contents.figures}
    rates = [by_name[name] for name in _RATES if name in by_name]
    others = [figure for figure in contents.figures if figure.name not in (*_RATES, _GRID)]
    for title, anchor, figures in (
        ("Bit error rates: Figs 21 to 24", "rates", rates),
        ("The paper's other figures", "figures", others),
    ):
        if figures:
            sections.append(Section(title, anchor, ()))
            sections += [
                Section(figure.title, figure.name.replace("_", "-"), tuple(blocks_of(figure)), level=3)
                for figure in figures
            ]
        if anchor == "rates" and contents.grids and _GRID in by_name:
            sections.append(dimming(contents.grids, by_name[_GRID]))
    sections.append(_making(contents))
    title = "The paper's whole evidence, reproduced and scored"
    return Report(title, f"{PAPER}, against `vocc_torch`", tuple(sections))


def _summary(contents: Contents) -> list[Block]:
    """Give what a reader wants first."""
    blocks = [] if contents.scorecard is None else summary(contents.scorecard)
    totals = _totals(contents.location)
    if totals:
        blocks.append(Paragraph("**How much of the error rate is location:** " + "; ".join(totals) + "."))
    minutes = sum(contents.facts.seconds.values()) / 60
    blocks.append(
        Paragraph(
            f"Made by `{contents.facts.command}` in {minutes:.1f} minutes: {literal(contents.facts.budget)}."
        )
    )
    return blocks


def _totals(splits: Sequence[LocationSplit]) -> list[str]:
    """Say for three features how much of each experiment's errors is location."""
    return [
        f"{split.share.gain:.0%} [{split.share.low:.0%}, {split.share.high:.0%}] of the errors of three "
        f"features over {split.experiment}"
        for split in splits
        if split.value is None and split.receiver == "flda_3" and split.share is not None
    ]


def _location(splits: Sequence[LocationSplit]) -> Section:
    """Split errors into those of location and those of bit decision."""
    labels = {name: style.label for name, style in receiver_styles(PAPER_RECEIVERS).items()}
    rows = []
    for split in splits:
        if split.receiver not in labels:
            continue
        where = "all" if split.value is None else value_text(split.value)
        share = split.share
        told = "no error" if share is None else f"{share.gain:.0%} [{share.low:.0%}, {share.high:.0%}]"
        rates = (f"{split.located.ber:.1e}", f"{split.truth.ber:.1e}")
        rows.append((f"{split.experiment}, {where}", literal(labels[split.receiver]), *rates, told))
    blocks = (
        Paragraph(
            "Every frame was read twice, with the panel located as in section IV-B-2 and with its true "
            "corners. "
            "What is gone with true corners is location error; the rest is bit decision. The paper does not "
            "have this split."
        ),
        Table(
            ("point", "receiver", "BER, panel located", "BER, true corners", "share that is location"),
            tuple(row for row in rows if ", all" in row[0]),
            ("left", "left", "right", "right", "right"),
            caption="Location against decision, over all points of each experiment",
        ),
        Table(
            ("point", "receiver", "BER, panel located", "BER, true corners", "share that is location"),
            tuple(row for row in rows if ", all" not in row[0]),
            ("left", "left", "right", "right", "right"),
            caption="Location against decision, point by point",
            folded=True,
        ),
    )
    return Section("Location error or bit decision", "location", blocks)


def _making(contents: Contents) -> Section:
    """Say how the numbers were made."""
    facts = contents.facts
    blocks: list[Block] = [
        Code(facts.command),
        Paragraph(f"{literal(facts.budget)}. {literal(facts.machine)}."),
    ]
    blocks.append(_times(facts))
    if contents.others:
        blocks.append(Bullets(tuple(f"{what}: [`{path}`]({path})" for what, path in contents.others.items())))
    blocks.append(Code(facts.configuration))
    return Section("How this was made", "making", tuple(blocks))


def _times(facts: Facts) -> Table:
    """Give the wall-clock time by stage."""
    rows = [(literal(stage), f"{seconds:.1f}") for stage, seconds in facts.seconds.items()]
    rows.append(("all", f"{sum(facts.seconds.values()):.1f}"))
    return Table(("stage", "seconds"), tuple(rows), ("left", "right"), caption="Wall-clock time by stage")
