"""The receiver by stages: each does only what is needed, and together they decide as a shared reading."""

import pytest
import torch

from vocc_torch.receiver import resample
from vocc_torch.receiver.bank import (
    GREYSCALE_RECEIVERS,
    RECEIVER_NAMES,
    Preambles,
    ReceiverBank,
)
from vocc_torch.receiver.classifiers import Guarded, Inputs, PanelOtsu, Patch
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver, StagedReceiver
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
    return takes, panels, flda


def test_all_receivers_share_the_stages(link):
    takes, panels, flda = link
    bank = ReceiverBank([*RECEIVER_NAMES, "otsu"], flda, {"otsu": OTSU})
    staged = StagedReceiver(bank, Reader(), PaperLocator())
    assert torch.equal(staged.locate(takes[0]).corners_px, panels.corners_px)
    readings, (on, off) = Reader().read_takes(takes, panels)
    wanted = bank.scores(readings, Preambles(on, off))
    for scores in (
        staged(takes[0], preambles=staged.preambles(*takes[1:], panels)),
        staged(takes[0], panels, Preambles(on, off)),
    ):
        assert list(scores) == [*RECEIVER_NAMES, "otsu"]
        assert all(torch.equal(scores[name], wanted[name]) for name in wanted)


@pytest.mark.parametrize("name", [*RECEIVER_NAMES, "otsu"])
def test_one_receiver_alone_decides_as_among_all_and_measures_no_more(
    link, name, monkeypatch
):
    takes, panels, flda = link
    readings, (on, off) = Reader().read_takes(takes, panels)
    wanted = ReceiverBank([name], flda, {"otsu": OTSU}).scores(
        readings, Preambles(on, off)
    )[name]
    staged = StagedReceiver(ReceiverBank([name], flda, {"otsu": OTSU}), Reader())
    if name == "center_greyscale":
        # No panel is resampled for single pixels.
        monkeypatch.setattr(resample, "_read", None)
    patches = staged.rectify(takes[0], panels)
    measured = staged.measure(takes[0], panels, patches)
    given = Preambles(on, off) if name in GREYSCALE_RECEIVERS else None
    assert torch.equal(staged.decide(measured, given)[name], wanted)
    needed = [one in staged.bank.needed for one in ("agr", "gri", "ngr")]
    assert [bool(measured.features[..., column].any()) for column in range(3)] == needed
    assert bool(measured.greys.centre.any()) == ("centre" in staged.bank.needed)


def test_the_kept_receiver_decides_by_the_same_stages(link):
    takes, panels, flda = link
    kept = Receiver("flda_2", PaperLocator(), Reader(), flda.select([0, 1]))(takes[0])
    scores = StagedReceiver(ReceiverBank(["flda_2"], flda), Reader())(takes[0], panels)
    assert torch.equal(kept.scores, scores["flda_2"])
    assert torch.equal(kept.corners_px, panels.corners_px)
