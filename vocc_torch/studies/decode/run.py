"""``task=decode``: the command's layer over :mod:`vocc_torch.studies.decode.decoder`."""

import csv
import shutil
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.files import VIDEO_SUFFIXES
from vocc_torch.measure.config import Settings
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.shipped import SHIPPED
from vocc_torch.recordings.frames import RecordedFrame, turned
from vocc_torch.recordings.reading import (
    ALLOWED,
    expected_frames,
    read_recording,
    readable,
)
from vocc_torch.recordings.streams import LiveStream, is_stream
from vocc_torch.report.folder import (
    Cells,
    print_places,
    say,
    write_config,
    write_rows,
)
from vocc_torch.report.progress import ProgressView
from vocc_torch.studies.decode import DecodeConfig
from vocc_torch.studies.decode.album import Album
from vocc_torch.studies.decode.decoder import (
    readings_of,
    sized_receiver,
    with_arithmetic,
)
from vocc_torch.studies.decode.reading import COLUMNS, Reading, demand_several
from vocc_torch.studies.decode.summary import Summary
from vocc_torch.studies.decode.viewer import Viewer
from vocc_torch.types import resolve_device

if TYPE_CHECKING:
    from vocc_torch.measure.plan import Plan

MS_PER_S = 1000
_picture_of = attrgetter("frame.source", "frame.index", "frame.light")
"""Names the picture that a panel is drawn into."""


def run_decode(settings: Settings, config: DecodeConfig, folder: Path) -> None:
    """Decode a recording and write its bits and annotated pictures.

    Raises:
        VoccError: no input, a key that does not hold for it, or an input without a panel.
    """
    if settings.input is None:
        raise VoccError(f"input is null: task=decode needs input=PICTURE; {ALLOWED}")
    source, channel, grey_only = settings.input, config.first_channel, config.grey_only
    if is_stream(source):
        stream = LiveStream(source, channel, grey_only=grey_only, newest=config.newest)
        with closing(stream):
            run_live(settings, config, folder, stream)
        return
    if config.newest is not None:
        rule = f"null where input is a file, as {source}"
        raise VoccError.of("decode.newest", config.newest, rule)
    if config.scale > 1 and source.lower().endswith(VIDEO_SUFFIXES):
        rule = f"1 where input is a video, as {source}: pictures are annotated"
        raise VoccError.of("decode.scale", config.scale, rule)
    failures: list[str] = []
    files = read_recording(Path(source), channel, grey_only=grey_only)
    run_files(settings, config, folder, readable(files, failures), failures)


def run_files(
    settings: Settings,
    config: DecodeConfig,
    folder: Path,
    recording: Iterator[RecordedFrame],
    failures: list[str],
) -> None:
    """Decode the frames of files, and write bits, pictures and the receiver where one was trained.

    Raises:
        VoccError: no panel in any frame; at the end, files that cannot be read.
    """
    console = Console()
    receiver, readings = readings_for(settings, config, recording, console)
    summary, rows = Summary(), list[Cells]([COLUMNS])
    album = Album(folder, config.scale)
    viewer = Viewer() if config.show else None
    total = expected_frames(Path(settings.input or ""))
    try:
        with ProgressView(total, console, "decoding") as view:
            for _, panels in groupby(readings, _picture_of):
                found = []
                for reading in panels:
                    rows.append(reading.row())
                    summary.add(reading)
                    found += [reading] * reading.found
                    if viewer is not None:
                        viewer.show(reading)
                view.advance("decoding", summary.frames - view.done)
                if found and config.annotate and found[0].frame.time_s is None:
                    album.add(found)
    except BaseException:
        shutil.rmtree(album.folder, ignore_errors=True)
        raise
    is_trained, frames = settings.model is None, summary.frames
    if summary.best is None:
        size = f"{receiver.shape.rows} x {receiver.shape.columns} LEDs"
        nothing = f"input {settings.input} shows no panel of {size} in {frames} of {frames} frames"
        hint = summary.hint(config, is_trained, receiver)
        raise VoccError("; ".join([f"{nothing}: {hint}", *failures]))
    write_rows(folder / "bits.csv", rows)
    write_receiver(settings, receiver, folder)
    summary.print_best(console, config.most)
    places = [("bits", "bits.csv")]
    places += [("pictures", "annotated")] * bool(album.names)
    places += [("receiver", "receiver.pt")] * is_trained
    print_places(console, folder, places)
    for doubt in summary.doubts():
        warnings.warn(doubt, stacklevel=2)
    if failures:
        raise VoccError(
            f"{failures[0]}; bits.csv has the {frames} frames that could be read"
        )


