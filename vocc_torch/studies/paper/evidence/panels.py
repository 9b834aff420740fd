"""Figs 4 to 6, 17 and 20: panels as the camera wrote them, and the grey values that mislead a receiver."""

import numpy as np
import torch

from vocc_torch.measure.estimate import Estimate
from vocc_torch.simulation import effects
from vocc_torch.studies.paper import evidence
from vocc_torch.studies.paper.evidence import PaperFigure, Source, drawing, features
from vocc_torch.types import Frames

PAPER_SCENES = {6: (32000.0, 500.0), 30: (4000.0, 3500.0), 50: (1000.0, 4000.0)}
"""Section IV-D-1: ambient light (lx) and LED luminance (cd/m2) by the contrast stated, in per cent."""
BACKGROUND_GREYS = (86.0, 102.0, 118.0)
"""Section IV-C: auto-ISO gives the background a grey value from the first to the last."""


def grey_overlap(source: Source) -> PaperFigure:
    """Fig. 4: the frame with the darkest On LEDs beside the frame with the brightest Off LEDs."""
    sample = source.sample
    greys, bits = sample.greys, sample.bits
    highest_on = np.where(bits, greys, -np.inf).max(axis=(1, 2))
    lowest_off = np.where(bits, np.inf, greys).min(axis=(1, 2))
    mixed = np.isfinite(highest_on) & np.isfinite(lowest_off)
    dark = int(np.where(mixed, highest_on, np.inf).argmin())
    bright = int(np.where(mixed, lowest_off, -np.inf).argmax())
    found = features.Separation.of(greys, bits)
    numbers = {
        "dark_frame_highest_on_grey": float(highest_on[dark]),
        "bright_frame_lowest_off_grey": float(lowest_off[bright]),
        "best_fixed_threshold_grey": found.threshold,
        "best_fixed_threshold_wrong_share": found.wrong_share,
    }
    ranks = np.argsort(np.argsort(greys.mean(axis=(1, 2)), kind="stable")).astype(float)
    frames = np.broadcast_to(ranks[:, None, None], greys.shape)
    labels = (
        "sample frame, by the mean grey of the panel",
        "Average grey of an LED (0 to 255)",
    )
    panels = {
        f"On LEDs are at most {highest_on[dark]:.0f}": drawing.picture(
            sample.panels[dark]
        ),
        f"Off LEDs are at least {lowest_off[bright]:.0f}": drawing.picture(
            sample.panels[bright]
        ),
        "all LEDs": drawing.cloud(
            frames, greys, bits, labels, (0.0, 1.0, found.threshold)
        ),
    }
    return PaperFigure(
        evidence.led_rows(bits, {"average_grey": greys}), numbers, panels
    )


def blooming_interference(source: Source) -> PaperFigure:
    """Figs 5 and 6: the sample's Off LED farthest above its threshold, without and with blooming."""
    clear, sample, plan = source.without_blooming(), source.sample, source.plan
    margins = np.where(
        sample.bits, -np.inf, sample.greys - sample.thresholds[:, None, None]
    )
    frame, row, column = (
        int(at) for at in np.unravel_index(margins.argmax(), margins.shape)
    )
    scene, bits = (
        sample.scene[slice(frame, frame + 1)],
        torch.from_numpy(sample.bits[frame : frame + 1]),
    )
    sharp = source.average_greys(clear, scene, bits)
    bloomed = sample.greys[frame : frame + 1]
    misread = int((margins >= 0).sum())
    numbers = {
        "led_row": row + 1,
        "led_column": column + 1,
        "grey_without_blooming": float(sharp[0, row, column]),
        "grey_with_blooming": float(bloomed[0, row, column]),
        "threshold": float(sample.thresholds[frame]),
        "gri": float(sample.features["gri"][frame, row, column]),
        "misread_off_leds": misread,
        "misread_off_share": misread / int((~sample.bits).sum()),
    }
    corners, shape = clear.true_panels(scene).corners_px, plan.world.panel.shape
    pictures = [
        evidence.cut_out(simulator.render(scene, bits), corners, shape)
        for simulator in (clear, plan.world.simulator())
    ]
    greys = {"without blooming": sharp[0, row], "with blooming": bloomed[0, row]}
    labels = (
        f"LED column (row {row + 1}, column {column + 1} is Off)",
        "Average grey (0 to 255)",
    )
    panels = {
        "without blooming": drawing.picture(pictures[0]),
        "with blooming": drawing.picture(pictures[1]),
        f"threshold {numbers['threshold']:.0f}": drawing.steps(greys, labels),
    }
    values = {
        "average_grey_without_blooming": sharp,
        "average_grey_with_blooming": bloomed,
    }
    return PaperFigure(evidence.led_rows(bits.numpy(), values), numbers, panels)


