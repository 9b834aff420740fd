"""What each receiver costs in time and makes in errors on the same frames."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from vocc_torch.errors import VoccError, demand_least, demand_word, whole_number
from vocc_torch.measure import curve, estimate, stage_times
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.train import Making
from vocc_torch.simulation.simulator import Framing
from vocc_torch.studies.compare import TradeoffConfig

FRAMINGS: Mapping[str, Framing] = {"whole": "filled", "crops": "crop"}
"""How frames are rendered that a receiver gets whole, or cut to the panel's surroundings."""


Rank = Literal["frontier", "perhaps", "beaten"]


@dataclass(frozen=True)
class TimingSettings:
    """How times are taken and judged."""

    least_frames: int = 48  # timed rounds meet at least so many, whatever the batch
    most_batch: int = 1024  # frames at a time
    busy_share: float = 0.05  # waiting from which times are said to be doubtful


TIMING = TimingSettings()


@dataclass(frozen=True, slots=True)
class Setting:
    """A receiver and what finds the panel for it.

    Args:
        receiver: what decides.
        locator: where the corners come from.
    """

    receiver: str
    locator: str

    @property
    def name(self) -> str:
        """A name that no other setting has, also for a folder."""
        return f"{self.receiver}-{self.locator}"


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
            whole_number("tradeoff.batch_sizes", batch, 1, TIMING.most_batch)
        demand_least("tradeoff.", config, repeats=1, threads=0)
        why = "task=tradeoff, which compares receivers on the same frames"
        self.plan.budget.demand_no_stop_rule(why)

    @property
    def settings(self) -> tuple[Setting, ...]:
        """Every receiver with every locator."""
        return tuple(
            Setting(name, locator)
            for locator in self.config.locators
            for name in self.plan.receiver.names
        )

    def rounds(self, batch: int) -> int:
        """Timed rounds with batches of a size."""
        return max(self.config.repeats, -(-TIMING.least_frames // batch))


@dataclass(frozen=True)
class OperatingPoint:
    """The time that a receiver takes, the errors that it makes, and whether another one beats it.

    Args:
        setting: the receiver.
        batch: frames at a time.
        time_ms: median time a frame with its quartiles, ms, above 0.
        ber: bit error rate with its 95 % interval; without errors its upper end is a limit. After several
            trainings it is the algorithm's.
        rank: ``frontier`` where no other is quicker and better, by medians and rates; ``beaten`` where one
            is so whose rate is lower beyond chance, else ``perhaps``.
    """

    setting: Setting
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
        return values != others and all(
            value <= limit for value, limit in zip(values, others, strict=True)
        )


def most_accurate(points: Sequence[OperatingPoint]) -> OperatingPoint | None:
    """Choose the lowest rate; of equal rates the interval's end decides, then the time."""

    def order(point: OperatingPoint) -> tuple[float, float, float]:
        return point.ber.value, point.ber.high, point.ms

    return min(points, key=order, default=None)


@dataclass(frozen=True)
class PriceList:
    """All that was measured.

    Args:
        study: what was compared.
        costs: what it took to train each setting.
        errors: of every setting by its name, at one value.
        times: the stages' times, by setting and batch.
        machine: what was measured on.
        waited_share: share of the time in which other work had the processor, 0 to 1.
    """

    study: TradeoffStudy
    costs: Mapping[Setting, Making]
    errors: curve.Curves
    times: Mapping[tuple[Setting, int], stage_times.StageTimes]
    machine: str
    waited_share: float = 0.0

    @property
    def frames(self) -> int:
        """Frames that errors were counted on."""
        return self.errors.total(self.study.settings[0].name).frames

    @property
    def batches(self) -> list[int]:
        """Batch sizes that were timed, ascending."""
        return sorted({batch for _, batch in self.times})

    def points(self, batch: int | None = None) -> list[OperatingPoint]:
        """Give every setting's operating point with batches of a size, or with its quickest ones."""
        points, rates = [], {row.receiver: row.rate for row in self.errors.table()}
        for setting in self.study.settings:
            totals = {
                size: self.times[setting, size].total
                for size in ([batch] if batch else self.batches)
            }
            best = min(totals, key=lambda size: totals[size].value)
            rate = rates[setting.name]
            points.append(OperatingPoint(setting, best, totals[best], rate))
        return ranked(points, self.errors)


def ranked(
    points: Sequence[OperatingPoint], errors: curve.Curves
) -> list[OperatingPoint]:
    """Say of each point whether another one beats it, and how surely.

    Args:
        points: in any order.
        errors: of every setting by its name, at one value.
    """
    pairs = estimate.all_pairs(len(points))
    confidence, (value,) = estimate.joint_confidence(pairs), errors.values
    found = []
    for point in points:
        # By intervals of all pairs that hold together at 95 %.
        surely = [
            errors.difference(
                point.setting.name, better.setting.name, value, confidence
            ).low
            > 0
            for better in points
            if better.beats(point)
        ]
        rank: Rank = "frontier"
        if surely:
            rank = "beaten" if any(surely) else "perhaps"
        found.append(replace(point, rank=rank))
    return found
