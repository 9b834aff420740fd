"""Claims as data, and the scorecard of made-up readings."""

import inspect
import itertools

import pytest
from made_up_evidence import of_rates

from vocc_torch.studies.paper.plan import EVIDENCE, FIGURES
from vocc_torch.studies.paper.rules import RULES
from vocc_torch.studies.paper.scorecard import (
    CLAIMS,
    PARTS,
    PaperReading,
    claim_rows,
    fit_rows,
    stars,
)

NEAR, FAR = 6.6e-4, 6.6e-3


def readings_of(rates):
    """Readings by name, with a rate of two features and one of three in two places."""
    readings = {}
    for name, (board, lens, two) in rates.items():
        measured = of_rates(
            frames=20_000,
            flda_2={8e3: two, 16e3: 2 * two},
            flda_3={8e3: 0.76 * two, 16e3: two},
        )
        readings[name] = PaperReading(
            name=name,
            values={"board": board, "lens": lens},
            why="made up",
            plan=None,
            experiments=measured.experiments,
        )
    return readings


FOUR = {
    "a": (0.4, 25, NEAR),
    "b": (None, 25, FAR),
    "c": (0.4, 18, 2 * NEAR),
    "d": (None, 18, FAR),
}


def test_every_claim_has_one_of_five_rules_with_its_arguments():
    assert len(RULES) == 5
    assert len({claim.name for claim in CLAIMS}) == len(CLAIMS) == 87
    for claim in CLAIMS:
        inspect.signature(RULES[claim.rule]).bind(None, **claim.arguments)
        assert claim.name.partition(".")[0] in PARTS
        assert all((claim.where, claim.text, claim.paper))


def test_numbers_of_claims_are_those_of_figures_that_are_made():
    names = {*EVIDENCE, "dimming"}
    for claim in CLAIMS:
        pairs = claim.arguments.get("ascending", [])
        value = claim.arguments.get("value")
        for name in itertools.chain(*pairs, [value] if value else []):
            assert name.partition(".")[0] in names
    assert {*EVIDENCE} < {*FIGURES}


def test_quoted_rates_are_stars_at_their_values():
    assert stars("contrast") == {"flda_2": [(0.33, 5.3e-4)], "flda_3": [(0.33, 3.9e-4)]}
    assert stars("distance") == {}


def test_the_reading_with_the_quoted_rates_is_nearest_and_agrees_most():
    readings = readings_of(FOUR)
    near, far = readings["a"], readings["b"]
    assert near.decades.value == pytest.approx(0, abs=0.02)
    assert far.decades.value == pytest.approx(1, abs=0.02)
    assert far.decades.low > near.decades.high
    assert near.count("agree") > far.count("agree")
    rows, lines = (
        list(rows_of(readings.values())) for rows_of in (fit_rows, claim_rows)
    )
    assert [row[0] for row in rows] == ["reading", *FOUR]
    for table in (rows, lines):
        assert {len(row) for row in table} == {len(table[0])}
    judged = [reading.judgements for reading in readings.values()]
    assert len(lines) == 1 + sum(map(len, judged))
