"""Hard cases of precision, devices and torch's own settings: the whole link under each of them."""

import shutil
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from vocc_torch.errors import VoccError
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator, RefinedLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution, SceneModel, Simulator
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Frames, PanelShape, Scene, resolve_device

HALVES = (torch.bfloat16, torch.float16)
SHAPE = PanelShape(8, 8)
DARKEST = SceneModel(ambient_lx=Distribution("constant", (1000.0,)))
"""The paper's hardest point: the bit error rate is 1 to 3 %."""


def trained(dtype=torch.float32):
    """Train on one block of crops."""
    link = Link(Simulator(dtype=dtype), PaperLocator(), Reader())
    seen = next(link.observe(SceneModel(), block_keys(0, "train", 64), preambles=False))
    return FLDA(3).fit(seen.readings.features, seen.bits)


def everything(*, frames=64, batch=64, flda=None, **settings):
    """Run the whole link: every tensor that it gives, joined over the batches, and the decided bits."""
    link = Link(Simulator(**settings), PaperLocator(), Reader(), batch_frames=batch)
    flda = flda or trained()
    keys = block_keys(1, "precision", frames)
    seen = list(link.observe(DARKEST, keys, preambles=True, frames=frames))
    parts = {
        "grey": [one.frames.grey for one in seen],
        "corners": [one.panels.corners_px for one in seen],
        "features": [one.readings.features for one in seen],
        "patches": [one.readings.patches for one in seen],
        "centres": [one.readings.greys.centre for one in seen],
        "preambles": [one.preambles.on.average for one in seen],
        "scores": [flda(one.readings.features) for one in seen],
    }
    return {name: torch.cat(tensors) for name, tensors in parts.items()}


def same(first, second):
    """Demand equality to the last bit."""
    for name, tensor in first.items():
        assert tensor.dtype == second[name].dtype, name
        assert torch.equal(tensor, second[name]), name


@contextmanager
def setting(change, value, restored):
    """Change one of torch's global settings for a while."""
    change(value)
    try:
        yield
    finally:
        change(restored)


def test_unknown_precision():
    for name in ("float128", "", "FLOAT32", "double"):
        with pytest.raises(
            VoccError, match=f"^precision is '{name}': it must be float32 or float64$"
        ):
            build_plan(SimpleNamespace(precision=name), Path())


def test_half_precision_in_the_configuration():
    for name in ("bfloat16", "float16", "half"):
        with pytest.raises(VoccError) as refused:
            build_plan(SimpleNamespace(precision=name), Path())
        wanted = f"precision is '{name}': it must be float32 or float64, half precision changes pixels and bits"
        assert str(refused.value) == wanted


def test_half_precision_in_the_simulator():
    for dtype in (*HALVES, torch.int32, torch.complex64, torch.bool):
        with pytest.raises(
            VoccError,
            match=f"^dtype is {dtype}: it must be torch.float32 or torch.float64",
        ):
            Simulator(dtype=dtype)


def test_a_missing_device():
    there = torch.cuda.device_count()
    with pytest.raises(VoccError) as refused:
        resolve_device(f"cuda:{there}")
    assert str(refused.value).startswith(
        f"device is 'cuda:{there}', and this machine has {there} CUDA devices: use"
    )
    for name in ("abacus", "meta", "cuda:-1", "cuda:x", ""):
        with pytest.raises(
            VoccError, match=f"^device is '{name}': it must be auto, cpu or cuda$"
        ):
            resolve_device(name)
        with pytest.raises(
            VoccError, match=f"^device is '{name}': it must be auto, cpu or cuda$"
        ):
            Simulator(device=name)
    assert resolve_device("auto").type == ("cuda" if there else "cpu")


def test_float32_against_float64():
    scene, bits = DARKEST.draw(BlockKey(1, "precision", 0), SHAPE)
    raw = {
        name: value for name, value in PAPER_EFFECTS.items() if name != "quantization"
    }
    double, single = (
        Simulator(effects=raw, dtype=dtype).render(scene, bits).grey
        for dtype in (torch.float64, torch.float32)
    )
    assert (double.dtype, single.dtype) == (torch.float64, torch.float32)
    assert float(((single - double) / double).abs().max()) < 1e-5
    flda = trained(torch.float64)
    exact, near = (
        everything(frames=256, flda=flda, dtype=dtype)
        for dtype in (torch.float64, torch.float32)
    )
    apart = (exact["grey"].int() - near["grey"].int()).abs()
    assert int(apart.max()) <= 1
    assert int((apart > 0).sum()) <= 1e-5 * apart.numel()
    turned = (exact["scores"] >= 0) != (near["scores"] >= 0)
    assert float(exact["scores"].abs()[turned].amax() if turned.any() else 0) < 0.05
    assert float(turned.double().mean()) <= 1e-4


