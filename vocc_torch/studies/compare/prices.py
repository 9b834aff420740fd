"""What each receiver costs in time and makes in errors on the same frames, and which one to take."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from vocc_torch.errors import VoccError, demand_least, demand_word, whole_number
from vocc_torch.measure import estimate
from vocc_torch.measure.curve import Curves
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.stage_times import StageTimes
from vocc_torch.measure.train import Making
from vocc_torch.report import styles
from vocc_torch.report.terminal import rate_texts
from vocc_torch.simulation.simulator import Framing
from vocc_torch.studies.compare import TradeoffConfig

FRAMINGS: Mapping[str, Framing] = {"whole": "filled", "crops": "crop"}
"""How frames are rendered that a receiver gets whole, or cut to the panel's surroundings."""

Rank = Literal["frontier", "perhaps", "beaten"]


@dataclass(frozen=True)
class PriceSettings:
    """How times are taken and judged, and what is recommended for."""

    least_frames: int = 48  # timed rounds meet at least so many, whatever the batch
    most_batch: int = 1024  # frames at a time
    busy_share: float = 0.05  # waiting from which times are said to be doubtful
    frames_per_s: tuple[int, ...] = (1000, 100, 60, 30)  # rates of cameras
    rates: tuple[float, ...] = (1e-2, 1e-3, 1e-4, 1e-5)  # bit error rates
    columns: int = 110  # of a line of words


SETTINGS = PriceSettings()


def setting_name(key: Key) -> str:
    """Name a receiver with its locator as no other is named, also for a folder."""
    return f"{key.receiver}-{key.locator}"


def setting_words(key: Key) -> str:
    """Name a receiver and what finds the panel for it, for people."""
    label = styles.receiver_styles([key.receiver])[key.receiver].label
    return f"{label}, {styles.LOCATED[key.locator]}"


@dataclass(frozen=True)
class TradeoffStudy:
    """A study of what accuracy costs in time.

    Args:
        plan: world, receivers and budget; its experiment has no part in it.
        config: the study's section of the configuration.
        scene_name: what results call the scene.
        left_out: receivers that were asked for and cannot be built here, and why.

    Raises:
        VoccError: a value outside its range or an unknown name.
    """

    plan: Plan
    config: TradeoffConfig
    scene_name: str = ""
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check every list and every number, before any work is done."""
        config = self.config
        for name in ("locators", "batch_sizes"):
            if not getattr(config, name):
                raise VoccError(
                    f"tradeoff.{name} is empty: it must hold at least one value"
                )
        self.plan.receiver.demand_locators("tradeoff.locators", config.locators)
        demand_word("tradeoff.frames", config.frames, FRAMINGS)
        for batch in config.batch_sizes:
            whole_number("tradeoff.batch_sizes", batch, 1, SETTINGS.most_batch)
        demand_least("tradeoff.", config, repeats=1, threads=0)
        why = "task=tradeoff, which compares receivers on the same frames"
        self.plan.budget.demand_no_stop_rule(why)

    @property
    def keys(self) -> list[Key]:
        """Every receiver with every locator."""
        return [
            Key(locator, name)
            for locator in self.config.locators
            for name in self.plan.receiver.names
        ]


@dataclass(frozen=True)
class OperatingPoint:
    """The time that a receiver takes, the errors that it makes, and whether another one beats it.

    Args:
        key: the receiver and its locator.
        batch: frames at a time.
        time_ms: median time a frame with its quartiles, ms, above 0.
        ber: bit error rate with its 95 % interval; without errors its upper end is a limit. After several
            trainings it is the algorithm's.
        rank: ``frontier`` where no other is quicker and better, by medians and rates; ``beaten`` where one
            is so whose rate is lower beyond chance, else ``perhaps``.
    """

    key: Key
    batch: int
    time_ms: estimate.Estimate
    ber: estimate.Estimate
    rank: Rank = "frontier"

    @property
    def ms(self) -> float:
        """Median time a frame, ms."""
        return self.time_ms.value

    def beats(self, other: "OperatingPoint") -> bool:
        """Whether it is no slower and no worse, and better in one."""
        values, others = (self.ms, self.ber.value), (other.ms, other.ber.value)
        return values != others and values[0] <= others[0] and values[1] <= others[1]

    def __str__(self) -> str:
        """Write receiver, rate and time."""
        rate, interval = rate_texts(self.ber)
        bounds = f" ({interval})" if interval else ""
        time = styles.number_text(self.ms)
        return f"{setting_words(self.key)}: BER {rate}{bounds}, {time} ms"


@dataclass(frozen=True)
class PriceList:
    """All that was measured.

    Args:
        study: what was compared.
        costs: what it took to train each receiver.
        errors: of every receiver by its :func:`setting_name`, at one value.
        times: the stages' times, by receiver and batch.
        machine: what was measured on.
        waited_share: share of the time in which other work had the processor, 0 to 1.
    """

    study: TradeoffStudy
    costs: Mapping[Key, Making]
    errors: Curves
    times: Mapping[tuple[Key, int], StageTimes]
    machine: str
    waited_share: float = 0.0

    @property
    def frames(self) -> int:
        """Frames that errors were counted on."""
        return self.errors.total(self.errors.receivers[0]).frames

    def points(self, *batches: int) -> list[OperatingPoint]:
        """Give every receiver's operating point with the quickest of some batches; of all by default."""
        rates = {row.receiver: row.rate for row in self.errors}
        points = []
        for key in self.study.keys:
            totals = {
                batch: self.times[key, batch].total
                for batch in batches or self.study.config.batch_sizes
            }
            best = min(totals, key=lambda batch: totals[batch].value)
            rate = rates[setting_name(key)]
            points.append(OperatingPoint(key, best, totals[best], rate))
        return ranked(points, self.errors)

    def conditions(self) -> str:
        """Say what the prices rest on."""
        study = self.study
        handed = "whole frames" if study.config.frames == "whole" else "crops"
        text = (
            f"{self.frames} frames of the scene {study.scene_name}, the same for all;"
            f" times on {handed} in each receiver's best batch; {self.machine}."
        )
        if self.waited_share >= SETTINGS.busy_share:
            share = 100 * self.waited_share
            text += f" Other work had the processor for {share:.0f} % of the time."
        return text


