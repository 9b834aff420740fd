"""Recordings of many points, each read by every receiver, and what arrives of every code in it."""

import time
from collections import defaultdict
from collections.abc import Hashable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.codes import code_of
from vocc_torch.extras.messages.combine import Block, Combiner
from vocc_torch.extras.messages.config import AXES, MessagesConfig
from vocc_torch.extras.messages.front import Front
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import packed, payload_bytes
from vocc_torch.extras.messages.reception import decoded
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.train import Training, calibrated_receiver
from vocc_torch.receiver.bank import GREYSCALE_RECEIVERS
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.simulation.recording import NoFrameLeftError, Recorded, Shutter, record
from vocc_torch.simulation.scene import narrowed


class Variant(NamedTuple):
    """What carries a message: a receiver, its soft values, whether packets are interleaved, and the code."""

    receiver: str
    soft: str
    interleave: bool
    code: str


class SweepPoint(NamedTuple):
    """A point: what is varied, and its value there."""

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
        scene = narrowed(scene, {"distance_m": self.config.at_distance_m}, "messages.at")
        varied = {} if self.place.axis == "ratio" else {self.place.axis: self.place.value}
        return narrowed(scene, varied, "messages")

    @property
    def ratio(self) -> float:
        """Frames of the camera a symbol."""
        return self.place.value if self.place.axis == "ratio" else self.config.at_ratio


@dataclass
class RecordingResult:
    """What came of one recording.

    Args:
        lost: packets that did not arrive, by what carried them.
        sent: packets sent, likewise.
        seconds: the recording's length.
        frames: of the camera.
        wrong: wrong bits in single frames by receiver, and how many bits there were.
        spent_s: processor time to locate and read frames by receiver, to add symbols up by receiver and kind
            of soft values, and to decode by variant.
        false: packets that a checksum vouched for and nobody sent.
    """

    lost: dict[Variant, int] = field(default_factory=dict)
    sent: dict[Variant, int] = field(default_factory=dict)
    seconds: float = 0.0
    frames: int = 0
    wrong: dict[str, tuple[int, int]] = field(default_factory=dict)
    spent_s: dict[Hashable, float] = field(default_factory=partial(defaultdict, float))
    false: dict[Variant, int] = field(default_factory=partial(defaultdict, int))


def variants_of(plan: Plan, config: MessagesConfig) -> list[Variant]:
    """Name all that is compared.

    Raises:
        VoccError: a receiver that needs preambles, of which a message has none.
    """
    if greyscale := [name for name in plan.receiver.names if name in GREYSCALE_RECEIVERS]:
        raise VoccError(f"receiver.names has {greyscale[0]}: it needs preambles, which messages do not send")
    names = product(plan.receiver.names, config.soft, config.interleave, config.codes)
    return [Variant(*one) for one in names]


def jobs_of(plan: Plan, config: MessagesConfig, receivers: Mapping[str, Receiver]) -> list[RecordingJob]:
    """List all recordings."""
    places = [SweepPoint(axis, value) for axis in AXES for value in getattr(config, axis)]
    return [
        RecordingJob(plan, config, place, n, receivers) for place in places for n in range(config.recordings)
    ]


def receivers_of(plan: Plan, training: Training) -> dict[str, Receiver]:
    """Put the named receivers together, with what finds the panel."""
    (locator,) = plan.receiver.finders([plan.receiver.locator]).values()
    made = {}
    for name in plan.receiver.names:
        own = replace(plan, receiver=replace(plan.receiver, save=name, locator="truth"))
        made[name] = calibrated_receiver(own, training)
        if locator is not None:
            made[name].locator = locator
    return made


