"""``vocc-torch doctor``: versions, device, missing extras, and the time of a picture."""

import platform
import re
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement

from vocc_torch import __version__

DISTRIBUTION = "vocc-torch"
DEVELOPMENT = ("test", "docs", "benchmark")
"""Extras that a user does not need."""
PURPOSES = {
    "video": "films, cameras and standard input",
    "heif": "pictures of phones (HEIC)",
    "viewer": "decode.show=true",
    "messages": "films of messages and Reed-Solomon codes",
    "ldpc": "LDPC codes of 5G",
    "parallel": "several jobs at a time",
    "ray": "executor=ray",
    "dask": "executor=dask",
    "classifiers": "classifiers of scikit-learn",
    "onnx": "receivers as ONNX graphs",
}


class Check(NamedTuple):
    """One line of the report.

    Args:
        name: subject of the check.
        is_good: whether the check passed.
        found: result of the check.
        advice: remedy; empty if the check passed.
    """

    name: str
    is_good: bool
    found: str
    advice: str = ""

    def __str__(self) -> str:
        """The line, which begins with ok or a dash."""
        mark = "ok" if self.is_good else "--"
        advice = f": {self.advice}" if self.advice else ""
        return f"{mark}  {self.name:<12} {self.found}{advice}"


def run_doctor() -> int:
    """Print every check; status 1 where a picture cannot be decoded."""
    status = 0
    for check in (*versions(), *extras(), cameras(), *decoding()):
        print(check, flush=True)
        status |= check.name == "decode" and not check.is_good
    return status


def versions() -> Iterator[Check]:
    """Versions of Python and of the libraries, and what computes."""
    from vocc_torch.measure.timing import describe_machine
    from vocc_torch.types import resolve_device

    system = f"Python {platform.python_version()}, {platform.platform(terse=True)}"
    yield Check(DISTRIBUTION, True, f"{__version__}, {system}")
    names = ("torch", "kornia", "numpy", "hydra-core")
    libraries = ", ".join(f"{name} {version(name)}" for name in names)
    yield Check("libraries", True, libraries)
    device = resolve_device("auto")
    advice = "device=cuda needs an NVIDIA GPU and a torch built for it"
    found = f"{device}, {describe_machine(device)}"
    yield Check("device", True, found, advice * (device.type == "cpu"))


def extras() -> Iterator[Check]:
    """The extras of the package, each with the line that installs it."""
    by_extra: dict[str, list[Requirement]] = {}
    for text in requires(DISTRIBUTION) or ():
        requirement = Requirement(text)
        extra = re.search(r"extra == ['\"](\w+)", str(requirement.marker))
        if extra and extra[1] not in DEVELOPMENT:
            by_extra.setdefault(extra[1], []).append(requirement)
    for name, requirements in by_extra.items():
        lacking = [str(part.name) for part in requirements if not is_there(part)]
        purpose = PURPOSES.get(name, "")
        found = f"without {', '.join(lacking)}" if lacking else "installed"
        advice = (
            f"for {purpose} pip install '{DISTRIBUTION}[{name}]'" if lacking else ""
        )
        yield Check(name, not lacking, found, advice)


def is_there(requirement: Requirement) -> bool:
    """Whether a distribution is installed in a version that is asked for."""
    try:
        return requirement.specifier.contains(
            version(requirement.name), prereleases=True
        )
    except PackageNotFoundError:
        return False


def cameras() -> Check:
    """Cameras that ``input=camera:NUMBER`` may open."""
    try:
        import av
    except ImportError:
        return Check(
            "camera", False, "no reader", f"pip install '{DISTRIBUTION}[video]'"
        )
    if sys.platform != "linux":
        return Check("camera", True, f"PyAV {av.__version__}", "input=camera:0")
    found = sorted(path.name for path in Path("/dev").glob("video*"))
    if not found:
        return Check("camera", False, "no /dev/video*", "connect a camera")
    return Check("camera", True, ", ".join(found), "input=camera:0")


def decoding() -> Iterator[Check]:
    """Decode a drawn panel of known bits with the receiver that ships, and time each stage."""
    from vocc_torch.report.terminal import Stopwatch

    watch = Stopwatch()
    with watch.stage("load"):
        import torch

        from vocc_torch.receiver.shipped import shipped_receiver
        from vocc_torch.simulation import Simulator
        from vocc_torch.types import Scene

        receiver = shipped_receiver("street")
    bits = torch.rand(1, 8, 8, generator=torch.Generator().manual_seed(0)) < 0.5
    frames = Simulator(framing="full").render(Scene.of(distance_m=20.0), bits)
    with watch.stage("locate"):
        panels = receiver.locator(frames, receiver.shape)
    with watch.stage("read"):
        read = receiver(frames, panels).bits
    wrong = int((read != bits).sum())
    found = f"{wrong} of {bits.numel()} bits of a drawn panel are wrong"
    yield Check("decode", not wrong, found, "install the package again" * bool(wrong))
    times = ", ".join(
        f"{name} {1000 * taken:.0f} ms" for name, taken in watch.seconds.items()
    )
    yield Check("times", True, f"{times} for the first frame of 1920 x 1080")
