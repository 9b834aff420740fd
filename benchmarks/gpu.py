"""Everything on one GPU in seven minutes: equality with the CPU, speed, memory, and where the time goes.

Every section is a process of its own with a time limit. Its rows are appended to the CSV file at once, so
that a run that is cut off keeps what it had. A section that fails leaves a row with the reason.

    python benchmarks/gpu.py --csv gpu.csv
    python benchmarks/gpu.py --dry --csv dry.csv    # a batch of 8 on the CPU: does every section run?
"""

import argparse
import csv
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import torch

from vocc_torch import PanelShape, load_scene
from vocc_torch.measure.counts import half_errors
from vocc_torch.measure.link import Link, Observation, block_keys
from vocc_torch.measure.plan import World
from vocc_torch.measure.timing import describe_machine, interleaved, median_of
from vocc_torch.plugins import one_line
from vocc_torch.receiver.deciders import bank_of
from vocc_torch.receiver.features import led_measures
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.resample import cell_size_px
from vocc_torch.types import Frames

FIELDS = ("section", "what", "device", "batch", "value", "unit", "note")
NOT_MEASURED = "not measured"
CUDA_TESTS = ("tests/measure/test_cuda.py",)
ROOT = Path(__file__).resolve().parents[1]
SHAPE = PanelShape(8, 8)

Row = dict[str, object]


@dataclass(frozen=True)
class Settings:
    """Sizes of a run; the limits add up to less than seven minutes."""

    device: str = "cuda"
    scenes: tuple[str, ...] = ("paper", "night")  # compared with the CPU
    equality_frames: int = 2048  # of each scene, compared with the CPU
    equality_s: float = 45.0  # of each scene; what was compared by then counts
    training_frames: int = 512  # of the discriminant
    batches: tuple[int, ...] = (256, 1024, 4096, 16384)
    middle_batch: int = 4096  # profiled and compiled
    cpu_batch: int = 64  # quickest on a CPU
    cpu_threads: int = 2
    rounds: int = 5
    kernels: int = 10  # longest ones that are listed
    full_frames: int = 64  # full-HD frames of the receiver alone
    full_batch: int = 32
    copied_bytes: int = 1 << 30  # copied to measure the memory's bandwidth
    backend: str = "inductor"  # of torch.compile
    slowness: float = 1.0  # of the machine: what the sections' limits are times


DRY = Settings(
    device="cpu",
    scenes=("paper",),
    equality_frames=8,
    training_frames=32,
    cpu_threads=1,
    batches=(8,),
    middle_batch=8,
    cpu_batch=8,
    rounds=1,
    kernels=2,
    full_frames=2,
    full_batch=2,
    copied_bytes=1 << 10,
    backend="eager",
    slowness=10.0,
)


def synchronize(device: str) -> None:
    """Wait until the device is done."""
    if device == "cuda":
        torch.cuda.synchronize()


def link_on(device: str, batch: int, scene: str = "paper") -> tuple[Link, World]:
    """Build the link with the paper's locator, and the world that it simulates."""
    world = replace(load_scene(scene), device=device)
    return Link(world.simulator(), PaperLocator(), Reader(SHAPE), batch), world


def observed(link: Link, world: World, frames: int) -> Iterator[Observation]:
    """Observe frames in batches; the name of the point is the same on every device."""
    return link.observe(
        world.scene, block_keys(0, "gpu", frames), preambles=False, frames=frames
    )


@cache
def trained(settings: Settings) -> FLDA:
    """Fit the discriminant on the CPU."""
    flda = FLDA(3)
    for seen in observed(*link_on("cpu", 64), settings.training_frames):
        found = seen.panels.found
        flda.update(seen.readings.features[found], seen.bits[found])
    return flda


