"""The scorecard as sections of the report."""

from __future__ import annotations

from vocc_torch.evaluation.scorecard import VERDICTS, Fit, Scorecard, Verdict, best_reading, fits
from vocc_torch.reporting.report.document import (
    Block,
    Bullets,
    Cell,
    Highlight,
    Highlights,
    Paragraph,
    Section,
    Table,
    Tone,
)
from vocc_torch.reporting.report.inline import literal

TONES: dict[Verdict, Tone] = {"agree": "agree", "differ": "differ", "cannot say": "unsure"}
"""How each verdict is shown."""
FIT_COLUMNS = ("reading", *VERDICTS, "distance to quoted rates", "distance to quoted gains")


def summary(scorecard: Scorecard) -> list[Block]:
    """Give the numbers that a reader wants first."""
    tally, best = scorecard.tally(), best_reading(fits(scorecard))
    words = {
        "agree": "claims and numbers of the paper that we measure too",
        "differ": "that we measure otherwise",
        "cannot say": "that these frames cannot decide",
    }
    items = [Highlight(str(tally[verdict]), words[verdict], TONES[verdict]) for verdict in VERDICTS]
    sure = "beyond doubt" if best.clear else "though not beyond doubt"
    return [
        Highlights(tuple(items)),
        Paragraph(
            f"Under the report's own reading, **{literal(scorecard.default.name)}**. The reading nearest to "
            f"the quoted error rates is **{literal(best.reading or 'none')}**, {sure}: {literal(best.why)}."
        ),
    ]


def claims(scorecard: Scorecard) -> Section:
    """Give every claim under the report's own reading."""
    rows = [
        (
            literal(f"{claim.text} ({claim.where})"),
            literal(claim.paper),
            literal(judged.measured),
            Cell(judged.verdict, TONES[judged.verdict]),
            literal(judged.reason),
        )
        for claim, judged in scorecard.details()
    ]
    caption = (
        f"Claims and quoted numbers of the paper against what was measured: "
        f"{literal(scorecard.default.name)}. "
        "In brackets 95 % intervals, frames as the independent units"
    )
    header = ("claim", "the paper", "measured", "verdict", "reason")
    rules = Paragraph(
        "A quoted rate differs where the 95 % intervals of ours and of the paper's own 2000 frames part; "
        "an order "
        "differs where a comparison on the same frames contradicts it beyond doubt; an optimum differs where "
        "another value is lower beyond doubt. *Cannot say* means that the frames do not decide."
    )
    return Section("Scorecard", "scorecard", (rules, Table(header, tuple(rows), caption=caption)))


def matrix(scorecard: Scorecard) -> Section:
    """Give every claim's verdict under every reading, and how well each reading fits."""
    names = [literal(reading.name) for reading in scorecard.readings]
    rows: list[tuple[str | Cell, ...]] = [
        (literal(claim.text), *(Cell(verdict, TONES[verdict]) for verdict in verdicts))
        for claim, verdicts in scorecard.matrix()
        if claim.basis == "curves"
    ]
    found = fits(scorecard)
    best = best_reading(found)
    blocks = (
        Paragraph(
            "The paper leaves open the focal length (18 mm in the text, 25 mm in Table 1), the locator's "
            "details, "
            "the meter's constant K, the f-number N and what is between the LEDs. K and N cancel while "
            "auto-ISO "
            "meets its target; the other two are varied here."
        ),
        Table(
            FIT_COLUMNS,
            tuple(tuple(literal(cell) for cell in row) for row in fit_rows(scorecard)[1:]),
            caption="How well each reading fits: verdicts of the claims that depend on it, and mean "
            "distances",
        ),
        Bullets((f"Best: {literal(best.reading or 'none')}. {literal(best.why)}.",)),
        Table(
            ("claim", *names),
            tuple(rows),
            caption="Verdict of every claim that depends on the reading",
            folded=True,
        ),
    )
    return Section("Which reading fits", "readings", blocks)


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
