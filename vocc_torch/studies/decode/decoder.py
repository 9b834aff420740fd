"""Anything that holds frames in, readings out: what ``vt.decode`` and ``task=decode`` share."""

import warnings
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path

import torch

from vocc_torch.boundary import checked
from vocc_torch.errors import VoccError
from vocc_torch.receiver.locators import DetectorLocator, PanelLocator, locator_words
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.shipped import SHIPPED, shipped_receiver
from vocc_torch.recordings.frames import RecordedFrame, turned
from vocc_torch.recordings.reading import read_source, readable
from vocc_torch.recordings.streams import is_stream
from vocc_torch.studies.decode import DecodeConfig
from vocc_torch.studies.decode.colour import FIXED, SETTINGS, Mix, channel_of, unmixed
from vocc_torch.studies.decode.reading import Reading, is_adjustable, read_panels
from vocc_torch.studies.decode.shapes import AUTO, ShapeChoice, find_shape
from vocc_torch.types import PanelShape, resolve_device


@checked
def decode(
    source: object,
    model: str | Path | Receiver = "street",
    *,
    rows: int | str | None = None,
    columns: int | str | None = None,
    channel: str = "luma",
    most: int = 1,
    follow: bool | None = None,
    turn: int = 0,
    mirror: bool = False,
    false_alarms: float | None = None,
    arithmetic: str | None = None,
    plug_ins: Sequence[str] = (),
    device: str = "auto",
) -> Iterator[Reading]:
    """Read the bits of pictures, films, arrays or a live source, frame by frame.

    ``vocc-torch task=decode`` reads the same bits. A warning at the end names the
    files of a folder that cannot be read.

    Args:
        source: a path of a picture, a folder of pictures, a film or a NumPy file; a live source
            (``camera:0``, ``rtsp://...``, ``-``); a Pillow picture; or an array or tensor (H,W), (H,W,3),
            (B,H,W) or (B,H,W,3) of integers or floats, with the white levels of a NumPy file.
        model: a receiver, its file, or ``street``, the receiver that ships.
        rows: rows of the panel; None takes those of the receiver, ``auto`` tries usual shapes and warns if
            the choice is uncertain.
        columns: columns of the panel, given as ``rows``.
        channel: how colour becomes grey, as ``decode.channel``.
        most: most panels per frame.
        follow: follow the panel from frame to frame; None follows in live sources only.
        turn: turn frames clockwise, 0, 90, 180 or 270 degrees.
        mirror: exchange left and right after turning.
        false_alarms: accept a panel if at most this many false alarms are expected in a frame without one;
            None takes the receiver's.
        arithmetic: of the detector's networks, as ``decode.arithmetic``; None takes the receiver's.
        plug_ins: Python files and packages whose code the model may run.
        device: ``auto``, ``cpu`` or ``cuda``.

    Returns:
        One reading per panel: ``bits`` (R,C), ``text``, ``corners_px``, ``found``, ``margin`` and ``frame``. A frame
        without a panel gives one reading, whose ``found`` is False.

    Raises:
        VoccError: a source, model or option that cannot be used.

    Example:
        >>> import numpy as np
        >>> [reading.found for reading in decode(np.zeros((2, 40, 60)))]
        [False, False]
    """
    try:
        words = None if follow is None else str(follow)
        config = DecodeConfig(
            channel,
            most=most,
            follow=words,
            turn=turn,
            mirror=mirror,
            arithmetic=arithmetic,
        )
    except VoccError as error:
        raise VoccError(str(error).removeprefix("decode.")) from None
    failures: list[str] = []
    recording = readable(read_source(source, config.first_channel), failures)
    recording = turned(recording, turn, mirror)
    receiver, recording, choice = sized_receiver(
        recording, model, rows, columns, plug_ins, false_alarms, arithmetic, device
    )
    if choice is not None and not choice.is_sure:
        warnings.warn(str(choice), stacklevel=2)
    is_live = isinstance(source, str) and is_stream(source)
    readings, _ = readings_of(receiver, recording, config, is_live)
    return with_warning(readings, failures)


def with_warning(found: Iterator[Reading], failures: list[str]) -> Iterator[Reading]:
    """Pass readings on, and warn at the end of what could not be read."""
    yield from found
    if failures:
        warnings.warn(failures[0], stacklevel=2)