def equality(settings: Settings) -> Iterator[Row]:
    """Compare decisions, counts and pixels of the CPU and the device."""
    flda = trained(settings)
    for scene in settings.scenes:
        begin, frames, largest = time.monotonic(), 0, 0
        sums = dict.fromkeys(("pixels", "unlike_pixels", "unlike_bits"), 0)
        errors = {"cpu": 0, settings.device: 0}
        views = [
            observed(*link_on(device, 64, scene), settings.equality_frames)
            for device in ("cpu", settings.device)
        ]
        for pair in zip(*views, strict=True):
            decided = []
            for seen, device in zip(pair, ("cpu", settings.device), strict=True):
                decider = bank_of(["flda_3"], flda)["flda_3"].to(torch.device(device))
                bits = decider.score(seen.readings) >= 0
                halves = half_errors(bits, seen.bits, seen.panels.found)
                errors[device] += int(halves.sum())
                decided.append((bits & seen.panels.found.view(-1, 1, 1)).cpu())
            grey = [seen.frames.grey.cpu().int() for seen in pair]
            apart = (grey[0] - grey[1]).abs()
            frames, largest = frames + len(apart), max(largest, int(apart.max()))
            sums["pixels"] += apart.numel()
            sums["unlike_pixels"] += int((apart > 0).sum())
            sums["unlike_bits"] += int((decided[0] != decided[1]).sum())
            if time.monotonic() - begin > settings.equality_s:
                break
        about = {"what": scene, "batch": 64}
        yield about | {"value": frames, "unit": "frames compared"}
        yield about | {"value": sums["unlike_bits"], "unit": "bits unlike the CPU's"}
        for device, count in errors.items():
            yield about | {"device": device, "value": count / 2, "unit": "bit errors"}
        share = sums["unlike_pixels"] / sums["pixels"]
        yield about | {"value": share, "unit": "share of pixels unlike the CPU's"}
        yield about | {"value": largest, "unit": "largest difference, grey values"}


def tests(settings: Settings) -> Iterator[Row]:
    """Run the tests that need a GPU."""
    words = ["-m", "pytest", "-q", "-o", "addopts=", "-p", "no:cacheprovider"]
    command = [sys.executable, *words, "-m", "cuda", *CUDA_TESTS]
    if settings.device != "cuda":
        command.append("--collect-only")
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False
    )
    last = [*done.stdout.strip().splitlines(), done.stderr.strip()[-200:]][-2:]
    yield {"what": "pytest -m cuda", "value": done.returncode, "note": " ".join(last)}


def stages_of(
    settings: Settings, device: str, batch: int, flda: FLDA
) -> tuple[Callable[[], None], dict[str, Callable[[], Any]]]:
    """Give the link on a batch and its stages; each stage gets the last output of the stage before."""
    link, world = link_on(device, batch)
    decider = bank_of(["flda_3"], flda)["flda_3"].to(torch.device(device))
    keys = block_keys(0, "gpu", batch)
    drawn = [world.scene.draw(key, SHAPE) for key in keys]
    scene = type(drawn[0][0]).cat([one for one, _ in drawn])[:batch]
    sent = torch.cat([bits for _, bits in drawn])[:batch]
    kept: dict[str, Any] = {}

    def simulate() -> None:
        kept["frames"] = link.simulator.render(
            scene, sent, nearest_m=world.scene.nearest_m
        )

    def locate() -> None:
        kept["panels"] = PaperLocator()(kept["frames"], SHAPE)

    def read() -> None:
        kept["readings"] = link.reader.read(kept["frames"], kept["panels"])

    def decide() -> None:
        bits = decider.score(kept["readings"]) >= 0
        there = sent.to(device, non_blocking=True)
        kept["errors"] = half_errors(bits, there, kept["panels"].found)

    stages: dict[str, Callable[[], Any]] = {
        "simulate": simulate,
        "locate": locate,
        "read": read,
        "decide": decide,
    }

    def whole() -> None:
        for stage in stages.values():
            stage()

    return whole, stages


def host_waits(stage: Callable[[], Any]) -> object:
    """Count how often a stage makes the host wait for the GPU."""
    torch.cuda.set_sync_debug_mode("warn")
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            stage()
    finally:
        torch.cuda.set_sync_debug_mode("default")
    return sum("synchronizing" in str(one.message) for one in caught)


