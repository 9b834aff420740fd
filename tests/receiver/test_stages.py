"""The receiver by stages: each does only what is needed, and together they decide as a shared reading."""

import pytest
import torch

from vocc_torch.receiver import resample
from vocc_torch.receiver.classifiers import Guarded, Inputs, PanelOtsu, Patch
from vocc_torch.receiver.deciders import (
    GREYSCALE_RECEIVERS,
    RECEIVER_NAMES,
    Preambles,
    bank_of,
)
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import GREYS, Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.types import PanelShape

OTSU = Guarded(
    "otsu", PanelOtsu(), Inputs((), Patch(cells=1, samples=4, relative="white"))
)


@pytest.fixture(scope="module")
def link():
    """Sixteen frames with their preambles, and FLDA trained on them."""
    scene, bits = SceneModel().draw(BlockKey(0, "stages", 0), PanelShape())
    scene, bits = scene[:16], bits[:16]
    takes = [
        Simulator().render(scene, sent, nearest_m=30.0)
        for sent in (bits, torch.ones_like(bits), torch.zeros_like(bits))
    ]
    panels = PaperLocator()(takes[0], PanelShape())
    flda = FLDA(3).fit(Reader().read(takes[0], panels).features, bits)
    return takes, bits, panels, flda


def test_all_receivers_share_the_readings(link):
    takes, bits, panels, flda = link
    bank = bank_of([*RECEIVER_NAMES, "otsu"], flda, {"otsu": OTSU})
    assert list(bank) == [*RECEIVER_NAMES, "otsu"]
    readings, *known = (Reader().read(take, panels) for take in takes)
    lit = Preambles(*(Reader().read(take, panels, GREYS).greys for take in takes[1:]))
    for preamble, reading in zip(lit, known, strict=True):
        assert torch.equal(preamble.average, reading.greys.average)
        assert torch.equal(preamble.centre, reading.greys.centre)
    wrong = {
        name: float(((decider.score(readings, lit) >= 0) != bits).double().mean())
        for name, decider in bank.items()
    }
    assert wrong["flda_3"] == min(wrong.values()) < 0.05
    # The neighbours alone say next to nothing.
    assert wrong["flda_ngr"] == max(wrong.values()) < 0.6


@pytest.mark.parametrize("name", [*RECEIVER_NAMES, "otsu"])
def test_one_receiver_alone_decides_as_among_all_and_measures_no_more(
    link, name, monkeypatch
):
    takes, _, panels, flda = link
    readings, on, off = (Reader().read(take, panels) for take in takes)
    lit = Preambles(on.greys, off.greys) if name in GREYSCALE_RECEIVERS else None
    decider = bank_of([name], flda, {"otsu": OTSU})[name]
    wanted = decider.score(readings, lit)
    if name == "center_greyscale":
        # No panel is resampled for single pixels.
        monkeypatch.setattr(resample, "_read", None)
    measured = Reader().read(takes[0], panels, decider.features)
    assert torch.equal(decider.score(measured, lit), wanted)
    needed = [one in decider.features for one in ("agr", "gri", "ngr")]
    assert [bool(measured.features[..., column].any()) for column in range(3)] == needed
    assert bool(measured.greys.centre.any()) == ("centre" in decider.features)


def test_the_kept_receiver_decides_by_the_same_stages(link):
    takes, _, panels, flda = link
    kept = Receiver("flda_2", PaperLocator(), Reader(), flda.select([0, 1]))(takes[0])
    decider = bank_of(["flda_2"], flda)["flda_2"]
    assert torch.equal(kept.scores, decider.score(Reader().read(takes[0], panels)))
    assert torch.equal(kept.corners_px, panels.corners_px)
