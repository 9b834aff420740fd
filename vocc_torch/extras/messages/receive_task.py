"""``task=receive``: a recording in, the message out, or the parts of it that a checksum vouches for."""

import warnings
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.clock import SoftFrames
from vocc_torch.extras.messages.config import PLAN, ReceiveConfig
from vocc_torch.extras.messages.front import Front
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import Message, messages_of, payload_bytes
from vocc_torch.extras.messages.reception import COLUMNS, received
from vocc_torch.extras.messages.record_task import with_panel_of
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.files import write_atomically
from vocc_torch.measure import timing
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.recordings.frames import RecordedFrame
from vocc_torch.recordings.reading import (
    batches,
    expected_frames,
    read_recording,
    readable,
)
from vocc_torch.report import folder as run_folder
from vocc_torch.report.terminal import Console, ProgressView
from vocc_torch.studies.decode.run import receiver_of, write_receiver


@dataclass(frozen=True)
class ReceiveSettings:
    """How a recording is read, and what is said of it."""

    batch_frames: int = 64  # read at a time
    batch_pixels: int = 64_000_000  # the most of them
    most_parts: int = 12  # incomplete messages that are written
    least_led_pitch_px: float = 2.0  # the camera's sampling limit


SETTINGS = ReceiveSettings()

MISSING_COLUMNS = (
    "message",
    "first_sequence",
    "last_sequence",
    "first_byte",
    "end_byte",
)
"""Columns of ``missing.csv``."""


def soft_values(
    front: Front, recording: Iterable[RecordedFrame], failures: list[str]
) -> Iterator[SoftFrames]:
    """Read a recording, batch by batch; an interruption ends it.

    Args:
        front: follows the panel.
        recording: the frames.
        failures: takes the interruption.
    """
    parts = batches(recording, SETTINGS.batch_frames, SETTINGS.batch_pixels)
    try:
        # The next frames are decoded while these are read.
        with ThreadPoolExecutor(1) as beside:
            coming = beside.submit(next, parts, None)
            while batch := coming.result():
                coming = beside.submit(next, parts, None)
                values = front([frame.grey for frame in batch])
                yield values, [frame.time_s for frame in batch]
    except KeyboardInterrupt:  # what arrived until then is written
        failures.append(f"interrupted after {front.frames} frames")


def run_receive(settings: Settings, config: ReceiveConfig, folder: Path) -> None:
    """Receive a message and write it, or what arrived of it under another name, and a row a packet.

    Raises:
        VoccError: no input or plan; and, when everything is written, a message that is not whole.
    """
    source = run_folder.input_of(
        settings, "task=receive needs input=VIDEO, a folder of pictures or an array"
    )
    console = Console()
    beside = (source if source.is_dir() else source.parent) / PLAN
    plan = MessagePlan.read(beside if config.plan is None else Path(config.plan))
    layout = Layout(plan)
    payload = payload_bytes(layout.code.info_bytes)
    failures, ends_s = list[str](), list[float]()
    recording = readable(
        read_recording(source, config.channel, grey_only=True), failures
    )
    settings = with_panel_of(settings, plan)
    # The panel is followed, so its corners are surer than those of single frames.
    receiver = receiver_of(settings, build_plan(settings), at_truth=True)
    front = Front(receiver, config.locate_every, config.soft, config.follow)

    def timed() -> Iterator[RecordedFrame]:
        for number, frame in enumerate(view.counted(recording, "receiving")):
            if config.fps is not None:
                frame = replace(frame, time_s=number / config.fps)
            if frame.time_s is not None:
                ends_s[1:] = [frame.time_s]
            yield frame

    # The other cores decode: torch's threads would spin there.
    with timing.threads(1), ProgressView(expected_frames(source), console) as view:
        packets = [*received(layout, soft_values(front, timed(), failures))]
    rows = [COLUMNS, *(packet.row for packet in packets)]
    run_folder.write_rows(folder / "report.csv", rows)
    arrived = [packet.packet for packet in packets if packet.packet is not None]
    messages = messages_of(arrived, payload)
    write_receiver(settings, receiver, folder)
    # The packets that a recording has time for; without time stamps those of the received blocks.
    blocks = len({packet.block for packet in packets})
    if ends_s:
        symbols = (ends_s[-1] - ends_s[0]) * plan.signalling.symbol_rate_hz
        blocks = max(1, round(symbols / layout.symbols))
    sent = blocks * layout.packets
    summary = (
        f"{len(arrived)} of {sent} packets arrived in {front.frames} frames; "
        f"the panel was found in {front.found} of {front.looked} frames that were searched"
    )
    if front.follows:
        summary += "; it was followed" + ", for it moves" * front.auto
    run_folder.say(console, summary)
    places = [("packets", "report.csv"), *write_messages(messages, folder)]
    for content, name in places:
        if content == "message":
            size = (folder / name).stat().st_size
            words = f"{name}: {size} bytes, all verified by their checksum"
            run_folder.say(console, words)
    places += [("receiver", "receiver.pt")] * (settings.model is None)
    run_folder.print_places(console, folder, places)
    for doubt in doubts(messages):
        warnings.warn(f"input {source}: {doubt}", stacklevel=2)
    if not any(message.complete for message in messages):
        why = lost(messages, sent, front.led_pitch_px)
        failures.insert(0, f"input {source}: {why}")
    if failures:
        raise VoccError("; ".join(failures))


