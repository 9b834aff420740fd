"""``task=record``: a panel's film in, the recording of a simulated camera out, with its truth."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

from vocc_torch.arrays import Bools, Bytes, read_bits
from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.config import FRAMES, PLAN, RecordConfig
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.files import atomic_file, write_atomically
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.plan import Plan
from vocc_torch.report import folder as run_folder
from vocc_torch.report.terminal import Console, ProgressView
from vocc_torch.report.video import write_video
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.effects.coding import Quantization
from vocc_torch.simulation.recording import Recorded, Shutter, further_films, record
from vocc_torch.types import Scene

CORNERS = [f"{axis}_{corner}" for corner in ("tl", "tr", "br", "bl") for axis in "xy"]
COLUMNS = ("frame", "taken_s", "symbol", "distance_m", *CORNERS)
"""Columns of ``truth.csv``; corners in px of the recording."""


def with_panel_of(settings: Settings, plan: MessagePlan) -> Settings:
    """Give the settings with the plan's panel."""
    sides = asdict(plan.shape)  # the section has both, beside what LedPanel has
    return replace(settings, panel=replace(settings.panel, **sides))


@dataclass(frozen=True)
class Take:
    """A camera's recording of a film.

    Args:
        plan: its world, and the frames of a batch.
        config: the camera.
        scene: at the recording's begin.
        film: (N,R,C) bool, the symbols.
        fps: frames a second.
        rate_hz: symbols a second by the panel's own clock.
        key: names the draws.
    """

    plan: Plan
    config: RecordConfig
    scene: Scene
    film: Bools
    fps: float
    rate_hz: float
    key: BlockKey

    @property
    def symbol_s(self) -> float:
        """How long each symbol shows."""
        return (1 + self.config.drift) / self.rate_hz

    @property
    def shutter(self) -> Shutter:
        """The camera's shutter; unless it is said, when it first opens is drawn within a symbol."""
        config, start_s = self.config, self.config.start_s
        if start_s is None:
            start_s = float(self.key.generator("start").random()) * self.symbol_s
        faults = config.dropped, config.repeated, config.black, config.burst_frames
        return Shutter(self.fps, start_s, config.readout_s, *faults)

    def parts(self, window: float | None) -> Iterator[Recorded]:
        """Take it, as :func:`~vocc_torch.simulation.recording.record` does."""
        return record(
            self.plan.world.simulator(),
            self.scene,
            torch.from_numpy(self.film),
            self.symbol_s,
            self.shutter,
            self.key,
            speed_m_s=self.config.speed_m_s,
            window=window,
            batch=self.plan.batch_frames,
        )


def run_record(settings: Settings, config: RecordConfig, folder: Path) -> None:
    """Record a film, as an array and as a video, with the truth and the plan beside it.

    Raises:
        VoccError: no input, or one that task=transmit did not write.
    """
    source = run_folder.input_of(
        settings, "task=record needs input=FOLDER, that of task=transmit"
    )
    plan = MessagePlan.read(source / PLAN)
    film = read_bits(source / FRAMES, "input", plan.shape.sides)
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
    rate_hz = plan.signalling.symbol_rate_hz
    take = Take(study, config, scene, film, config.fps, rate_hz, key)
    parts = take.parts(config.margin if settings.framing == "crop" else None)
    rows: list[run_folder.Cells] = [COLUMNS]

    def pictures() -> Iterator[Bytes]:
        for part in parts:
            corners = part.panels.corners_px - part.frames.origin_px[:, None]
            away_m = scene.distance_m + config.speed_m_s * torch.from_numpy(
                np.nan_to_num(part.taken_s)
            )
            places = torch.cat([away_m[:, None], corners.flatten(1).cpu()], 1).tolist()
            for time_s, symbol, place in zip(
                part.taken_s.tolist(), part.symbols, places, strict=True
            ):
                taken_s = None if symbol is None else f"{time_s:.6f}"
                cells = [f"{number:.3f}" for number in place]
                rows.append((len(rows) - 1, taken_s, symbol, *cells))
            grey = part.frames.grey[:, 0].cpu().numpy()
            if not file.tell():
                shape = (count, *grey.shape[1:])
                head = {"descr": "|u1", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(file, head)
            file.write(grey.tobytes())
            yield from part.frames.pixels

    length_s = len(film) * take.symbol_s
    count = len(take.shutter.taken_s(length_s, key.generator("shutter")))
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
    for name, sent in further_films(simulator, torch.from_numpy(film), key).items():
        with atomic_file(folder / f"frames{name}.npy") as temporary:
            np.save(temporary, sent.numpy())
    run_folder.write_config(settings, folder)
    console = Console()
    ratio = config.fps * take.symbol_s
    run_folder.say(
        console,
        f"{len(rows) - 1} frames, {ratio:.3g} a symbol, at {float(scene.distance_m[0]):.1f} m",
    )
    places = {
        "recording": "recording.mp4",
        "frames": "recording.npy",
        "truth": "truth.csv",
        "plan": PLAN,
    }
    run_folder.print_places(console, folder, places.items())
