"""``task=decode``: pictures, films or a live source in, bits out."""

import math
import shutil
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, replace
from itertools import chain, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import Settings
from vocc_torch.receiver.locators import PanelLocator, locator_words
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.shipped import SHIPPED, shipped_receiver
from vocc_torch.recordings.frames import RecordedFrame, turned
from vocc_torch.recordings.reading import read_recording, readable
from vocc_torch.recordings.streams import LiveStream, is_stream
from vocc_torch.report import folder as run_folder
from vocc_torch.report.terminal import Console
from vocc_torch.studies.decode import DecodeConfig
from vocc_torch.studies.decode.album import Album
from vocc_torch.studies.decode.colour import SEEN_FRAMES, Mix, channel_of, unmixed
from vocc_torch.studies.decode.live import decode_live
from vocc_torch.studies.decode.reading import (
    COLUMNS,
    decode,
    demand_several,
    is_adjustable,
)
from vocc_torch.studies.decode.summary import Summary
from vocc_torch.studies.decode.viewer import Viewer
from vocc_torch.types import PanelShape


def run_decode(settings: Settings, config: DecodeConfig, folder: Path) -> None:
    """Decode a recording and write its bits and annotated pictures.

    Raises:
        VoccError: no input, or an input without a panel.
    """
    run_folder.refuse_results(folder)
    if settings.input is None:
        allowed = "input=PICTURE, a folder of pictures, a video, camera:0, an rtsp:// address or - for stdin"
        raise VoccError(f"input is null: task=decode needs {allowed}")
    channel = "luma" if config.channel in ("auto", "unmix") else config.channel
    if is_stream(settings.input):
        with closing(LiveStream(settings.input, channel)) as stream:
            run_live(settings, config, folder, stream)
        return
    failures: list[str] = []
    recording = turned(
        readable(read_recording(Path(settings.input), channel), failures),
        config.turn,
        config.mirror,
    )
    first = list(
        islice(recording, 1)
    )  # a file that cannot be read is refused before a receiver is trained
    if not first:
        raise VoccError(failures[0])
    run_files(settings, config, folder, chain(first, recording), failures)


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
    receiver = receiver_of(settings, config, folder)
    recording, lights = in_channel(receiver, recording, config.channel, console)
    summary = Summary()
    album = Album(folder, config.scale)
    viewer = Viewer() if config.show else None
    try:
        for reading in decode(
            receiver, recording, config.most, config.follow or "false", lights
        ):
            summary.add(reading)
            if reading.found and config.annotate and reading.frame.time_s is None:
                album.add(reading)
            if viewer is not None:
                viewer.show(reading)
    except BaseException:
        shutil.rmtree(album.folder, ignore_errors=True)
        raise
    is_trained = settings.model is None
    if summary.best is None:
        size = f"{receiver.shape.rows} x {receiver.shape.columns} LEDs"
        nothing = f"input {settings.input} shows no panel of {size} in {summary.frames} of {summary.frames} frames"
        raise VoccError(
            "; ".join(
                [f"{nothing}: {summary.hint(config, is_trained, receiver)}", *failures]
            )
        )
    run_folder.write_rows(folder / "bits.csv", [COLUMNS, *summary.rows])
    write_receiver(settings, receiver, folder)
    summary.print_best(console, config.most)
    places = [("bits", "bits.csv")]
    if album.names:
        places.append(("pictures", "annotated"))
    if is_trained:
        places.append(("receiver", "receiver.pt"))
    run_folder.print_places(console, folder, places)
    summary.warn(receiver)
    if failures:
        raise VoccError(
            f"{failures[0]}; bits.csv has the {summary.frames} frames that could be read"
        )


def run_live(
    settings: Settings, config: DecodeConfig, folder: Path, stream: LiveStream
) -> None:
    """Decode a live source until it ends or Ctrl-C.

    Raises:
        VoccError: the source fails; what it gave until then is written.
    """
    console = Console()
    receiver = receiver_of(settings, config, folder)
    recording, lights = in_channel(
        receiver,
        turned(iter(stream), config.turn, config.mirror),
        config.channel,
        console,
    )
    readings = decode(
        receiver,
        recording,
        config.most,
        config.follow or "true",
        lights,
        frames_at_once=1,
    )
    viewer = Viewer() if config.show else None
    folder.mkdir(parents=True, exist_ok=True)
    write_receiver(settings, receiver, folder)
    decode_live(readings, stream, folder / "bits.csv", console, viewer)
    run_folder.print_places(console, folder, [("bits", "bits.csv")])