def recorded(job: RecordingJob) -> RecordingResult:
    """Take a recording, read it with every receiver and decode it as every code.

    One random block is shown over and over. For each code the scrambling is the one by which that block holds
    its packets, so all of them are compared on the same frames.
    """
    plan, config = job.plan, job.config
    shape, rate_hz = plan.world.panel.shape, config.signalling.symbol_rate_hz
    key = BlockKey(plan.seed, f"messages/{job.place.axis}={job.place.value:g}", job.number)
    base = Layout(MessagePlan(shape, config.options("none")))
    random = key.generator("bits").integers(2, size=(base.packets, base.word_bits), dtype=np.uint8)
    shown = base.write(random)
    film = np.tile(shown, (config.blocks, 1, 1))
    done = RecordingResult(seconds=len(film) / rate_hz)
    fronts = {name: Front(receiver) for name, receiver in job.receivers.items()}
    leader, variants = next(iter(fronts.values())), variants_of(plan, config)
    combiners = {(one.receiver, one.soft): Combiner(base) for one in variants}
    blocks: dict[tuple[str, str], list[Block]] = {one: [] for one in combiners}
    wrong = dict.fromkeys(fronts, 0)
    for part in filmed(job, film, key):
        stamps = [(done.frames + i) / (job.ratio * rate_hz) for i in range(len(part.symbols))]
        done.frames += len(stamps)
        truth = film[np.clip([number or 0 for number in part.symbols], 0, len(film) - 1)]
        with torch.inference_mode():
            begun = time.process_time()
            frames, corners = leader.locate([*part.frames.grey[:, 0].cpu().numpy()])
            located_s = time.process_time() - begun
            for name, front in fronts.items():
                begun = time.process_time()
                read = front.read(frames, corners)
                bits = front.values(*read, "hard")
                done.spent_s[name] += located_s + time.process_time() - begun
                wrong[name] += int(((bits >= 0) != truth).sum())
                for soft in config.soft:
                    begun = time.process_time()
                    blocks[name, soft] += combiners[name, soft].push(front.values(*read, soft), stamps)
                    done.spent_s[name, soft] += time.process_time() - begun
    for of, combiner in combiners.items():
        begun = time.process_time()
        blocks[of] += combiner.finish()
        done.spent_s[of] += time.process_time() - begun
    done.wrong = {name: (count, done.frames * shape.leds) for name, count in wrong.items()}
    for one in variants:
        begun = time.process_time()
        decode(done, one, blocks[one.receiver, one.soft], job, shown, key)
        done.spent_s[one] += time.process_time() - begun
    return done


def filmed(job: RecordingJob, film: NDArray[np.bool_], key: BlockKey) -> Iterator[Recorded]:
    """Let the camera of a job take a film."""
    config, own = job.config, job.config.record
    symbol_s = (1 + own.drift) / config.signalling.symbol_rate_hz
    fps = job.ratio * config.signalling.symbol_rate_hz
    start_s = float(key.generator("start").random()) * symbol_s
    shutter = Shutter(fps, start_s, own.readout_s, own.dropped, own.repeated, own.black, own.burst_frames)
    scene = job.model.draw(key, job.plan.world.panel.shape)[0][:1]
    with suppress(NoFrameLeftError):  # all its packets are lost
        yield from record(
            job.plan.world.simulator(),
            scene,
            torch.from_numpy(film),
            symbol_s,
            shutter,
            key,
            speed_m_s=own.speed_m_s,
            window=own.margin,
            batch=job.plan.batch_frames,
        )


def decode(
    done: RecordingResult,
    of: Variant,
    blocks: Sequence[Block],
    job: RecordingJob,
    shown: NDArray[np.bool_],
    key: BlockKey,
) -> None:
    """Note which packets of a code arrive where every block shows ``shown``."""
    layout = Layout(MessagePlan(job.plan.world.panel.shape, job.config.options(of.code, of.interleave)))
    code = code_of(layout)
    text = key.generator("text").bytes(layout.packets * payload_bytes(code.info_bytes))
    infos = list(packed(text, code.info_bytes))
    words = code.encode(np.stack([np.frombuffer(info, np.uint8) for info in infos]))
    layout = layout.rescrambled(words, shown)
    done.sent[of] = job.config.blocks * layout.packets
    arrived = set()
    for block in blocks:
        for got in decoded(block, layout, code):
            if got.packet is None:
                continue
            size = len(got.packet.payload)
            if got.packet.payload == text[got.packet.sequence * size :][:size]:
                arrived.add((block.number, got.place))
            else:
                done.false[of] += 1
    done.lost[of] = max(0, done.sent[of] - len(arrived))


