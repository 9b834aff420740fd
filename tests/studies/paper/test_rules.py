"""Each rule against made-up curves whose verdict is known."""

import math

import numpy as np
import pytest
from made_up_evidence import clustered, curves_of, of_rates

from vocc_torch.measure.estimate import Estimate
from vocc_torch.studies.paper.rules import (
    Evidence,
    NotMeasuredError,
    minimum,
    number,
    order,
    quoted,
    trend,
)

LOW, HIGH = {1e3: 1e-3, 8e3: 1e-3}, {1e3: 2e-2, 8e3: 3e-2}


def ordered(high, low, frames=2000):
    evidence = of_rates(frames=frames, average_greyscale=high, flda_3=low)
    return order(evidence, ["ambient"], ["average_greyscale"], ["flda_3"])


def test_an_order_agrees_differs_or_cannot_be_told():
    assert ordered(HIGH, LOW).verdict == "agree"
    against = ordered(LOW, HIGH)
    assert against.verdict == "differ"
    assert (
        "average_greyscale 1.0e-3 at 8000 lx and flda_3 3.0e-2 at 8000 lx"
        in against.reason
    )
    assert ordered(LOW, LOW).verdict == "cannot say"
    # One contradiction beyond chance is enough; half of the comparisons in favour are enough.
    assert ordered({1e3: 2e-2, 8e3: 1e-3}, {1e3: 1e-3, 8e3: 3e-2}).verdict == "differ"
    assert ordered({1e3: 2e-2, 8e3: 1e-3}, {1e3: 1e-3, 8e3: 1e-3}).verdict == "agree"


def test_what_was_not_measured_has_no_verdict():
    evidence = of_rates(flda_3=LOW)
    for rule, arguments in (
        (
            order,
            {"experiments": ["distance"], "above": ["flda_3"], "below": ["flda_2"]},
        ),
        (order, {"experiments": ["ambient"], "above": ["flda_3"], "below": ["flda_2"]}),
        (minimum, {"experiment": "ambient", "receiver": "flda_3", "at": 4e3}),
        (number, {"value": "fig04.nothing"}),
    ):
        with pytest.raises(NotMeasuredError):
            rule(evidence, **arguments)


FLAT = dict.fromkeys((1e3, 2e3, 4e3, 8e3, 16e3, 32e3), 1e-3)
VALLEY = dict(zip(FLAT, (2e-2, 1e-2, 5e-3, 5e-4, 5e-3, 2e-2), strict=True))
RISE = dict(zip(FLAT, (1e-3, 5e-3, 1e-2, 2e-2, 3e-2, 4e-2), strict=True))


@pytest.mark.parametrize(
    ("rule", "arguments", "rates", "verdict"),
    [
        (trend, {"first": 1e3}, RISE, "agree"),
        (trend, {"first": 1e3}, FLAT | {8e3: 2e-2, 32e3: 5e-3}, "differ"),
        (trend, {"first": 1e3}, VALLEY, "differ"),
        (trend, {"first": 1e3}, FLAT, "cannot say"),
        # Without a first value the lowest value is compared alone.
        (trend, {"rises": False}, VALLEY | {32e3: 5e-3}, "agree"),
        (minimum, {"at": 8e3}, VALLEY, "agree"),
        (minimum, {"at": 4e3}, VALLEY, "differ"),
        (minimum, {"at": 1e3}, VALLEY, "differ"),
        (minimum, {"at": 8e3}, FLAT, "cannot say"),
        # Without a value the rate falls and rises again.
        (minimum, {}, VALLEY, "agree"),
        (minimum, {}, RISE, "differ"),
        (minimum, {}, FLAT, "cannot say"),
    ],
)
def test_rules_along_an_axis(rule, arguments, rates, verdict):
    about = {"receivers": ["flda_3"], "last": 32e3, "rises": True}
    about = (about if rule is trend else {"receiver": "flda_3"}) | arguments
    assert rule(of_rates(flda_3=rates), "ambient", **about).verdict == verdict


