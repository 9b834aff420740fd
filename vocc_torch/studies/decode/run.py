"""``task=decode``: images or a video in, bits out."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby, islice
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.files import write_atomically
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.plan import Plan, resolve_device
from vocc_torch.measure.train import train, trained_receiver
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.show.canvas import annotated
from vocc_torch.show.csv_file import write_rows
from vocc_torch.show.folder import print_place, refuse_results, write_config
from vocc_torch.studies.decode import DecodeConfig
from vocc_torch.studies.decode.recording import RecordedFrame, read_recording

DOUBTFUL_SCORE = 0.6
"""Noise that fills a 4:3 picture scores 0.56; of the paper's scenes one in fifty scores less than this."""


def run_decode(settings: Settings, config: DecodeConfig, folder: Path) -> None:
    """Decode a recording and write its bits and annotated pictures.

    Raises:
        VoccError: no input, or an input without a panel.
    """
    refuse_results(folder)
    if settings.input is None:
        raise VoccError("input is null: task=decode needs input=PICTURE, a folder of pictures or a video")
    source, console = Path(settings.input), Console()
    recording = read_recording(source, config.channel)
    plan = build_plan(settings, folder)
    receiver = receiver_for(plan, None if settings.model is None else Path(settings.model))
    try:
        rows, best = _read(config, decode(receiver, recording), folder)
    except BaseException:
        shutil.rmtree(folder / "annotated", ignore_errors=True)
        raise
    if best is None:
        hint = "see receiver.location for the locator's limits, and decode.channel for coloured LEDs"
        raise VoccError(f"input {source} shows no panel in {len(rows)} of {len(rows)} frames: {hint}")
    write_rows(folder / "bits.csv", [COLUMNS, *rows])
    write_config(settings, folder)
    if settings.model is None:
        receiver.save(folder / "receiver.pt")
    found = sum(bool(row[COLUMNS.index("bits")]) for row in rows)
    _show_bits(console, best, f"{found} of {len(rows)} frames show a panel")
    print_place(console, "bits", folder / "bits.csv")


def _read(
    config: DecodeConfig, readings: Iterator[Reading], folder: Path
) -> tuple[list[list[str]], Reading | None]:
    """Decode every frame and write the annotated pictures; give the rows and the reading of most margin."""
    rows, best, names = [], None, set[str]()
    for reading in readings:
        rows.append(reading.row())
        if not reading.found:
            continue
        if config.annotate and reading.frame.time_s is None:
            stem = Path(reading.frame.source).stem
            # a.png and a.jpg of one folder are two pictures
            name = reading.frame.source if stem in names else stem
            names.add(stem)
            picture = io.BytesIO()
            drawn = annotated(reading.frame.colour, reading.corners_px, reading.bits, config.scale)
            drawn.save(picture, format="PNG")
            write_atomically(folder / "annotated" / f"{name}.png", picture.getvalue())
        best = reading if best is None or reading.margin > best.margin else best
    return rows, best


def _show_bits(console: Console, reading: Reading, summary: str) -> None:
    """Print the bits as they sit on the panel."""
    plain = console.options.ascii_only
    on, off = ("#", ".") if plain else ("●", "·")
    for row in reading.bits:
        console.print("  " + " ".join(on if bit else off for bit in row), highlight=False)
    console.print(reading.text, soft_wrap=True, highlight=False)
    others = f"; {reading.candidates} blobs could have been the panel" if reading.candidates > 1 else ""
    doubt = ", which may be no panel" if reading.panel_score < DOUBTFUL_SCORE else ""
    score = f"panel score {reading.panel_score:.2f}{doubt}"
    where = reading.frame.source + ("" if reading.frame.time_s is None else f", frame {reading.frame.index}")
    judged = f"{where}: least margin {reading.margin:.3g}, {score}{others}; {summary}"
    console.print(judged, soft_wrap=True, highlight=False)


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


def decode(receiver: Receiver, recording: Iterator[RecordedFrame]) -> Iterator[Reading]:
    """Decode a recording frame by frame, in batches of equal size.

    Args:
        receiver: a trained receiver.
        recording: its frames, as :func:`~vocc_torch.studies.decode.recording.read_recording` gives them.

    Raises:
        VoccError: a frame that cannot be read.
    """
    for shape, run in groupby(recording, key=lambda frame: frame.grey.shape):
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
