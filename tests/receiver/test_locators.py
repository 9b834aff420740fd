import dataclasses
import json

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


def test_the_model_file_names_the_refined_locator(tmp_path):
    fitted(RefinedLocator()).save(tmp_path / "receiver.pt")
    written = json.loads((tmp_path / "receiver.pt").read_bytes())["settings"]["locator"]
    assert (written["name"], written["paper"]["closing_px"]) == ("refined", 11)


def test_files_without_a_name_hold_the_papers_locator(tmp_path):
    fitted(RefinedLocator()).save(tmp_path / "receiver.pt")
    settings, state = read_model(tmp_path / "receiver.pt")
    settings["locator"] = dataclasses.asdict(PaperLocator(closing_px=9))
    write_model(tmp_path / "receiver.pt", settings, state)
    assert Receiver.load(tmp_path / "receiver.pt").locator == PaperLocator(closing_px=9)


def test_an_unknown_locator_in_a_file_is_refused(tmp_path):
    fitted(RefinedLocator()).save(tmp_path / "receiver.pt")
    settings, state = read_model(tmp_path / "receiver.pt")
    settings["locator"] = {"name": "oracle"}
    write_model(tmp_path / "receiver.pt", settings, state)
    with pytest.raises(VoccError, match=r"is damaged \(its locator is 'oracle'"):
        Receiver.load(tmp_path / "receiver.pt")


def test_an_unknown_name_is_refused():
    with pytest.raises(
        VoccError,
        match=r"receiver.locator is 'refind': it must be paper or refined or detector",
    ):
        locator_named("refind", PaperLocator())
