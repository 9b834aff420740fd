"""Decode recordings: images or a video in, bits out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby, islice
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import Plan, resolve_device
from vocc_torch.measure.train import train, trained_receiver
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.studies.decode.recording import Channel, RecordedFrame, read_recording

COLUMNS = (
    *("source", "frame", "time_s", "found", "x_top_left", "y_top_left", "x_top_right", "y_top_right"),
    *("x_bottom_right", "y_bottom_right", "x_bottom_left", "y_bottom_left", "bits", "margin", "panel_score"),
    "candidates",
)
"""Columns of ``bits.csv``."""
BATCH_PIXELS = 32_000_000
"""Pixels decoded at a time."""


@dataclass(frozen=True, slots=True)
class Reading:
    """What was read from one recorded frame.

    Args:
        frame: where it came from; its pictures are dropped once drawn.
        found: whether a panel was found.
        corners_px: (4,2) corners, clockwise from the top left.
        bits: (R,C) bool.
        margin: the smallest distance of a score from the threshold.
        panel_score: how panel-like the chosen blob is, 0 to 1.
        candidates: how many blobs could have been the panel.
    """

    frame: RecordedFrame
    found: bool
    corners_px: NDArray[np.float64]
    bits: NDArray[np.bool_]
    margin: float
    panel_score: float
    candidates: int

    @property
    def text(self) -> str:
        """The bits as 0 and 1 in raster order; empty where no panel was found."""
        return "".join("1" if bit else "0" for bit in self.bits.ravel()) if self.found else ""

    def row(self) -> list[str]:
        """The frame's row of ``bits.csv``."""
        frame = self.frame
        time_s = "" if frame.time_s is None else f"{frame.time_s:.6f}"
        corners = [f"{c:.2f}" if self.found else "" for c in self.corners_px.ravel()]
        judged = [f"{self.margin:.4g}", f"{self.panel_score:.3f}"] if self.found else ["", ""]
        head = [frame.source, str(frame.index), time_s, str(int(self.found))]
        return [*head, *corners, self.text, *judged, str(self.candidates)]


def receiver_for(plan: Plan, model: Path | None) -> Receiver:
    """Load the receiver, or train one on the plan's scenes where no model is given.

    Raises:
        VoccError: a model that cannot be read or is for another panel.
    """
    if model is None:
        untouched = replace(plan.experiment, training={})
        return trained_receiver(plan, train(replace(plan, experiment=untouched)))
    receiver = Receiver.load(model).to(resolve_device(plan.world.device))
    wanted, has = plan.receiver.reader.shape, receiver.shape
    if wanted != has:
        given = f"model {model} reads a panel of {has.rows} x {has.columns} LEDs"
        raise VoccError(
            f"{given}, and panel.rows x panel.columns is {wanted.rows} x {wanted.columns}: make them agree"
        )
    return receiver


def decode(receiver: Receiver, source: Path, channel: Channel) -> Iterator[Reading]:
    """Decode a recording frame by frame, in batches of equal size.

    Args:
        receiver: a trained receiver.
        source: a picture, a folder of pictures or a video.
        channel: how colour becomes grey.

    Raises:
        VoccError: an input that is missing or cannot be read.
    """
    for shape, run in groupby(read_recording(source, channel), key=lambda frame: frame.grey.shape):
        size = max(1, min(64, BATCH_PIXELS // (shape[0] * shape[1])))
        while batch := list(islice(run, size)):
            yield from _decode_batch(receiver, batch)


def _decode_batch(receiver: Receiver, batch: list[RecordedFrame]) -> Iterator[Reading]:
    """Decode frames of one size."""
    greys = torch.from_numpy(np.stack([frame.grey for frame in batch]))
    read = receiver.decode(greys.to(receiver.classifier.mean.device))
    margins = read.scores.abs().amin(dim=(1, 2))
    for i, frame in enumerate(batch):
        yield Reading(
            frame=frame,
            found=bool(read.found[i]),
            corners_px=read.corners_px[i].cpu().numpy(),
            bits=read.bits[i].cpu().numpy(),
            margin=float(margins[i]),
            panel_score=float(read.panel_score[i]),
            candidates=int(read.candidates[i]),
        )
