"""Recordings of many points, each read by every receiver, and what arrives of every code in it."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
import torch

from vocc_torch.arrays import Bools
from vocc_torch.extras.messages.clock import SoftFrames
from vocc_torch.extras.messages.combine import Block, blocks_of
from vocc_torch.extras.messages.config import MessagesConfig
from vocc_torch.extras.messages.front import Front
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import packed, payload_bytes
from vocc_torch.extras.messages.reception import decoded
from vocc_torch.extras.messages.record_task import Take
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.recording import NoFrameLeftError
from vocc_torch.simulation.scene import narrowed


class Place(NamedTuple):
    """A point of one receiver and one code: the quantity that varies, its value, and what carries messages."""

    axis: str
    value: float
    receiver: str
    code: str


@dataclass(frozen=True)
class Carried:
    """What one code carried to one receiver at one point, in one recording or in several.

    Args:
        lost: packets lost, of those sent, by recording: the counts' frames are recordings, its bits packets.
        raw: wrong bits of single frames, likewise by recording.
        kbit_s: of packets sent.
        frames: of the camera.
        false: packets whose checksum is right and which nobody sent.
    """

    lost: Counts
    raw: Counts
    kbit_s: float
    frames: int
    false: int

    def __add__(self, other: "Carried") -> "Carried":
        """Add another recording."""
        names = "lost", "raw", "frames", "false"
        sums = {name: getattr(self, name) + getattr(other, name) for name in names}
        return replace(self, **sums)

    @property
    def loss(self) -> Estimate:
        """Share of the packets that were lost, with its 95 % interval; a recording's packets err together."""
        return ber_interval(self.lost)

    @property
    def goodput(self) -> Estimate:
        """What arrives, kbit/s."""
        loss, full = self.loss, self.kbit_s
        return Estimate(
            full * (1 - loss.value), full * (1 - loss.high), full * (1 - loss.low)
        )


def counted(errors: int, of: int) -> Counts:
    """Count the errors of one recording; where there was nothing that could err, nothing is known.

    Example:
        >>> (counted(0, 4) + counted(3, 4) + counted(0, 0)).ber
        0.375
    """
    if not of:
        return Counts()
    return Counts(1, of, 2 * errors, 4 * errors * errors, int(errors > 0))


def recorded(
    plan: Plan,
    config: MessagesConfig,
    receivers: Mapping[str, Receiver],
    job: tuple[str, float, int],
) -> dict[Place, Carried]:
    """Take a recording, read it with every receiver and decode it as every code.

    One random block is shown over and over. For each code the scrambling is the one by which that block holds
    its packets, so all of them are compared on the same frames.

    Args:
        plan: world, seed and batch size.
        config: what is sent.
        receivers: by name; the first one's locator follows the panel for all.
        job: the quantity that varies, its value, and the number of the recording at that point.
    """
    axis, value, number = job
    changes = {**plan.experiment.scene, "distance_m": config.at_distance_m}
    ratio = config.at_ratio
    if axis == "ratio":
        ratio = value
    else:
        changes[axis] = value
    model = narrowed(plan.world.scene, changes, "messages")
    shape, rate_hz = plan.world.panel.shape, config.signalling.symbol_rate_hz
    key = BlockKey(plan.seed, f"messages/{axis}={value:g}", number)
    base = Layout(MessagePlan(shape, config.options("none")))
    shown = base.write(
        key.generator("bits").integers(
            2, size=(base.packets, base.word_bits), dtype=np.uint8
        )
    )
    film = np.tile(shown, (config.blocks, 1, 1))
    fronts = {name: Front(receiver) for name, receiver in receivers.items()}
    leader = next(iter(fronts.values()))
    read: dict[str, list[SoftFrames]] = {name: [] for name in fronts}
    wrong, taken = dict.fromkeys(fronts, 0), 0
    scene, fps = model.draw(key, shape)[0][:1], ratio * rate_hz
    take = Take(plan, config.record, scene, film, fps, rate_hz, key)
    with suppress(NoFrameLeftError):  # all its packets are lost
        for part in take.parts(config.record.margin):
            stamps = [(taken + i) / fps for i in range(len(part.symbols))]
            taken += len(stamps)
            symbols = [number or 0 for number in part.symbols]
            truth = film[np.clip(symbols, 0, len(film) - 1)]
            with torch.inference_mode():
                frames, corners = leader.locate([*part.frames.grey[:, 0].cpu().numpy()])
                for name, front in fronts.items():
                    values = front.values(*front.read(frames, corners))
                    wrong[name] += int(((values >= 0) != truth).sum())
                    read[name].append((values, stamps))
    blocks = {name: [*blocks_of(base, parts)] for name, parts in read.items()}
    results = {}
    for receiver, code in product(read, config.codes):
        layout = Layout(MessagePlan(shape, config.options(code)))
        sent, info_bytes = config.blocks * layout.packets, layout.code.info_bytes
        arrived, false = packets_of(blocks[receiver], layout, shown, key)
        results[Place(axis, value, receiver, code)] = Carried(
            counted(max(0, sent - arrived), sent),
            counted(wrong[receiver], taken * shape.leds),
            8e-3 * payload_bytes(info_bytes) * sent / (len(film) / rate_hz),
            taken,
            false,
        )
    return results


def packets_of(
    blocks: Sequence[Block], layout: Layout, shown: Bools, key: BlockKey
) -> tuple[int, int]:
    """Count the packets that arrive where every block shows ``shown``, and those that nobody sent."""
    info_bytes = layout.code.info_bytes
    text = key.generator("text").bytes(layout.packets * payload_bytes(info_bytes))
    words = layout.code.encode([*packed(text, info_bytes)])
    layout, arrived, false = layout.rescrambled(words, shown), set(), 0
    for block in blocks:
        for received in decoded(block, layout):
            if (packet := received.packet) is not None:
                size = len(packet.payload)
                if packet.payload == text[packet.sequence * size :][:size]:
                    arrived.add((block.number, received.place))
                else:
                    false += 1
    return len(arrived), false
