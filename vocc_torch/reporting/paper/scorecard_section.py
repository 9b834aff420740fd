"""The scorecard as sections of the report."""

from __future__ import annotations

from vocc_torch.evaluation.scorecard import VERDICTS, Scorecard, Verdict
from vocc_torch.reporting.paper.groups import Group, counted, groups_of
from vocc_torch.reporting.paper.statements import (
    OUTCOME_TONES,
    STATEMENTS,
    Statement,
    at_truth,
    causes,
    outcome,
)
from vocc_torch.reporting.paper.words import inline, plain, reading_text, sentence
from vocc_torch.reporting.report.document import Block, Cell, Paragraph, Section, Table, Tone
from vocc_torch.reporting.report.inline import literal

TONES: dict[Verdict, Tone] = {"agree": "agree", "differ": "differ", "cannot say": "unsure"}
"""How each verdict is shown."""


def scorecard_sections(scorecard: Scorecard) -> list[Section]:
    """Give the main statements, the counts by group, and every claim under the report's own reading."""
    groups = groups_of(scorecard)
    rules = Paragraph(
        "A quoted rate or share **differs** where the 95\N{NO-BREAK SPACE}% interval of the difference between "
        "ours and the paper's leaves out zero (the paper's frames are counted as ours are, for it states no "
        "interval). An order differs where a comparison on the same frames contradicts it beyond doubt; a "
        "lowest point where another value is lower beyond doubt. **Cannot say** means that these frames do "
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
    rows = []
    for statement in STATEMENTS:
        claims = statement.claims(scorecard)
        if not claims:
            continue
        found = outcome(claims)
        cells = [
            f"[{inline(statement.text)}](#{statement.anchor})",
            Cell(found, OUTCOME_TONES[found]),
            _agreeing(scorecard, statement, None),
        ]
        if truth is not None:
            depends = any(claim.basis == "curves" for claim, _ in claims)
            cells.append(_agreeing(scorecard, statement, truth) if depends else "")
        rows.append((*cells, _why(scorecard, statement)))
    header = ["the paper says", "here", "claims that agree"]
    header += ["with true corners"] if truth is not None else []
    caption = f"The paper's main statements against what was measured: {reading_text(scorecard.default)}"
    return Table((*header, "why not"), tuple(rows), caption=literal(caption))


def _agreeing(scorecard: Scorecard, statement: Statement, reading: object) -> str:
    raise NotImplementedError


def _why(scorecard: Scorecard, statement: Statement) -> str:
    raise NotImplementedError


def _counts(groups: tuple[Group, ...], scorecard: Scorecard) -> Table:
    raise NotImplementedError


def _claims(group: Group) -> Table:
    raise NotImplementedError
