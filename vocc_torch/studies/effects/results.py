"""What each effect costs in time and does to the bit error rate, put together."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vocc_torch.measure import stage_times
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.plan import Locator
from vocc_torch.simulation.effects import build_effects
from vocc_torch.studies.effects.plan import EffectStudy, Key, ScenePair, fills, group_of

KINDS = ("near", "located", "whole")
"""What is rendered: the panel's surroundings, what a locator needs, or whole frames from the start."""

READINGS: dict[str, Locator] = {
    "true_corners": "truth",
    "retrained": "truth",
    "located": "paper",
}
"""How the bits are read, and the locator: at the true corners by a receiver that never met the effect; the
same by one that trained with it; and by the first where the paper's locator finds the panel."""

Rounds = NDArray[np.float64]
"""Time a frame, or what something adds to it, round by round, ms."""


@dataclass(frozen=True)
class Costs:
    """Times of all scenes.

    Args:
        times: ms a frame round by round, by kind and scene.
        machine: what was measured on.
        waited_share: share of the timing during which this process did not have the processor, 0 to 1.
    """

    times: Mapping[tuple[str, Key], Rounds]
    machine: str
    waited_share: float

    def added(self, kind: str, pair: ScenePair) -> Rounds:
        """Return what an effect adds, within each round, since a busy spell of the machine meets both."""
        present, absent = build_effects(pair.present), build_effects(pair.absent)
        # Without an effect that fills the sensor a locator gets the very crops.
        kind = "near" if kind == "located" and not fills(present) else kind
        return self.times[kind, present] - self.times[kind, absent]


class Change(NamedTuple):
    """Bit errors with and without an effect, on the same frames.

    Args:
        present: errors with it.
        absent: errors without it.
        estimate: bit error rate with it less that without it, with its 95 % interval, frames as the units.
    """

    present: Counts
    absent: Counts
    estimate: Estimate


@dataclass(frozen=True)
class EffectRow:
    """What one effect costs and does where the rest of the scene stays as it is.

    Args:
        pair: the scenes with and without it.
        costs: added time a frame, by kind.
        changes: by reading and receiver, as far as they were measured.
    """

    pair: ScenePair
    costs: Mapping[str, Rounds]
    changes: Mapping[tuple[str, str], Change]

    @property
    def group(self) -> str:
        """What it belongs to, such as optics; empty for many together."""
        return (
            group_of(self.pair.name, self.pair.order)
            if self.pair.name in self.pair.own
            else ""
        )

    @property
    def label(self) -> str:
        """The names of what it is about."""
        return " + ".join(self.pair.own) if self.group else self.pair.name

    @property
    def fills_sensor(self) -> bool:
        """Whether frames must be rendered whole for a locator because of it."""
        built = build_effects(self.pair.present)
        return fills(tuple(effect for effect in built if effect.name in self.pair.own))

    @property
    def settings(self) -> str:
        """Its parameters as they were given; empty for many together."""
        given = self.pair.present[self.pair.name] if self.group else {}
        return ", ".join(f"{name}={_text(value)}" for name, value in given.items())


def _text(value: object) -> str:
    """Write a parameter: a number, or a distribution with its numbers."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_text, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


SeverityErrors = Mapping[tuple[float, str, str], Counts]
"""Errors at the true corners, by severity, reading (``true_corners`` or ``retrained``) and receiver."""


@dataclass(frozen=True)
class EffectResults:
    """Every effect one at a time, all together, and over their severity.

    Args:
        study: what was measured.
        rows: the effects in physical order.
        together: all those that the scene does not name, at once.
        costs: the times.
        base: errors in the scene itself, by locator and receiver.
        severities: over the severity of each effect that has one, from harmless to harsh, in physical order.
    """

    study: EffectStudy
    rows: tuple[EffectRow, ...]
    together: EffectRow | None
    costs: Costs
    base: Mapping[tuple[Locator, str], Counts]
    severities: Mapping[str, SeverityErrors] = field(default_factory=dict)

    @property
    def every_row(self) -> tuple[EffectRow, ...]:
        """The effects, and all together where there is that."""
        return (*self.rows, self.together) if self.together else self.rows

    @property
    def readings(self) -> list[str]:
        """The readings that any effect has."""
        known = {place for row in self.every_row for place in row.changes}
        return [one for one in READINGS if (one, self.study.shown) in known]

    def frames(self, reading: str) -> list[int]:
        """The numbers of frames that effects were read on."""
        shown = (row.changes.get((reading, self.study.shown)) for row in self.every_row)
        return sorted({change.present.frames for change in shown if change})

    def base_counts(self, receiver: str) -> dict[str, Counts]:
        """A receiver's errors in the scene itself, by reading; retraining has no meaning there."""
        found = {
            one: self.base.get((READINGS[one], receiver))
            for one in ("true_corners", "located")
        }
        return {
            reading: counts for reading, counts in found.items() if counts is not None
        }

    @functools.cached_property
    def base_costs(self) -> dict[str, Rounds]:
        """The scene itself, ms a frame, by kind."""
        return {
            kind: self.costs.times[kind, build_effects(self.study.scene)]
            for kind in KINDS
        }

    @functools.cached_property
    def sums(self) -> dict[str, Rounds]:
        """What the added effects cost alone, near the panel and for a locator, summed; empty without any.

        Frames become whole once, whatever the number of effects that fill the sensor. With all effects they
        are whole from the start, so the costs that add are those of frames that are whole from the start.
        """
        added = [row for row in self.rows if not row.pair.in_scene]
        if not added:
            return {}
        located = [row.costs["located"] for row in added]
        if any(row.fills_sensor for row in added):
            to_whole = self.base_costs["whole"] - self.base_costs["located"]
            located = [to_whole, *(row.costs["whole"] for row in added)]
        return {
            "near": np.sum([row.costs["near"] for row in added], 0),
            "located": np.sum(located, 0),
        }

    @property
    def ratios(self) -> list[float] | None:
        """The cost of all together over the sum of the single costs, near the panel and for a locator.

        None where there are no two, or where a sum cannot be told from nothing.
        """
        alone = {
            kind: stage_times.median_of(rounds) for kind, rounds in self.sums.items()
        }
        single = sum(not row.pair.in_scene for row in self.rows) < 2
        if (
            self.together is None
            or single
            or min(one.low for one in alone.values()) <= 0
        ):
            return None
        both = self.together.costs
        return [
            stage_times.median_of(both[kind]).value / one.value
            for kind, one in alone.items()
        ]