def sized_receiver(
    recording: Iterator[RecordedFrame],
    model: str | Path | Receiver,
    rows: int | str | None,
    columns: int | str | None,
    plug_ins: Sequence[str] = (),
    false_alarms: float | None = None,
    arithmetic: str | None = None,
    device: str = "cpu",
) -> tuple[Receiver, Iterator[RecordedFrame], ShapeChoice | None]:
    """Take a receiver, load one from a file, or take one that ships, for a panel of these rows and columns.

    Args:
        recording: of which the first frames decide the shape where it is ``auto``.
        model: a receiver, its file, or the name of one that ships.
        rows: of the panel; None takes those of the receiver.
        columns: likewise.
        plug_ins: files of code that a file may name.
        false_alarms: of its locator in a frame without a panel; None takes the receiver's.
        arithmetic: of its detector; None takes the receiver's. The shape is found in float32.
        device: where it is put.

    Returns:
        The receiver, all of the recording, and what was found of the panel's shape, or None.

    Raises:
        VoccError: a model that cannot be read or is for another panel, a locator without such a rate, or a
            shape to be found by a receiver that does not ship or that no usual panel has.
    """
    choice, name, place = None, str(model), resolve_device(device)
    if isinstance(model, Receiver):
        receiver = model
    elif name in SHIPPED:
        receiver = shipped_receiver(name)
    else:
        receiver = Receiver.load(model, plug_ins)
    if arithmetic is not None:
        receiver = copy(receiver)
        receiver.locator = with_arithmetic(receiver.locator, arithmetic, place)
    if AUTO in (rows, columns):
        if name not in SHIPPED:
            rule = "a whole number for a receiver that does not ship"
            raise VoccError.of("panel.rows or panel.columns", AUTO, rule)
        first, recording = looked_ahead(recording)
        greys = [frame.grey for frame in first]
        choice = find_shape(name, greys, rows or AUTO, columns or AUTO)
        rows, columns = choice.shape.sides
    has = receiver.shape
    rows = has.rows if rows is None else rows
    columns = has.columns if columns is None else columns
    shape = PanelShape(rows, columns)  # type: ignore[arg-type]  # refuses what is no number
    if name in SHIPPED:
        receiver.reader = replace(receiver.reader, shape=shape)
    elif shape != has:
        raise VoccError(
            f"model {model} reads a panel of {has.rows} x {has.columns} LEDs, and"
            f" panel.rows x panel.columns is {shape.rows} x {shape.columns}: make them"
            " agree"
        )
    if false_alarms is not None:
        if not is_adjustable(receiver.locator):
            raise VoccError(
                f"receiver.false_alarms is {false_alarms}: only detector states them,"
                f" and the model's locator is {locator_words(receiver.locator)[0]}"
            )
        receiver = copy(receiver)
        receiver.locator = receiver.locator.at_rate(false_alarms)
    return receiver.to(place), recording, choice


def looked_ahead(
    recording: Iterator[RecordedFrame],
) -> tuple[list[RecordedFrame], Iterator[RecordedFrame]]:
    """Give the first frames of a recording, and an iterator over all of its frames."""
    first = list(islice(recording, SETTINGS.frames))
    return first, chain(first, recording)


def readings_of(
    receiver: Receiver,
    recording: Iterator[RecordedFrame],
    config: DecodeConfig,
    is_live: bool = False,
) -> tuple[Iterator[Reading], str]:
    """Choose the grey plane of frames, and read them; say how it was chosen where it was not named.

    Args:
        receiver: locates and decides.
        recording: the frames, upright.
        config: how they are read.
        is_live: whether each frame is read as it arrives, and the panel followed.

    Raises:
        VoccError: colours that cannot be separated, or several panels of a locator that sees one.
    """
    recording, text, lights = in_channel(
        receiver, recording, config.channel, config.most
    )
    follow = config.follow or str(is_live).lower()
    at_once = 1 if is_live else 64
    found = read_panels(receiver, recording, config.most, follow, lights, at_once)
    return found, text


def with_arithmetic(
    locator: PanelLocator | None, arithmetic: str, device: torch.device
) -> DetectorLocator:
    """Give the detector with its networks in another arithmetic.

    Raises:
        VoccError: a locator without networks, or an arithmetic that the device or the installed packages lack.
    """
    if not isinstance(locator, DetectorLocator):
        rule = "leave it out, because the receiver's locator has no networks"
        raise VoccError(f"decode.arithmetic is {arithmetic}: {rule}")
    changed = replace(locator, arithmetic=arithmetic)
    changed.networks(device)
    return changed


def in_channel(
    receiver: Receiver,
    recording: Iterator[RecordedFrame],
    channel: str,
    most: int = 1,
) -> tuple[Iterator[RecordedFrame], str, tuple[Mix, ...]]:
    """Choose the grey plane, or the planes of several colours, by the first frames where that is asked for.

    Raises:
        VoccError: colours that cannot be separated.
    """
    if channel not in ("auto", "unmix"):
        return recording, "", ()
    first, recording = looked_ahead(recording)
    size, mix, mixes = first[0].colour.shape, FIXED[0], tuple[Mix, ...]()
    shown = [frame.colour for frame in first if frame.colour.shape == size]
    frames = f"the first {len(shown)} frames"
    if channel == "unmix":
        mix, mixes = unmixed(receiver, shown)
        if not mixes:
            rule = f"auto, or one channel: {frames} show no panel on which three colours differ"
            raise VoccError.of("decode.channel", "unmix", rule)
        text = f"{'; '.join(map(str, mixes))}, of linear light; located in {mix.name}"
    elif (best := channel_of(receiver, shown, most)) is None:
        text = f"{mix}, for {frames} are grey"
    else:
        mix = best.mix
        text = f"{mix}, for no panel was found in {frames}"
        if best.apart:
            text = (
                f"{mix}, for On and Off lie {best.apart:.3g} standard deviations apart"
                f" in {frames}, {best.sure} of them without doubt"
            )
    if mix != FIXED[0] or mixes:
        recording = (replace(frame, grey=mix(frame.colour)) for frame in recording)
    return recording, f"decode.channel={channel}: {text}", mixes
