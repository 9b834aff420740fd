"""Edges of the discriminant: batches of statistics, what a sum keeps of rounding, devices, and refusals."""

import math
import re
import warnings
from fractions import Fraction

import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.receiver.discriminant import (
    GAP_LIMIT,
    LARGEST,
    ClassScatter,
    Discriminant,
    FLDAWarning,
    ScaledScatter,
    discriminant,
)
from vocc_torch.receiver.flda import FLDA

META = torch.device("meta")


def samples(seed, count=40, features=3):
    """A regular training set of both classes."""
    draw = torch.Generator().manual_seed(seed)
    bits = torch.arange(count) % 2 == 1
    rows = torch.randn(count, features, generator=draw, dtype=torch.float64)
    return rows + 2.0 * bits.unsqueeze(-1), bits


def parts(seen):
    """The fields of statistics, by name."""
    return {name: getattr(seen, name) for name in ClassScatter.__dataclass_fields__}


# Sums


def exact(value, rest):
    """A sum of two numbers without rounding."""
    return Fraction(float(value)) + Fraction(float(rest))


def test_the_second_number_holds_what_rounding_took_from_a_sum_of_scatters():
    one = torch.ones(2, dtype=torch.int64)
    mean = torch.zeros(2, 1, dtype=torch.float64)
    scatter = torch.ones(2, 1, 1, dtype=torch.float64)
    for ours, theirs in ((2.0**-60, 2.0**-62), (-(2.0**-60), 2.0**-61), (2.0**-58, -(2.0**-70))):
        left = ClassScatter(one, mean, mean, scatter, scatter * ours)
        right = ClassScatter(one, mean, mean, scatter / 3, scatter * theirs)
        total = left.merged(right)
        wanted = 1 + Fraction(1 / 3) + Fraction(ours) + Fraction(theirs)
        error = exact(total.scatter[0, 0, 0], total.scatter_rest[0, 0, 0]) - wanted
        assert abs(error) < Fraction(2) ** -105


def test_a_mean_is_rounded_once_however_many_samples_were_summed():
    """Half a unit in the last place; the sum alone is off by one and a half."""
    for count in (1000, 10_007):
        rows = (
            torch.rand(count, 3, generator=torch.Generator().manual_seed(count), dtype=torch.float64) + 1000
        )
        rows[0] = 0.0
        seen = ClassScatter.of(rows, torch.zeros(count, dtype=torch.bool), 3)
        for feature, values in enumerate(rows.T.tolist()):
            mean = sum(map(Fraction, values)) / count
            error = exact(seen.mean[0, feature], seen.mean_rest[0, feature]) - mean
            assert abs(error) < Fraction(0.501) * Fraction(math.ulp(float(mean)))


def test_a_step_between_means_too_small_for_the_scatter_is_kept_beside_it():
    """Two samples 2^-30 apart add (2^-30)^2 / 2 to a scatter of 1, which float64 alone does not notice."""
    one = torch.ones(2, dtype=torch.int64)
    mean = torch.zeros(2, 1, dtype=torch.float64)
    scatter = torch.ones(2, 1, 1, dtype=torch.float64)
    for step, large in ((2.0**-30, 1.0), (3 * 2.0**-31, 7.0), (2.0**-28, 1e8)):
        left = ClassScatter(one, mean, mean, scatter * large, 0 * scatter)
        right = ClassScatter(one, mean + step, mean, 0 * scatter, 0 * scatter)
        total = left.merged(right)
        assert total.scatter[0, 0, 0] == large
        wanted = Fraction(large) + Fraction(step) ** 2 / 2
        assert exact(total.scatter[0, 0, 0], total.scatter_rest[0, 0, 0]) == wanted


def test_a_threshold_between_large_features_keeps_what_rounding_took_from_the_means():
    """Two features near 1e8 whose weights are 2 and -2: what is left of the threshold is 36 and the rests."""
    count, one = torch.tensor([8, 8]), torch.eye(2, dtype=torch.float64)
    mean = torch.tensor([[1e8 + 16, 1e8], [1e8 + 18, 1e8 - 2]], dtype=torch.float64)
    rest = torch.tensor([[2.0**-28, -(2.0**-29)]] * 2, dtype=torch.float64)
    seen = ClassScatter(
        count, mean, rest, torch.stack([8 * one] * 2), torch.zeros(2, 2, 2, dtype=torch.float64)
    )
    rule, complaint = Discriminant.of(seen)
    assert not complaint
    assert rule.direction.tolist() == [2.0, -2.0]
    assert rule.threshold == 36 + 2.0**-27 + 2.0**-28


