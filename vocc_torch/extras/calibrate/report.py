"""The page of a calibration: measured beside expected, what is left, and every value with its uncertainty."""

import math
from pathlib import Path

import numpy as np
from matplotlib import colormaps

from vocc_torch.extras.calibrate.fit import SURE
from vocc_torch.extras.calibrate.noise import ROUNDING, expected
from vocc_torch.extras.calibrate.scene import WORDS, Findings
from vocc_torch.extras.calibrate.transfer import TransferCurve
from vocc_torch.files import write_atomically
from vocc_torch.report import page, plots
from vocc_torch.report.led_plots import Picture, picture_figure

FARTHEST = 5.0
"""Standard deviations at which the colours of residuals end, or of theirs where they are the wider."""


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
