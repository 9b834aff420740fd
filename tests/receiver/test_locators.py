import dataclasses

import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator, RefinedLocator, locator_named
from vocc_torch.receiver.model_file import read_model, write_model
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel, Simulator


def fitted(locator):
    generator = torch.Generator().manual_seed(0)
    bits = torch.rand(200, generator=generator) < 0.5
    features = (
        torch.rand(200, 3, generator=generator, dtype=torch.float64) + bits[:, None]
    )
    flda = FLDA(n_features=3)
    flda.update(features, bits)
    return Receiver("flda_3", locator, Reader(), flda)


@pytest.mark.parametrize(
    "locator",
    [
        PaperLocator(closing_px=9),
        RefinedLocator(PaperLocator(min_area_px=50), min_share=0.9),
    ],
)
def test_a_saved_receiver_keeps_its_locator(locator, tmp_path):
    receiver = fitted(locator)
    receiver.save(tmp_path / "receiver.pt")
    loaded = Receiver.load(tmp_path / "receiver.pt")
    assert loaded.locator == locator
    scene, bits = SceneModel().draw(BlockKey(0, "locators", 0), receiver.shape)
    frames = Simulator().render(scene[:4], bits[:4])
    first, second = receiver(frames), loaded(frames)
    assert torch.equal(first.corners_px, second.corners_px)
    assert torch.equal(first.scores, second.scores)


def test_a_locator_in_a_file_has_a_name_or_is_the_papers(tmp_path):
    path = tmp_path / "receiver.pt"
    fitted(RefinedLocator()).save(path)
    settings, state = read_model(path)
    written = settings["locator"]
    assert (written["name"], written["paper"]["closing_px"]) == ("refined", 11)
    unnamed = dataclasses.asdict(PaperLocator(closing_px=9))
    write_model(path, {**settings, "locator": unnamed}, state)
    assert Receiver.load(path).locator == PaperLocator(closing_px=9)
    write_model(path, {**settings, "locator": {"name": "oracle"}}, state)
    with pytest.raises(VoccError, match=r"is damaged \(its locator is 'oracle'"):
        Receiver.load(path)


def test_an_unknown_name_is_refused():
    with pytest.raises(
        VoccError,
        match=r"receiver.locator is 'refind': it must be paper or refined or detector",
    ):
        locator_named("refind", PaperLocator())