# Batches


def test_a_batch_of_statistics_is_its_sets():
    """Merged, selected from or solved together, each set is what it is alone."""
    first = [ClassScatter.of(*samples(seed), 3) for seed in range(6)]
    second = [ClassScatter.of(*samples(seed, count=10 + 2 * seed), 3) for seed in range(6, 12)]
    together = ClassScatter.stacked(first, (3, 2)).merged(ClassScatter.stacked(second, (3, 2)))
    alone = [a.merged(b) for a, b in zip(first, second, strict=True)]
    for seen, sets in ((together, alone), (together.select([2, 0]), [one.select([2, 0]) for one in alone])):
        for name, value in parts(seen).items():
            assert torch.equal(value, parts(ClassScatter.stacked(sets, (3, 2)))[name]), name


def alike(share, gap):
    """Two features that are one, but for a step between the classes: a given share of the means' difference.

    Within the classes both are -1 and 1, so nothing is rounded but the means of On.
    """
    spread = torch.tensor([-1.0, 1.0, -1.0, 1.0], dtype=torch.float64)
    bits = torch.tensor([False, False, True, True])
    second = spread + bits * (gap + 2 * share * gap)
    return torch.stack([spread + bits * gap, second], dim=-1), bits


@pytest.mark.parametrize("gap", [2.0**-7, 1.0, 2.0**10])
@pytest.mark.parametrize("part", [0.25, 4.0])
def test_a_step_across_collinear_features_separates_from_a_share_of_the_difference_on(part, gap):
    rows, bits = alike(part * GAP_LIMIT, gap)
    with pytest.warns(FLDAWarning) as caught:
        rule = discriminant(rows, bits)
    outcome = "the classes separate without variance, scores are huge" if part > 1 else "least-norm solution"
    assert str(caught[0].message).endswith(outcome)
    # The least-norm solution weighs two features that are one alike.
    assert bool((rule.direction[0] - rule.direction[1]).abs() < 1e-3 * rule.direction.abs().max()) == (
        part < 1
    )


def test_sets_of_a_batch_do_not_see_each_other():
    """However a set's means, rounding or separation compare with those of the others in its batch."""
    steps = torch.tensor([-1.0, 1.0, -1.0, 1.0], dtype=torch.float64)
    bits = torch.tensor([False, False, True, True])
    noisy = torch.stack(
        [steps + 1e9, 1e9 + 1e-5 * bits.to(torch.float64)], dim=-1
    )  # flat, and its step near to rounding
    far, plain = torch.stack([steps + 1e8 * bits, steps**2], dim=-1), alike(0.0, 1.0)[0]
    apart, below = alike(8 * GAP_LIMIT, 1.0)[0], alike(GAP_LIMIT / 4, 1.0)[0]
    regular = torch.stack([steps + 2 * bits, torch.tensor([0.0, 1.0, 3.0, 2.0], dtype=torch.float64)], dim=-1)
    sets = torch.stack([noisy, far, plain, apart, regular, below, noisy, plain, apart])
    with pytest.warns(FLDAWarning):
        together = discriminant(sets, bits.expand(len(sets), -1))
    for index, one in enumerate(sets):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FLDAWarning)
            alone = discriminant(one, bits)
        for ours, theirs in zip(together, alone, strict=True):
            assert torch.allclose(ours[index], theirs, rtol=1e-12, atol=0), index


def test_a_flat_feature_has_no_covariance_with_another():
    """Its spread is rounding, and so is what it shares with a feature that varies."""
    wave = torch.tensor([-1.0, 1.0, -1.0, 1.0, 1.0, -1.0], dtype=torch.float64)
    bits = torch.tensor([False, False, False, True, True, True])
    flat = 1e8 + 1.5e-8 * wave
    assert flat.std() > 0
    rows = torch.stack([wave, flat, wave + bits, torch.full_like(wave, 7.0)], dim=-1)
    scaled = ScaledScatter.of(ClassScatter.of(rows, bits, 4))
    assert scaled.flat.tolist() == [False, True, False, True]
    assert scaled.constant.tolist() == [False, True, False, True]
    for index in (1, 3):
        assert scaled.within[index].count_nonzero() == 0
        assert scaled.within[:, index].count_nonzero() == 0
        assert scaled.scale[index] == 1.0
    assert torch.equal(scaled.within, scaled.within.mT)
    assert scaled.within.diagonal()[[0, 2]].tolist() == pytest.approx([1.0, 1.0], rel=1e-15)


