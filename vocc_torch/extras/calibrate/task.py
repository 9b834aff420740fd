"""``task=calibrate``: a recording in, a scene and a page out."""

import math
import shlex
import warnings
from dataclasses import asdict, replace
from importlib import resources
from pathlib import Path

import numpy as np
from matplotlib import colormaps

from vocc_torch.arrays import read_bits
from vocc_torch.errors import VoccError
from vocc_torch.extras.calibrate import CalibrateConfig
from vocc_torch.extras.calibrate.fit import SURE
from vocc_torch.extras.calibrate.noise import ROUNDING, expected
from vocc_torch.extras.calibrate.reading import read_footage
from vocc_torch.extras.calibrate.scene import WORDS, Findings
from vocc_torch.extras.calibrate.study import calibrate
from vocc_torch.extras.calibrate.transfer import TransferCurve
from vocc_torch.files import write_atomically
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.measure.build import build_panel, receiver_plan
from vocc_torch.measure.config import Settings
from vocc_torch.report import folder as run_folder
from vocc_torch.report import page, plots
from vocc_torch.report.led_plots import Picture, picture_figure
from vocc_torch.report.terminal import Console, ProgressView

FARTHEST = 5.0
"""Standard deviations at which the colours of residuals end, or of theirs where they are the wider."""


def run_calibrate(settings: Settings, config: CalibrateConfig, folder: Path) -> None:
    """Write a recording's scene and its page.

    Raises:
        VoccError: the name of a scene that ships, no input, or one that cannot be calibrated from.
    """
    shipped = resources.files("vocc_torch.conf") / "scene" / f"{settings.name}.yaml"
    if shipped.is_file():
        raise VoccError.of(
            "name",
            repr(settings.name),
            "another name than that of a scene that ships: the calibrated scene bears it",
        )
    source = run_folder.input_of(
        settings, "task=calibrate needs input=VIDEO, a folder of pictures or a picture"
    )
    panel = build_panel(settings.panel)
    receiver, console = receiver_plan(settings, panel), Console()
    locator, bits = receiver.finder, None
    assert locator is not None  # the configuration refuses true corners
    if config.bits is not None:
        bits = read_bits(Path(config.bits), "calibrate.bits", panel.shape.sides)
    with ProgressView(1, console, "reading the recording", unit="") as view:
        footage = read_footage(source, config, locator, panel.shape)
        view.say(f"frames: {len(footage)}")
    camera, doubt = of_size(settings.camera, *footage.greys.shape[1:])
    doubts = [doubt, *(f"input {source}: {said}" for said in footage.doubts())]
    with ProgressView(1, console, "fitting the scene", unit=""):
        study = calibrate(footage, camera, panel, config, bits)
    path = folder / "scene" / f"{settings.name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, study.text(path.stem, source.name).encode())
    run_folder.write_config(settings, folder)
    for sentence in filter(None, doubts + study.doubts):
        warnings.warn(sentence, stacklevel=2)
    command = next_command(settings.name, study.panel)
    write_page(study, source.name, command, folder)
    unknown = [f"not determined: {sentence}" for sentence in study.unknown]
    named = ", ".join(effect.effect for effect in study.effects if effect.asked)
    run_folder.say(console, *unknown, f"effects: {named}", f"train: {command}")
    places = [("scene", str(path.relative_to(folder))), ("page", "page.html")]
    run_folder.print_places(console, folder, places)
    if footage.failures:
        raise VoccError(
            f"{footage.failures[0]}; the scene is of the frames that could be read"
        )


def of_size(camera: Camera, height: int, width: int) -> tuple[Camera, str]:
    """Give the camera whose whole picture has the recording's size, and say what was taken.

    A recording of the same shape is the whole sensor, scaled; another one is a part of it about the middle.
    """
    if (camera.height_px, camera.width_px) == (height, width):
        return camera, ""
    said = f"the frames are {width} x {height} px and camera= says {camera.width_px} x {camera.height_px}: "
    fitted = replace(camera, width_px=width, height_px=height)
    if camera.height_px * width == camera.width_px * height:
        return fitted, said + "they are treated as the whole sensor, scaled"
    wide = camera.sensor_width_mm * width / camera.width_px
    said += "they are treated as the middle of the sensor, with pixels of the same size"
    return replace(fitted, sensor_width_mm=wide), said


def next_command(name: str, fitted: LedPanel) -> str:
    """Give the command that trains for the scene: the panel's keys are said, because no scene has them."""
    usual, found = (
        asdict(panel) | asdict(panel.shape) | {"shape": None}
        for panel in (LedPanel(), fitted)
    )
    words = [
        f"panel.{key}={'null' if value is None else value}"
        for key, value in found.items()
        if value != usual[key]
    ]
    return shlex.join(["vocc-torch", f"scene={name}", *words, "task=train"])


def write_page(study: Findings, source: str, command: str, folder: Path) -> None:
    """Write ``page.md``, ``page.html`` and their pictures.

    Args:
        study: the calibration.
        source: the recording's name.
        command: what trains for the scene.
        folder: the run's.
    """
    rms = write_frames(study, folder / "frames.png")
    if study.curve is not None:
        write_transfer(study.fit.gamma, study.curve, folder / "transfer.png")
    about = {"source": source, "command": command, "study": study, "sure": SURE}
    words = WORDS["effects"]
    text = page.render(__package__, "page.md.j2", rms=rms, words=words, **about)
    html = page.html(text, f"A scene from {source}", folder)
    write_atomically(folder / "page.md", text.encode())
    write_atomically(folder / "page.html", html.encode())


def write_frames(study: Findings, path: Path) -> float:
    """Draw frames as measured, as expected, and what is left of them; give its root mean square."""
    fit, numbers = study.fit, study.footage.numbers
    mean, variance = fit.predicted()
    off = (fit.grey - mean) / np.sqrt(variance)
    far = FARTHEST * max(1.0, math.sqrt(fit.scale))
    order = (off**2).mean((1, 2)).argsort()
    chosen = np.unique([0, order[len(order) // 2], order[-1]])
    shades = colormaps["RdBu_r"](off[chosen] / (2 * far) + 0.5, bytes=True)[..., :3]
    pictures = []
    for frame, shade in zip(chosen, shades, strict=True):
        pictures += [
            Picture(fit.grey[frame], f"frame {numbers[frame]}: measured"),
            Picture(mean[frame], "expected"),
            Picture(shade, "difference", f"to {far:.3g} standard deviations"),
        ]
    plots.save_figure(picture_figure(pictures, "Measured and expected"), path)
    return math.sqrt(((fit.grey - mean) ** 2).mean())


def write_transfer(gamma: float, curve: TransferCurve, path: Path) -> None:
    """Draw the photon transfer curve."""
    figure, (axes,) = plots.sheet(1, "Photon transfer", size_in=(6.1, 4.2))
    fitted = expected(curve.light, gamma, curve.noise)[1]
    axes.plot(curve.light, curve.variance, "o", color=plots.LOOK.ink, label="measured")
    axes.plot(
        curve.light, fitted, color="#0072B2", label="photon transfer and rounding"
    )
    axes.axhline(
        ROUNDING, linestyle=":", color=plots.LOOK.quiet, label="rounding alone"
    )
    axes.loglog()
    axes.set_xlabel("light, relative to that of grey value 118")
    axes.set_ylabel("variance, grey values squared")
    axes.legend(fontsize=8, frameon=False)
    plots.save_figure(figure, path)
