"""The notes below the table of task=test: what is not in it, where errors come from, and who differs."""

from types import SimpleNamespace

import made_up_tallies
import numpy as np
import pytest

from vocc_torch.measure.plan import Experiment
from vocc_torch.studies.curve import notes_on

NAMES, FRAMES = ("flda_2", "flda_3"), 1000


def curves_of(wrong, misplaced=(), locator="paper"):
    """Curves of two receivers from the frames in which each has a wrong bit, by value."""
    places = np.arange(FRAMES)
    bits = {
        value: {
            name: np.isin(places, list(frames))
            for name, frames in zip(NAMES, pair, strict=True)
        }
        for value, pair in wrong.items()
    }
    off = np.tile(np.isin(places, list(misplaced)).astype(int), (len(NAMES), 1))
    return made_up_tallies.curves_of(bits, locator=locator, misplaced=off)


def plan_of(experiment=None, frames=FRAMES):
    experiment = experiment or Experiment("e", "distance_m", (30.0,))
    receiver = SimpleNamespace(reference="flda_3")
    return SimpleNamespace(
        experiment=experiment, frames_in_point=frames, receiver=receiver
    )


def test_receivers_that_differ_are_named_by_value():
    """A hundred frames against none is no chance, five against four is."""
    wrong = {30.0: (range(100), ()), 50.0: ((), range(100)), 70.0: (range(5), range(4))}
    heading, line = notes_on(plan_of(), curves_of(wrong, locator="truth"))[-2:]
    said = "Compared with flda_3 on the same frames (95 %), by distance_m:"
    assert heading == said
    assert line == "  flda_2: more errors at 30; fewer errors at 50"
    alike = curves_of({70.0: (range(5), range(4))}, locator="truth")
    assert notes_on(plan_of(), alike)[-1] == "  flda_2: no difference found"


@pytest.mark.parametrize(
    ("wrong", "misplaced", "is_said"),
    [
        (range(20), range(15), True),
        (range(9), range(9), False),  # too few wrong frames
        (range(20), range(9), False),  # less than half of the errors
        (range(20), range(11, 1000), False),  # nearly every frame is off
    ],
)
def test_location_is_named_where_it_causes_most_errors(wrong, misplaced, is_said):
    curves = curves_of({30.0: (wrong, wrong)}, misplaced)
    notes = [note for note in notes_on(plan_of(), curves) if "wrong bits" in note]
    assert notes == is_said * [
        "75 % of flda_2's wrong bits are in the 1.5 % of the frames with corners over a quarter"
        " of a cell off: try receiver.locator=refined"
    ]


def test_frames_and_bins_without_results_are_named():
    binned = Experiment("e", "contrast", (0.0, 0.2, 0.4))
    notes = notes_on(plan_of(binned, 1200), curves_of({0.1: ((), ())}))
    assert notes[:2] == [
        "200 of 1200 frames have a contrast outside the bins and are not counted",
        "no frame has a contrast in the bins at 0.3: they are not in the results",
    ]
