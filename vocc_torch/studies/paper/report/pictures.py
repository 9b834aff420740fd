"""Figures as blocks of the report."""

from __future__ import annotations

from vocc_torch.show.report.document import Block, Paragraph, Picture
from vocc_torch.show.report.inline import literal
from vocc_torch.studies.paper.report.contents import Shown
from vocc_torch.studies.paper.report.groups import groups_of, on_figure, tally_text
from vocc_torch.studies.paper.report.numbers import numbers_table
from vocc_torch.studies.paper.report.words import inline, listed, spaced
from vocc_torch.studies.paper.scorecard import Scorecard

_FEW = 3
"""Claims that differ are named under their figure where there are not more."""


def blocks_of(figure: Shown, scorecard: Scorecard | None = None) -> list[Block]:
    """Give a figure's pictures, what the scorecard says of them, and the figure's numbers.

    Args:
        figure: a written figure.
        scorecard: the claims; None where they were not judged.
    """
    blocks: list[Block] = []
    for path, caption in figure.pictures:
        of_paper = figure.name.startswith("fig")
        text = spaced(caption or (f"The paper: {figure.caption}" if of_paper else figure.caption))
        blocks.append(Picture(path, literal(text), alt=f"{figure.title}. {text}", data=figure.table))
    if scorecard is not None:
        blocks += _verdicts(figure, scorecard)
    if figure.findings:
        blocks.append(numbers_table(figure.title, figure.findings))
    return blocks


def _verdicts(figure: Shown, scorecard: Scorecard) -> list[Block]:
    """Say how the claims on a figure were judged, with links to them."""
    claims = on_figure(scorecard, figure.name)
    if not claims:
        return []
    keys = {claim.key for claim, _ in claims}
    links = [
        f"[{literal(group.title.partition(':')[0].lower())}](#{group.anchor})"
        for group in groups_of(scorecard)
        if keys & {claim.key for claim, _ in group.claims}
    ]
    text = f"**Measured here:** {tally_text(claims)} (scorecard: {listed(links)})."
    differing = [
        f"{inline(claim.text)} (measured: {inline(judged.measured)})"
        for claim, judged in claims
        if judged.verdict == "differ"
    ]
    if 0 < len(differing) <= _FEW:
        text += f" Not so: {'; '.join(differing)}."
    return [Paragraph(text)]
