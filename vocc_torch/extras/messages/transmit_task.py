"""``task=transmit``: a file in, a panel's film out."""

from pathlib import Path

import numpy as np

from vocc_torch.extras.messages.config import FRAMES, PLAN, TransmitConfig
from vocc_torch.extras.messages.reception import film_of
from vocc_torch.extras.messages.signalling import FIELDS, MessagePlan, Signalling
from vocc_torch.files import atomic_file, read_file, write_atomically
from vocc_torch.hardware import PanelShape
from vocc_torch.measure.config import Settings
from vocc_torch.report import folder as run_folder
from vocc_torch.report.terminal import Console, ProgressView
from vocc_torch.report.video import write_video

LARGEST_BYTES = 1 << 24
"""Of a message: its film of ten hours is held in memory."""

LIT = 255
"""Grey value of an On LED."""


def plan_of(settings: Settings, config: TransmitConfig) -> MessagePlan:
    """Give the plan that a configuration describes."""
    shape = PanelShape(settings.panel.rows, settings.panel.columns)  # type: ignore[attr-defined]  # of the schema
    signalling = Signalling(**{name: getattr(config, name) for name in FIELDS})
    return MessagePlan(shape, signalling)


def run_transmit(settings: Settings, config: TransmitConfig, folder: Path) -> None:
    """Write the film of a file, as an array and as a video, and what a receiver must know.

    Raises:
        VoccError: no input, one that cannot be read or is empty, or a plan that leaves no room.
    """
    source = run_folder.input_of(
        settings, "task=transmit needs input=FILE, the message"
    )
    message = read_file(source, "input", LARGEST_BYTES)
    plan, console = plan_of(settings, config), Console()
    film = np.tile(film_of(message, plan), (config.repeats, 1, 1))
    led = np.full((config.cell_px, config.cell_px), LIT, np.uint8)
    large = (np.kron(symbol, led) for symbol in film)
    with ProgressView(len(film), console, "writing") as view:
        frames = view.counted(large, "writing")
        write_video(folder / "film.mp4", frames, config.symbol_rate_hz)
    with atomic_file(folder / FRAMES) as temporary:
        np.save(temporary, film)
    write_atomically(folder / PLAN, plan.text.encode())
    run_folder.write_config(settings, folder)
    seconds = len(film) / config.symbol_rate_hz
    run_folder.say(
        console,
        f"{len(message)} bytes in {len(film)} symbols, {seconds:.1f} s: "
        + f"{8e-3 * len(message) * config.repeats / seconds:.2f} kbit/s",
    )
    places = {"film": "film.mp4", "frames": FRAMES, "plan": PLAN}
    run_folder.print_places(console, folder, places.items())
