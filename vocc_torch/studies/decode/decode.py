"""Decode recordings: images or a video in, bits out."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from vocc_torch.errors import VoccError
from vocc_torch.files import write_atomically
from vocc_torch.measure.plan import Plan, resolve_device
from vocc_torch.measure.train import train, trained_receiver
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.studies.decode.recording import Channel, RecordedFrame, read_recording

COLUMNS = [
    "source",
    "frame",
    "time_s",
    "found",
    "x_top_left",
    "y_top_left",
    "x_top_right",
    "y_top_right",
    "x_bottom_right",
    "y_bottom_right",
    "x_bottom_left",
    "y_bottom_left",
    "bits",
    "margin",
    "panel_score",
    "candidates",
]
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
        batch: list[RecordedFrame] = []
        for frame in run:
            batch.append(frame)
            if len(batch) == size:
                yield from _decode_batch(receiver, batch)
                batch = []
        if batch:
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


def bits_csv(rows: list[list[str]]) -> bytes:
    """Write the rows of ``bits.csv`` with their heading."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(rows)
    return text.getvalue().encode()


def annotated(reading: Reading, scale: int) -> Image.Image:
    """Draw the located panel and a mark a bit onto the picture: filled for On, hollow for Off."""
    picture = Image.fromarray(reading.frame.colour)
    if scale > 1:
        picture = picture.resize((picture.width * scale, picture.height * scale), Image.Resampling.NEAREST)
    if not reading.found:
        return picture
    draw = ImageDraw.Draw(picture)
    corners = reading.corners_px * scale
    outline = [(float(x), float(y)) for x, y in [*corners, corners[0]]]
    rows, columns = reading.bits.shape
    cell = min(
        np.linalg.norm(corners[1] - corners[0]) / columns, np.linalg.norm(corners[3] - corners[0]) / rows
    )
    draw.line(outline, fill=(0, 158, 115), width=max(1, round(cell / 12)))
    radius = max(0.6, 0.16 * float(cell))
    for r in range(rows):
        for c in range(columns):
            x, y = _cell_centre(corners, (c + 0.5) / columns, (r + 0.5) / rows)
            box = (x - radius, y - radius, x + radius, y + radius)
            draw.ellipse(box, fill=(0, 114, 178) if reading.bits[r, c] else None, outline=(86, 180, 233))
    return picture


def _cell_centre(corners: NDArray[np.float64], u: float, v: float) -> tuple[float, float]:
    """A point inside the quadrilateral, bilinearly: close enough to draw a mark at."""
    top, bottom = (1 - u) * corners[0] + u * corners[1], (1 - u) * corners[3] + u * corners[2]
    x, y = (1 - v) * top + v * bottom
    return float(x), float(y)


def save_picture(picture: Image.Image, path: Path) -> None:
    """Write a picture as PNG, whole or not at all."""
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG")
    write_atomically(path, buffer.getvalue())
