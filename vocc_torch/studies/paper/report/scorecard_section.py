"""The scorecard as sections of the report."""

from __future__ import annotations

from collections.abc import Sequence

from vocc_torch.show.report.document import Block, Cell, Paragraph, Section, Table, Tone
from vocc_torch.show.report.inline import literal
from vocc_torch.studies.paper.report.groups import Group, Judged, counted, groups_of, tally_text
from vocc_torch.studies.paper.report.statements import OUTCOME_TONES, STATEMENTS, at_truth, causes, outcome
from vocc_torch.studies.paper.report.words import inline, plain, reading_text, sentence, spaced
from vocc_torch.studies.paper.scorecard import VERDICTS, Claim, Judgement, Scorecard, Verdict

TONES: dict[Verdict, Tone] = {"agree": "agree", "differ": "differ", "cannot say": "unsure"}
"""How each verdict is shown."""


def scorecard_sections(scorecard: Scorecard) -> list[Section]:
    """Give the main statements, the counts by group, and every claim under the report's own reading."""
    groups = groups_of(scorecard)
    rules = Paragraph(
        "A quoted rate or share **differs** where the 95\N{NO-BREAK SPACE}% interval of the difference "
        "between ours and the paper's leaves out zero (the paper states no interval; it is given that of its "
        "own number of frames). An order differs where any comparison, on the same frames, contradicts it "
        "beyond doubt, and **agrees** where none does and at least half support it beyond doubt; a lowest "
        "point differs where another value is lower beyond doubt. **Cannot say** means that these frames do "
        "not decide. Numbers of single pictures are compared as they are."
    )
    opening: list[Block] = [main_statements(scorecard), rules, _counts(groups, scorecard)]
    return [
        Section("Scorecard", "scorecard", tuple(opening)),
        *(Section(group.title, group.anchor, (_claims(group),), level=3) for group in groups),
    ]


def main_statements(scorecard: Scorecard) -> Table:
    """Give the paper's main statements, each with the verdicts that it stands on and why it fails."""
    truth = at_truth(scorecard)
    rows: list[tuple[str | Cell, ...]] = []
    for statement in STATEMENTS:
        claims = statement.claims(scorecard)
        if not claims:
            continue
        found = outcome(claims)
        cells: list[str | Cell] = [
            f"[{inline(statement.text)}](#{statement.anchor})",
            Cell(found, OUTCOME_TONES[found]),
            _agreeing(claims),
        ]
        if truth is not None:
            depends = any(claim.basis == "curves" for claim, _ in claims)
            cells.append(_agreeing(statement.claims(scorecard, truth)) if depends else "")
        rows.append((*cells, _why(scorecard, claims)))
    header = ["the paper says", "here", "claims that agree"]
    header += ["with true corners"] if truth is not None else []
    caption = f"The paper's main statements against what was measured: {reading_text(scorecard.default)}"
    return Table((*header, "why not"), tuple(rows), caption=literal(caption))


def _agreeing(claims: Sequence[Judged]) -> str:
    """Say how many of some claims agree, and how many cannot be decided."""
    found = counted(claims)
    text = f"{found['agree']} of {len(claims)}"
    return text + (f", {found['cannot say']} cannot be decided" if found["cannot say"] else "")


def _why(scorecard: Scorecard, claims: Sequence[Judged]) -> str:
    """Say why a statement does not hold in every claim: the known causes, and the surest contradiction.

    Where nothing contradicts it, say what kept a claim from being decided.
    """
    differing = [one for one in claims if one[1].verdict == "differ"]
    if not differing:
        silent = [judged.reason for _, judged in claims if judged.verdict == "cannot say" and judged.reason]
        return literal(sentence(f"not decided: {plain(silent[0])}")) if silent else ""
    parts = [
        cause.text + (f" ({cause.claims} of {len(differing)})" if len(differing) > 1 else "")
        for cause in causes(scorecard, claims)
    ]
    return literal(sentence("; ".join([*parts, f"for example, {_example(*differing[0])}"])))


def _example(claim: Claim, judged: Judgement) -> str:
    """Give what contradicts a claim most surely, or what was measured against what is quoted."""
    if not judged.against:
        return f"{plain(claim.text)}: {plain(judged.measured)}, where the paper has {plain(claim.paper)}"
    one = judged.against[0]
    of_one = one.above.receiver == one.below.receiver
    return (f"{plain(one.above.receiver)}: " if of_one else "") + plain(one.text())


def _counts(groups: Sequence[Group], scorecard: Scorecard) -> Table:
    """Count the verdicts of each group, with links to the groups."""
    rows = [
        (f"[{inline(group.title)}](#{group.anchor})", len(group.claims), counted(group.claims))
        for group in groups
    ]
    rows.append(("all", len(scorecard.claims), scorecard.tally()))
    return Table(
        ("claims on", "claims", *VERDICTS),
        tuple((name, str(total), *(str(found[v]) for v in VERDICTS)) for name, total, found in rows),
        ("left", "right", "right", "right", "right"),
        caption="Verdicts by group",
    )


def _claims(group: Group) -> Table:
    """Give a group's claims."""
    rows: list[tuple[str | Cell, ...]] = []
    explained = any(judged.reason for _, judged in group.claims)
    for claim, judged in group.claims:
        text = literal(sentence(plain(claim.text)))
        paper = f"Paper ({inline(claim.where)}): **{inline(claim.paper)}**"
        cells = (f"{text} {paper}", inline(judged.measured), Cell(judged.verdict, TONES[judged.verdict]))
        why = literal(sentence(plain(judged.reason))) if judged.reason else ""
        rows.append((*cells, why) if explained else cells)
    caption = f"{sentence(tally_text(group.claims))} In brackets 95 % intervals, frames as independent units"
    header = ("claim", "measured", "verdict", "why") if explained else ("claim", "measured", "verdict")
    return Table(header, tuple(rows), caption=literal(spaced(caption)))