def write_messages(messages: Sequence[Message], folder: Path) -> list[tuple[str, str]]:
    """Write each complete message, and where there is none the parts of the others.

    ``missing.csv`` has a row for each run of packets that did not arrive. Missing parts are left out of
    ``message.partial``: a packet may claim any length.

    Returns:
        What was written and the name of its file.
    """
    complete = [message for message in messages if message.complete]
    kind, ending = ("message", "bin") if complete else ("part", "partial")
    places, gaps = [], list[run_folder.Cells]()
    for number, message in enumerate(complete or messages[: SETTINGS.most_parts], 1):
        name = "message" if number == 1 else f"message_{number}"
        places.append((kind, f"{name}.{ending}"))
        write_atomically(folder / f"{name}.{ending}", message.content)
        for first, last in message.gaps:
            end = min(message.length, (last + 1) * message.payload)
            gaps.append((number, first, last, first * message.payload, end))
    if not complete:
        run_folder.write_rows(folder / "missing.csv", [MISSING_COLUMNS, *gaps])
        places.append(("missing", "missing.csv"))
    return places


def doubts(messages: Sequence[Message]) -> Iterator[str]:
    """Say where packets contradict each other, or belong to messages that are not written."""
    if contradictions := sum(message.contradictions for message in messages):
        yield (
            f"{contradictions} packets contradict "
            "the first packet of the same message and number: they are ignored"
        )
    parts = [len(message.parts) for message in messages if not message.complete]
    if 0 < len(parts) < len(messages):
        yield (
            f"{sum(parts)} packets of {len(parts)} other, incomplete messages are not written"
        )


def lost(messages: Sequence[Message], sent: int, led_pitch_px: float | None) -> str:
    """Say in words why there is no message, and which packets are missing.

    Args:
        messages: what arrived of them, none of them whole.
        sent: packets that the recording has time for.
        led_pitch_px: between neighbouring LEDs, px, or None where no panel was found.

    Example:
        >>> lost([Message(14, 0, 2, {0: b"12", 3: b"12", 4: b"12"})], 7, None)
        'of 7 packets of the message 4 are missing: missing.csv names them, message.partial has the others'
    """
    if not messages:
        if led_pitch_px is not None and led_pitch_px < SETTINGS.least_led_pitch_px:
            return (
                f"none of {sent} packets arrived: "
                f"LEDs are {led_pitch_px:.1f} px apart, and {SETTINGS.least_led_pitch_px:g} px are needed; "
                "come nearer or take a longer lens"
            )
        return f"none of {sent} packets arrived, so there is no message; report.csv says why"
    message = messages[0]
    if not message.gaps:
        return "all packets arrived, but the message's own checksum does not fit: message.partial has them"
    missing = message.packets - len(message.parts)
    refusal = f"of {message.packets} packets of the message {missing} are missing"
    if message.packets > sent:
        refusal += f", more than the {sent} that the recording has time for"
    return f"{refusal}: missing.csv names them, message.partial has the others"
