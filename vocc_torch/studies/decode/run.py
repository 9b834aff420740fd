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
from vocc_torch.receiver.locators import LOCATORS, PanelLocator, locator_words
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.recordings.frames import RecordedFrame
from vocc_torch.recordings.reading import read_recording, readable
from vocc_torch.report import folder as run_folder
from vocc_torch.report.canvas import annotated
from vocc_torch.report.terminal import Console
from vocc_torch.studies.decode import DecodeConfig
from vocc_torch.studies.decode.colour import SEEN_FRAMES, Mix, channel_of, unmixed
from vocc_torch.studies.decode.reading import COLUMNS, Reading, decode, demand_several

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
        self._shown: tuple[str, int, str] | None = None
        self._name = ""

    def add(self, reading: Reading) -> None:
        """Draw what was read; panels after the first are drawn into their frame's picture.

        Raises:
            OSError: the disk takes no more.
        """
        one = reading.frame.source, reading.frame.index, reading.frame.light
        if one != self._shown or self._drawn is None:
            self._shown = one
            self._drawn = annotated(reading.frame.colour, reading.corners_px, reading.bits, self.scale)
            self._name = self._free_name(reading.frame.source, reading.frame.light)
        else:
            corners_px = reading.corners_px * self.scale
            self._drawn = annotated(np.asarray(self._drawn), corners_px, reading.bits, 1)
        with atomic_file(self.folder / f"{self._name}.png") as temporary:
            self._drawn.save(temporary, format="PNG")

    def _free_name(self, source: str, light: str) -> str:
        """Return a name that no picture has, on a disk that may not tell upper from lower case."""
        # With room for the rest of a name of 255 bytes.
        stem = Path(source).stem.encode()[:200].decode(errors="ignore") + f"-{light}" * bool(light)
        name = stem
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
        frames: how many frames there are.
        shown: how many of them show a panel.
        found: panels that were read, in each colour; the next three are counted among them.
        doubtful: how many may be no panel.
        alike: how many have LEDs of one level.
        strange: how many are unlike what the receiver learned from.
        unlike: by name, the last value beyond what it learned from.
        least_alarms: false alarms a frame at the likeliest place not found; NaN where none are stated.
        likeliest: the frame that shows it.
        most: surely seen in one frame, of a locator that says how sure it is.
    """

    rows: list[list[str]] = field(default_factory=list)
    best: Reading | None = None
    frames: int = 0
    shown: int = 0
    found: int = 0
    doubtful: int = 0
    alike: int = 0
    strange: int = 0
    unlike: dict[str, float] = field(default_factory=dict)
    least_alarms: float = math.nan
    likeliest: str = ""
    most: int = 0
    _last: tuple[str, int] | None = None

    def add(self, reading: Reading) -> None:
        """Count a reading."""
        self.rows.append(reading.row())
        one = reading.frame.source, reading.frame.index
        self.frames += one != self._last
        self.shown += reading.found and one != self._last
        self._last = one
        if not reading.found:
            if reading.false_alarms > 0 and not self.least_alarms <= reading.false_alarms:
                self.least_alarms, self.likeliest = reading.false_alarms, reading.place
            return
        self.found += 1
        if not math.isnan(reading.false_alarms):
            self.most = max(self.most, reading.candidates)
        self.doubtful += reading.is_doubtful
        self.alike += reading.one_level
        self.strange += bool(reading.unlike)
        self.unlike |= reading.unlike
        if self.best is None or reading.margin > self.best.margin:
            self.best = reading

    @property
    def counted(self) -> str:
        """What was found, in words: frames, or where a frame has several rows, readings."""
        return f"{self.found} " + ("frames" if self.found == self.shown else "readings")

    def print_best(self, console: Console, most: int) -> None:
        """Print the surest bits as they sit on the panel, of up to ``most`` panels of a frame."""
        if self.best is None:
            return
        on, off = ("#", ".") if console.options.ascii_only else ("●", "·")
        grid = ["  " + " ".join(on if bit else off for bit in bits) for bits in self.best.bits]
        judged = f"{self.best.judged}; {self.shown} of {self.frames} frames show a panel"
        judged += f", {self.found} readings" * (self.found > self.shown)
        if self.most > most:
            judged += f"; a frame shows {self.most}: decode.most={self.most} reads them"
        for text in (*grid, f"  {on} On, {off} Off", self.best.text, judged):
            console.print(text, soft_wrap=True, markup=False, highlight=False)

    def hint(self, config: DecodeConfig, is_trained: bool, receiver: Receiver) -> str:
        """Say what may be tried where nothing was found, by a receiver that was trained here or before."""
        tries = ["decode.channel=auto for coloured LEDs"] * (config.channel != "auto")
        if config.follow == "true" or (config.follow == "auto" and math.isnan(self.least_alarms)):
            return " or ".join(["try decode.follow=false, which searches every frame,", *tries])
        if math.isnan(self.least_alarms) and not receiver.locator.finds_several:
            return " and ".join(["see receiver.location for the locator's limits", *tries])
        tries += ["receiver=recommended for one bright panel that is surely there"] * is_trained
        expected, frames = self.least_alarms * self.frames, self.frames
        if not expected < BY_CHANCE or not is_adjustable(receiver.locator):
            tries = ["check panel.rows and panel.columns", *tries]
            return "no place looks like one surely enough: " + ", or try ".join(tries)
        step = 10.0 ** (math.floor(math.log10(self.least_alarms)) - 1)
        enough = f"receiver.false_alarms={math.ceil(self.least_alarms / step) * step:.2g}"
        told = f"{self.least_alarms:.2g} false alarms are expected in a frame without a panel"
        told += f", {expected:.2g} in {frames}" * (frames > 1)
        sized = f"if the panel has {receiver.shape.rows} x {receiver.shape.columns} LEDs"
        return f"at the likeliest place, in {self.likeliest}, {told}: give {enough} to have it read, {sized}"

    def warn(self, receiver: Receiver) -> None:
        """Warn of what makes the bits doubtful."""
        if self.doubtful:
            look = "look where it was found, at panel_score and at margin before you believe the bits"
            warnings.warn(f"{self.doubtful} of {self.counted} may show no panel: {look}", stacklevel=2)
        if self.alike:
            look = "where all are On or all Off, their bits mean nothing"
            warnings.warn(f"LEDs look alike in {self.alike} of {self.counted}: {look}", stacklevel=2)
        if self.strange:
            learned = receiver.trained_on
            limits = {name: "{:.3g} to {:.3g}".format(*learned[name][:2]) for name in self.unlike}
            far = [f"{name} {value:.3g}, not {limits[name]}" for name, value in self.unlike.items()]
            which = f"{self.strange} of {self.counted} are unlike what {receiver.name} learned from"
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
    (finder,) = plan.receiver.finders([plan.receiver.locator]).values()
    if model is None:
        demand_several(finder, config.most)
    at_truth = finder is not None and finder.finds_several
    receiver = receiver_for(plan, model, settings.plug_ins, at_truth=at_truth)
    if model is not None and settings.receiver.false_alarms is not None:
        receiver.locator = at_rate(receiver.locator, settings.receiver.false_alarms)
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
        size = f"{receiver.shape.rows} x {receiver.shape.columns} LEDs"
        nothing = f"input {source} shows no panel of {size} in {read.frames} of {read.frames} frames"
        raise VoccError("; ".join([f"{nothing}: {read.hint(config, model is None, receiver)}", *failures]))
    run_folder.write_rows(folder / "bits.csv", [COLUMNS, *read.rows])
    run_folder.write_config(settings_used(settings, receiver), folder)
    if model is None:
        receiver.save(folder / "receiver.pt")
    read.print_best(console, config.most)
    places = [("bits", "bits.csv")] + [("pictures", "annotated")] * bool(album.names)
    run_folder.print_places(console, folder, places + [("receiver", "receiver.pt")] * (model is None))
    read.warn(receiver)
    if failures:
        raise VoccError(f"{failures[0]}; bits.csv has the {read.frames} frames that could be read")


def at_rate(locator: PanelLocator, false_alarms: float) -> PanelLocator:
    """Give a model's locator with another rate of false alarms.

    Raises:
        VoccError: a locator that states none, or a rate that is none.
    """
    if not is_adjustable(locator):
        rule = f"only learned states them, and the model's locator is {locator_words(locator)[0]}"
        raise VoccError(f"receiver.false_alarms is {false_alarms}: {rule}")
    return locator.at_rate(false_alarms)


def is_adjustable(locator: PanelLocator) -> bool:
    """Whether ``receiver.false_alarms`` holds for a locator: it ships, and states false alarms."""
    return LOCATORS.get(locator.name) is type(locator) and locator.states_false_alarms


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