def run_live(
    settings: Settings, config: DecodeConfig, folder: Path, stream: LiveStream
) -> None:
    """Print and write what is read of a live source as it comes, until it ends or Ctrl-C.

    Each row of ``bits.csv`` is on the disk once it is printed.

    Raises:
        VoccError: the source fails; what it gave until then is written.
    """
    console = Console()
    receiver, readings = readings_for(settings, config, iter(stream), console, True)
    viewer = Viewer() if config.show else None
    folder.mkdir(parents=True, exist_ok=True)
    write_receiver(settings, receiver, folder)
    summary, latencies_s = Summary(), []
    with (folder / "bits.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        try:
            for reading in readings:
                table.writerow(reading.row())
                file.flush()
                summary.add(reading)
                if (arrived_s := reading.frame.arrived_s) is not None:
                    latencies_s.append(time.monotonic() - arrived_s)
                index, time_s = reading.frame.index, reading.frame.time_s
                place = f"frame {index:6d}" if time_s is None else f"{time_s:9.3f} s"
                text = f"{reading.text}  margin {reading.margin:.3g}"
                say(console, f"{place}  {text if reading.found else 'no panel'}")
                if viewer is not None:
                    viewer.show(reading)
        except KeyboardInterrupt:
            pass
        finally:
            say(console, summarised(summary, latencies_s, stream.dropped))
    if not summary.frames:
        raise VoccError(f"input {stream.source}: no frame arrived")
    print_places(console, folder, [("bits", "bits.csv")])


def readings_for(
    settings: Settings,
    config: DecodeConfig,
    recording: Iterator[RecordedFrame],
    console: Console,
    is_live: bool = False,
) -> tuple[Receiver, Iterator[Reading]]:
    """Give the receiver and what it reads, and print the shape and the channel that were chosen.

    The receiver ships or is in a model file; where ``model`` is null it is trained.

    Raises:
        VoccError: a model that cannot be read or is for another panel, or several panels of a locator that
            finds one.
    """
    recording = turned(recording, config.turn, config.mirror)
    if settings.model is None:
        # Loaded here because a receiver that is at hand needs no simulation.
        from vocc_torch.measure.build import build_plan

        plan = build_plan(settings)
        finder = plan.receiver.finder
        demand_several(finder, config.most)
        if config.arithmetic is not None:
            # Refused before a training.
            place = resolve_device(settings.device)
            changed = with_arithmetic(finder, config.arithmetic, place)
        at_truth = finder is not None and finder.finds_several
        receiver = receiver_of(settings, plan, at_truth=at_truth)
        if config.arithmetic is not None:
            receiver.locator = changed
    else:
        rate, panel = settings.receiver.false_alarms, vars(settings.panel)
        sides = panel["rows"], panel["columns"]
        receiver, recording, choice = sized_receiver(
            recording,
            settings.model,
            *sides,
            settings.plug_ins,
            rate,
            config.arithmetic,
            settings.device,
        )
        if choice is not None:
            say(console, str(choice))
    readings, channel = readings_of(receiver, recording, config, is_live)
    if channel:
        say(console, channel)
    return receiver, readings


def receiver_of(settings: Settings, plan: "Plan", *, at_truth: bool) -> Receiver:
    """Load the receiver that ``model`` names, or train it on the plan's scenes where that is null.

    Raises:
        VoccError: a model that cannot be read or is for another panel.
    """
    if settings.model is None:
        from vocc_torch.measure.train import receiver_for

        return receiver_for(plan, at_truth=at_truth)
    panel, plug_ins = vars(settings.panel), settings.plug_ins
    sides = panel["rows"], panel["columns"]
    return sized_receiver(
        iter(()), settings.model, *sides, plug_ins, device=settings.device
    )[0]


def write_receiver(settings: Settings, receiver: Receiver, folder: Path) -> None:
    """Write the configuration, and the receiver where it was trained in this run."""
    if settings.model in SHIPPED:
        write_config(settings, folder)
        return
    from vocc_torch.measure.train import settings_used

    write_config(settings_used(settings, receiver), folder)
    if settings.model is None:
        receiver.save(folder / "receiver.pt")


def summarised(summary: Summary, latencies_s: Sequence[float], dropped: int) -> str:
    """Say in one line in how many frames a panel was found, and the latency.

    Args:
        summary: of the frames that were read.
        latencies_s: from a frame's arrival until its bits were written, for each frame.
        dropped: frames that were not read.

    Example:
        >>> summarised(Summary(frames=3, shown=2), [0.01, 0.02, 0.03], 1)
        'panel found in 2 of 3 frames; latency 20 ms, 29 ms at the 95th percentile; 1 frames dropped'
    """
    text = f"panel found in {summary.shown} of {summary.frames} frames"
    if latencies_s:
        median, high = MS_PER_S * np.quantile(latencies_s, [0.5, 0.95])
        text += f"; latency {median:.0f} ms, {high:.0f} ms at the 95th percentile"
    return text + f"; {dropped} frames dropped" * bool(dropped)
