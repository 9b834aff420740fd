"""``task=receive``: a recording in, the message out, or the parts of it that a checksum vouches for."""

import warnings
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from pathlib import Path

from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.config import PLAN, ReceiveConfig
from vocc_torch.extras.messages.front import Front
from vocc_torch.extras.messages.packets import Assembly, Packet, payload_bytes
from vocc_torch.extras.messages.reception import COLUMNS, Received, Reception
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

BATCH_FRAMES = 64
"""Frames read at a time."""

BATCH_PIXELS = 64_000_000
"""Most pixels of them."""

MOST_NAMED = 12
"""Ranges of missing packets that a refusal names, and incomplete messages that are written."""

NEAREST_LEDS_PX = 2.0
"""LEDs nearer to each other than this share their pixels: the camera's sampling limit."""


MISSING_COLUMNS = (
    "message",
    "first_sequence",
    "last_sequence",
    "first_byte",
    "end_byte",
)
"""Columns of ``missing.csv``."""


def receive(
    reception: Reception,
    front: Front,
    recording: Iterable[RecordedFrame],
    fps: float | None = None,
) -> Iterator[Received]:
    """Receive a recording packet by packet, in constant memory.

    Args:
        reception: finds the packets.
        front: follows the panel.
        recording: the frames.
        fps: frames a second, or None for the recording's own times.
    """
    number, parts = count(), batches(recording, BATCH_FRAMES, BATCH_PIXELS)
    # The next frames are decoded while these are read.
    with ThreadPoolExecutor(1) as beside:
        coming = beside.submit(next, parts, None)
        while batch := coming.result():
            coming = beside.submit(next, parts, None)
            times = [
                frame.time_s if fps is None else next(number) / fps for frame in batch
            ]
            yield from reception.push(front([frame.grey for frame in batch]), times)
    yield from reception.finish()


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
    reception = Reception(plan)
    assembly = Assembly(payload_bytes(reception.layout.code.info_bytes))
    failures: list[str] = []
    recording = readable(
        read_recording(source, config.channel, grey_only=True), failures
    )
    settings = with_panel_of(settings, plan)
    # The panel is followed, so its corners are surer than those of single frames.
    receiver = receiver_of(settings, build_plan(settings), at_truth=True)
    front = Front(receiver, config.locate_every, config.soft, config.follow)
    rows: list[run_folder.Cells] = [COLUMNS]
    arrived: list[Packet] = []

    def take(packets: Iterable[Received]) -> None:
        for packet in packets:
            rows.append(packet.row())
            if packet.packet is not None:
                arrived.append(packet.packet)
                assembly.add(packet.packet)

    try:
        # The other cores decode: torch's threads would spin there.
        with timing.threads(1), ProgressView(expected_frames(source), console) as view:
            frames = view.counted(recording, "receiving")
            take(receive(reception, front, frames, config.fps))
    except KeyboardInterrupt:  # what arrived until then is written
        failures.append(f"interrupted after {front.frames} frames")
        take(reception.finish())
    run_folder.write_rows(folder / "report.csv", rows)
    write_receiver(settings, receiver, folder)
    sent = reception.packets_sent
    summary = (
        f"{len(arrived)} of {sent} packets arrived in {front.frames} frames; "
        f"the panel was found in {front.found} of {front.looked} frames that were searched"
    )
    if front.follows:
        summary += "; it was followed" + ", for it moves" * front.auto
    run_folder.say(console, summary)
    places = [("packets", "report.csv"), *write_messages(assembly, folder)]
    for content, name in places:
        if content == "message":
            size = (folder / name).stat().st_size
            run_folder.say(
                console, f"{name}: {size} bytes, all verified by their checksum"
            )
    run_folder.print_places(
        console,
        folder,
        places + [("receiver", "receiver.pt")] * (settings.model is None),
    )
    for doubt in doubts(assembly):
        warnings.warn(f"input {source}: {doubt}", stacklevel=2)
    if not any(message.complete for message in assembly.messages):
        failures.insert(
            0, f"input {source}: {lost(assembly, sent, front.led_pitch_px)}"
        )
    if failures:
        raise VoccError("; ".join(failures))