def receiver_of(settings: Settings, config: DecodeConfig, folder: Path) -> Receiver:
    """Take the receiver that ships or that a model file holds; train one where ``model`` is null.

    Raises:
        VoccError: a model that cannot be read or is for another panel, or several panels of a locator that
            finds one.
    """
    if settings.model in SHIPPED:
        panel = asdict(settings.panel)
        receiver = shipped_receiver(
            settings.model, PanelShape(panel["rows"], panel["columns"])
        )
    else:
        receiver = trained_or_loaded(settings, config, folder)
    if settings.model is not None and settings.receiver.false_alarms is not None:
        receiver.locator = at_rate(receiver.locator, settings.receiver.false_alarms)
    return receiver


def trained_or_loaded(
    settings: Settings, config: DecodeConfig, folder: Path
) -> Receiver:
    """Load the receiver of a model file, or train one."""
    # Loaded here because a receiver that ships needs no simulation.
    from vocc_torch.measure.build import build_plan
    from vocc_torch.measure.train import receiver_for

    model = None if settings.model is None else Path(settings.model)
    # A model brings a locator of its own.
    named = (
        settings.receiver
        if model is None
        else replace(settings.receiver, locator="truth")
    )
    plan = build_plan(replace(settings, receiver=named), folder)
    (finder,) = plan.receiver.finders([plan.receiver.locator]).values()
    if model is None:
        demand_several(finder, config.most)
    at_truth = finder is not None and finder.finds_several
    return receiver_for(plan, model, settings.plug_ins, at_truth=at_truth)


def write_receiver(settings: Settings, receiver: Receiver, folder: Path) -> None:
    """Write the configuration, and the receiver where it was trained in this run."""
    if settings.model in SHIPPED:
        run_folder.write_config(settings, folder)
        return
    from vocc_torch.measure.train import settings_used

    run_folder.write_config(settings_used(settings, receiver), folder)
    if settings.model is None:
        receiver.save(folder / "receiver.pt")


def at_rate(locator: PanelLocator, false_alarms: float) -> PanelLocator:
    """Give a model's locator another rate of false alarms.

    Raises:
        VoccError: a locator that states none, or a rate outside its range.
    """
    if not is_adjustable(locator):
        rule = f"only learned states them, and the model's locator is {locator_words(locator)[0]}"
        raise VoccError(f"receiver.false_alarms is {false_alarms}: {rule}")
    return locator.at_rate(false_alarms)


def in_channel(
    receiver: Receiver,
    recording: Iterator[RecordedFrame],
    channel: str,
    console: Console,
) -> tuple[Iterator[RecordedFrame], tuple[Mix, ...]]:
    """Choose the grey plane, or the planes of several colours, by the first frames where that is asked for.

    Raises:
        VoccError: colours that cannot be separated.
    """
    lights: tuple[Mix, ...] = ()
    if channel == "auto":
        recording, text = in_best_channel(receiver, recording)
    elif channel == "unmix":
        recording, text, lights = in_each_colour(receiver, recording)
    else:
        return recording, lights
    console.print(text, soft_wrap=True, markup=False, highlight=False)
    return recording, lights


def in_best_channel(
    receiver: Receiver, recording: Iterator[RecordedFrame]
) -> tuple[Iterator[RecordedFrame], str]:
    """Give a recording the grey plane that its first frames are read best in, and say which."""
    shown, every = first_colours(recording)
    mix, far, sure = channel_of(receiver, shown)
    frames = (
        every
        if mix.name == "luma"
        else (replace(one, grey=mix(one.colour)) for one in every)
    )
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
        none = (
            f"the first {len(shown)} frames show no panel on which three colours differ"
        )
        raise VoccError.of("decode.channel", "unmix", f"auto, or one channel: {none}")
    frames = (replace(one, grey=best(one.colour)) for one in every)
    told = f"decode.channel=unmix: {'; '.join(map(str, mixes))}, of linear light; located in {best.name}"
    return frames, told, mixes


def first_colours(
    recording: Iterator[RecordedFrame],
) -> tuple[list[NDArray[np.uint8]], Iterator[RecordedFrame]]:
    """Give the pictures of one size that decide for all of a recording, and the whole recording."""
    first = list(islice(recording, SEEN_FRAMES))
    return [
        one.colour for one in first if one.colour.shape == first[0].colour.shape
    ], chain(first, recording)
