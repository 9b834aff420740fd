"""Edges of the discriminant: batches of statistics, what a sum keeps of rounding, devices, and refusals."""

import math
import re
import warnings
from fractions import Fraction

import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.receiver.discriminant import FLDAWarning, discriminant
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.scatter import ClassScatter

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