def write_messages(assembly: Assembly, folder: Path) -> list[tuple[str, str]]:
    """Write each complete message, and where there is none the parts of the others.

    ``missing.csv`` has a row for each run of packets that did not arrive. Missing parts are left out of
    ``message.partial``: a packet may claim any length.

    Returns:
        What was written and the name of its file.
    """
    messages = assembly.messages
    if complete := [message for message in messages if message.complete]:
        places = [("message", f"message{suffix(n)}.bin") for n in range(len(complete))]
        for message, (_, name) in zip(complete, places, strict=True):
            write_atomically(folder / name, message.content)
        return places
    places, gaps = [], list[run_folder.Cells]()
    for n, message in enumerate(messages[:MOST_NAMED]):
        places.append(("part", f"message{suffix(n)}.partial"))
        write_atomically(folder / places[-1][1], message.content)
        for first, last in message.gaps:
            end = min(message.length, (last + 1) * message.payload)
            gaps.append((n + 1, first, last, first * message.payload, end))
    run_folder.write_rows(folder / "missing.csv", [MISSING_COLUMNS, *gaps])
    return [*places, ("missing", "missing.csv")]


def suffix(number: int) -> str:
    """Name the files of several messages.

    Example:
        >>> suffix(0), suffix(1)
        ('', '_2')
    """
    return f"_{number + 1}" if number else ""


def doubts(assembly: Assembly) -> Iterator[str]:
    """Say where packets contradict each other, or belong to messages that are not written."""
    if assembly.contradictions:
        yield (
            f"{assembly.contradictions} packets contradict "
            "the first packet of the same message and number: they are ignored"
        )
    complete = sum(message.complete for message in assembly.messages)
    if complete and complete < len(assembly.messages):
        others = sum(len(message.parts) for message in assembly.messages[complete:])
        count = len(assembly.messages) - complete
        yield f"{others} packets of {count} other, incomplete messages are not written"


def lost(assembly: Assembly, sent: int, led_pitch_px: float | None) -> str:
    """Say in words why there is no message, and which packets are missing.

    Args:
        assembly: the packets.
        sent: packets that the recording has time for.
        led_pitch_px: between neighbouring LEDs, px, or None where no panel was found.

    Example:
        >>> from vocc_torch.extras.messages.packets import Message
        >>> some = Assembly(2)
        >>> some.by_message[14, 0] = Message(14, 0, 2, {0: b"12", 3: b"12", 4: b"12"})
        >>> lost(some, 7, None)
        'of 7 packets of the message 4 are missing (1-2, 5-6): message.partial has the others'
    """
    if not assembly.messages:
        if led_pitch_px is not None and led_pitch_px < NEAREST_LEDS_PX:
            return (
                f"none of {sent} packets arrived: "
                f"LEDs are {led_pitch_px:.1f} px apart, and {NEAREST_LEDS_PX:g} px are needed; "
                "come nearer or take a longer lens"
            )
        return f"none of {sent} packets arrived, so there is no message; report.csv says why"
    message = assembly.messages[0]
    if not message.gaps:
        return "all packets arrived, but the message's own checksum does not fit: message.partial has them"
    named = [str(a) if a == b else f"{a}-{b}" for a, b in message.gaps[:MOST_NAMED]]
    further = len(message.gaps) - len(named)
    places = ", ".join(named) + f" and {further} more places" * (further > 0)
    missing = message.packets - len(message.parts)
    refusal = (
        f"of {message.packets} packets of the message {missing} are missing ({places})"
    )
    if message.packets > sent:
        refusal += f", more than the {sent} that the recording has time for"
    return f"{refusal}: message.partial has the others"
