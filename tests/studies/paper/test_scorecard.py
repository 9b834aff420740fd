"""Claims as data, and the scorecard of made-up readings."""

import inspect
import itertools
from types import SimpleNamespace

import pytest
from made_up_evidence import of_rates

from vocc_torch.studies.paper.plan import EVIDENCE, FIGURES
from vocc_torch.studies.paper.rules import RULES
from vocc_torch.studies.paper.scorecard import CLAIMS, PARTS, score, stars

NEAR, FAR = 6.6e-4, 6.6e-3


def reading(name, **values):
    return SimpleNamespace(name=name, values=values, why="made up")


def evidence(two):
    return of_rates(
        frames=20_000,
        flda_2={8e3: two, 16e3: 2 * two},
        flda_3={8e3: 0.76 * two, 16e3: two},
    )


def card_of(rates):
    readings = [
        reading(name, board=board, lens=lens)
        for name, (board, lens, _) in rates.items()
    ]
    return score(readings, {name: evidence(two) for name, (_, _, two) in rates.items()})


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
    card = card_of(FOUR)
    decades = {name: card.fits[name].decades for name in FOUR}
    assert decades["a"].value == pytest.approx(0, abs=0.02)
    assert decades["b"].value == pytest.approx(1, abs=0.02)
    assert decades["b"].low > decades["a"].high
    assert card.fits["a"].count("agree") > card.fits["b"].count("agree")
    rows = list(card.fit_rows())
    assert [row[0] for row in rows] == ["reading", *FOUR]
    assert all(len(row) == len(rows[0]) for row in rows)
    lines = list(card.rows())
    assert all(len(line) == len(lines[0]) for line in lines)
    assert len(lines) == 1 + sum(map(len, card.judgements.values()))
