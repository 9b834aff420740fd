"""What each effect costs and does: times of frames, and bit errors with and without it on the same frames."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.paired import DifferenceInterval, PairedCounts, paired_interval
from vocc_torch.measure.tally import tallies
from vocc_torch.measure.timing import Timing, quartiles

READINGS = ("true_corners", "retrained", "located")
"""How the bits are read: at the simulator's corners by a receiver that never met the effect; the same by one
that trained with it; and by the first where the paper's locator finds the panel."""


@dataclass(frozen=True, slots=True)
class Cost:
    """Time of a frame, or what something adds to it, round by round.

    Args:
        rounds_ms: a time a frame for each round, ms; at least one.

    Raises:
        VoccError: no round.

    Example:
        >>> cost = Cost((3.0, 1.0, 2.0))
        >>> cost.low_ms, cost.median_ms, cost.high_ms, cost.shown
        (1.5, 2.0, 2.5, True)
    """

    rounds_ms: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse a cost that was never measured."""
        if not self.rounds_ms:
            raise VoccError("rounds_ms is empty: a cost needs at least one round")

    @classmethod
    def of(cls, timing: Timing, frames: int) -> Cost:
        """Give the time a frame of calls that render ``frames`` frames each."""
        return cls(tuple(1000 * seconds / frames for seconds in timing.seconds))

    def __sub__(self, other: Cost) -> Cost:
        """Compare within each round, since a busy spell of the machine meets both."""
        return Cost(tuple(a - b for a, b in zip(self.rounds_ms, other.rounds_ms, strict=True)))

    def __add__(self, other: Cost) -> Cost:
        """Add within each round."""
        return Cost(tuple(a + b for a, b in zip(self.rounds_ms, other.rounds_ms, strict=True)))

    @property
    def median_ms(self) -> float:
        """Median, ms."""
        return quartiles(self.rounds_ms)[1]

    @property
    def low_ms(self) -> float:
        """Lower quartile, ms."""
        return quartiles(self.rounds_ms)[0]

    @property
    def high_ms(self) -> float:
        """Upper quartile, ms."""
        return quartiles(self.rounds_ms)[2]

    @property
    def shown(self) -> bool:
        """Whether the quartiles leave out 0: what they do not cannot be told from nothing."""
        return self.low_ms > 0 or self.high_ms < 0


@dataclass(frozen=True, slots=True)
class Change:
    """Bit errors with and without something, on the same frames.

    Args:
        present: errors with it.
        absent: errors without it.
        paired: the two compared frame by frame, ``present`` as a.
        located: whether a locator found the panels, which may lose one and with it half of a frame's bits.

    Example:
        >>> halves = np.array([[4, 2, 0], [0, 2, 0]])
        >>> change = Change.of(halves[0], halves[1], np.array([True, True, True]), np.ones(3, bool), 64)
        >>> change.present.bit_errors, change.absent.bit_errors, round(change.difference, 5)
        (3.0, 1.0, 0.01042)
    """

    present: Counts
    absent: Counts
    paired: PairedCounts
    located: bool = False

    @classmethod
    def of(
        cls,
        present: NDArray[np.int64],
        absent: NDArray[np.int64],
        found: NDArray[np.bool_],
        found_absent: NDArray[np.bool_],
        bits_per_frame: int,
        *,
        located: bool = False,
    ) -> Change:
        """Count and compare the half errors of N frames.

        Args:
            present: (N,) wrong bits times two with it.
            absent: (N,) the same without it.
            found: (N,) whether the panel was found with it.
            found_absent: (N,) the same without it.
            bits_per_frame: at least 1.
            located: whether a locator found the panels.

        Raises:
            VoccError: arrays that do not belong together.
        """
        if not len(present) == len(absent) == len(found) == len(found_absent):
            sizes = [len(part) for part in (present, absent, found, found_absent)]
            raise VoccError(f"present, absent and found have {sizes} frames: they must be the same")
        halves, hits = np.stack([present, absent]), np.stack([found, found_absent])
        (first, second), pairs = tallies(halves, bits_per_frame, hits)
        return cls(first, second, pairs[0, 1], located)

    @property
    def difference(self) -> float:
        """Bit error rate with it less that without it."""
        return self.paired.difference

    @property
    def interval(self) -> DifferenceInterval:
        """The difference with its 95 % interval, frames as the independent units."""
        # Where panels are located, the frame that has not come yet may be one whose panel is lost.
        lost = self.present.bits / self.present.frames / 2
        return paired_interval(self.paired, errors_per_discordant_frame=lost if self.located else 1.0)

    @property
    def frames(self) -> int:
        """Frames compared."""
        return self.paired.frames


@dataclass(frozen=True)
class EffectRow:
    """What one effect costs and does where the rest of the scene stays as it is.

    Args:
        name: the effect, as a scene names it.
        group: what it belongs to, such as optics.
        settings: its parameters, as text.
        own: the effects in which the two scenes differ: itself, and what cannot stand without it.
        companions: effects that both scenes have because it needs them, though the study's scene names none.
        in_scene: whether the scene names it already, so that it was taken away for the comparison.
        fills_sensor: whether frames must be rendered whole for a locator because of it.
        near: added to the rendering of the panel's surroundings, which true corners need, ms a frame.
        located: added to the rendering of what a locator needs, ms a frame: crops stay crops until an effect
            fills the sensor, and what that costs is in it.
        whole: added to the rendering of frames that are whole from the start, ms a frame.
        changes: by reading and receiver.
    """

    name: str
    group: str
    settings: str
    own: tuple[str, ...]
    companions: tuple[str, ...]
    in_scene: bool
    fills_sensor: bool
    near: Cost
    located: Cost
    whole: Cost
    changes: Mapping[str, Mapping[str, Change]]

    @property
    def label(self) -> str:
        """The names of what it is about."""
        return " + ".join(self.own) if self.name in self.own else self.name

    def change(self, reading: str, receiver: str) -> Change | None:
        """Give what the effect does to a receiver; None where that was not measured."""
        return self.changes.get(reading, {}).get(receiver)


@dataclass(frozen=True)
class EffectTable:
    """Every effect one at a time, and all together.

    Args:
        scene: name of the scene; empty for one without.
        rows: the effects in physical order.
        together: all those that the scene does not name, at once.
        base_near: the scene itself, the panel's surroundings, ms a frame.
        base_located: the scene itself as a locator needs it, ms a frame.
        base_whole: the scene itself, rendered whole from the start, ms a frame.
        base: errors in the scene itself, by locator and receiver.
        receivers: names in the order of the results.
        shown: the receiver that tables and figures show.
        training_frames: frames that each receiver trained on.
        machine: what the times were measured on.
        waited_share: share of the timing during which this process did not have the processor, 0 to 1.
        frames_a_call: frames rendered in a timed call, near the panel and whole.
    """

    scene: str
    rows: tuple[EffectRow, ...]
    together: EffectRow | None
    base_near: Cost
    base_located: Cost
    base_whole: Cost
    base: Mapping[str, Mapping[str, Counts]]
    receivers: tuple[str, ...]
    shown: str
    training_frames: int
    machine: str
    waited_share: float
    frames_a_call: tuple[int, int]

    @property
    def added(self) -> tuple[EffectRow, ...]:
        """The effects that the scene does not name."""
        return tuple(row for row in self.rows if not row.in_scene)

    @property
    def sum_near(self) -> Cost | None:
        """Sum of what the added effects cost alone near the panel; None where there is none."""
        return _sum([row.near for row in self.added])

    @property
    def sum_located(self) -> Cost | None:
        """What a locator's frames cost with all added effects if costs add; None where there is none.

        Frames become whole once, whatever the number of effects that fill the sensor. With all effects they
        are whole from the start, so the costs that add are those of frames that are whole from the start.
        """
        if not any(row.fills_sensor for row in self.added):
            return _sum([row.located for row in self.added])
        return _sum([self.base_whole - self.base_located, *(row.whole for row in self.added)])


def _sum(costs: Sequence[Cost]) -> Cost | None:
    """Add costs within each round; None where there is none."""
    return functools.reduce(Cost.__add__, costs) if costs else None


@dataclass(frozen=True)
class SeverityPoint:
    """Errors at one severity.

    Args:
        value: the parameter's value.
        errors: by reading (``true_corners`` or ``retrained``) and receiver.
    """

    value: float
    errors: Mapping[str, Mapping[str, Counts]]


@dataclass(frozen=True)
class SeverityCurve:
    """Bit error rate over the severity of one effect, true corners.

    Args:
        name: the effect.
        parameter: what varies, as ``effect.parameter``.
        points: from harmless to harsh.
        usual: the parameter's value in the table of effects, where it is a number.
    """

    name: str
    parameter: str
    points: tuple[SeverityPoint, ...]
    usual: float | None
