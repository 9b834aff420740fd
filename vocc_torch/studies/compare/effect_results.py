"""What each effect costs in time and does to the bit error rate, put together."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.paired import paired_interval
from vocc_torch.measure.plan import Locator
from vocc_torch.simulation.effects import build_effects
from vocc_torch.studies.compare.effect_plan import (
    Effects,
    EffectStudy,
    Key,
    ScenePair,
    fills,
)

KINDS = ("near", "located")
"""What is rendered: the panel's surroundings, or what a locator needs."""

READINGS: dict[str, Locator] = {
    "true_corners": "truth",
    "retrained": "truth",
    "located": "paper",
}
"""How the bits are read, and the locator: at the true corners by a receiver that never met the effect; the
same by one that trained with it; and by the first where the paper's locator finds the panel."""

Rounds = NDArray[np.float64]
"""Time a frame, or what something adds to it, round by round, ms."""

SeverityErrors = Mapping[tuple[float, str, str], Counts]
"""Errors at the true corners, by severity, reading (``true_corners`` or ``retrained``) and receiver."""


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
    """What one effect costs and does where everything else in the scene stays as it is.

    Args:
        pair: the scenes with and without it.
        costs: added time a frame, by kind.
        changes: by reading and receiver, as far as they were measured.
    """

    pair: ScenePair
    costs: Mapping[str, Rounds]
    changes: Mapping[tuple[str, str], Change]

    def estimate(self, reading: str, receiver: str) -> Estimate | None:
        """Give the change of a receiver's bit error rate; None where it was not measured."""
        change = self.changes.get((reading, receiver))
        return change.estimate if change else None

    @property
    def label(self) -> str:
        """The names of what it is about."""
        pair = self.pair
        return " + ".join(pair.differing) if pair.name in pair.differing else pair.name

    @property
    def fills_sensor(self) -> bool:
        """Whether frames must be rendered whole for a locator because of it."""
        names = self.pair.differing
        built = build_effects(self.pair.present)
        return fills(tuple(effect for effect in built if effect.name in names))


@dataclass(frozen=True)
class SceneErrors:
    """Errors in every scene that was read.

    Args:
        study: the study.
        errors: by scene and locator; a row a receiver, those of one training scene after another.
        trained_on: the training scenes, in that order.
    """

    study: EffectStudy
    errors: Mapping[tuple[Key, Locator], FrameErrors]
    trained_on: Mapping[tuple[Key, Locator], list[Key]]

    def of(
        self, scene: Effects, locator: Locator, trained_on: Effects, frames: int
    ) -> FrameErrors:
        """Return the errors in the first frames of a scene by receivers of one training, a row a receiver."""
        place = build_effects(scene), locator
        count = len(self.study.plan.receiver.names)
        first = count * self.trained_on[place].index(build_effects(trained_on))
        return self.errors[place].of(slice(first, first + count), slice(frames))

    def changes(self, pair: ScenePair) -> dict[tuple[str, str], Change]:
        """Compare a scene with the one without the effect, as far as frames were read."""
        changes, names = {}, self.study.plan.receiver.names
        for reading, locator in READINGS.items():
            frames = min(
                self.study.frames_with(locator, effects)
                for effects in (pair.present, pair.absent)
            )
            if not frames:
                continue
            trained_on = pair.present if reading == "retrained" else pair.absent
            present = self.of(pair.present, locator, trained_on, frames)
            absent = self.of(pair.absent, locator, pair.absent, frames)
            stacked = FrameErrors.stacked([present, absent])
            # Where panels are located, the frame that has not come yet may be one whose panel is lost.
            lost = 1.0 if locator == "truth" else stacked.leds / 2
            for row, name in enumerate(names):
                wrong = stacked.pairs[row, row + len(names)]
                change = paired_interval(wrong, errors_per_discordant_frame=lost)
                counts = stacked.counts[row], stacked.counts[row + len(names)]
                changes[reading, name] = Change(*counts, change)
        return changes

    def over_severity(self, name: str) -> SeverityErrors:
        """Put one effect's severities together."""
        pair, frames = self.study.pair(name), self.study.config.severity_frames
        trained = {"true_corners": pair.absent, "retrained": pair.present}
        found: dict[tuple[float, str, str], Counts] = {}
        for value, (reading, scene) in itertools.product(
            self.study.severities[name], trained.items()
        ):
            errors = self.of(self.study.at(name, value), "truth", scene, frames)
            names = self.study.plan.receiver.names
            for receiver, counts in zip(names, errors.counts, strict=True):
                found[float(value), reading, receiver] = counts
        return found

    def base(self) -> dict[tuple[str, str], Counts]:
        """Errors in the scene itself, by reading and receiver; retraining has no meaning there."""
        found: dict[tuple[str, str], Counts] = {}
        scene, names = self.study.scene, self.study.plan.receiver.names
        for reading in ("true_corners", "located"):
            locator = READINGS[reading]
            if frames := self.study.frames_with(locator, scene):
                errors = self.of(scene, locator, scene, frames)
                for receiver, counts in zip(names, errors.counts, strict=True):
                    found[reading, receiver] = counts
        return found


@dataclass(frozen=True)
class EffectResults:
    """Every effect one at a time, all together, and over their severity.

    Args:
        study: what was measured.
        rows: the effects in physical order.
        together: all those that the scene does not name, at once.
        costs: the times.
        base: errors in the scene itself, by reading and receiver.
        severities: over the severity of each effect that has one, from harmless to harsh, in physical order.
    """

    study: EffectStudy
    rows: tuple[EffectRow, ...]
    together: EffectRow | None
    costs: Costs
    base: Mapping[tuple[str, str], Counts]
    severities: Mapping[str, SeverityErrors]

    @property
    def every_row(self) -> tuple[EffectRow, ...]:
        """The effects, and all together where there is that."""
        return (*self.rows, self.together) if self.together else self.rows

    @property
    def readings(self) -> list[str]:
        """The readings that any effect has."""
        known = {place for row in self.every_row for place in row.changes}
        return [name for name in READINGS if (name, self.study.shown) in known]

    @cached_property
    def base_costs(self) -> dict[str, Rounds]:
        """The scene itself, ms a frame, by kind."""
        scene = build_effects(self.study.scene)
        return {kind: self.costs.times[kind, scene] for kind in KINDS}
