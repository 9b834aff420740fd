"""``vocc-torch doctor``: versions, device, missing extras, and the time of a picture."""

import platform
import re
import sys
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

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


def say(is_good: bool, name: str, found: str, advice: str = "") -> None:
    """Print a line of the report: ``ok`` or a dash, its subject, the result, and the remedy where there is one."""
    mark, remedy = "ok" if is_good else "--", f": {advice}" if advice else ""
    print(f"{mark}  {name:<12} {found}{remedy}", flush=True)


def run_doctor() -> int:
    """Print every check; status 1 where a picture cannot be decoded."""
    say_versions()
    say_extras()
    say_cameras()
    return decode_picture()


def say_versions() -> None:
    """Say the versions of Python and of the libraries, and what computes."""
    from vocc_torch.measure.timing import describe_machine
    from vocc_torch.types import resolve_device

    system = f"Python {platform.python_version()}, {platform.platform(terse=True)}"
    say(True, DISTRIBUTION, f"{__version__}, {system}")
    names = ("torch", "kornia", "numpy", "hydra-core")
    say(True, "libraries", ", ".join(f"{name} {version(name)}" for name in names))
    device = resolve_device("auto")
    advice = "device=cuda needs an NVIDIA GPU and a torch built for it"
    found = f"{device}, {describe_machine(device)}"
    say(True, "device", found, advice * (device.type == "cpu"))


def say_extras() -> None:
    """Say which extras of the package are installed, and how to install the others."""
    lacking: dict[str, list[str]] = {}
    for requirement in map(Requirement, requires(DISTRIBUTION) or ()):
        found = re.search(r"extra == ['\"](\w+)", str(requirement.marker))
        if found and found[1] not in DEVELOPMENT:
            names = lacking.setdefault(found[1], [])
            names += [requirement.name] * (not is_there(requirement))
    for extra, names in lacking.items():
        command = f"pip install '{DISTRIBUTION}[{extra}]'"
        if names:
            advice = f"for {PURPOSES.get(extra, '')} {command}"
            say(False, extra, f"without {', '.join(names)}", advice)
        else:
            say(True, extra, "installed")


def is_there(requirement: Requirement) -> bool:
    """Whether a distribution is installed in a version that is asked for."""
    try:
        return requirement.specifier.contains(
            version(requirement.name), prereleases=True
        )
    except PackageNotFoundError:
        return False


def say_cameras() -> None:
    """Say which cameras ``input=camera:NUMBER`` may open."""
    found = sorted(path.name for path in Path("/dev").glob("video*"))
    try:
        import av
    except ImportError:
        say(False, "camera", "no reader", f"pip install '{DISTRIBUTION}[video]'")
        return
    if sys.platform != "linux":
        say(True, "camera", f"PyAV {av.__version__}", "input=camera:0")
    elif found:
        say(True, "camera", ", ".join(found), "input=camera:0")
    else:
        say(False, "camera", "no /dev/video*", "connect a camera")


def decode_picture() -> int:
    """Decode a drawn panel of known bits with the receiver that ships, and time each stage; status 1 if it fails."""
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
    say(not wrong, "decode", found, "install the package again" * (wrong > 0))
    times = (f"{name} {1000 * taken:.0f} ms" for name, taken in watch.seconds.items())
    say(True, "times", f"{', '.join(times)} for the first frame of 1920 x 1080")
    return int(wrong > 0)
