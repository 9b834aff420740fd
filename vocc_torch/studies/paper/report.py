"""The report on the paper: what its template ``report.md.j2`` shows, and the two files."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vocc_torch.files import atomic_file, write_atomically
from vocc_torch.measure.grid import Grid, best_luminance
from vocc_torch.show.page import SIGNS, html, render
from vocc_torch.show.styles import LOCATED, receiver_styles
from vocc_torch.studies.paper.claims import CAUSES, PARTS, STATEMENTS, ClaimGroup, part_of
from vocc_torch.studies.paper.figures import PAPER_RECEIVERS, RATE_FIGURES
from vocc_torch.studies.paper.judgement import VERDICTS, PaperReading
from vocc_torch.studies.paper.location import LocationSplit
from vocc_torch.studies.paper.words import number_table
from vocc_torch.studies.paper.scorecard import (
    DEFAULT,
    FIT_COLUMNS,
    Judged,
    Scorecard,
    fits,
    outcome,
    tally,
)
from vocc_torch.studies.paper.words import (
    EXPERIMENTS,
    RECEIVERS,
    joined,
    percent,
    place,
    plain,
    reading_text,
    sentence,
)

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
    rates = [figure for figure in figures if figure.name in {one.name for one in RATE_FIGURES}]
    by_name = {figure.name: figure for figure in figures if figure.name in ("dimming", "location")}
    shares = [split for split in location if split.value is None and split.receiver == "flda_3"]
    text = render(
        __package__,
        "report.md.j2",
        title=TITLE,
        facts=facts,
        minutes=sum(facts.seconds.values()) / 60,
        card=None if card is None else _card(card),
        location=[split for split in location if split.receiver in PAPER_RECEIVERS],
        location_shares=[split for split in shares if split.share],
        rates=[_figure(figure, card) for figure in rates],
        figures=[_figure(one, card) for one in figures if one not in rates and one.name not in by_name],
        dimming=_figure(by_name["dimming"], None) | {"tables": _dimming(grids or {})}
        if "dimming" in by_name
        else None,
        location_figure=_figure(by_name["location"], None) if "location" in by_name else None,
        others=others or {},
        plain=plain,
        place=place,
        experiment=lambda name: EXPERIMENTS.get(name, name),
        receivers=RECEIVERS,
        percent=percent,
        sentence=sentence,
        signed=lambda word, text=None: f"{_SIGN[word]} {word if text is None else text}".lstrip(),
    )
    page = html(text, TITLE, folder)
    with atomic_file(folder / "report.md") as temporary:
        temporary.write_bytes(text.encode("utf-8", "replace"))
        write_atomically(folder / "report.html", page.encode("utf-8", "replace"))


def _card(card: Scorecard) -> dict[str, object]:
    """Give what the report shows of the scorecard."""
    every, truth, found = card.judged(), card.at_truth(), fits(card)
    parts: dict[ClaimGroup, list[Judged]] = {part: [] for part in PARTS}
    for judged in every:
        parts[part_of(judged[0])].append(judged)
    statements = [_statement(card, group, truth) for group in STATEMENTS if card.judged(group)]
    outcomes: dict[str, list[str]] = {heading: [] for heading in _HEADINGS.values()}
    for one in statements:
        some = one["agree"] < one["total"] and one["outcome"] in ("holds", "holds in part")
        share = f" ({one['agree']} of {one['total']} claims)" if some else ""
        outcomes[_HEADINGS[one["outcome"]]].append(f"{one['text']}{share}")
    return {
        "verdicts": VERDICTS,
        "tally": tally(every),
        "total": len(every),
        "own": _name(card.own),
        "is_default": (card.own.focal_length_mm, card.own.locator) == DEFAULT,
        "with_truth": truth is not None,
        "statements": statements,
        "outcomes": {heading: "; ".join(texts) for heading, texts in outcomes.items() if texts},
        "causes": causes(card, every),
        "parts": [
            {
                "title": part.text,
                "anchor": part.anchor,
                "claims": claims,
                "tally": tally(claims),
            }
            for part, claims in parts.items()
            if claims
        ],
        "readings": [_name(reading) for reading in card.readings],
        "fit_head": ("reading", *FIT_COLUMNS[1:]),
        "fits": [(_name(fit.reading), *fit.row()[1:]) for fit in found],
        "best": _best(card),
        "matrix": [
            (claim, [card.judgements[claim.claim, reading.name].verdict for reading in card.readings])
            for claim in card.claims
            if claim.basis == "curves"
        ],
    }


def _name(reading: PaperReading) -> str:
    """Name a reading for people."""
    return reading_text(reading.focal_length_mm, reading.locator)


def _statement(card: Scorecard, group: ClaimGroup, truth: PaperReading | None) -> dict[str, Any]:
    """Give a main statement with the verdicts that it stands on, and why it fails."""
    claims = card.judged(group)
    depends = any(claim.basis == "curves" for claim, _ in claims)
    at_truth = card.judged(group, truth) if truth is not None and depends else []
    by_reading = [card.judged(group, reading) for reading in card.readings] if depends else []
    return {
        "text": group.text,
        "anchor": part_of(claims[0][0]).anchor,
        "outcome": outcome(claims),
        "agree": tally(claims)["agree"],
        "total": len(claims),
        "tally": tally(claims),
        "at_truth": tally(at_truth) if at_truth else None,
        "why": why(card, claims),
        "by_reading": [(outcome(one), tally(one)["agree"]) for one in by_reading],
    }


def causes(card: Scorecard, claims: Sequence[Judged]) -> list[tuple[str, int]]:
    """Give the known causes of claims that differ, each with how many of them it holds for.

    Args:
        card: the scorecard.
        claims: any claims; those that do not differ are passed over.
    """
    truth = card.at_truth()
    counts = dict.fromkeys(CAUSES, 0)
    for claim, judged in claims:
        if judged.verdict == "differ":
            held = set(judged.causes)
            if truth is not None and claim.basis == "curves":
                held.add(card.judgements[claim.claim, truth.name].verdict)
            for name in held & set(CAUSES):
                counts[name] += 1
    return [(CAUSES[name], count) for name, count in counts.items() if count]


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
    """Give the reading that is nearest to the quoted rates and how surely; None where none was measured."""
    found = fits(card)
    known = [(fit, fit.decades) for fit in found if fit.decades is not None]
    if not known:
        return None
    best, decades = min(known, key=lambda one: one[1].value)
    most = max(fit.tally["agree"] for fit in found)
    return {
        "name": _name(best.reading),
        "factor": 10**decades.value,
        "others": len(found) - 1,
        "near": sum(other.low <= decades.high for fit, other in known if fit is not best),
        "most": most,
        "total": sum(best.tally.values()),
        "leaders": joined([_name(fit.reading) for fit in found if fit.tally["agree"] == most]),
    }


def _figure(figure: ReportFigure, card: Scorecard | None) -> dict[str, object]:
    """Give a figure's pictures, what the scorecard says of it, and its numbers."""
    numbers = {int(number) for number in re.findall(r"\d+", figure.name)}
    claims = [
        one
        for one in (card.judged() if card is not None else [])
        if numbers & {int(number) for number in re.findall(r"Fig\. (\d+)", one[0].where)}
    ]
    differing = [one for one in claims if one[1].verdict == "differ"]
    head, rows = number_table(figure.findings)
    own = f"The paper: {figure.caption}" if figure.name.startswith("fig") else figure.caption
    return {
        "figure": figure,
        "pictures": [(path.as_posix(), caption or own) for path, caption in figure.pictures],
        "table": figure.table.as_posix(),
        "tally": tally(claims) if claims else None,
        "parts": list(dict.fromkeys(part_of(claim) for claim, _ in claims)),
        "differing": differing if len(differing) <= _FEW else [],
        "head": head,
        "rows": rows,
    }


def _dimming(grids: Mapping[str, Grid]) -> list[dict[str, object]]:
    """Give the best luminance for each ambient light, a table a locator."""
    tables: list[dict[str, object]] = []
    for locator, grid in grids.items():
        names = [name for name in PAPER_RECEIVERS if name in grid.receivers]
        rows = [
            (style.label, *(best.candidates_text for best in best_luminance(grid, name)))
            for name, style in receiver_styles(names).items()
        ]
        head = ("receiver", *(place(grid.row_axis, level) for level in grid.rows))
        tables.append({"located": LOCATED[locator], "head": head, "rows": rows})
    return tables
