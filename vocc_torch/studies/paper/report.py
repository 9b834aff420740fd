"""The report on the paper: what its template ``report.md.j2`` shows, and the two files."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from vocc_torch.files import atomic_file, write_atomically
from vocc_torch.measure.grid import Grid, best_luminance
from vocc_torch.show.page import SIGNS, html, render
from vocc_torch.show.styles import LOCATED, receiver_styles
from vocc_torch.studies.paper import scorecard, words
from vocc_torch.studies.paper.experiments import DIMMING, PAPER_RECEIVERS, RATE_FIGURES
from vocc_torch.studies.paper.figures import LocationSplit
from vocc_torch.studies.paper.judgement import VERDICTS
from vocc_torch.studies.paper.scorecard import Judged, Scorecard

TITLE = "The paper's whole evidence, reproduced and scored"
_SIGN = {
    **{"agree": SIGNS["agree"], "differ": SIGNS["differ"], "cannot say": SIGNS["unsure"]},
    **{"holds": SIGNS["agree"], "does not hold": SIGNS["differ"], "holds in part": ""},
}
_HEADINGS = {
    "holds": "Holds",
    "holds in part": "Holds in part",
    "does not hold": "Does not hold",
    "cannot say": "Cannot be decided",
}
_FEW = 3
"""Claims that differ are named under their figure where there are not more."""


@dataclass(frozen=True)
class ReportFigure:
    """A figure that has been written.

    Args:
        name: its name, such as ``fig22``.
        title: its headline.
        caption: what it shows.
        pictures: PNG files, relative to the report's folder, with a caption each; the figure's own where that
            is empty.
        table: CSV file with its data, relative to the report's folder.
        findings: its numbers by name.
    """

    name: str
    title: str
    caption: str
    pictures: tuple[tuple[Path, str], ...]
    table: Path
    findings: Mapping[str, float] = field(default_factory=dict)

    @property
    def anchor(self) -> str:
        """Its name in links."""
        return self.name.replace("_", "-")


@dataclass(frozen=True)
class RunFacts:
    """How the numbers were made.

    Args:
        command: what makes them again.
        budget: frames in words.
        machine: what they were made on, in words.
        seconds: wall-clock seconds by stage, in order.
        configuration: the resolved configuration, as YAML.
        resumed: whether an earlier run had counted some of the frames.
    """

    command: str
    budget: str
    machine: str
    seconds: Mapping[str, float]
    configuration: str
    resumed: bool = False


def write_report(
    folder: Path,
    facts: RunFacts,
    figures: Sequence[ReportFigure] = (),
    card: Scorecard | None = None,
    location: Sequence[LocationSplit] = (),
    grids: Mapping[str, Grid] | None = None,
    others: Mapping[str, Path] | None = None,
) -> None:
    """Write ``report.md`` and ``report.html``, both or neither; what was not measured is left out.

    Args:
        folder: where the two go, with the report's pictures and data in it.
        facts: how the numbers were made.
        figures: in order.
        card: the claims, or None where an experiment was left out.
        location: what location costs, with the report's own focal length.
        grids: bit error rates over ambient light and luminance by locator.
        others: further files by what they hold, relative to the folder.

    Raises:
        VoccError: a picture is missing, or a file cannot be written.
    """
    shown = {figure.name: _figure(figure, card) for figure in figures}
    rates = [one for name, one in shown.items() if name in {figure.name for figure in RATE_FIGURES}]
    beyond = {name: shown.get(name) for name in (DIMMING, "location")}
    shares = [one for one in location if one.value is None and one.receiver == "flda_3" and one.share]
    helpers = (
        *(words.plain, words.place, words.percent, words.sentence, words.reading_text),
        *(scorecard.tally, scorecard.outcome, scorecard.part_of, scorecard.fits, causes, why),
    )
    text = render(
        __package__,
        "report.md.j2",
        title=TITLE,
        facts=facts,
        minutes=sum(facts.seconds.values()) / 60,
        card=card,
        verdicts=VERDICTS,
        **({} if card is None else _of_card(card)),
        location=[split for split in location if split.receiver in PAPER_RECEIVERS],
        location_shares=shares,
        rates=rates,
        figures=[one for name, one in shown.items() if one not in rates and name not in beyond],
        dimming=beyond[DIMMING],
        best_luminances=_dimming(grids or {}),
        location_figure=beyond["location"],
        others=others or {},
        experiment=lambda name: words.EXPERIMENTS.get(name, name),
        receivers=words.RECEIVERS,
        signed=lambda word, text=None: f"{_SIGN[word]} {word if text is None else text}".lstrip(),
        **{helper.__name__: helper for helper in helpers},
    )
    page = html(text, TITLE, folder)
    with atomic_file(folder / "report.md") as temporary:
        temporary.write_bytes(text.encode("utf-8", "replace"))
        write_atomically(folder / "report.html", page.encode("utf-8", "replace"))


def _of_card(card: Scorecard) -> dict[str, object]:
    """What the report shows of the scorecard beyond its own lists."""
    parts: dict[scorecard.ClaimGroup, list[Judged]] = {part: [] for part in scorecard.PARTS}
    for judged in card.judged():
        parts[scorecard.part_of(judged[0])].append(judged)
    statements = {group: card.judged(group) for group in scorecard.STATEMENTS if card.judged(group)}
    outcomes: dict[str, list[str]] = {heading: [] for heading in _HEADINGS.values()}
    for group, claims in statements.items():
        agree, outcome = scorecard.tally(claims)["agree"], scorecard.outcome(claims)
        some = agree < len(claims) and outcome in ("holds", "holds in part")
        share = f" ({agree} of {len(claims)} claims)" if some else ""
        outcomes[_HEADINGS[outcome]].append(f"{group.text}{share}")
    return {
        "is_default": (card.own.focal_length_mm, card.own.locator) == scorecard.DEFAULT,
        "statements": statements,
        "outcomes": {heading: "; ".join(texts) for heading, texts in outcomes.items() if texts},
        "parts": {part: claims for part, claims in parts.items() if claims},
        "fit_head": ("reading", *scorecard.FIT_COLUMNS[1:]),
        "best": _best(card),
    }


def causes(card: Scorecard, claims: Sequence[Judged]) -> list[tuple[str, int]]:
    """The known causes of claims that differ, each with how many of them it holds for.

    Args:
        card: the scorecard.
        claims: any claims; those that do not differ are passed over.
    """
    truth = card.at_truth()
    counts = dict.fromkeys(scorecard.CAUSES, 0)
    for claim, judged in claims:
        if judged.verdict == "differ":
            held = set(judged.causes)
            if truth is not None and claim.basis == "curves":
                held.add(card.judgements[claim.claim, truth.name].verdict)
            for name in held & set(counts):
                counts[name] += 1
    return [(scorecard.CAUSES[name], count) for name, count in counts.items() if count]


def why(card: Scorecard, claims: Sequence[Judged]) -> str:
    """Say why a statement does not hold in every claim: the known causes, and the surest contradiction.

    Where nothing contradicts it, say what kept a claim from being decided.
    """
    differing = [one for one in claims if one[1].verdict == "differ"]
    if not differing:
        silent = [judged.reason for _, judged in claims if judged.verdict == "cannot say" and judged.reason]
        return f"not decided: {silent[0]}" if silent else ""
    claim, judged = differing[0]
    example = f"{claim.text}: {judged.measured}, where the paper has {claim.paper}"
    if judged.against:
        one = judged.against[0]
        example = (f"{one.above[0]}: " if one.above[0] == one.below[0] else "") + one.text()
    parts = [
        text + (f" ({count} of {len(differing)})" if len(differing) > 1 else "")
        for text, count in causes(card, claims)
    ]
    return "; ".join([*parts, f"for example, {example}"])


def _best(card: Scorecard) -> dict[str, object] | None:
    """The reading that is nearest to the quoted rates and how surely; None where none was measured."""
    found = scorecard.fits(card)
    known = [(fit, fit.decades) for fit in found if fit.decades is not None]
    if not known:
        return None
    best, decades = min(known, key=lambda one: one[1].value)
    most = max(fit.tally["agree"] for fit in found)
    leaders = [fit.reading for fit in found if fit.tally["agree"] == most]
    return {
        "reading": best.reading,
        "factor": 10**decades.value,
        "others": len(found) - 1,
        "near": sum(other.low <= decades.high for fit, other in known if fit is not best),
        "most": most,
        "total": sum(best.tally.values()),
        "leaders": words.joined([words.reading_text(one.focal_length_mm, one.locator) for one in leaders]),
    }


def _figure(figure: ReportFigure, card: Scorecard | None) -> dict[str, object]:
    """A figure's pictures, what the scorecard says of it, and its numbers."""
    numbers = set(map(int, re.findall(r"\d+", figure.name)))
    claims = [
        one
        for one in (card.judged() if card is not None else [])
        if numbers & set(map(int, re.findall(r"Fig\. (\d+)", one[0].where)))
    ]
    differing = [one for one in claims if one[1].verdict == "differ"]
    head, rows = words.number_table(figure.findings)
    own = f"The paper: {figure.caption}" if figure.name.startswith("fig") else figure.caption
    return {
        "figure": figure,
        "pictures": [(path.as_posix(), caption or own) for path, caption in figure.pictures],
        "tally": scorecard.tally(claims) if claims else None,
        "parts": list(dict.fromkeys(scorecard.part_of(claim) for claim, _ in claims)),
        "differing": differing if len(differing) <= _FEW else [],
        "head": head,
        "rows": rows,
    }


def _dimming(grids: Mapping[str, Grid]) -> list[dict[str, object]]:
    """The best luminance for each ambient light, a table a locator."""
    tables: list[dict[str, object]] = []
    for locator, grid in grids.items():
        names = [name for name in PAPER_RECEIVERS if name in grid.receivers]
        rows = [
            (style.label, *(best.candidates_text for best in best_luminance(grid, name)))
            for name, style in receiver_styles(names).items()
        ]
        head = ("receiver", *(words.place(grid.row_axis, level) for level in grid.rows))
        tables.append({"located": LOCATED[locator], "head": head, "rows": rows})
    return tables
