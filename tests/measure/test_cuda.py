"""The whole link on a CUDA device against the CPU, on the same draws; skipped where there is none.

The shares of pixels and bits that differ are recorded as properties of each test (``--junitxml``). What may
differ: a GPU adds in another order, so a value on the edge between two grey values rounds the other way; with
TF32 on, as torch has it by default, float32 convolutions (the Sobel filter of GRI, the ring of NGR) keep 10
bits of their inputs. Float64 knows no TF32.
"""

from contextlib import contextmanager
from functools import cache

import pytest
import torch

from vocc_torch.measure.link import Link, block_keys
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.types import Frames

pytestmark = [
    pytest.mark.cuda,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device"),
]

FRAMES = 128


@contextmanager
def tf32(allowed):
    """Let convolutions round their inputs to TF32, or not."""
    with torch.backends.cudnn.flags(
        enabled=True, benchmark=False, deterministic=False, allow_tf32=allowed
    ):
        yield


def run(device, locator, dtype, flda=None):
    """Run the link on a device, reading in the simulation's precision; everything comes back on the CPU."""
    link = Link(Simulator(device=device, dtype=dtype), locator, Reader())
    found = {
        name: [] for name in ("grey", "corners", "found", "features", "bits", "on")
    }
    for seen in link.observe(
        SceneModel(), block_keys(0, "cuda", FRAMES), preambles=True
    ):
        frames = seen.frames
        features = seen.readings.features
        if dtype == torch.float64:
            wide = Frames(
                frames.grey.double(),
                frames.origin_px,
                frames.sensor_px,
                frames.surround,
            )
            features = link.reader.read(wide, seen.panels).features
        parts = (
            frames.grey,
            seen.panels.corners_px,
            seen.panels.found,
            features,
            seen.bits,
        )
        for name, part in zip(found, (*parts, seen.preambles.on.average), strict=True):
            found[name].append(part.cpu())
    joined = {name: torch.cat(parts) for name, parts in found.items()}
    flda = flda or FLDA(3).fit(joined["features"], joined["bits"])
    return joined | {
        "scores": flda.to(device)(joined["features"].to(device)).cpu()
    }, flda.cpu()


@cache
def on_cpu(locator, dtype):
    """Run the link on the CPU, once for all settings of the GPU."""
    return run("cpu", locator, dtype)


def shares(first, second):
    """Give the shares of pixels and bits that differ, and the largest difference of the features."""
    pixels = float((first["grey"] != second["grey"]).double().mean())
    bits = float(((first["scores"] >= 0) != (second["scores"] >= 0)).double().mean())
    return (
        pixels,
        bits,
        (first["features"] - second["features"]).abs().flatten(0, 2).amax(0).tolist(),
    )


@pytest.mark.parametrize("allowed", [False, True], ids=["exact", "TF32"])
@pytest.mark.parametrize(
    "dtype", [torch.float32, torch.float64], ids=["float32", "float64"]
)
@pytest.mark.parametrize("locator", [None, PaperLocator()], ids=["truth", "paper"])
def test_the_gpu_sees_and_reads_what_the_cpu_does(
    locator, dtype, allowed, record_property
):
    """Draws are equal; pixels may differ by one grey value, and bits only where a score is all but 0."""
    cpu, flda = on_cpu(locator, dtype)
    with tf32(allowed):
        cuda, _ = run("cuda", locator, dtype, flda)
    assert torch.equal(cpu["bits"], cuda["bits"])
    assert torch.equal(cpu["found"], cuda["found"])
    pixels, bits, features = shares(cpu, cuda)
    record_property(
        "shares of pixels and bits that differ, largest differences",
        (pixels, bits, features),
    )
    assert int((cpu["grey"].int() - cuda["grey"].int()).abs().max()) <= 1
    assert pixels < (1e-5 if dtype == torch.float32 else 1e-7)
    assert bits < 1e-3
    same = (cpu["grey"] == cuda["grey"]).flatten(1).all(1) & (
        cpu["corners"] == cuda["corners"]
    ).flatten(1).all(1)
    apart = (cpu["features"] - cuda["features"])[same].abs().flatten(0, 2).amax(0)
    rounding = torch.tensor(
        [1e-9, 1e-9, 1e-9] if dtype == torch.float64 else [1e-4, 1e-3, 1e-4]
    )
    if allowed and dtype == torch.float32:
        # 2^-11 of 255 through the filter's weights: half a grey value a sample at most.
        rounding = torch.tensor([1e-4, 0.5, 2**-10])
    assert bool((apart <= rounding).all()), apart