def test_two_classes_of_6e18_samples_are_still_solved():
    """Either number is in int64's range, and their sum is not."""
    many = ClassScatter.of(*samples(1), 3)
    count = torch.tensor([6 * 10**18, 6 * 10**18])
    more = ClassScatter(count, many.mean, many.mean_rest, many.scatter * 3e17, 0 * many.scatter)
    one, other = ScaledScatter.of(many), ScaledScatter.of(more)
    assert torch.allclose(one.scale, other.scale, rtol=1e-14, atol=0)
    assert torch.allclose(one.within, other.within, rtol=1e-12, atol=1e-14)


# Modules


def test_statistics_gathered_in_inference_mode_are_ordinary_tensors():
    """A module that learned while frames were read can be loaded, moved and learned through later."""
    with torch.inference_mode():
        learned = FLDA(3).fit(*samples(1))
        grown = FLDA(3).update(*samples(1)).update(*samples(2))
        both = FLDA(3).fit(*samples(3)).merge(grown)
        some = both.select([0, 2])
    for module in (learned, grown, both, some):
        assert not any(buffer.is_inference() for buffer in module.buffers())
        state = {name: value.clone() for name, value in module.state_dict().items()}
        module.load_state_dict(state)
        points = torch.zeros(4, module.n_features, dtype=torch.float64, requires_grad=True)
        (slope,) = torch.autograd.grad(module(points).sum(), points)
        assert torch.equal(slope, module.direction.expand(4, -1))


@pytest.mark.parametrize("assign", [False, True])
def test_a_loaded_module_counts_in_integers_and_sums_in_float64(assign):
    state = FLDA(3).fit(*samples(1)).state_dict()
    halved = {name: value.to(torch.float32) for name, value in state.items()}
    module = FLDA(3)
    module.load_state_dict(halved, assign=assign)
    assert module.count.dtype == torch.int64
    assert module.count.tolist() == [20, 20]
    others = [buffer for name, buffer in module.named_buffers() if name != "count"]
    assert {buffer.dtype for buffer in others} == {torch.float64}


def test_statistics_stay_on_the_device_of_the_module():
    """Without an accelerator the device without data stands for one."""
    here = ClassScatter.of(*samples(1), 3)
    there = here.to(META)
    assert {part.device for part in parts(there).values()} == {META}
    assert {part.device for part in parts(there.merged(here)).values()} == {META}
    assert {part.device for part in parts(there.select([0, 2])).values()} == {META}
    module = FLDA(3).to(META)
    assert {buffer.device for buffer in module.select([1]).buffers()} == {META}


# Refusals and warnings


@pytest.mark.parametrize(("bad", "score"), [(math.nan, "nan"), (math.inf, "inf"), (-math.inf, "-inf")])
def test_a_decision_that_cannot_be_made_names_its_score(bad, score):
    module = FLDA(1).fit(torch.tensor([[0.0], [1.0], [5.0], [6.0]]), torch.tensor([0, 0, 1, 1]))
    assert module.predict(torch.tensor([[0.5], [5.5]])).tolist() == [False, True]
    with pytest.raises(VoccError, match=rf"its score is {score}, neither On nor Off$"):
        module.predict(torch.tensor([[0.5], [bad], [5.5]]))


@pytest.mark.parametrize("shape", [(5, 0), (2, 5, 0), (2, 0, 5, 3), (0, 5, 3), (7,), ()])
def test_features_without_sets_or_columns_are_refused_by_their_shape(shape):
    wanted = re.escape(f"features is {shape}: it must be a tensor of shape (..., samples, features)")
    with pytest.raises(VoccError, match=f"^{wanted}$"):
        discriminant(torch.zeros(shape), torch.zeros(shape[:-1], dtype=torch.bool))


