"""Sample frames with the located panel and the decided bits drawn in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from vocc_torch.measure.counter import point_name
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.sweep import monte_carlo_values
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.simulation.framing import crop_origins_px
from vocc_torch.simulation.geometry import panel_centre_px
from vocc_torch.studies.decode.decode import Reading, annotated
from vocc_torch.studies.decode.recording import RecordedFrame
from vocc_torch.types import Frames

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
    plan = replace(plan, world=replace(plan.world, framing="crop"))
    link, pictures = Link.of(plan), {}
    receiver = receiver.to(link.simulator.device)
    for value in monte_carlo_values(plan):
        name, model = point_name(plan.experiment, value), plan.experiment.model_at(plan.world, value)
        keys = block_keys(plan.seed, name, SAMPLES)
        seen = next(
            Link(link.simulator, link.locator, link.reader, SAMPLES).observe(model, keys, preambles=False)
        )
        read = receiver(seen.frames, seen.panels)
        shown = link.simulator.crop_px(model.nearest_m)
        middle = panel_centre_px(seen.scene, link.simulator.camera)
        places = crop_origins_px(middle, shown, link.simulator.camera.sensor_px)
        rows = []
        for i in range(len(seen.frames)):
            grey, origin = _about(seen.frames, i, places[i], shown)
            colour = np.repeat(grey[..., None], 3, axis=2)
            corners = (read.corners_px[i].cpu() - origin).numpy()
            reading = Reading(
                frame=RecordedFrame(name, i, None, colour, grey),
                found=bool(read.found[i]),
                corners_px=corners,
                bits=read.bits[i].cpu().numpy(),
                margin=0.0,
                panel_score=float(read.panel_score[i]),
                candidates=int(read.candidates[i]),
            )
            scale = max(1, min(SCALE, WIDEST_PX // colour.shape[1]))
            size = (colour.shape[1] * scale, colour.shape[0] * scale)
            plain = Image.fromarray(colour).resize(size, Image.Resampling.NEAREST)
            rows.append(np.concatenate([np.asarray(plain), np.asarray(annotated(reading, scale))]))
        pictures[name] = np.concatenate(rows, axis=1)
    return pictures


def _about(
    frames: Frames, i: int, place_px: Tensor, size_px: tuple[int, int]
) -> tuple[NDArray[np.uint8], Tensor]:
    """Cut a whole frame to the panel's surroundings; give (H,W) uint8 and its first pixel's place (2,)."""
    grey, origin = frames.grey[i, 0], frames.origin_px[i].cpu()
    if tuple(grey.shape) == frames.sensor_px:
        left, top = place_px.tolist()
        grey, origin = grey[top : top + size_px[0], left : left + size_px[1]], place_px.cpu()
    return grey.round().clamp(0, 255).byte().cpu().numpy(), origin