@torch.inference_mode()
def link(settings: Settings) -> Iterator[Row]:
    """Time the link and its stages by batch, count the host's waits, and list the longest kernels."""
    flda = trained(settings)
    torch.set_num_threads(settings.cpu_threads)
    sizes = [("cpu", settings.cpu_batch)]
    sizes += [(settings.device, batch) for batch in settings.batches]
    for device, batch in sizes:
        whole, stages = stages_of(settings, device, batch, flda)
        whole()
        times = interleaved(
            {"link": whole} | stages, settings.rounds, torch.device(device)
        )
        for name, timing in times.items():
            rate = batch / median_of(timing).value
            about = {"what": name, "device": device, "batch": batch}
            yield about | {"value": f"{rate:.5g}", "unit": "frames/s"}
            if device == "cuda" and name != "link":
                yield about | {"value": host_waits(stages[name]), "unit": "host waits"}
    whole, _ = stages_of(settings, settings.device, settings.middle_batch, flda)
    whole()
    synchronize(settings.device)
    with torch.profiler.profile() as profile:
        whole()
        synchronize(settings.device)
    name = f"self_{'device' if settings.device == 'cuda' else 'cpu'}_time_total"
    spent = sorted(profile.key_averages(), key=lambda one: -getattr(one, name))
    for one in spent[: settings.kernels]:
        about = {"what": f"kernel {one.key[:80]}", "batch": settings.middle_batch}
        milliseconds = f"{getattr(one, name) / 1e3:.4g}"
        yield about | {"value": milliseconds, "unit": "ms", "note": f"{one.count} x"}


@torch.inference_mode()
def receiver(settings: Settings) -> Iterator[Row]:
    """Time the receiver on full-HD frames: resident, copied first, on CPU cores, and OpenCV's."""
    flda = trained(settings)
    world = replace(load_scene("paper"), framing="filled")
    full = Link(world.simulator(), None, Reader(SHAPE), settings.full_batch)
    seen = list(observed(full, world, settings.full_frames))
    grey = torch.cat([one.frames.grey for one in seen]).cpu()
    torch.set_num_threads(settings.cpu_threads)

    def reading(device: str, frames: torch.Tensor) -> Callable[[], None]:
        decider = bank_of(["flda_3"], flda)["flda_3"].to(torch.device(device))
        locator, reader = PaperLocator(), Reader(SHAPE)

        def read() -> None:
            for part in frames.split(settings.full_batch):
                there = Frames.whole(part.to(device, non_blocking=True))
                panels = locator(there, SHAPE)
                decider.score(reader.read(there, panels))

        return read

    calls = {"cpu cores": reading("cpu", grey)}
    pinned = grey.pin_memory() if settings.device == "cuda" else grey
    calls["copied"] = reading(settings.device, pinned)
    resident = grey.to(settings.device)
    calls["resident"] = reading(settings.device, resident)
    bytes_there = torch.empty(
        settings.copied_bytes, dtype=torch.uint8, device=settings.device
    )
    calls["memory"] = bytes_there.clone
    try:
        from peer_read import read_bits
        from peer_render import PeerConfig

        rule = flda.direction.numpy(), float(flda.threshold), PeerConfig()
        calls["OpenCV, one frame at a time"] = lambda: read_bits(
            grey[:, 0].numpy(), *rule
        )
    except ImportError as error:
        yield {"what": "OpenCV", "value": NOT_MEASURED, "note": one_line(error)}
    times = interleaved(calls, settings.rounds, torch.device(settings.device))
    spent = {name: median_of(one).value for name, one in times.items()}
    bandwidth = 2 * settings.copied_bytes / spent.pop("memory")
    yield {"what": "memory", "value": f"{bandwidth / 1e9:.4g}", "unit": "GB/s"}
    for name, seconds in spent.items():
        about = {"what": name, "batch": settings.full_batch}
        rate = len(grey) / seconds
        yield about | {"value": f"{rate:.5g}", "unit": "full-HD frames/s"}
    share = grey.numel() / spent["resident"] / bandwidth
    yield {"what": "resident", "value": f"{share:.4g}", "unit": "of the bandwidth"}


