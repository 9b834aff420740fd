"""The scorecard over several trainings: a verdict that hangs on the first one is told apart."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_readings import BITS, counted, curves_of, judged, of_rates, reading_of
from made_up_tallies import tallies

from vocc_torch.measure.curve import Measured
from vocc_torch.measure.trainings import Trained
from vocc_torch.studies.paper.scorecard import Claim, Scorecard, score_all

NAMES, FRAMES = ("flda_2", "flda_3"), 4000


def curves(factors, experiment="distance", ber=4e-3):
    """Curves at two values: flda_3 has ``factors[k]`` times the rate of flda_2 after training k."""
    rng = np.random.default_rng(5)
    every = {}
    for value, scale in ((30.0, 0.5), (70.0, 1.0)):
        hard = rng.random((FRAMES, BITS))
        both = [[(hard < scale * ber * by).sum(1) for by in (1.0, factor)] for factor in factors]
        every[value] = 2 * np.array(both)
    first = {value: dict(zip(NAMES, half[0] // 2, strict=True)) for value, half in every.items()}
    made, trained, pairs = curves_of(experiment, first), {}, {}
    for value, half in every.items():
        each = [counted(one // 2)[0] for one in half]
        shape = half.sum(0)
        whole, (pair,) = (lambda found: (found[0], found[1].values()))(
            tallies(shape, BITS * len(factors), np.ones(shape.shape, dtype=bool))
        )
        pairs[*NAMES, value] = pair
        for place, name in enumerate(NAMES):
            trained[name, value] = Trained(tuple(one[place] for one in each), whole[place])
    return replace(made, trained=trained, trained_pairs=pairs)


def reading(factors, **changes):
    """The same as a reading, of the first training or of the algorithms."""
    return replace(reading_of({"distance": Measured({"truth": curves(factors)}, {})}), **changes)


ORDER = {"experiments": ["distance"], "above": ["flda_2"], "below": ["flda_3"]}
LUCKY = (0.4, 1.6, 0.5, 1.5, 1.0)


@pytest.mark.parametrize(
    ("factors", "first", "every"),
    [
        (LUCKY, "agree", "cannot say"),
        ((0.4, 0.42, 0.38), "agree", "agree"),
        ((1.6, 1.7, 1.5), "differ", "differ"),
    ],
)
def test_an_order_holds_for_the_algorithms_only_beyond_the_scatter_of_trainings(factors, first, every):
    assert judged(reading(factors), "order", **ORDER).verdict == first
    assert judged(reading(factors, of_algorithms=True), "order", **ORDER).verdict == every


def test_a_gain_and_a_rate_are_those_of_all_trainings():
    factors = (0.5, 0.7, 0.6)
    one, all_ = reading(factors), reading(factors, of_algorithms=True)
    rule = {"experiment": "distance", "gain": 0.4, "at": 70.0}
    alone, found = (judged(of, "quoted_gain", **rule) for of in (one, all_))
    assert (alone.low + alone.high) / 2 == pytest.approx(0.5, abs=0.05)
    assert (found.low + found.high) / 2 == pytest.approx(0.4, abs=0.05)
    assert found.high - found.low > 2 * (alone.high - alone.low)
    assert found.verdict == "agree"
    row = all_.row("distance", "flda_3", 70.0)
    trained = all_.curves("distance").trained["flda_3", 70.0]
    assert (row.ber, row.ber_low) == (trained.pooled.ber, trained.interval().low)
    # A quoted rate is of one training: it may lie as far off as one of ours does.
    rates = {"experiment": "distance", "at": 70.0, "receiver": "flda_3", "ber": 1.35 * 0.6 * 4e-3}
    assert judged(one, "quoted_ber", **rates).verdict == "differ"
    assert judged(all_, "quoted_ber", **rates).verdict == "agree"


def test_verdicts_that_change_are_named(monkeypatch):
    claim = Claim("made.up", "IV", "text", "paper", "order", ORDER, "curves")
    monkeypatch.setattr("vocc_torch.studies.paper.scorecard.score.__defaults__", ((25.0, "truth"), [claim]))
    card = score_all([reading(LUCKY)], (25.0, "truth"))
    ((changed, first, every),) = card.changed()
    assert (changed.claim, first.verdict, every.verdict) == ("made.up", "agree", "cannot say")
    assert card.rows()[1][-2:] == ("cannot say", every.measured)
    single = of_rates("distance", {name: {30.0: 1e-3, 70.0: 2e-3} for name in NAMES})
    card = score_all([reading_of({"distance": single})], (25.0, "truth"))
    assert isinstance(card, Scorecard)
    assert (card.algorithms, card.changed(), card.rows()[1][-2:]) == ({}, [], (None, None))
