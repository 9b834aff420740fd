"""The whole link on a CUDA device against the CPU; skipped where there is none."""

import pytest
import torch

from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.studies.link import Link

pytestmark = [
    pytest.mark.cuda,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device"),
]


@pytest.mark.parametrize("locator", [None, PaperLocator()], ids=["truth", "paper"])
def test_the_gpu_sees_and_reads_what_the_cpu_does(locator):
    """Draws are equal; pixels may differ by one grey level where float32 rounds the other way."""
    key = [BlockKey(0, "cuda", 0)]
    seen = {}
    for device in ("cpu", "cuda"):
        link = Link(Simulator(device=device), locator, Reader())
        seen[device] = next(link.observe(SceneModel(), key, preambles=True))
    cpu, cuda = seen["cpu"], seen["cuda"]
    assert torch.equal(cpu.bits, cuda.bits.cpu())
    difference = (cpu.frames.grey.int() - cuda.frames.grey.cpu().int()).abs()
    assert int(difference.max()) <= 1
    assert float((difference > 0).double().mean()) < 1e-3
    assert torch.equal(cpu.panels.found, cuda.panels.found.cpu())
    features = (cpu.readings.features - cuda.readings.features.cpu()).abs().flatten(0, 2)
    assert float(features.amax(0)[0]) < 0.05
