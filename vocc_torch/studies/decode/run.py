"""``task=decode``: images or a video in, bits out."""

import math
import shutil
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import chain, count, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.train import receiver_for, settings_used
from vocc_torch.receiver.locators import STATING
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.recording import RecordedFrame, read_recording, readable
from vocc_torch.show import folder as run_folder
from vocc_torch.show.canvas import annotated
from vocc_torch.show.terminal import Console
from vocc_torch.studies.decode import DecodeConfig
from vocc_torch.studies.decode.colour import SEEN_FRAMES, Mix, channel_of, unmixed
from vocc_torch.studies.decode.reading import COLUMNS, Reading, decode

BY_CHANCE = 0.3
"""False alarms in as many frames as were read from which on the likeliest place is not worth a word. In one
frame rates above 0.07 are not told from 1: the first floor of the tables."""


class Album:
    """Annotated pictures in a run's folder, one a frame of a picture.

    Args:
        folder: the run's.
        scale: how many times a picture is enlarged.
    """

    def __init__(self, folder: Path, scale: int) -> None:
        self.folder, self.scale = folder / "annotated", scale
        self.names: set[str] = set()
        self._drawn: Image.Image | None = None
        self._name = ""

    def add(self, reading: Reading) -> None:
        """Draw what was read; panels after the first are drawn into their frame's picture.

        Raises:
            OSError: the disk takes no more.
        """
        if reading.panel == 0 or self._drawn is None:
            self._drawn = annotated(reading.frame.colour, reading.corners_px, reading.bits, self.scale)
            self._name = self._free_name(reading.frame.source)
        else:
            corners_px = reading.corners_px * self.scale
            self._drawn = annotated(np.asarray(self._drawn), corners_px, reading.bits, 1)
        with atomic_file(self.folder / f"{self._name}.png") as temporary:
            self._drawn.save(temporary, format="PNG")

    def _free_name(self, source: str) -> str:
        """Return a name that no picture has, on a disk that may not tell upper from lower case."""
        # With room for the rest of a name of 255 bytes.
        stem = name = Path(source).stem.encode()[:200].decode(errors="ignore")
        for number in count(1):
            if name.casefold() not in self.names:
                break
            name = f"{stem}-{number}"
        self.names.add(name.casefold())
        return name


@dataclass
class Summary:
    """What the readings of a recording come to.

    Args:
        rows: of ``bits.csv``.
        best: the reading with the largest least margin.
        found: how many show a panel; the next three are counted among them.
        doubtful: how many may be no panel.
        alike: how many have LEDs of one level.
        strange: how many are unlike what the receiver learned from.
        unlike: by name, the last value beyond what it learned from.
        least_alarms: false alarms a frame at the likeliest place not found; NaN where none are stated.
        likeliest: the frame that shows it.
    """

    rows: list[list[str]] = field(default_factory=list)
    best: Reading | None = None
    found: int = 0
    doubtful: int = 0
    alike: int = 0
    strange: int = 0
    unlike: dict[str, float] = field(default_factory=dict)
    least_alarms: float = math.nan
    likeliest: str = ""

    def add(self, reading: Reading) -> None:
        """Count a reading."""
        self.rows.append(reading.row())
        if not reading.found:
            if reading.false_alarms > 0 and not self.least_alarms <= reading.false_alarms:
                self.least_alarms, self.likeliest = reading.false_alarms, reading.place
            return
        self.found += 1
        self.doubtful += reading.is_doubtful
        self.alike += reading.one_level
        self.strange += bool(reading.unlike)
        self.unlike |= reading.unlike
        if self.best is None or reading.margin > self.best.margin:
            self.best = reading

    def print_best(self, console: Console) -> None:
        """Print the surest bits as they sit on the panel."""
        if self.best is None:
            return
        on, off = ("#", ".") if console.options.ascii_only else ("●", "·")
        grid = ["  " + " ".join(on if bit else off for bit in bits) for bits in self.best.bits]
        judged = f"{self.best.judged}; {self.found} of {len(self.rows)} frames show a panel"
        for text in (*grid, f"  {on} On, {off} Off", self.best.text, judged):
            console.print(text, soft_wrap=True, markup=False, highlight=False)

    def hint(self, config: DecodeConfig, is_trained: bool) -> str:
        """Say what may be tried where nothing was found, by a receiver that was trained here or before."""
        tries = ["decode.channel=auto for coloured LEDs"] * (config.channel != "auto")
        if config.follow == "true":
            return " or ".join(["try decode.follow=false, which searches every frame,", *tries])
        if math.isnan(self.least_alarms):
            return " and ".join(["see receiver.location for the locator's limits", *tries])
        tries += ["receiver=recommended for one bright panel that is surely there"] * is_trained
        expected, frames = self.least_alarms * len(self.rows), len(self.rows)
        if expected >= BY_CHANCE:
            return " or ".join(["no place looks like one by more than chance: try another size", *tries])
        step = 10.0 ** (math.floor(math.log10(self.least_alarms)) - 1)
        enough = f"receiver.false_alarms={math.ceil(self.least_alarms / step) * step:.2g}"
        told = f"{self.least_alarms:.2g} false alarms are expected in a frame without a panel"
        told += f", {expected:.2g} in {frames}" * (frames > 1)
        done = f"{'give' if is_trained else 'train with'} {enough} to have it read"
        return f"at the likeliest place, in {self.likeliest}, {told}: {done}"

    def warn(self, receiver: Receiver) -> None:
        """Warn of what makes the bits doubtful."""
        if self.doubtful:
            look = "look where it was found, at panel_score and at margin before you believe the bits"
            warnings.warn(f"{self.doubtful} of {self.found} frames may show no panel: {look}", stacklevel=2)
        if self.alike:
            look = "where all are On or all Off, their bits mean nothing"
            warnings.warn(f"LEDs look alike in {self.alike} of {self.found} frames: {look}", stacklevel=2)
        if self.strange:
            learned = receiver.trained_on
            limits = {name: "{:.3g} to {:.3g}".format(*learned[name][:2]) for name in self.unlike}
            far = [f"{name} {value:.3g}, not {limits[name]}" for name, value in self.unlike.items()]
            which = f"{self.strange} of {self.found} frames are unlike what {receiver.name} learned from"
            warnings.warn(f"{which} ({'; '.join(far)}): expected_errors may be too low", stacklevel=2)


