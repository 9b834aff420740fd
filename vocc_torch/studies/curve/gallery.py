"""Sample frames with the located panel and the decided bits drawn in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.sweep import monte_carlo_values, point_name
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.show.annotated import annotated, enlarged
from vocc_torch.simulation.framing import crop_origins_px
from vocc_torch.simulation.geometry import panel_centre_px

SAMPLES = 4
"""Frames drawn for each point."""
SCALE = 6
"""Enlargement: a panel is some 30 pixels wide."""
WIDEST_PX = 1200
"""Widest enlarged frame: a crop of a near panel is large enough as it is."""


def sample_frames(plan: Plan, receiver: Receiver) -> dict[str, NDArray[np.uint8]]:
    """Draw the first frames of each point, plain above and annotated below.

    Args:
        plan: the study.
        receiver: decides the bits that are drawn; where the study takes the true corners, so does it.

    Returns:
        Point name to picture, (H,W,3) uint8.
    """
    # Whole frames enlarged would be pictures of gigabytes; the decisions on crops are the same.
    plan = replace(plan, world=replace(plan.world, framing="crop"), batch_frames=SAMPLES)
    link, pictures = Link.of(plan), {}
    receiver = receiver.to(link.simulator.device)
    for value in monte_carlo_values(plan):
        name, model = point_name(plan.experiment, value), plan.experiment.model_at(plan.world, value)
        seen = next(link.observe(model, block_keys(plan.seed, name, SAMPLES), preambles=False))
        read = receiver(seen.frames, seen.panels)
        shown = link.simulator.crop_px(model.nearest_m)
        centre = panel_centre_px(seen.scene, link.simulator.camera)
        places = crop_origins_px(centre, shown, link.simulator.camera.sensor_px)
        rows = []
        for i in range(len(seen.frames)):
            pixels, origin = seen.frames.grey[i, 0], seen.frames.origin_px[i]
            if tuple(pixels.shape) == seen.frames.sensor_px:  # a scene that needs the whole sensor
                left, top = places[i].tolist()
                pixels, origin = pixels[top : top + shown[0], left : left + shown[1]], places[i]
            grey = pixels.round().clamp(0, 255).byte().cpu().numpy()
            colour = np.repeat(grey[..., None], 3, axis=2)
            scale = max(1, min(SCALE, WIDEST_PX // grey.shape[1]))
            plain = drawn = np.asarray(enlarged(colour, scale))
            if read.found[i]:
                corners = (read.corners_px[i].cpu() - origin.cpu()).numpy()
                drawn = np.asarray(annotated(colour, corners, read.bits[i].cpu().numpy(), scale))
            rows.append(np.concatenate([plain, drawn]))
        pictures[name] = np.concatenate(rows, axis=1)
    return pictures
