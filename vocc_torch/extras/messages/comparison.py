"""Recordings of many points, each read by every receiver, and what arrives of every code in it."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
import torch

from vocc_torch.arrays import Bools
from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.codes import code_of, encoded
from vocc_torch.extras.messages.combine import Block, Combiner
from vocc_torch.extras.messages.config import AXES, MessagesConfig
from vocc_torch.extras.messages.front import Front
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import packed, payload_bytes
from vocc_torch.extras.messages.reception import decoded
from vocc_torch.extras.messages.record_task import shutter_of
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.train import Training, calibrated_receiver
from vocc_torch.receiver.bank import GREYSCALE_RECEIVERS
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.simulation.recording import NoFrameLeftError, Recorded, record
from vocc_torch.simulation.scene import narrowed


class Variant(NamedTuple):
    """What carries a message: a receiver and a code."""

    receiver: str
    code: str


class Packets(NamedTuple):
    """How many packets of a recording were sent, were lost, and have a right checksum though nobody sent them."""

    sent: int
    lost: int
    false: int


class SweepPoint(NamedTuple):
    """A point: the quantity that varies, and its value."""

    axis: str
    value: float


@dataclass(frozen=True)
class RecordingJob:
    """One recording; picklable, so that workers do it.

    Args:
        plan: world, seed and batch size.
        config: what is sent.
        place: the point.
        number: of the recording at that point.
        receivers: by name; the first one's locator follows the panel for all.
    """

    plan: Plan
    config: MessagesConfig
    place: SweepPoint
    number: int
    receivers: Mapping[str, Receiver]

    @property
    def model(self) -> SceneModel:
        """The scenes of the point."""
        scene = narrowed(self.plan.world.scene, self.plan.experiment.scene)
        scene = narrowed(
            scene, {"distance_m": self.config.at_distance_m}, "messages.at"
        )
        varied = (
            {} if self.place.axis == "ratio" else {self.place.axis: self.place.value}
        )
        return narrowed(scene, varied, "messages")

    @property
    def ratio(self) -> float:
        """Frames of the camera a symbol."""
        return self.place.value if self.place.axis == "ratio" else self.config.at_ratio


@dataclass(frozen=True)
class RecordingResult:
    """What came of one recording.

    Args:
        seconds: the recording's length.
        frames: of the camera.
        wrong: wrong bits in single frames by receiver, and how many bits there were.
        packets: what became of them, by what carried them.
    """

    seconds: float
    frames: int
    wrong: dict[str, tuple[int, int]]
    packets: dict[Variant, Packets]


def variants_of(plan: Plan, config: MessagesConfig) -> list[Variant]:
    """Name all that is compared.

    Raises:
        VoccError: a receiver that needs preambles, of which a message has none.
    """
    if greyscale := [
        name for name in plan.receiver.names if name in GREYSCALE_RECEIVERS
    ]:
        raise VoccError(
            f"receiver.names has {greyscale[0]}: it needs preambles, which messages do not send"
        )
    return [Variant(*pair) for pair in product(plan.receiver.names, config.codes)]


def jobs_of(
    plan: Plan, config: MessagesConfig, receivers: Mapping[str, Receiver]
) -> list[RecordingJob]:
    """List all recordings."""
    places = [
        SweepPoint(axis, value) for axis in AXES for value in getattr(config, axis)
    ]
    return [
        RecordingJob(plan, config, place, n, receivers)
        for place in places
        for n in range(config.recordings)
    ]


def receivers_of(plan: Plan, training: Training) -> dict[str, Receiver]:
    """Put the named receivers together, with what finds the panel."""
    (locator,) = plan.receiver.finders([plan.receiver.locator]).values()
    receivers = {}
    for name in plan.receiver.names:
        receiver_plan = replace(
            plan, receiver=replace(plan.receiver, save=name, locator="truth")
        )
        receivers[name] = calibrated_receiver(receiver_plan, training)
        if locator is not None:
            receivers[name].locator = locator
    return receivers


def recorded(job: RecordingJob) -> RecordingResult:
    """Take a recording, read it with every receiver and decode it as every code.

    One random block is shown over and over. For each code the scrambling is the one by which that block holds
    its packets, so all of them are compared on the same frames.
    """
    config, shape = job.config, job.plan.world.panel.shape
    rate_hz = config.signalling.symbol_rate_hz
    key = BlockKey(
        job.plan.seed, f"messages/{job.place.axis}={job.place.value:g}", job.number
    )
    base = Layout(MessagePlan(shape, config.options("none")))
    random = key.generator("bits").integers(
        2, size=(base.packets, base.word_bits), dtype=np.uint8
    )
    shown = base.write(random)
    film = np.tile(shown, (config.blocks, 1, 1))
    fronts = {name: Front(receiver) for name, receiver in job.receivers.items()}
    leader = next(iter(fronts.values()))
    combiners = {name: Combiner(base) for name in fronts}
    blocks: dict[str, list[Block]] = {name: [] for name in fronts}
    wrong, taken = dict.fromkeys(fronts, 0), 0
    for part in filmed(job, film, key):
        count = len(part.symbols)
        stamps = [(taken + i) / (job.ratio * rate_hz) for i in range(count)]
        taken += count
        truth = film[
            np.clip([number or 0 for number in part.symbols], 0, len(film) - 1)
        ]
        with torch.inference_mode():
            frames, corners = leader.locate([*part.frames.grey[:, 0].cpu().numpy()])
            for name, front in fronts.items():
                reading = front.read(frames, corners)
                wrong[name] += int(
                    ((front.values(*reading, "hard") >= 0) != truth).sum()
                )
                values = front.values(*reading, "scores")
                blocks[name] += combiners[name].push(values, stamps)
    for name, combiner in combiners.items():
        blocks[name] += combiner.finish()
    packets = {
        variant: decode(variant, blocks[variant.receiver], job, shown, key)
        for variant in variants_of(job.plan, config)
    }
    rates = {name: (errors, taken * shape.leds) for name, errors in wrong.items()}
    return RecordingResult(len(film) / rate_hz, taken, rates, packets)


def filmed(job: RecordingJob, film: Bools, key: BlockKey) -> Iterator[Recorded]:
    """Let the camera of a job take a film."""
    config, camera_config = job.config, job.config.record
    symbol_s = (1 + camera_config.drift) / config.signalling.symbol_rate_hz
    fps = job.ratio * config.signalling.symbol_rate_hz
    shutter = shutter_of(camera_config, fps, symbol_s, key)
    scene = job.model.draw(key, job.plan.world.panel.shape)[0][:1]
    with suppress(NoFrameLeftError):  # all its packets are lost
        yield from record(
            job.plan.world.simulator(),
            scene,
            torch.from_numpy(film),
            symbol_s,
            shutter,
            key,
            speed_m_s=camera_config.speed_m_s,
            window=camera_config.margin,
            batch=job.plan.batch_frames,
        )


def decode(
    variant: Variant,
    blocks: Sequence[Block],
    job: RecordingJob,
    shown: Bools,
    key: BlockKey,
) -> Packets:
    """Count which packets of a code arrive where every block shows ``shown``."""
    options = job.config.options(variant.code)
    layout = Layout(MessagePlan(job.plan.world.panel.shape, options))
    code = code_of(layout)
    text = key.generator("text").bytes(layout.packets * payload_bytes(code.info_bytes))
    words = encoded(code, packed(text, code.info_bytes))
    layout = layout.rescrambled(words, shown)
    arrived, false = set(), 0
    for block in blocks:
        for received in decoded(block, layout, code):
            if (packet := received.packet) is None:
                continue
            size = len(packet.payload)
            if packet.payload == text[packet.sequence * size :][:size]:
                arrived.add((block.number, received.place))
            else:
                false += 1
    sent = job.config.blocks * layout.packets
    return Packets(sent, max(0, sent - len(arrived)), false)


@dataclass(frozen=True)
class Carried:
    """What one variant carried at one point.

    Args:
        place: the point.
        variant: what carried it.
        lost: packets lost, of those sent, by recording: the counts' frames are recordings, its bits packets.
        raw: wrong bits of single frames, likewise by recording.
        kbit_s: of packets sent.
        frames: of the camera.
        false: packets whose checksum is right and which nobody sent.
    """

    place: SweepPoint
    variant: Variant
    lost: Counts
    raw: Counts
    kbit_s: float
    frames: int
    false: int

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


def counted(recordings: Iterable[tuple[int, int]]) -> Counts:
    """Count errors by recording, each with how many there were of how many.

    Example:
        >>> counted([(0, 4), (3, 4)]).ber
        0.375
    """
    counts = (Counts(1, of, 2 * n, 4 * n * n, int(n > 0)) for n, of in recordings)
    return sum(counts, Counts())


def carried(
    plan: Plan,
    config: MessagesConfig,
    place: SweepPoint,
    results: Sequence[RecordingResult],
) -> Iterator[Carried]:
    """Put the recordings of a point together."""
    for variant, (sent, _, _) in results[0].packets.items():
        options = config.options(variant.code)
        code = code_of(Layout(MessagePlan(plan.world.panel.shape, options)))
        kbit_s = 8e-3 * payload_bytes(code.info_bytes) * sent / results[0].seconds
        packets = [result.packets[variant] for result in results]
        wrong = [result.wrong[variant.receiver] for result in results]
        yield Carried(
            place,
            variant,
            counted((lost, sent) for _, lost, _ in packets),
            # Of a recording that lost all its frames nothing is known.
            counted(pair for pair in wrong if pair[1]),
            kbit_s,
            sum(result.frames for result in results),
            sum(false for _, _, false in packets),
        )