@dataclass(frozen=True)
class Carried:
    """What one variant carried at one point.

    Args:
        place: the point.
        variant: what carried it.
        lost: packets lost, of those sent, by recording: the counts' frames are recordings, its bits packets.
        raw: wrong bits of single frames, likewise by recording.
        each: packets lost in each recording.
        payload_bits: of a packet.
        packets_s: packets sent a second.
        frames: of the camera.
        read_ms: processor time from a frame to the sums of its symbols, ms.
        decode_ms: to decode a packet, ms.
        false: packets that were vouched for and never sent.
    """

    place: SweepPoint
    variant: Variant
    lost: Counts
    raw: Counts
    each: tuple[int, ...]
    payload_bits: int
    packets_s: float
    frames: int
    read_ms: float
    decode_ms: float
    false: int

    @property
    def loss(self) -> Estimate:
        """Share of the packets that were lost, with its 95 % interval; a recording's packets err together."""
        return ber_interval(self.lost)

    @property
    def goodput(self) -> Estimate:
        """What arrives, kbit/s."""
        loss, full = self.loss, 1e-3 * self.payload_bits * self.packets_s
        return Estimate(full * (1 - loss.value), full * (1 - loss.high), full * (1 - loss.low))


def counted(wrong: Sequence[int], of: int | Sequence[int]) -> Counts:
    """Count errors by recording, of as many in each, or of each its own.

    Example:
        >>> counted([0, 3], 4).ber
        0.375
    """
    halves = [2 * one for one in wrong]
    squares, erring = sum(one * one for one in halves), sum(one > 0 for one in wrong)
    every = of * len(wrong) if isinstance(of, int) else sum(of)
    return Counts(len(wrong), every, sum(halves), squares, erring)


def carried(
    plan: Plan, config: MessagesConfig, place: SweepPoint, outcomes: Sequence[RecordingResult]
) -> Iterator[Carried]:
    """Put the recordings of a point together."""
    frames = sum(one.frames for one in outcomes)
    for variant in outcomes[0].lost:
        layout = Layout(MessagePlan(plan.world.panel.shape, config.options(variant.code, variant.interleave)))
        bits, lost = 8 * payload_bytes(code_of(layout).info_bytes), [one.lost[variant] for one in outcomes]
        sent, wrong = outcomes[0].sent[variant], [one.wrong[variant.receiver] for one in outcomes]
        seen = [one for one in wrong if one[1]]  # of a recording that lost all its frames nothing is known
        parts = variant.receiver, variant[:2], variant
        spent = [sum(one.spent_s[of] for one in outcomes) for of in parts]
        yield Carried(
            place,
            variant,
            counted(lost, sent),
            counted([errors for errors, _ in seen], [bits for _, bits in seen]),
            tuple(lost),
            bits,
            sent / outcomes[0].seconds,
            frames,
            1e3 * (spent[0] + spent[1]) / max(1, frames),
            1e3 * spent[2] / (sent * len(outcomes)),
            sum(one.false[variant] for one in outcomes),
        )


def pairs(results: Sequence[Carried]) -> Iterator[tuple[Carried, Carried, PairedCounts]]:
    """Compare what differs in one thing alone, on the same recordings: first less second."""
    for a, b in combinations(results, 2):
        unlike = [x != y for x, y in zip(a.variant, b.variant, strict=True)]
        if a.place != b.place or sum(unlike) != 1:
            continue
        apart = [2 * (x - y) for x, y in zip(a.each, b.each, strict=True)]
        sides = [[one for one in apart if one > 0], [-one for one in apart if one < 0]]
        told = [number for side in sides for number in (sum(side), sum(x * x for x in side), len(side))]
        yield a, b, PairedCounts(a.lost.frames, a.lost.bits, *told)
