"""Which reading of what the paper leaves open fits best, as a section of the report."""

from __future__ import annotations

from vocc_torch.show.report.document import Cell, Paragraph, Section, Table
from vocc_torch.show.report.inline import literal
from vocc_torch.studies.paper.report.groups import counted
from vocc_torch.studies.paper.report.scorecard_section import TONES
from vocc_torch.studies.paper.report.statements import OUTCOME_TONES, STATEMENTS, outcome
from vocc_torch.studies.paper.report.words import inline, listed, plain, reading_text, sentence, spaced
from vocc_torch.studies.paper.scorecard import VERDICTS, Fit, Scorecard, best_reading, fits

FIT_COLUMNS = ("reading", *VERDICTS, "distance to quoted rates", "distance to quoted gains")
"""Columns of ``fits.csv``."""


def readings(scorecard: Scorecard) -> Section:
    """Give the main statements and every claim under every reading, and how well each reading fits."""
    names = [literal(reading_text(reading)) for reading in scorecard.readings]
    blocks = (
        Paragraph(
            spaced(
                "The paper leaves open the focal length (18 mm in the text of section IV-C, 25 mm in "
                "Table 1), the locator's details, the meter's constant K, the f-number N and what is between "
                "the LEDs. K and N cancel while auto-ISO meets its target. Varied here are the focal length "
                "and where the panel's corners come from. True corners are no reading of the paper, which "
                "locates the panel itself: they show what a perfect locator would give."
            )
        ),
        Paragraph(best_text(scorecard)),
        _fits(scorecard),
        _statements(scorecard, names),
        _matrix(scorecard, names),
    )
    return Section("Which reading fits", "readings", blocks)


def best_text(scorecard: Scorecard) -> str:
    """Say as inline text which reading is nearest to the quoted rates, and how surely."""
    texts = {reading.name: literal(reading_text(reading)) for reading in scorecard.readings}
    found = fits(scorecard)
    best = best_reading(found)
    of_best = next((fit for fit in found if fit.reading == best.reading), None)
    if of_best is None or of_best.rates is None:
        return "No quoted error rate was measured under any reading."
    rates, others = of_best.rates, len(found) - 1
    near = [
        fit for fit in found if fit is not of_best and fit.rates is not None and fit.rates.low <= rates.high
    ]
    text = (
        f"Nearest to the paper's four quoted error rates is **{texts[best.reading]}**: on average a factor "
        f"of {10**rates.decades:.1f} away."
    )
    if others:
        text += (
            f" Of the other {others} readings, {_number(len(near))} cannot be told from it."
            if near
            else " Every other reading is farther away beyond doubt."
        )
    most = max(fit.tally["agree"] for fit in found)
    leaders = [texts[fit.reading] for fit in found if fit.tally["agree"] == most]
    total = sum(of_best.tally.values())
    text += (
        f" Most claims, {most} of the {total} that depend on the reading, agree under **{listed(leaders)}**."
    )
    return text


def _number(count: int) -> str:
    """Write a small number."""
    return {1: "one"}.get(count, str(count))


def _fits(scorecard: Scorecard) -> Table:
    """Give how well each reading fits."""
    texts = [literal(reading_text(reading)) for reading in scorecard.readings]
    rows = tuple(
        (text, *(inline(cell) for cell in line[1:]))
        for text, line in zip(texts, fit_rows(scorecard)[1:], strict=True)
    )
    caption = (
        "How well each reading fits: verdicts of the claims that depend on it, and how far its numbers are "
        "from the quoted ones on average; a decade is a factor of ten, a point a percentage point"
    )
    return Table(FIT_COLUMNS, rows, ("left", "right", "right", "right", "left", "left"), caption=caption)


def _statements(scorecard: Scorecard, names: list[str]) -> Table:
    """Give how many claims of each main statement agree under every reading."""
    rows: list[tuple[str | Cell, ...]] = []
    for statement in STATEMENTS:
        lines = [statement.claims(scorecard, reading) for reading in scorecard.readings]
        if not any(claim.basis == "curves" for claim, _ in lines[0]):
            continue
        cells = [
            Cell(f"{counted(line)['agree']} of {len(line)}", OUTCOME_TONES[outcome(line)]) for line in lines
        ]
        rows.append((f"[{inline(statement.text)}](#{statement.anchor})", *cells))
    caption = "Main statements under every reading: how many of their claims agree"
    return Table(("the paper says", *names), tuple(rows), caption=caption)


def _matrix(scorecard: Scorecard, names: list[str]) -> Table:
    """Give every claim's verdict under every reading."""
    rows: list[tuple[str | Cell, ...]] = [
        (
            f"{literal(sentence(plain(claim.text)))} ({inline(claim.where)})",
            *(Cell(verdict, TONES[verdict]) for verdict in verdicts),
        )
        for claim, verdicts in scorecard.matrix()
        if claim.basis == "curves"
    ]
    caption = "Verdict of every claim that depends on the reading"
    return Table(("claim", *names), tuple(rows), caption=caption, folded=True)


def fit_rows(scorecard: Scorecard) -> list[tuple[str, ...]]:
    """Give how well each reading fits, a line each, the head first."""
    return [FIT_COLUMNS, *(_fit_row(one) for one in fits(scorecard))]


def _fit_row(fit: Fit) -> tuple[str, ...]:
    """Write how well one reading fits."""
    rates = "not measured"
    if fit.rates is not None:
        free = (
            f", {fit.rates.error_free} of {fit.rates.points} without errors" if fit.rates.error_free else ""
        )
        rates = f"{fit.rates.decades:.2f} decades [{fit.rates.low:.2f}, {fit.rates.high:.2f}]{free}"
    gains = "none defined" if fit.gain_points is None else f"{fit.gain_points:.0f} points over {fit.gains}"
    return (fit.reading, *(str(fit.tally[verdict]) for verdict in VERDICTS), rates, gains)
