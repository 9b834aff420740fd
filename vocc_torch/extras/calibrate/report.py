"""The page of a calibration: measured beside expected, what is left, and every value with its uncertainty."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vocc_torch.extras.calibrate.noise import ROUNDING, WHITE, expected
from vocc_torch.extras.calibrate.scene import Findings
from vocc_torch.extras.calibrate.transfer import TransferCurve
from vocc_torch.files import write_atomically
from vocc_torch.report import page, plots

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
    fit, curve = study.fit, study.curve
    write_frames(study, folder / "frames.png")
    has_curve = curve is not None and len(curve.light) > 1
    if curve is not None and has_curve:
        write_transfer(study, curve, folder / "transfer.png")
    left = fit.grey - fit.predicted()[0]
    text = page.render(
        __package__,
        "page.md.j2",
        source=source,
        command=command,
        shown=shown,
        study=study,
        rms=float(np.sqrt((left**2).mean())),
        has_curve=has_curve,
    )
    html = page.html(text, f"A scene from {source}", folder)
    write_atomically(folder / "page.md", text.encode())
    write_atomically(folder / "page.html", html.encode())


def shown(setting: float | Sequence[object]) -> str:
    """Write a value as the page shows it.

    Example:
        >>> shown(["uniform", 1.23456, 2.0]), shown(3)
        ('[1.235, 2]', '3')
    """
    if isinstance(setting, Sequence):
        numbers = (value for value in setting if isinstance(value, int | float))
        return f"[{', '.join(f'{number:.4g}' for number in numbers)}]"
    return f"{setting:.5g}"


def write_frames(study: Findings, path: Path) -> None:
    """Draw frames as measured, as expected, and what is left of them."""
    fit = study.fit
    mean, variance = fit.predicted()
    off = (fit.grey - mean) / np.sqrt(variance)
    far = FARTHEST * max(1.0, math.sqrt(fit.scale))
    order = (off**2).mean((1, 2)).argsort().tolist()
    frames = list(dict.fromkeys([0, order[len(order) // 2], order[-1]]))
    height, width = fit.drawing.size_px
    layout = plots.rows_of(list(range(3 * len(frames))), 3)
    size = 10.0, len(frames) * (3.2 * height / width + 0.35) + 0.5
    figure, axes = plots.sheet(layout, size, "Measured and expected")
    for row, frame in enumerate(frames):
        number = int(study.footage.numbers[frame])
        panes = (
            (f"frame {number}: measured", fit.grey, 0.0, WHITE, "gray"),
            ("expected", mean, 0.0, WHITE, "gray"),
            (f"difference, to {far:.3g} standard deviations", off, -far, far, "RdBu_r"),
        )
        for column, (head, plane, low, high, colours) in enumerate(panes):
            pane = axes[3 * row + column]
            pane.imshow(
                plane[frame], cmap=colours, vmin=low, vmax=high, interpolation="nearest"
            )
            pane.set_title(head, fontsize=9)
            pane.set_axis_off()
    plots.save_figure(figure, path)


def write_transfer(study: Findings, curve: TransferCurve, path: Path) -> None:
    """Draw the photon transfer curve."""
    figure, panels = plots.sheet([[0]], (6.1, 4.2), "Photon transfer")
    axes = panels[0]
    light = np.geomspace(curve.light.min(), curve.light.max(), 100)
    fitted = expected(light, study.fit.gamma, curve.noise)[1]
    axes.plot(curve.light, curve.variance, "o", color=plots.LOOK.ink, label="measured")
    axes.plot(light, fitted, "-", color="#0072B2", label="photon transfer and rounding")
    axes.axhline(
        ROUNDING, linestyle=":", color=plots.LOOK.quiet, label="rounding alone"
    )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="light, relative to that of grey value 118",
        ylabel="variance, grey values squared",
    )
    axes.legend(fontsize=8, frameon=False)
    plots.save_figure(figure, path)