def test_receiver_in_float32():
    scene, bits = DARKEST.draw(BlockKey(1, "precision", 0), SHAPE)
    simulator = Simulator()
    frames, panels = simulator.render(scene, bits), simulator.true_panels(scene)
    double = Frames(
        frames.grey.double(), frames.origin_px, frames.sensor_px, frames.surround
    )
    exact, near = (Reader().read(one, panels) for one in (double, frames))
    assert (exact.patches.dtype, near.patches.dtype) == (torch.float64, torch.float32)
    assert float((exact.features - near.features).abs().max()) < 1e-4


def test_frames_of_half_precision():
    scene, bits = DARKEST.draw(BlockKey(1, "precision", 0), SHAPE)
    simulator = Simulator()
    frames = simulator.render(scene, bits)
    flda = trained()
    receiver = Receiver("flda_3", PaperLocator(), Reader(), flda)
    wanted = receiver(frames)
    for dtype in HALVES:
        halved = Frames(
            frames.grey.to(dtype), frames.origin_px, frames.sensor_px, frames.surround
        )
        decoded = receiver(halved)
        assert torch.equal(decoded.scores, wanted.scores), dtype
        assert torch.equal(decoded.corners_px, wanted.corners_px), dtype
        greys, bytes_ = (
            Reader().read_greys(one, simulator.true_panels(scene))
            for one in (halved, frames)
        )
        assert torch.equal(greys.centre, bytes_.centre), dtype


def test_an_image_of_half_precision():
    receiver = Receiver("flda_3", PaperLocator(), Reader(), FLDA(3))
    for dtype in (*HALVES, torch.float32, torch.int16):
        with pytest.raises(
            VoccError, match=f"^images has dtype {dtype} .*it must be uint8"
        ):
            receiver.decode(torch.zeros(1, 40, 40, dtype=dtype))


def test_another_default_dtype():
    wanted = everything()
    scene = Scene.of(2, ambient_lx=4001.7, distance_m=33.3)
    assert torch.get_default_dtype() == torch.float32
    for dtype in (torch.float64, *HALVES):
        with setting(torch.set_default_dtype, dtype, torch.float32):
            same(everything(), wanted)
            again = Scene.of(2, ambient_lx=4001.7, distance_m=33.3)
        for field in fields(Scene):
            assert torch.equal(
                getattr(again, field.name), getattr(scene, field.name)
            ), (dtype, field.name)


def test_inference_mode():
    wanted = everything()
    with torch.inference_mode():
        inside = everything()
        features = inside["features"].clone()
        flda = FLDA(3).update(
            features,
            torch.arange(features[..., 0].numel()).view(features.shape[:-1]) % 2,
        )
        flda.predict(features)
    same({name: tensor.clone() for name, tensor in inside.items()}, wanted)
    point = torch.ones(3, dtype=torch.float64, requires_grad=True)
    flda(point).backward()
    assert torch.equal(point.grad, flda.direction)


def test_autocast_around_the_link():
    wanted = everything()
    scene, bits = DARKEST.draw(BlockKey(1, "precision", 0), SHAPE)
    frames, panels = Simulator().render(scene, bits), Simulator().true_panels(scene)
    features = Reader().read(frames, panels).features
    average = Reader().read_greys(frames, panels).average
    for dtype in HALVES:
        with torch.autocast("cpu", dtype):
            same(everything(), wanted)
            assert torch.equal(Reader().read(frames, panels).features, features)
            assert torch.equal(Reader().read_greys(frames, panels).average, average)
            assert torch.is_autocast_enabled("cpu"), (
                "the caller's own setting comes back"
            )


def test_autocast_around_a_receiver():
    scene, bits = DARKEST.draw(BlockKey(1, "precision", 0), SHAPE)
    frames = Simulator().render(scene, bits)
    for locator in (PaperLocator(), RefinedLocator()):
        receiver = Receiver("flda_3", locator, Reader(), trained())
        wanted = receiver(frames)
        for dtype in HALVES:
            with torch.autocast("cpu", dtype):
                assert torch.equal(receiver(frames).scores, wanted.scores), (
                    locator,
                    dtype,
                )


def test_autocast_around_the_simulator():
    scene, bits = DARKEST.draw(BlockKey(1, "precision", 0), SHAPE)
    wanted = Simulator().render(scene, bits).grey
    for dtype in HALVES:
        with torch.autocast("cpu", dtype):
            assert torch.equal(Simulator().render(scene, bits).grey, wanted), dtype