@torch.inference_mode()
def memory(settings: Settings) -> Iterator[Row]:
    """Measure the peak memory of the link by batch."""
    flda = trained(settings)
    for batch in settings.batches:
        whole, _ = stages_of(settings, settings.device, batch, flda)
        peak: object = NOT_MEASURED
        if settings.device == "cuda":
            torch.cuda.reset_peak_memory_stats()
        whole()
        if settings.device == "cuda":
            peak = f"{torch.cuda.max_memory_allocated() / 2**30:.4g}"
        yield {"what": "link", "batch": batch, "value": peak, "unit": "GiB"}


@torch.inference_mode()
def compiled(settings: Settings) -> Iterator[Row]:
    """Compare the compiled features with those of the uncompiled function."""
    link, world = link_on(settings.device, settings.middle_batch)
    seen = next(iter(observed(link, world, settings.middle_batch)))
    (patches,) = link.reader.rectify([seen.frames], seen.panels)
    sizes = cell_size_px(seen.panels.corners_px, SHAPE)
    needed = ("agr", "gri", "ngr")

    def features() -> object:
        return led_measures(patches, SHAPE, *sizes, "sobel", needed)

    graph = torch.compile(features, backend=settings.backend)
    times = interleaved(
        {"features": features, "compiled features": graph},
        settings.rounds,
        torch.device(settings.device),
    )
    for name, timing in times.items():
        spent = f"{1e3 * median_of(timing).value:.4g}"
        about = {"what": name, "batch": settings.middle_batch}
        yield about | {"value": spent, "unit": "ms"}


SECTIONS: dict[str, tuple[Callable[[Settings], Iterator[Row]], float]] = {
    "equality": (equality, 110.0),
    "link": (link, 100.0),
    "receiver": (receiver, 60.0),
    "tests": (tests, 60.0),
    "memory": (memory, 30.0),
    "compiled": (compiled, 40.0),
}
"""The sections, the most important first, with their limits in s."""


def write(path: Path, section: str, device: str, row: Row) -> None:
    """Append a row and write it to disk before the next measurement."""
    fresh = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, FIELDS, restval="", lineterminator="\n")
        if fresh:
            writer.writeheader()
        whole = {"section": section, "device": device} | row
        note = " ".join(str(whole.get("note", "")).split())
        writer.writerow(whole | {"note": note})
        file.flush()
        os.fsync(file.fileno())


def run(section: str, settings: Settings, path: Path) -> None:
    """Measure one section in this process."""
    try:
        for row in SECTIONS[section][0](settings):
            write(path, section, settings.device, row)
    except Exception as error:
        reason = {"what": "failed", "value": NOT_MEASURED, "note": one_line(error)}
        write(path, section, settings.device, reason)


def apart(section: str, settings: Settings, path: Path, words: list[str]) -> None:
    """Measure one section in a process of its own, and end it at its limit."""
    command = [sys.executable, __file__, "--only", section, "--csv", str(path), *words]
    reason = ""
    try:
        limit_s = settings.slowness * SECTIONS[section][1]
        status = subprocess.run(command, timeout=limit_s, check=False)
        if status.returncode:
            reason = f"status {status.returncode}"
    except subprocess.TimeoutExpired as error:
        reason = f"cut off after {error.timeout:g} s"
    if reason:
        row = {"what": "ended", "value": NOT_MEASURED, "note": reason}
        write(path, section, settings.device, row)


def main() -> None:
    """Measure the chosen sections."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--csv", type=Path, required=True, help="file for the rows")
    parser.add_argument("--only", choices=SECTIONS, help="one section, in this process")
    parser.add_argument("--dry", action="store_true", help="a batch of 8 on the CPU")
    given = parser.parse_args()
    settings = DRY if given.dry else Settings()
    if given.only:
        run(given.only, settings, given.csv)
        return
    if settings.device == "cuda" and not torch.cuda.is_available():
        for section in SECTIONS:
            row = {"what": "all", "value": NOT_MEASURED, "note": "no CUDA device"}
            write(given.csv, section, settings.device, row)
        return
    machine = describe_machine(torch.device(settings.device))
    write(given.csv, "machine", settings.device, {"what": machine})
    for section in SECTIONS:
        apart(section, settings, given.csv, ["--dry"] if given.dry else [])


if __name__ == "__main__":
    main()