def test_a_minimum_among_values_without_errors_cannot_be_told():
    silent = of_rates(flda_3=VALLEY | {4e3: 0.0, 8e3: 0.0})
    found = minimum(silent, "ambient", "flda_3", 8e3)
    assert found.reason == "several values have no errors"


@pytest.mark.parametrize(
    ("rate", "frames", "verdict"),
    [
        (6.6e-4, 2000, "agree"),
        (4e-3, 2000, "differ"),
        (1e-4, 20_000, "differ"),
        (0.0, 20_000, "differ"),
        (0.0, 50, "cannot say"),
        (6.6e-4, 30, "cannot say"),
    ],
)
def test_a_quoted_rate(rate, frames, verdict):
    evidence = of_rates(frames=frames, flda_2={8e3: rate}, flda_3={8e3: rate})
    assert quoted(evidence, "ambient", 8e3, "flda_2", ber=6.6e-4).verdict == verdict


@pytest.mark.parametrize(
    ("three", "frames", "verdict"),
    [
        (0.76, 20_000, "agree"),
        (0.3, 20_000, "differ"),
        (1.5, 20_000, "differ"),
        (0.7, 40, "cannot say"),
    ],
)
def test_a_quoted_gain(three, frames, verdict):
    rng = np.random.default_rng(0)
    two = clustered(rng, 6.6e-4 if frames > 100 else 2e-3, frames)
    kept = rng.binomial(two, min(three, 1.0)) + (three > 1) * rng.binomial(two, 0.5)
    evidence = Evidence(
        {"ambient": curves_of("ambient", {8e3: {"flda_2": two, "flda_3": kept}})}, {}
    )
    assert quoted(evidence, "ambient", 8e3, gain=0.24).verdict == verdict


def test_two_features_without_errors_have_no_gain():
    evidence = of_rates(flda_2={8e3: 0.0}, flda_3={8e3: 0.0})
    assert quoted(evidence, "ambient", 8e3, gain=0.24).measured == "no gain"


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [(0.1, 0.2, "agree"), (0.3, 0.5, "differ"), (0.15, 0.3, "cannot say")],
)
def test_a_number_lies_within_limits(low, high, verdict):
    evidence = of_rates(
        numbers={"fig25.share": Estimate((low + high) / 2, low, high)}, flda_3=LOW
    )
    assert number(evidence, "fig25.share", least=0.05, most=0.25).verdict == verdict


@pytest.mark.parametrize(
    ("numbers", "verdict"),
    [
        ((1, 2, 3), "agree"),
        ((1, 3, 2), "differ"),
        ((1, 1, 3), "cannot say"),
        ((1, math.nan, 3), None),
    ],
)
def test_numbers_ascend(numbers, verdict):
    evidence = of_rates(
        numbers=dict(zip(("f.a", "f.b", "f.c"), numbers, strict=True)), flda_3=LOW
    )
    if verdict is None:
        with pytest.raises(NotMeasuredError):
            number(evidence, ascending=[("f.a", "f.b"), ("f.b", "f.c")])
    else:
        assert (
            number(evidence, ascending=[("f.a", "f.b"), ("f.b", "f.c")]).verdict
            == verdict
        )
        assert number(evidence, ascending=[("f.a", "f.c"), ("f.b", "f.c")]).verdict == (
            "agree" if max(numbers) == numbers[2] else "differ"
        )


def test_true_claims_are_contradicted_no_oftener_than_the_intervals_err():
    """Two receivers of one rate, and a rate that is the quoted one, each in 200 studies."""
    rng, wrong_order, wrong_rate = np.random.default_rng(1), 0, 0
    for _ in range(200):
        curves = curves_of(
            "ambient",
            {8e3: {name: clustered(rng, 2e-3, 400) for name in ("flda_2", "flda_3")}},
        )
        evidence = Evidence({"ambient": curves}, {})
        wrong_order += (
            order(evidence, ["ambient"], ["flda_2"], ["flda_3"]).verdict == "differ"
        )
        wrong_rate += (
            quoted(evidence, "ambient", 8e3, "flda_2", ber=2e-3).verdict == "differ"
        )
    # Binomial with 200 trials of 5 %: 21 or more in 1 study of 1500.
    assert wrong_order < 21
    assert wrong_rate < 21