def test_threads_and_batches():
    before, flda = torch.get_num_threads(), trained()
    with setting(torch.set_num_threads, 1, before):
        wanted = everything(flda=flda)
        for batch in (1, 7):
            same(everything(batch=batch, flda=flda), wanted)
        full = everything(frames=1, framing="full", flda=flda)
    # Threads that share a busy core wait for each other by spinning: few frames keep that short.
    with setting(torch.set_num_threads, 2, before):
        same(everything(flda=flda), wanted)
        same(everything(frames=1, framing="full", flda=flda), full)


def test_deterministic_mode():
    wanted = everything()
    simulator = Simulator()
    scene = Scene(
        *(getattr(Scene.of(4), field.name).clone() for field in fields(Scene))
    )
    scene.distance_m.copy_(torch.tensor([4.0, 50.0, 12.0, 25.0]))
    frames = simulator.render(scene, torch.ones(4, 8, 8, dtype=torch.bool))

    def read():
        return Reader().read(frames, simulator.true_panels(scene)).features

    plain = read()
    with setting(
        torch.use_deterministic_algorithms,
        True,
        torch.are_deterministic_algorithms_enabled(),
    ):
        for _ in range(2):
            same(everything(), wanted)
            assert torch.equal(read(), plain)


CHANCY = {
    *(
        "put_",
        "histc",
        "median",
        "nanmedian",
        "kthvalue",
        "max_unpool2d",
        "nll_loss",
        "ctc_loss",
    ),
    *(
        "grid_sampler_2d_backward",
        "upsample_bilinear2d_backward",
        "reflection_pad2d_backward",
    ),
}
"""What torch names as without a deterministic form on CUDA (see torch.use_deterministic_algorithms)."""


class Watched(TorchDispatchMode):
    """Note each operation with the type of what it gives."""

    def __init__(self):
        super().__init__()
        self.seen = set()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        given = func(*args, **(kwargs or {}))
        if isinstance(given, torch.Tensor):
            weights = (
                func.overloadpacket.__name__ == "bincount"
                and len(args) > 1
                and args[1] is not None
            )
            self.seen.add(
                (func.overloadpacket.__name__, given.is_floating_point() or weights)
            )
        return given


def test_operations_on_a_gpu():
    with Watched() as watched:
        everything(frames=1, framing="full")
    names = {name for name, _ in watched.seen}
    assert {"index_add_", "bincount", "convolution"} & names == {
        "index_add_",
        "bincount",
        "convolution",
    }, names
    assert not names & CHANCY, names & CHANCY
    floating = {name for name, is_floating in watched.seen if is_floating}
    assert floating & {
        "bincount",
        "cumsum",
        "scatter_add",
        "scatter_add_",
        "index_add_",
    } == {"index_add_"}


@pytest.mark.slow
@pytest.mark.skipif(
    not any(map(shutil.which, ("g++", "clang++"))),
    reason="torch.compile needs a C++ compiler",
)
@pytest.mark.filterwarnings(
    "default:`torch.jit.script_method` is deprecated:DeprecationWarning"
)  # torch's own
def test_compiled_and_eager_agree():
    """Compiled kernels fuse products and sums, so features differ by rounding; pixels and bits do not."""
    scene, bits = DARKEST.draw(BlockKey(1, "precision", 0), SHAPE)
    simulator, reader = Simulator(), Reader()
    eager = simulator.render(scene, bits, nearest_m=DARKEST.nearest_m)
    panels = PaperLocator()(eager, SHAPE)
    flda = trained()

    def score(frames, panels):
        features = reader.read(frames, panels).features
        return features, flda.decision_function(features)

    torch.compiler.reset()
    try:
        made = torch.compile(simulator.render)(scene, bits, nearest_m=DARKEST.nearest_m)
        features, scores = torch.compile(score)(eager, panels)
        breaks = sum(torch._dynamo.utils.counters["graph_break"].values())
    finally:
        torch.compiler.reset()
    wanted_features, wanted = score(eager, panels)
    apart = (made.grey.int() - eager.grey.int()).abs()
    assert int(apart.max()) <= 1
    assert int((apart > 0).sum()) <= 1e-5 * apart.numel()
    assert float((features - wanted_features).abs().max()) < 1e-4
    turned = (scores >= 0) != (wanted >= 0)
    assert not bool((turned & (wanted.abs() > 1e-3)).any())
    assert 0 < breaks < 40, (
        "values on the host part the graph: rectification asks how large its window is"
    )


def test_numpy_shares_no_state_with_the_draws():
    """Scenes and bits come from keyed streams: neither library's global seed moves them."""
    drawn = []
    for seed in (0, 1):
        torch.manual_seed(seed)
        np.random.seed(seed)  # noqa: NPY002  # the global state is what must not matter
        drawn.append(DARKEST.draw(BlockKey(1, "precision", 0), SHAPE))
    assert torch.equal(drawn[0][1], drawn[1][1])
    assert torch.equal(drawn[0][0].distance_m, drawn[1][0].distance_m)
