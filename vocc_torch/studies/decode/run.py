"""``task=decode``: bits from a recording."""

from __future__ import annotations

import io
import shutil
from pathlib import Path

from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.files import write_atomically
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.show.annotated import annotated
from vocc_torch.show.csv_file import write_rows
from vocc_torch.show.folder import print_place, refuse_results, write_config
from vocc_torch.studies.decode.config import DecodeConfig
from vocc_torch.studies.decode.decode import COLUMNS, Reading, decode, receiver_for

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
    if not 1 <= config.scale <= 16:
        raise VoccError(f"decode.scale is {config.scale}: it must be from 1 to 16")
    source, console = Path(settings.input), Console()
    if not source.exists():
        raise VoccError(f"input {source} does not exist: give a picture, a folder of pictures or a video")
    plan = build_plan(settings, folder)
    receiver = receiver_for(plan, None if settings.model is None else Path(settings.model))
    try:
        rows, best = _read(config, receiver, source, folder)
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
    config: DecodeConfig, receiver: Receiver, source: Path, folder: Path
) -> tuple[list[list[str]], Reading | None]:
    """Decode every frame and write the annotated pictures; give the rows and the reading of most margin."""
    rows, best, names = [], None, set[str]()
    for reading in decode(receiver, source, config.channel):  # type: ignore[arg-type]  # checked there
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