def run_decode(settings: Settings, config: DecodeConfig, folder: Path) -> None:
    """Decode a recording and write its bits and annotated pictures.

    Raises:
        VoccError: no input, or an input without a panel.
    """
    run_folder.refuse_results(folder)
    if settings.input is None:
        raise VoccError("input is null: task=decode needs input=PICTURE, a folder of pictures or a video")
    source, console = Path(settings.input), Console()
    failures: list[str] = []
    # Until the receiver has chosen.
    channel = "luma" if config.channel in ("auto", "unmix") else config.channel
    recording = readable(read_recording(source, channel), failures)
    first = list(islice(recording, 1))  # before a receiver is trained
    if not first:
        raise VoccError(failures[0])
    model = None if settings.model is None else Path(settings.model)
    # A model brings a locator of its own.
    named = settings.receiver if model is None else replace(settings.receiver, locator="truth")
    plan = build_plan(replace(settings, receiver=named), folder)
    receiver = receiver_for(plan, model, settings.plug_ins, at_truth=plan.receiver.locator in STATING)
    recording = chain(first, recording)
    lights: tuple[Mix, ...] = ()
    if config.channel in ("auto", "unmix"):
        if config.channel == "auto":
            recording, told = in_best_channel(receiver, recording)
        else:
            recording, told, lights = in_each_colour(receiver, recording)
        console.print(told, soft_wrap=True, markup=False, highlight=False)
    read, album = Summary(), Album(folder, config.scale)
    try:
        for reading in decode(receiver, recording, config.most, config.follow, lights):
            read.add(reading)
            if reading.found and config.annotate and reading.frame.time_s is None:
                album.add(reading)
    except BaseException:
        shutil.rmtree(album.folder, ignore_errors=True)
        raise
    if read.best is None:
        nothing = f"input {source} shows no panel in {len(read.rows)} of {len(read.rows)} frames"
        raise VoccError("; ".join([f"{nothing}: {read.hint(config, model is None)}", *failures]))
    run_folder.write_rows(folder / "bits.csv", [COLUMNS, *read.rows])
    run_folder.write_config(settings_used(settings, receiver), folder)
    if model is None:
        receiver.save(folder / "receiver.pt")
    read.print_best(console)
    places = [("bits", "bits.csv")] + [("pictures", "annotated")] * bool(album.names)
    run_folder.print_places(console, folder, places + [("receiver", "receiver.pt")] * (model is None))
    read.warn(receiver)
    if failures:
        raise VoccError(f"{failures[0]}; bits.csv has the {len(read.rows)} frames that could be read")


def in_best_channel(
    receiver: Receiver, recording: Iterator[RecordedFrame]
) -> tuple[Iterator[RecordedFrame], str]:
    """Give a recording the grey plane that its first frames are read best in, and say which."""
    shown, every = first_colours(recording)
    mix, far, sure = channel_of(receiver, shown)
    frames = every if mix.name == "luma" else (replace(one, grey=mix(one.colour)) for one in every)
    why = f"On and Off lie {far:.3g} standard deviations apart in the first {len(shown)} frames"
    why += f", {sure} of them without doubt"
    if math.isnan(far):
        why = f"the first {len(shown)} frames are grey"
    elif not far:
        why = f"no panel was found in the first {len(shown)} frames"
    return frames, f"decode.channel=auto: {mix}, for {why}"


def in_each_colour(
    receiver: Receiver, recording: Iterator[RecordedFrame]
) -> tuple[Iterator[RecordedFrame], str, tuple[Mix, ...]]:
    """Give a recording the plane that its panel is best located in, and the planes of each colour of LEDs.

    Raises:
        VoccError: the first frames show no panel on which three colours send different bits.
    """
    shown, every = first_colours(recording)
    best, mixes = unmixed(receiver, shown)
    if not mixes:
        none = f"the first {len(shown)} frames show no panel on which three colours differ"
        raise VoccError.of("decode.channel", "unmix", f"auto, or one channel: {none}")
    frames = (replace(one, grey=best(one.colour)) for one in every)
    told = f"decode.channel=unmix: {'; '.join(map(str, mixes))}, of linear light; located in {best.name}"
    return frames, told, mixes


def first_colours(
    recording: Iterator[RecordedFrame],
) -> tuple[list[NDArray[np.uint8]], Iterator[RecordedFrame]]:
    """Give the pictures of one size that decide for all of a recording, and the whole recording."""
    first = list(islice(recording, SEEN_FRAMES))
    return [one.colour for one in first if one.colour.shape == first[0].colour.shape], chain(first, recording)