def blur_order(source: Source) -> PaperFigure:
    """Fig. 17: one panel with the same Gaussian after and before gamma encoding."""
    world, clear, scene = (
        source.plan.world,
        source.without_blooming(),
        evidence.paper_scene(),
    )
    bits = source.bits("blur_order")
    before, sharp = (
        simulator.render(scene, bits) for simulator in (world.simulator(), clear)
    )
    (blur,) = effects.build_effects({"blooming": world.effects["blooming"]})
    grey = blur(
        sharp.grey.to(torch.float64), effects.Context(scene, world.camera)
    ).round()
    after = Frames(grey, sharp.origin_px, sharp.sensor_px)
    corners = clear.true_panels(scene).corners_px
    names = ("gaussian after gamma", "gaussian before gamma", "no blooming")
    pictures = {
        name: evidence.cut_out(frames, corners, world.panel.shape)
        for name, frames in zip(names, (after, before, sharp), strict=True)
    }
    dull, bright, clean = pictures.values()
    numbers = {
        "highest_grey_after_gamma": float(dull.max()),
        "highest_grey_before_gamma": float(bright.max()),
        "highest_grey_no_blooming": float(clean.max()),
        "mean_loss": float((bright - dull).mean()),
        "greatest_loss": float((bright - dull).max()),
    }
    line = int(bright.max(axis=1).argmax())
    profiles = {name: picture[line] for name, picture in pictures.items()}
    panels = {name: drawing.picture(pictures[name]) for name in names[:2]}
    panels["the row of the brightest pixel"] = drawing.steps(
        profiles, ("Column (px)", "Grey value (0 to 255)")
    )
    return PaperFigure(evidence.pixel_rows(pictures), numbers, panels)


def contrast_panels(source: Source) -> PaperFigure:
    """Fig. 20: the paper's three scenes with the same bits, and their contrast before and after blur.

    After blur it is of the mean greys of an all-On and an all-Off panel.
    The interval of a contrast has its values at both ends of the range of the background's grey, which the
    paper leaves open. Interference is what blooming adds to the mean grey of Off LEDs.
    """
    world, bits, clear = (
        source.plan.world,
        source.bits("contrast"),
        source.without_blooming(),
    )
    simulator = world.simulator()
    pictures, panels, numbers = {}, {}, {}
    for stated, light in PAPER_SCENES.items():
        blurred, sharp = [], []
        for grey in BACKGROUND_GREYS:
            scene = evidence.paper_scene(*light, grey)
            lit, dark = (
                source.average_greys(simulator, scene, torch.full_like(bits, on))
                for on in (True, False)
            )
            blurred.append(float(lit.mean() - dark.mean()) / 255)
            sharp.append(float(simulator.contrast(scene)))
        scene, off = evidence.paper_scene(*light), ~bits.cpu().numpy()
        greys = [
            source.average_greys(one, scene, bits)[off].mean()
            for one in (simulator, clear)
        ]
        numbers[f"interference_{stated}"] = exact(float(greys[0] - greys[1]) / 255)
        frames, corners = (
            simulator.render(scene, bits),
            simulator.true_panels(scene).corners_px,
        )
        pictures[f"contrast_{stated}"] = evidence.cut_out(
            frames, corners, world.panel.shape
        )
        numbers[f"contrast_{stated}"] = Estimate(blurred[1], min(blurred), max(blurred))
        misfit = max(min(blurred) - stated / 100, stated / 100 - max(blurred), 0.0)
        numbers[f"misfit_{stated}"] = exact(misfit)
        numbers[f"contrast_before_blur_{stated}"] = Estimate(
            sharp[1], min(sharp), max(sharp)
        )
        heading = f"{light[0]:.0f} lx, {light[1]:.0f} cd/m²: the paper has {stated} %\n"
        heading += f"mean greys {blurred[1]:.1%}, before blur {sharp[1]:.1%}"
        panels[heading] = drawing.picture(pictures[f"contrast_{stated}"])
    return PaperFigure(evidence.pixel_rows(pictures), numbers, panels)


def exact(value: float) -> Estimate:
    """A number without an interval."""
    return Estimate(value, value, value)
