"""``task=record``: a panel's film in, the recording of a simulated camera out, with its truth."""

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from vocc_torch.arrays import Bytes, read_bits
from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.config import FRAMES, PLAN, RecordConfig
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.files import atomic_file, write_atomically
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.report import folder as run_folder
from vocc_torch.report.terminal import Console, ProgressView
from vocc_torch.report.video import write_video
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.effects.coding import Quantization
from vocc_torch.simulation.recording import Recorded, Shutter, further_films, record

CORNERS = [f"{axis}_{corner}" for corner in ("tl", "tr", "br", "bl") for axis in "xy"]
COLUMNS = ("frame", "taken_s", "symbol", "distance_m", *CORNERS)
"""Columns of ``truth.csv``; corners in px of the recording."""


def with_panel_of(settings: Settings, plan: MessagePlan) -> Settings:
    """Give the settings with the plan's panel."""
    sides = asdict(plan.shape)  # the section has both, beside what LedPanel has
    return replace(settings, panel=replace(settings.panel, **sides))


def shutter_of(
    config: RecordConfig, fps: float, symbol_s: float, key: BlockKey
) -> Shutter:
    """Give the camera's shutter; unless it is said, when it first opens is drawn within a symbol.

    Args:
        config: the camera.
        fps: frames a second.
        symbol_s: how long a symbol shows.
        key: names the draws.
    """
    start_s = config.start_s
    if start_s is None:
        start_s = float(key.generator("start").random()) * symbol_s
    faults = config.dropped, config.repeated, config.black, config.burst_frames
    return Shutter(fps, start_s, config.readout_s, *faults)


def truth_of(
    part: Recorded, first: int, distance_m: Tensor, speed_m_s: float
) -> Iterator[run_folder.Cells]:
    """Give the rows of ``truth.csv`` for some frames.

    Args:
        part: the frames.
        first: the number of the first of them.
        distance_m: of the panel at the recording's begin, (1,).
        speed_m_s: by which it grows.
    """
    corners = part.panels.corners_px - part.frames.origin_px[:, None]
    taken_s = torch.from_numpy(part.taken_s)[:, None]
    away_m = distance_m + speed_m_s * taken_s.nan_to_num()
    places = torch.cat([away_m, corners.flatten(1).cpu()], 1).tolist()
    for number, (time_s, symbol, place) in enumerate(
        zip(part.taken_s.tolist(), part.symbols, places, strict=True), first
    ):
        cells = [f"{value:.3f}" for value in place]
        yield (number, None if symbol is None else f"{time_s:.6f}", symbol, *cells)


def run_record(settings: Settings, config: RecordConfig, folder: Path) -> None:
    """Record a film, as an array and as a video, with the truth and the plan beside it.

    Raises:
        VoccError: no input, or one that task=transmit did not write.
    """
    source = run_folder.input_of(
        settings, "task=record needs input=FOLDER, that of task=transmit"
    )
    plan = MessagePlan.read(source / PLAN)
    film = torch.from_numpy(read_bits(source / FRAMES, "input", plan.shape.sides))
    study = build_plan(with_panel_of(settings, plan))
    simulator = study.world.simulator()
    if not any(
        isinstance(effect, Quantization) and effect.bits == 8
        for effect in simulator.effects
    ):
        raise VoccError(
            "scene.effects.quantization must be {bits: 8}: task=record writes greys of 8 bits"
        )
    key = BlockKey(study.seed, "recording", 0)
    scene = study.world.scene.draw(key, plan.shape)[0][:1]
    symbol_s = config.symbol_s(plan.signalling.symbol_rate_hz)
    shutter = shutter_of(config, config.fps, symbol_s, key)
    parts = record(
        simulator,
        scene,
        film,
        symbol_s,
        shutter,
        key,
        speed_m_s=config.speed_m_s,
        window=config.margin if settings.framing == "crop" else None,
        batch=study.batch_frames,
    )
    rows: list[run_folder.Cells] = [COLUMNS]

    def pictures() -> Iterator[Bytes]:
        for part in parts:
            first = len(rows) - 1
            rows.extend(truth_of(part, first, scene.distance_m, config.speed_m_s))
            grey = part.frames.grey[:, 0].cpu().numpy()
            if not file.tell():
                shape = (count, *grey.shape[1:])
                head = {"descr": "|u1", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(file, head)
            file.write(grey.tobytes())
            yield from part.frames.pixels

    count = len(shutter.taken_s(len(film) * symbol_s, key.generator("shutter")))
    # To a file and not to a memory map, which a full disk would end with SIGBUS.
    with (
        atomic_file(folder / "recording.npy") as temporary,
        temporary.open("wb") as file,
        ProgressView(count, doing="recording") as view,
    ):
        frames = view.counted(pictures(), "recording")
        write_video(folder / "recording.mp4", frames, config.fps, config.quality)
    run_folder.write_rows(folder / "truth.csv", rows)
    write_atomically(folder / PLAN, plan.text.encode())
    for name, sent in further_films(simulator, film, key).items():
        with atomic_file(folder / f"frames{name}.npy") as temporary:
            np.save(temporary, sent.numpy())
    run_folder.write_config(settings, folder)
    ratio, distance_m = config.fps * symbol_s, float(scene.distance_m[0])
    summary = f"{count} frames, {ratio:.3g} a symbol, at {distance_m:.1f} m"
    run_folder.say(Console(), summary)
    places = {
        "recording": "recording.mp4",
        "frames": "recording.npy",
        "truth": "truth.csv",
        "plan": PLAN,
    }
    run_folder.print_places(Console(), folder, places.items())
