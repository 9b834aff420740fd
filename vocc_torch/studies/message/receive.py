"""``task=receive``: a recording in, the message out, or the parts of it that a checksum vouches for."""

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, groupby, islice
from pathlib import Path

import numpy as np

from vocc_torch.errors import VoccError
from vocc_torch.files import write_atomically
from vocc_torch.measure import timing
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.train import receiver_for, settings_used
from vocc_torch.messages.front import Front
from vocc_torch.messages.packets import Assembly, payload_bytes
from vocc_torch.messages.reception import COLUMNS, Received, Reception
from vocc_torch.messages.signalling import MessagePlan
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.recording import RecordedFrame, read_recording, readable
from vocc_torch.report import folder as run_folder
from vocc_torch.report.terminal import Console
from vocc_torch.studies.message import PLAN, ReceiveConfig
from vocc_torch.studies.message.record import with_panel_of

BATCH_FRAMES, BATCH_PIXELS = 64, 64_000_000
"""Frames read at a time, and most pixels of them."""

MOST_NAMED = 12
"""Ranges of missing packets that a refusal names."""


def receive(
    receiver: Receiver,
    reception: Reception,
    front: Front,
    recording: Iterable[RecordedFrame],
    fps: float | None = None,
) -> Iterator[Received]:
    """Receive a recording packet by packet; what is held at a time does not grow with it.

    Args:
        receiver: reads the bits.
        reception: finds the packets.
        front: follows the panel.
        recording: the frames.
        fps: frames a second, or None for the recording's own times.
    """
    number, parts = 0, batches(recording)
    # The next frames are decoded while these are read.
    with ThreadPoolExecutor(1) as beside:
        coming = beside.submit(next, parts, None)
        while batch := coming.result():
            coming = beside.submit(next, parts, None)
            times = [frame.time_s for frame in batch]
            if fps is not None:
                times = [(number + i) / fps for i in range(len(batch))]
            number += len(batch)
            yield from reception.push(front([frame.grey for frame in batch]), times)
    yield from reception.finish()


def batches(recording: Iterable[RecordedFrame]) -> Iterator[list[RecordedFrame]]:
    """Batch frames of one size that are read together."""
    for (height, width), run in groupby(recording, key=lambda frame: frame.grey.shape):
        size = max(1, min(BATCH_FRAMES, BATCH_PIXELS // (height * width)))
        while batch := list(islice(run, size)):
            yield batch


def run_receive(settings: Settings, config: ReceiveConfig, folder: Path) -> None:
    """Receive a message and write it, or what arrived of it under another name, and a row a packet.

    Raises:
        VoccError: no input or plan; and, when everything is written, a message that is not whole.
    """
    run_folder.refuse_results(folder)
    if settings.input is None:
        raise VoccError("input is null: task=receive needs input=VIDEO, a folder of pictures or an array")
    source, console = Path(settings.input), Console()
    beside = (source if source.is_dir() else source.parent) / PLAN
    plan = MessagePlan.read(beside if config.plan is None else Path(config.plan))
    reception, assembly = Reception(plan), Assembly()
    failures: list[str] = []
    recording = readable(read_recording(source, config.channel, grey_only=True), failures)
    if not (first := list(islice(recording, 1))):
        raise VoccError(failures[0])
    model = None if settings.model is None else Path(settings.model)
    study = build_plan(with_panel_of(settings, plan), folder)
    # The panel is followed, so its corners are surer than those of single frames.
    receiver = receiver_for(study, model, settings.plug_ins, at_truth=True)
    front = Front(receiver, config.locate_every, config.soft, config.follow)
    rows: list[run_folder.Cells] = [COLUMNS]

    def take(packets: Iterable[Received]) -> None:
        for one in packets:
            rows.append(one.row())
            if one.packet is not None:
                assembly.add(one.packet)

    try:
        with timing.threads(1):  # the other cores decode: torch's threads would spin there
            take(receive(receiver, reception, front, chain(first, recording), config.fps))
    except KeyboardInterrupt:  # what arrived until then is written
        failures.append(f"interrupted after {front.frames} frames")
        take(reception.finish())
    info_bytes = reception.code.info_bytes
    whole, missing = assembly.whole(info_bytes), assembly.missing(info_bytes)
    run_folder.write_rows(folder / "report.csv", rows)
    run_folder.write_config(settings_used(settings, receiver), folder)
    if model is None:
        receiver.save(folder / "receiver.pt")
    shown = f"the panel was found in {front.found} of {front.looked} frames that were searched"
    told = f"{len(rows) - 1} packets in {front.frames} frames; {shown}"
    if front.tracker is not None:
        told += "; it was followed" + ", for it moves" * front.auto
    console.print(told, soft_wrap=True, highlight=False)
    places = [("packets", "report.csv")]
    if whole is not None:
        write_atomically(folder / "message.bin", whole)
        console.print(f"{len(whole)} bytes, all vouched for by their checksum", highlight=False)
        places.append(("message", "message.bin"))
    elif assembly.message is not None:
        write_atomically(folder / "message.partial", assembly.partial(info_bytes))
        write_missing(folder / "missing.csv", missing, assembly.message[0], info_bytes)
        places += [("part", "message.partial"), ("missing", "missing.csv")]
    run_folder.print_places(console, folder, places + [("receiver", "receiver.pt")] * (model is None))
    if whole is None:
        failures.insert(0, f"input {source}: {lost(missing, assembly, info_bytes)}")
    elif len(assembly.parts) > 1:
        failures.append(f"input {source} holds packets of {len(assembly.parts)} messages: one was written")
    if failures:
        raise VoccError("; ".join(failures))


def write_missing(path: Path, missing: list[int], length: int, info_bytes: int) -> None:
    """Write which bytes of a partial message nobody vouches for; they are zeros in it."""
    size = payload_bytes(info_bytes)
    rows = [(number, number * size, min(length, (number + 1) * size)) for number in missing]
    run_folder.write_rows(path, [("sequence", "first_byte", "end_byte"), *rows])


def lost(missing: list[int], assembly: Assembly, info_bytes: int) -> str:
    """Say in words which packets are missing.

    Example:
        >>> from vocc_torch.messages.packets import Packet
        >>> some = Assembly()
        >>> for number in (0, 3, 4):
        ...     some.add(Packet(number, (14, 0), b"12"))
        >>> lost(some.missing(18), some, 18)
        'of 7 packets of the message 4 are missing (1-2, 5-6): message.partial has zeros in their place'
    """
    if assembly.message is None:
        return "no packet arrived, so there is no message; report.csv says why"
    if not missing:
        return "all packets arrived, but the message's own checksum does not fit: message.partial has them"
    breaks = [i for i in range(1, len(missing)) if missing[i] > missing[i - 1] + 1]
    runs = [part.tolist() for part in np.split(np.array(missing), breaks)]
    named = [str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs[:MOST_NAMED]]
    more = f" and {len(runs) - MOST_NAMED} more places" if len(runs) > MOST_NAMED else ""
    count = -(-assembly.message[0] // payload_bytes(info_bytes))
    where = f"of {count} packets of the message {len(missing)} are missing ({', '.join(named)}{more})"
    return f"{where}: message.partial has zeros in their place"
