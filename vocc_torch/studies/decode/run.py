"""``task=decode``: images or a video in, bits out."""

import math
import shutil
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain, groupby, islice
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.train import receiver_for
from vocc_torch.receiver.calibration import APPEARANCE, outside
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.recording import RecordedFrame, read_recording, readable
from vocc_torch.receiver.track import Tracker
from vocc_torch.show import folder as run_folder
from vocc_torch.show.canvas import annotated
from vocc_torch.show.terminal import Console
from vocc_torch.studies.decode import DecodeConfig
from vocc_torch.studies.decode.colour import SEEN_FRAMES, channel_of, unmixed
from vocc_torch.studies.decode.judge import LEAST_PARTED, is_doubtful, parted
from vocc_torch.types import Frames

COLUMNS = (
    *("source", "frame", "time_s", "found", "x_top_left", "y_top_left", "x_top_right", "y_top_right"),
    *("x_bottom_right", "y_bottom_right", "x_bottom_left", "y_bottom_left", "bits", "margin", "panel_score"),
    *("candidates", "expected_errors", "panel", "false_alarms", "light"),
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
        unlike: what the receiver did not learn from, by name: a pitch, level or contrast.
        margin: the smallest distance of a score from the threshold.
        panel_score: how panel-like the chosen blob is, 0 to 1.
        candidates: how many blobs could have been the panel.
        is_doubtful: whether it may be no panel: a low score, or an LED that is neither On nor Off.
        expected_errors: wrong bits that the log-likelihood ratios let expect.
        one_level: whether all LEDs look alike, so that all may be On, or all Off.
        false_alarms: those expected in a frame without a panel at this score; NaN where none is stated.
        panel: its number in the frame, from 0, the likeliest first.
    """

    frame: RecordedFrame
    found: bool
    corners_px: NDArray[np.float64]
    bits: NDArray[np.bool_]
    unlike: Mapping[str, float]
    margin: float
    panel_score: float
    candidates: int
    is_doubtful: bool
    expected_errors: float
    one_level: bool
    false_alarms: float = math.nan
    panel: int = 0

    @property
    def text(self) -> str:
        """The bits as 0 and 1 in raster order; empty where no panel was found."""
        return "".join("1" if bit else "0" for bit in self.bits.ravel()) if self.found else ""

    @property
    def judged(self) -> str:
        """How sure the reading is, in words."""
        where = self.frame.source + (f", frame {self.frame.index}" if self.frame.index else "")
        doubt = ", which may be no panel" if self.is_doubtful else ""
        doubt += ", of one level of light" * self.one_level
        others = f"; {self.candidates} blobs could have been the panel" if self.candidates > 1 else ""
        if not math.isnan(self.false_alarms):
            others = f"; {self.false_alarms:.2g} false alarms expected in a frame without a panel"
        return f"{where}: least margin {self.margin:.3g}, panel score {self.panel_score:.2f}{doubt}{others}"

    def row(self) -> list[str]:
        """The frame's row of ``bits.csv``."""
        frame = self.frame
        time_s = "" if frame.time_s is None else f"{frame.time_s:.6f}"
        corners = [f"{c:.2f}" if self.found else "" for c in self.corners_px.ravel()]
        judged = [f"{self.margin:.4g}", f"{self.panel_score:.3f}"] if self.found else ["", ""]
        head = [frame.source, str(frame.index), time_s, str(int(self.found))]
        expected = f"{self.expected_errors:.3g}" if self.found else ""
        stated = "" if math.isnan(self.false_alarms) else f"{self.false_alarms:.3g}"
        rest = [str(self.candidates), expected, str(self.panel), stated, frame.light]
        return [*head, *corners, self.text, *judged, *rest]


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
    receiver = receiver_for(build_plan(settings, folder), model, settings.plug_ins)
    recording = chain(first, recording)
    if config.channel in ("auto", "unmix"):
        choose = in_best_channel if config.channel == "auto" else in_each_colour
        recording, told = choose(receiver, recording)
        console.print(told, soft_wrap=True, markup=False, highlight=False)
    rows, best, doubtful, strange, alike, names = [], None, 0, 0, 0, set[str]()
    unlike: dict[str, float] = {}
    try:
        drawn: Image.Image | None = None
        for reading in decode(receiver, recording, config.most, config.follow):
            rows.append(reading.row())
            if not reading.found:
                continue
            doubtful += reading.is_doubtful
            strange += bool(reading.unlike)
            alike += reading.one_level
            unlike |= reading.unlike
            if config.annotate and reading.frame.time_s is None:
                # Panels after the first are drawn into its picture.
                first_one = reading.panel == 0 or drawn is None
                under = reading.frame.colour if first_one else np.asarray(drawn)
                scale = 1 if first_one else config.scale
                drawn = annotated(under, reading.corners_px * scale, reading.bits, config.scale // scale)
                if first_one:
                    # With room for the rest of a name of 255 bytes.
                    name = Path(reading.frame.source).stem.encode()[:200].decode(errors="ignore")
                    while name.casefold() in names:
                        name += f"-{len(rows)}"
                    names.add(name.casefold())
                with atomic_file(folder / "annotated" / f"{name}.png") as temporary:
                    drawn.save(temporary, format="PNG")
            best = reading if best is None or reading.margin > best.margin else best
    except BaseException:
        shutil.rmtree(folder / "annotated", ignore_errors=True)
        raise
    if best is None:
        hint = "see receiver.location for the locator's limits, and decode.channel for coloured LEDs"
        nothing = f"input {source} shows no panel in {len(rows)} of {len(rows)} frames: {hint}"
        raise VoccError("; ".join([nothing, *failures]))
    run_folder.write_rows(folder / "bits.csv", [COLUMNS, *rows])
    run_folder.write_config(settings, folder)
    if model is None:
        receiver.save(folder / "receiver.pt")
    # The bits as they sit on the panel.
    on, off = ("#", ".") if console.options.ascii_only else ("●", "·")
    for bits in best.bits:
        console.print("  " + " ".join(on if bit else off for bit in bits), highlight=False)
    found = sum(bool(row[COLUMNS.index("bits")]) for row in rows)
    for text in (
        f"  {on} On, {off} Off",
        best.text,
        f"{best.judged}; {found} of {len(rows)} frames show a panel",
    ):
        console.print(text, soft_wrap=True, markup=False, highlight=False)
    places = [("bits", "bits.csv")] + [("pictures", "annotated")] * bool(names)
    run_folder.print_places(console, folder, places + [("receiver", "receiver.pt")] * (model is None))
    if doubtful:
        look = "look where it was found, at panel_score and at margin before you believe the bits"
        warnings.warn(f"{doubtful} of {found} frames may show no panel: {look}", stacklevel=2)
    if alike:
        look = "where all are On or all Off, their bits mean nothing"
        warnings.warn(f"LEDs look alike in {alike} of {found} frames: {look}", stacklevel=2)
    if strange:
        learned = receiver.trained_on
        parts = [f"{n} {v:.3g}, not {learned[n][0]:.3g} to {learned[n][1]:.3g}" for n, v in unlike.items()]
        far = f"{strange} of {found} frames are unlike what {receiver.name} learned from"
        warnings.warn(f"{far} ({'; '.join(parts)}): expected_errors may be too low", stacklevel=2)
    if failures:
        raise VoccError(f"{failures[0]}; bits.csv has the {len(rows)} frames that could be read")


def in_best_channel(
    receiver: Receiver, recording: Iterator[RecordedFrame]
) -> tuple[Iterator[RecordedFrame], str]:
    """Give a recording the grey plane that its first frames are read best in, and say which."""
    first = list(islice(recording, SEEN_FRAMES))
    shown = [one.colour for one in first if one.colour.shape == first[0].colour.shape]
    mix, far, sure = channel_of(receiver, shown)
    rest = chain(first, recording)
    frames = rest if mix.name == "luma" else (replace(one, grey=mix(one.colour)) for one in rest)
    if math.isnan(far):
        why = f"the first {len(shown)} frames are grey"
    elif not far:
        why = f"no panel was found in the first {len(shown)} frames"
    else:
        why = f"On and Off lie {far:.3g} standard deviations apart in the first {len(shown)} frames"
        why += f", {sure} of them without doubt"
    return frames, f"decode.channel=auto: {mix}, for {why}"


def in_each_colour(
    receiver: Receiver, recording: Iterator[RecordedFrame]
) -> tuple[Iterator[RecordedFrame], str]:
    """Give each frame of a recording three times, with the light of each colour of LEDs as its grey plane.

    Raises:
        VoccError: the first frames show no panel on which three colours send different bits.
    """
    first = list(islice(recording, SEEN_FRAMES))
    shown = [one.colour for one in first if one.colour.shape == first[0].colour.shape]
    mixes = unmixed(receiver, shown)
    if not mixes:
        rule = (
            f"auto, or one channel: the first {len(shown)} frames show no panel on which three colours differ"
        )
        raise VoccError.of("decode.channel", "unmix", rule)
    frames = (
        replace(one, grey=mix(one.colour), light=mix.name) for one in chain(first, recording) for mix in mixes
    )
    return frames, f"decode.channel=unmix: {'; '.join(map(str, mixes))}, of linear light"


def decode(
    receiver: Receiver, recording: Iterator[RecordedFrame], most: int = 1, follow: str = "false"
) -> Iterator[Reading]:
    """Decode a recording frame by frame, in batches of equal size.

    Args:
        receiver: a trained receiver.
        recording: its frames, as :func:`~vocc_torch.receiver.recording.read_recording` gives them.
        most: panels that are read in a frame, at most.
        follow: ``true`` where they are in order and the panel is followed, ``auto`` for videos, ``false``.

    Raises:
        VoccError: a frame that cannot be read, or several panels asked of a locator that sees one.
    """
    if most > 1 and not hasattr(receiver.locator, "sightings"):
        raise VoccError.of("decode.most", most, "1 where receiver.locator is not lattice or learned")
    for shape, run in groupby(recording, key=lambda frame: frame.grey.shape):
        tracker = Tracker(receiver.locator, receiver.shape)
        size = max(1, min(64, BATCH_PIXELS // (shape[0] * shape[1])))
        while batch := list(islice(run, size)):
            greys = torch.from_numpy(np.stack([frame.grey for frame in batch]))
            images, whose = Frames.whole(greys.to(receiver.device)), [*range(len(batch))]
            if follow == "true" or (follow == "auto" and batch[0].time_s is not None):
                with torch.inference_mode():
                    read = receiver(images, tracker.panels(greys).to(receiver.device))
            elif most > 1:
                whose, read = receiver.decode_several(images.grey, most)
            else:
                read = receiver.decode(images)
            sure = read.scores.abs()
            least = sure.amin(dim=(1, 2))
            corners, bits = read.corners_px.cpu().numpy(), read.bits.cpu().numpy()
            looks, beyond = read.appearance.cpu(), outside(read.appearance, receiver.trained_on)
            expected = torch.sigmoid(-read.llr.abs()).sum(dim=(1, 2))
            given = (
                read.found,
                least,
                read.panel_score,
                read.candidates,
                is_doubtful(read),
                expected,
                parted(read.scores, read.bits) < LEAST_PARTED,
                read.false_alarms,
            )
            number, before = 0, None
            for i, (place, found, *judged) in enumerate(
                zip(whose, *(one.tolist() for one in given), strict=True)
            ):
                frame, number = batch[place], number + 1 if place == before else 0
                before = place
                names = [name for name, far in beyond.items() if far[i] and found]
                unlike = {name: float(looks[i, APPEARANCE.index(name)]) for name in names}
                yield replace(Reading(frame, found, corners[i], bits[i], unlike, *judged), panel=number)
