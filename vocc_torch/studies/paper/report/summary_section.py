"""What a reader of the paper wants to know first."""

from __future__ import annotations

from collections import defaultdict

from vocc_torch.show.report.document import Block, Bullets, Highlight, Highlights, Paragraph, Section
from vocc_torch.show.report.inline import literal
from vocc_torch.studies.paper.report.contents import Contents, Facts
from vocc_torch.studies.paper.report.groups import counted
from vocc_torch.studies.paper.report.location_section import totals_text
from vocc_torch.studies.paper.report.readings_section import best_text
from vocc_torch.studies.paper.report.scorecard_section import TONES
from vocc_torch.studies.paper.report.statements import STATEMENTS, Outcome, causes, outcome
from vocc_torch.studies.paper.report.words import inline, reading_text, sentence, spaced
from vocc_torch.studies.paper.scorecard import VERDICTS, Scorecard
from vocc_torch.studies.paper.scorecard.score import DEFAULT

_WORDS = {
    "agree": "claims and quoted numbers of the paper that are the same here",
    "differ": "that are otherwise here",
    "cannot say": "that these frames cannot decide",
}
_OUTCOMES: dict[Outcome, str] = {
    "holds": "Holds",
    "holds in part": "Holds in part",
    "does not hold": "Does not hold",
    "cannot say": "Cannot be decided",
}


def summary(contents: Contents) -> Section:
    """Give verdicts in sum, what they rest on, and how long it took."""
    blocks: list[Block] = [] if contents.scorecard is None else _verdicts(contents.scorecard)
    if text := totals_text(contents.location):
        blocks.append(Paragraph(f"{text} [How that is known](#location)"))
    blocks.append(Paragraph(made(contents.facts)))
    return Section("Summary", "summary", tuple(blocks))


def made(facts: Facts) -> str:
    """Say as inline text what made the numbers, and how long it took."""
    minutes = spaced(f"{sum(facts.seconds.values()) / 60:.1f} min")
    text = f"Made by `{facts.command}` in {minutes}"
    text += ", going on from what an earlier run had counted" if facts.resumed else ""
    return f"{text}: {literal(facts.budget)}."


def _verdicts(scorecard: Scorecard) -> list[Block]:
    """Say what holds, what does not and why."""
    tally = scorecard.tally()
    items = [Highlight(str(tally[verdict]), _WORDS[verdict], TONES[verdict]) for verdict in VERDICTS]
    own = scorecard.default
    text = f"The report's own reading is **{literal(reading_text(own))}**"
    if (own.focal_length_mm, own.locator) == DEFAULT:
        text += ": Table 1's focal length, and the panel located in each frame as in section IV-B-2"
    return [
        Highlights(tuple(items)),
        Paragraph(f"{text}. Under it:"),
        Bullets(tuple(_outcomes(scorecard))),
        *_why(scorecard),
        Paragraph(f"{best_text(scorecard)} [Every reading](#readings)"),
    ]


def _outcomes(scorecard: Scorecard) -> list[str]:
    """List the main statements by outcome, as inline texts."""
    found: dict[Outcome, list[str]] = defaultdict(list)
    for statement in STATEMENTS:
        claims = statement.claims(scorecard)
        if not claims:
            continue
        result = outcome(claims)
        text, agree = inline(statement.text), counted(claims)["agree"]
        if result in ("holds", "holds in part") and agree < len(claims):
            text += f" ({agree} of {len(claims)} claims)"
        found[result].append(text)
    return [f"**{words}:** {'; '.join(found[key])}." for key, words in _OUTCOMES.items() if found[key]]


def _why(scorecard: Scorecard) -> list[Block]:
    """Say why claims differ."""
    more = "The [scorecard](#scorecard) has every claim with its reason."
    known = causes(scorecard, scorecard.details())
    if not known:
        return [Paragraph(more)]
    differing = scorecard.tally()["differ"]
    verb = "differs" if differing == 1 else "differ"
    text = (
        f"**Why {_claims(differing)} {verb}**, as far as the measurements tell; one may have several reasons."
    )
    return [
        Paragraph(f"{text} {more}"),
        Bullets(tuple(f"{literal(sentence(cause.text))} **{_claims(cause.claims)}**" for cause in known)),
    ]


def _claims(count: int) -> str:
    """Write a number of claims."""
    return "1 claim" if count == 1 else f"{count} claims"
