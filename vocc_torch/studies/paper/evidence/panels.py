"""Figs 4 to 6, 19 and 20: panels as the camera wrote them, and the grey values that mislead a receiver."""

import numpy as np
import torch

from vocc_torch.measure.estimate import Estimate
from vocc_torch.receiver.foreground import sensor_threshold
from vocc_torch.receiver.locators.paper import exact_frames
from vocc_torch.report.led_plots import Picture, picture_figure
from vocc_torch.studies.paper.evidence import PaperFigure
from vocc_torch.studies.paper.evidence.sample import Source, paper_scene

PAPER_SCENES = {6: (32000.0, 500.0), 30: (4000.0, 3500.0), 50: (1000.0, 4000.0)}
"""Section IV-D-1: ambient light (lx) and LED luminance (cd/m2) by the contrast stated, in per cent."""
BACKGROUND_GREYS = (86.0, 102.0, 118.0)
"""Section IV-C: auto-ISO gives the background a grey value from the first to the last."""


def grey_overlap(source: Source, title: str) -> PaperFigure:
    """Figs 4 to 6: the frame with the darkest On LEDs beside that with the brightest Off LEDs.

    An Off LED is misread where its grey is not below its scene's threshold.
    """
    sample = source.sample
    greys, bits = sample.values["average_grey"], sample.bits
    highest_on = np.where(bits, greys, -np.inf).max(axis=(1, 2))
    lowest_off = np.where(bits, np.inf, greys).min(axis=(1, 2))
    dark, bright = int(highest_on.argmin()), int(lowest_off.argmax())
    highest, lowest = float(highest_on[dark]), float(lowest_off[bright])
    numbers = {
        "dark_frame_highest_on_grey": highest,
        "bright_frame_lowest_off_grey": lowest,
        "misread_off_share": float((greys >= sample.thresholds)[~bits].mean()),
    }
    pictures = [
        Picture(sample.panels[dark], f"On LEDs are at most {highest:.0f}"),
        Picture(sample.panels[bright], f"Off LEDs are at least {lowest:.0f}"),
    ]
    return PaperFigure(numbers, picture_figure(pictures, title))


def frame_threshold(source: Source, title: str) -> PaperFigure:
    """Fig. 19: Otsu's threshold of a frame, and what is above it."""
    scene, bits = paper_scene(), source.bits("histogram")
    simulator = source.plan.world.simulator()
    frames = simulator.render(scene, bits)
    threshold = float(sensor_threshold(exact_frames(frames)))
    seen = source.read(simulator, scene, bits)
    panel = seen.patches[0, 0].double().numpy()
    numbers = {
        "background_grey": float(scene.background_grey),
        "threshold": threshold,
        "on_grey": float(seen.greys.average[bits].mean()),
    }
    above = np.where(panel > threshold, 255.0, 0.0)
    pictures = [
        Picture(panel, "the panel"),
        Picture(above, f"grey above {threshold:.0f}"),
    ]
    return PaperFigure(numbers, picture_figure(pictures, title))


def contrast_panels(source: Source, title: str) -> PaperFigure:
    """Fig. 20: the paper's three scenes with the same bits, and their contrast after blur.

    It is of the mean greys of an all-On and an all-Off panel. Its interval has the values at both ends of
    the range of the background's grey, which the paper leaves open. Interference is what blooming adds to
    the mean grey of Off LEDs.
    """
    simulators = source.plan.world.simulator(), source.without_blooming()
    bits, pictures = source.bits("contrast"), []
    numbers: dict[str, float | Estimate] = {}
    for stated, light in PAPER_SCENES.items():
        contrasts = []
        for grey in BACKGROUND_GREYS:
            scene = paper_scene(*light, grey)
            lit, dark = (
                source.read(simulators[0], scene, torch.full_like(bits, on))
                for on in (True, False)
            )
            step = lit.greys.average.mean() - dark.greys.average.mean()
            contrasts.append(float(step) / 255)
        low, middle, high = min(contrasts), contrasts[1], max(contrasts)
        bloomed, sharp = (
            source.read(simulator, paper_scene(*light), bits)
            for simulator in simulators
        )
        added = (bloomed.greys.average - sharp.greys.average)[~bits].mean()
        numbers |= {
            f"contrast_{stated}": Estimate(middle, low, high),
            f"misfit_{stated}": max(low - stated / 100, stated / 100 - high, 0.0),
            f"interference_{stated}": float(added) / 255,
        }
        heading = (
            f"{light[0]:.0f} lx, {light[1]:.0f} cd/m²\n"
            f"{middle:.1%}; the paper has {stated} %"
        )
        pixels = bloomed.patches[0, 0].double().numpy()
        pictures.append(Picture(pixels, heading))
    return PaperFigure(numbers, picture_figure(pictures, title))