def ranked(points: Sequence[OperatingPoint], errors: Curves) -> list[OperatingPoint]:
    """Say of each point whether another one beats it, and how surely.

    Args:
        points: in any order.
        errors: of every receiver by its :func:`setting_name`, at one value.
    """
    # By intervals of all pairs that hold together at 95 %.
    confidence = estimate.joint_confidence(estimate.all_pairs(len(points)))
    (value,), found = errors.values, []
    for point in points:
        rank: Rank = "frontier"
        for better in points:
            if better.beats(point):
                pair = setting_name(point.key), setting_name(better.key)
                surely = errors.difference(*pair, value, confidence).low > 0
                rank = "beaten" if surely or rank == "beaten" else "perhaps"
        found.append(replace(point, rank=rank))
    return found


def recommendation(prices: PriceList) -> str:
    """Say which receiver to take within a time, and below a bit error rate.

    A receiver keeps within a time where its upper quartile does, and below a rate where its whole interval
    does. Of equal rates the interval's end decides, then the time.
    """
    points = prices.points()
    best = sorted(points, key=lambda point: (point.ber.value, point.ber.high, point.ms))
    quick = sorted(points, key=lambda point: (point.ms, point.ber.value))
    lines = [prices.conditions()]
    for speed in SETTINGS.frames_per_s:
        limit_ms = 1e3 / speed
        taken = next((point for point in best if point.time_ms.high <= limit_ms), None)
        answer = f"take {taken}" if taken else f"none; the quickest is {quick[0]}"
        lines.append(f"Within {styles.number_text(limit_ms)} ms a frame: {answer}.")
    nearest = min(points, key=lambda point: (point.ber.high, point.ms))
    for rate in SETTINGS.rates:
        taken = next((point for point in quick if point.ber.high < rate), None)
        none = f"no receiver surely is; the best is {nearest}"
        answer = f"take {taken}" if taken else none
        lines.append(f"For a BER below {styles.rate_text(rate)}: {answer}.")
        if not taken:
            break
    for name, why in prices.study.left_out.items():
        lines.append(f"Left out: {name}, since {why}.")
    return "\n".join(textwrap.fill(line, SETTINGS.columns) for line in lines) + "\n"
