"""What a user hands over from Python: NumPy arrays, plain tensors are taken, all else refused by name."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from PIL import Image

from vocc_torch import (
    FLDA,
    Frames,
    LedPanel,
    Panels,
    PanelShape,
    Receiver,
    Scene,
    Simulator,
    VoccError,
)
from vocc_torch.receiver.deciders import bank_of
from vocc_torch.receiver.locators import PaperLocator, RefinedLocator
from vocc_torch.receiver.reader import Reader

SCENE, SHAPE = Scene.of(2), PanelShape()
BITS = torch.from_numpy(np.random.default_rng(0).random((2, 8, 8)) < 0.5)
SIMULATOR = Simulator(framing="full")
GREY = SIMULATOR.render(SCENE, BITS).grey
IMAGE = GREY[0, 0].numpy()
FRAMES, CORNERS = Frames.whole(GREY), SIMULATOR.true_panels(SCENE)
FLDA_3 = FLDA(3).fit(Reader().read(FRAMES, CORNERS).features, BITS)
RECEIVER = Receiver("flda_3", RefinedLocator(), Reader(), FLDA_3)
NAN, ROWS = torch.tensor([0.0, float("nan"), 1.0]), torch.ones(4, 3)

TAKEN: dict[str, Callable[[], torch.Tensor]] = {
    "array of frames": lambda: RECEIVER.decode(GREY[:, 0].numpy()).bits,
    "array of frames with a channel": lambda: RECEIVER.decode(GREY.numpy()).bits,
    "array, one frame": lambda: RECEIVER.decode(IMAGE).bits,
    "array that cannot be written": lambda: RECEIVER.decode(
        np.broadcast_to(IMAGE, (2, *IMAGE.shape))
    ).bits[1:],
    "array in another order": lambda: (
        RECEIVER.decode(np.ascontiguousarray(IMAGE[::-1])[::-1]).bits
    ),
    "tensor, one frame": lambda: RECEIVER.decode(GREY[0, 0]).bits,
    "frames": lambda: RECEIVER.decode(FRAMES).bits,
    "called with a tensor": lambda: RECEIVER(GREY).bits,
    "called with an array": lambda: RECEIVER(IMAGE).bits,
    "known corners from an array": lambda: (
        RECEIVER(GREY, Panels.known(CORNERS.corners_px.numpy())).bits
    ),
    "bits of an array": lambda: RECEIVER(SIMULATOR.render(SCENE, BITS.numpy())).bits,
    "features of an array": lambda: FLDA_3.predict(
        RECEIVER.reader.read(FRAMES, CORNERS).features.numpy()
    ),
}


@pytest.mark.parametrize("what", TAKEN)
def test_what_is_obvious_is_taken_and_means_the_same(what):
    bits = TAKEN[what]()
    assert torch.equal(bits, BITS[: len(bits)])


REFUSED: dict[str, tuple[Callable[[], object], str]] = {
    "decode a list": (lambda: RECEIVER.decode(IMAGE.tolist()), "images is [["),
    "decode a picture of Pillow": (
        lambda: RECEIVER.decode(Image.fromarray(IMAGE)),
        "images is <PIL.",
    ),
    "decode None": (
        lambda: RECEIVER.decode(None),
        "images is None: it must be a tensor or a NumPy array",
    ),
    "decode floats": (
        lambda: RECEIVER.decode(IMAGE / 255),
        "images has dtype torch.float64 and",
    ),
    "decode colours": (
        lambda: RECEIVER.decode(np.stack([IMAGE] * 3, 2)),
        "images has dtype torch.uint8 and",
    ),
    "decode objects": (
        lambda: RECEIVER.decode(np.array([None, 1])),
        "images is array([None, 1]",
    ),
    "call with a list": (
        lambda: RECEIVER([1]),
        "frames is [1]: it must be a tensor or a NumPy array",
    ),
    "call with corners": (
        lambda: RECEIVER(FRAMES, CORNERS.corners_px),
        "panels is tensor(",
    ),
    "locate None": (lambda: PaperLocator()(None, SHAPE), "frames is None"),
    "locate no shape": (lambda: RefinedLocator()(FRAMES, (8, 8)), "shape is (8, 8)"),
    "read a tensor": (lambda: Reader().read(GREY, CORNERS), "frames is tensor("),
    "read without panels": (
        lambda: Reader().read(FRAMES, None),
        "panels is None: it must be of type Panels",
    ),
    "reader": (
        lambda: Reader((8, 8)),
        "shape is (8, 8): it must be of type PanelShape",
    ),
    "receiver's name": (
        lambda: Receiver(["flda_3"], PaperLocator(), Reader(), FLDA_3),
        "receiver name is [",
    ),
    "receiver's locator": (
        lambda: Receiver("flda_3", "paper", Reader(), FLDA_3),
        "locator is 'paper'",
    ),
    "receiver's reader": (
        lambda: Receiver("flda_3", PaperLocator(), SHAPE, FLDA_3),
        "reader is PanelShape(",
    ),
    "receiver's classifier": (
        lambda: Receiver("flda_3", PaperLocator(), Reader(), 3),
        "classifier is 3: it",
    ),
    "bank's classifier": (lambda: bank_of(["flda_3"], "flda"), "flda is 'flda'"),
    "load a number": (
        lambda: Receiver.load(5),
        "path is 5: it must be text, or a path",
    ),
    "save at the root": (
        lambda: RECEIVER.save("/"),
        "path is '/': it must be that of a file",
    ),
    "save nowhere": (
        lambda: RECEIVER.save(None),
        "path is None: it must be text, or a path",
    ),
    "render no scene": (
        lambda: SIMULATOR.render(None, BITS),
        "scene is None: it must be of type Scene",
    ),
    "render no bits": (
        lambda: SIMULATOR.render(SCENE, None),
        "bits is None: it must be a tensor or a NumPy",
    ),
    "render numbers": (
        lambda: SIMULATOR.render(SCENE, BITS.double()),
        "bits has the type torch.float64",
    ),
    "render nearest text": (
        lambda: SIMULATOR.render(SCENE, BITS, nearest_m="x"),
        "nearest_m is 'x'",
    ),
    "render a key": (lambda: SIMULATOR.render(SCENE, BITS, keys="ab"), "keys is 'ab'"),
    "render keys of text": (
        lambda: SIMULATOR.render(SCENE, BITS, keys=["a", "b"]),
        "keys is 'a'",
    ),
    "contrast of nothing": (
        lambda: SIMULATOR.contrast("x"),
        "scene is 'x': it must be of type Scene",
    ),
    "crop nearest text": (
        lambda: SIMULATOR.crop_px(None),
        "nearest_m is None: it must be a finite number",
    ),
    "simulator of text": (
        lambda: Simulator("x"),
        "camera is 'x': it must be of type Camera",
    ),
    "simulator's camera": (lambda: Simulator(LedPanel()), "camera is LedPanel("),
    "simulator's panel": (lambda: Simulator(panel=SHAPE), "panel is PanelShape("),
    "effects by name": (
        lambda: Simulator(effects=["saturation"]),
        "scene.effects is ['saturation']",
    ),
    "effect of a number": (
        lambda: Simulator(effects={"saturation": 5}),
        "scene.effects.saturation is 5",
    ),
    "effect number": (
        lambda: Simulator(effects={5: {}}),
        "scene.effects.5 is not a known effect",
    ),
    "panel's shape": (
        lambda: LedPanel((8, 8)),
        "panel.shape is (8, 8): it must be of type PanelShape",
    ),
    "rows": (lambda: PanelShape("x"), "panel.rows is 'x': it must be a whole number"),
    "scene of text": (
        lambda: Scene.of("x"),
        "frames is 'x': it must be a whole number",
    ),
    "scene of a list": (
        lambda: Scene.of(distance_m=[50.0]),
        "scene.distance_m is [50.0]",
    ),
    "no frames": (
        lambda: Frames.whole([1]),
        "grey is [1]: it must be a tensor or a NumPy array",
    ),
    "no corners": (
        lambda: Panels.known(None),
        "corners_px is None: it must be a tensor or a NumPy array",
    ),
    "fit lists": (
        lambda: FLDA(3).fit([[0.0] * 3], [1]),
        "features is [[0.0, 0.0, 0.0]]",
    ),
    "fit bits of text": (
        lambda: FLDA(3).update(ROWS, np.array(["0"] * 4)),
        "bits is array(",
    ),
    "merge text": (lambda: FLDA(3).merge("x"), "other is 'x': it must be of type FLDA"),
    "endless": (
        lambda: Simulator(effects={"blooming": {"sigma_px": math.inf}}),
        "scene.effects.blooming.",
    ),
    "select a number": (
        lambda: FLDA_3.select(5),
        "features is 5: it must be of type Iterable",
    ),
    "score NaN": (
        lambda: FLDA_3.decision_function(NAN),
        "features holds a value that is not finite",
    ),
    "score infinity": (
        lambda: FLDA_3(ROWS / 0),
        "features holds a value that is not finite",
    ),
    "closing": (lambda: PaperLocator("x"), "location.closing_px is x: it must be odd"),
    "least area": (
        lambda: PaperLocator(min_area_px="x"),
        "location.min_area_px is 'x': it must be a whole",
    ),
    "least share": (
        lambda: RefinedLocator(min_share=None),
        "location.min_share is None",
    ),
    "least likeness": (
        lambda: PaperLocator(min_compactness="x"),
        "location.min_compactness is 'x'",
    ),
    "refined by name": (
        lambda: RefinedLocator("paper"),
        "paper is 'paper': it must be of type PaperLocator",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_the_rest_is_refused_by_name_in_one_line(what):
    call, said = REFUSED[what]
    with pytest.raises(VoccError) as refused:
        call()
    assert str(refused.value).startswith(said)
    assert "\n" not in str(refused.value)
