"""Arguments of the public functions: what their annotations do not allow is refused in a line, by name."""

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

import vocc_torch as vt
from vocc_torch.boundary import allowed, fits
from vocc_torch.errors import VoccError

PLACE = ("paper", "distance_m", [30])
REFUSED = {
    "frames is 1.5": lambda: vt.simulate("paper", 1.5),
    "frames is True": lambda: vt.simulate("paper", True),
    "frames is 0": lambda: vt.measure({}, *PLACE, frames=0),
    "frames is 1000000000000000000...": lambda: vt.train("paper", frames=10**400),
    "seed is 'a'": lambda: vt.simulate("paper", 1, seed="a"),
    "seed is 1.5": lambda: vt.simulate("paper", 1, 1.5),
    "seed is -1": lambda: vt.train("paper", seed=-1),
    "batch is 0": lambda: vt.simulate("paper", 1, batch=0),
    "values is ['a']": lambda: vt.measure({}, "paper", "distance_m", ["a"]),
    "values is '30'": lambda: vt.measure({}, "paper", "distance_m", "30"),
    "values is [inf]": lambda: vt.measure({}, "paper", "distance_m", [np.inf]),
    "receivers is {1: 2}": lambda: vt.measure({1: 2}, *PLACE),
    "progress is None": lambda: vt.measure({}, *PLACE, progress=None),
    "classifier is None": lambda: vt.train("paper", classifier=None),
    "features is 'agr'": lambda: vt.train("paper", features="agr"),
    "values is ": lambda: vt.measure(
        {}, "paper", "distance_m", torch.zeros(1).to_sparse()
    ),
    "turn is -90": lambda: vt.decode(np.zeros((4, 5)), turn=-90),
    "scene.camera.iso_limits is {'a': 1}": lambda: vt.load_scene(
        {"camera": {"iso_limits": {"a": 1}}}
    ),
    "scene.distance_m is np.float32": lambda: vt.load_scene(
        {"distance_m": np.float32(40)}
    ),
    "overrides is (5,)": lambda: vt.load_scene("paper", 5),
    "plug_ins is 'a.py'": lambda: vt.Receiver.load("a.pt", "a.py"),
}


@pytest.mark.parametrize("said", REFUSED)
def test_an_argument_of_another_kind_is_refused_before_any_work(said):
    with pytest.raises(VoccError) as error:
        REFUSED[said]()
    assert str(error.value).startswith(said)
    assert ": it must be " in str(error.value)
    assert "\n" not in str(error.value)


ALLOWED = {
    str: ("a", 1),
    str | None: (None, b"a"),
    Sequence[str]: (["a"], "a"),
    Sequence[Sequence[float]]: ([[1, Fraction(1, 2)]], [[10**400]]),
    Mapping[str, int]: ({"a": 1}, {"a": True}),
    Callable[[], int]: (len, 3),
    Path | str: (Path(), [Path()]),
}


@pytest.mark.parametrize("hint", ALLOWED, ids=str)
def test_an_annotation_allows_its_own_alone(hint):
    good, bad = ALLOWED[hint]
    assert fits(good, hint)
    assert not fits(bad, hint)
    assert "\n" not in allowed(hint)


def test_numbers_may_be_of_any_library():
    for values in (np.arange(2), torch.arange(2.0), [Fraction(1, 2)], range(2), ()):
        assert fits(values, Sequence[float])


def test_a_name_of_draws_may_be_any_text():
    frames = [next(vt.simulate("paper", 1, point=name)) for name in ("a\udcff", "b")]
    assert not torch.equal(frames[0].bits, frames[1].bits)


def test_frames_without_end_begin_at_once_and_are_those_of_a_few():
    whole = next(vt.simulate("paper", 140, batch=140)).bits
    for batch in (1, 48, 100):
        few = torch.cat([part.bits for part in vt.simulate("paper", 140, batch=batch)])
        assert torch.equal(few, whole)
        endless = vt.simulate("paper", 2**40, batch=batch)
        parts = torch.cat([next(endless).bits for _ in range(2)])
        assert torch.equal(parts[:140], whole[: len(parts)])


@pytest.mark.parametrize(
    "images",
    [
        torch.zeros(8, 8, dtype=torch.uint8).to_sparse(),
        torch.zeros(8, 8, dtype=torch.uint8, device="meta"),
    ],
    ids=["sparse", "meta"],
)
def test_tensors_without_values_are_refused(images):
    with pytest.raises(VoccError, match=r"^images is .*: it must be a dense tensor"):
        vt.Frames.of(images, "images")