@pytest.mark.parametrize(
    ("batch", "at", "place"), [((), (), ""), ((4,), (2,), " in set 2"), ((2, 3), (1, 0), " in set 1, 0")]
)
@pytest.mark.parametrize(("bit", "name"), [(False, "On (bit 1)"), (True, "Off (bit 0)")])
def test_a_missing_class_is_named_with_its_set(batch, at, place, bit, name):
    rows, bits = samples(1)
    on = bits.expand(*batch, -1).clone()
    on[at] = bit
    with pytest.raises(
        VoccError, match=f"^bits has no {re.escape(name)} sample{place}: a discriminant needs both$"
    ):
        discriminant(rows.expand(*batch, -1, -1), on)


def test_a_module_without_samples_says_what_to_call():
    wanted = "FLDA has seen no samples: call fit or update with both Off and On samples first"
    with pytest.raises(VoccError, match=f"^{wanted}$"):
        FLDA(2).predict(torch.zeros(1, 2))


def test_statistics_out_of_range_are_refused_in_words():
    one = ClassScatter.of(*samples(1), 3)
    large = r"scatter is not finite: features up to 1e\+140 in size are allowed"
    many = "count is below 0: more than 9e18 samples of a class, which overflow int64"
    huge = ClassScatter(one.count, one.mean, one.mean_rest, one.scatter * 1e308 * 10, one.scatter_rest)
    wrapped = ClassScatter(-one.count, one.mean, one.mean_rest, one.scatter, one.scatter_rest)
    below = ClassScatter(one.count, one.mean, one.mean_rest, -one.scatter, one.scatter_rest)
    none = "scatter holds a variance below 0: these are no statistics of samples"
    for seen, wanted in ((huge, large), (wrapped, many), (below, none)):
        with pytest.raises(VoccError, match=f"^{wanted}$"):
            seen.checked()


def test_the_largest_feature_is_taken_and_the_next_is_not():
    bits = torch.tensor([0, 1])
    most = torch.tensor([[LARGEST, 1.0], [-LARGEST, 2.0]], dtype=torch.float64)
    assert torch.equal(ClassScatter.of(most, bits, 2).mean, most)
    most[1, 0] = torch.nextafter(most[1, 0], torch.tensor(-math.inf, dtype=torch.float64))
    wanted = r"features holds -1e\+140 in feature 0 \(sample 1\): it must be finite, at most 1e\+140 in size"
    with pytest.raises(VoccError, match=f"^{wanted}$"):
        ClassScatter.of(most, bits, 2)


def test_means_that_coincide_are_complained_of_in_words():
    rows = torch.tensor([[-1.0, 0.0], [1.0, 3.0], [-1.0, 3.0], [1.0, 0.0]])
    bits = torch.tensor([0, 0, 1, 1])
    wanted = "the class means coincide, so every score is 0, that is On"
    with pytest.warns(FLDAWarning, match=f"^discriminant: {wanted}$"):
        rule = discriminant(rows, bits)
    assert rule.scores(rows).count_nonzero() == 0
    with pytest.warns(FLDAWarning) as caught:
        discriminant(torch.full((4, 2), 3.0), bits)
    # Nothing separates classes that are the same point.
    constant = r"constant features [0, 1] get weight 0"
    assert str(caught[0].message) == (
        f"discriminant: {wanted}; the within-class scatter is singular or ill-conditioned ({constant}): "
        "least-norm solution"
    )


def test_every_reason_of_a_singular_scatter_is_named():
    rows, bits = samples(1)
    rows = torch.cat([rows, rows[:, :1], torch.ones(len(rows), 1, dtype=torch.float64)], dim=1)
    with pytest.warns(FLDAWarning) as caught:
        discriminant(rows, bits)
    assert str(caught[0].message) == (
        "discriminant: the within-class scatter is singular or ill-conditioned (constant features [4] get "
        "weight 0; the features are collinear, condition number above 1e+12): least-norm solution"
    )


def test_a_warning_points_at_its_caller():
    """Not run under mutmut, whose wrapper around each function is the caller there."""
    rows, bits = samples(1)
    rows = torch.cat([rows, torch.ones(len(rows), 1, dtype=torch.float64)], dim=1)
    for ask in (lambda: discriminant(rows, bits), lambda: FLDA(4).fit(rows, bits)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            ask()
        [warning] = [one for one in caught if one.category is FLDAWarning]
        assert warning.filename == __file__
