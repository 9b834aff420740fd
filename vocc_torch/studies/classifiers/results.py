"""What a comparison of many receivers measured: error rates, the genie's, costs, and other scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import BerTable, Curves, Point, Row
from vocc_torch.measure.estimate import Estimate, joint_confidence
from vocc_torch.measure.genie import GenieReference
from vocc_torch.measure.paired import PairedCounts, paired_interval, rate_ratio
from vocc_torch.measure.train import Making

GENIE = "genie"
"""The genie's name among receivers."""


@dataclass(frozen=True)
class GeniePoint:
    """What is possible at one point: the genie, and the receivers on the same frames.

    Args:
        genie: the genie's errors.
        receivers: counts of the receivers.
    """

    genie: GenieReference
    receivers: Mapping[str, Counts]

    @property
    def best(self) -> tuple[str, ...]:
        """The receivers with the fewest wrong bits on these frames."""
        least = min((one.half_errors for one in self.receivers.values()), default=0)
        return tuple(name for name, one in self.receivers.items() if one.half_errors == least)

    @property
    def unbeaten(self) -> bool:
        """Whether no receiver has fewer wrong bits than the genie."""
        return all(self.genie.counts.half_errors <= one.half_errors for one in self.receivers.values())


@dataclass(frozen=True)
class Transfer:
    """A receiver that learnt from some scenes, tested on others.

    Args:
        receiver: its name.
        trained_on: name of the scenes that it learnt from.
        tested_on: name of the scenes of the test.
        counts: its errors.
        at_home: errors of the same receiver trained on the scenes of the test, on the same frames.
        paired: the one trained there (a) compared with this one (b).
    """

    receiver: str
    trained_on: str
    tested_on: str
    counts: Counts
    at_home: Counts
    paired: PairedCounts

    @property
    def ratio(self) -> Estimate | None:
        """Its rate over that of the receiver trained there; None where that one made no error."""
        return rate_ratio(self.at_home, self.counts, self.paired)

    def surely_worse(self, comparisons: int = 1) -> bool:
        """Whether it is worse than the one trained there, by intervals that hold together at 95 %.

        Args:
            comparisons: how many are stated together, at least 1.
        """
        return paired_interval(self.paired, joint_confidence(comparisons)).high < 0


@dataclass(frozen=True)
class Comparison:
    """All that was measured of many receivers.

    Args:
        reference: the receiver that the others are compared with.
        curves: by experiment.
        costs: what training took, by receiver.
        decision_ms: time of a frame from the rectified panel to its bits, by receiver.
        points: of each experiment the value that the summary states.
        genie: by experiment and value; empty without it.
        no_genie: why there is none, by experiment.
        transfers: across scenes, all of them with ``home`` on one side.
        lost_scenes: why scenes are not among ``transfers``, by name.
        home: name of the scenes of the experiments.
        most_training_frames: of a receiver in ``transfers``.
        left_out: receivers that were asked for and cannot be built here, and why.
    """

    reference: str
    curves: Mapping[str, Curves]
    costs: Mapping[str, Making]
    decision_ms: Mapping[str, float]
    points: Mapping[str, float]
    genie: Mapping[str, Mapping[float, GeniePoint]] = field(default_factory=dict)
    no_genie: Mapping[str, str] = field(default_factory=dict)
    transfers: Sequence[Transfer] = ()
    lost_scenes: Mapping[str, str] = field(default_factory=dict)
    home: str = ""
    most_training_frames: int = 0
    left_out: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def tables(self) -> dict[str, BerTable]:
        """Each experiment's points, the genie's last."""
        return {
            name: BerTable(
                [
                    *curves.points(),
                    *(
                        Point(name, curves.axis, value, GENIE, curves.locator, one.genie.counts, "frames")
                        for value, one in sorted(self.genie.get(name, {}).items())
                    ),
                ]
            )
            for name, curves in self.curves.items()
        }

    def row(self, experiment: str, receiver: str, value: float) -> Row | None:
        """Find a point."""
        return next((row for row in self.tables[experiment].of(receiver) if row.value == value), None)

    def ratio(self, experiment: str, receiver: str, value: float) -> Estimate | None:
        """Give a receiver's rate over the reference's at a point; None where that one made no error."""
        if receiver in (self.reference, GENIE):
            return None
        curves = self.curves[experiment]
        own, reference = (curves.counts[name, value] for name in (receiver, self.reference))
        return rate_ratio(reference, own, curves.pair(self.reference, receiver, value))

    @cached_property
    def half_errors(self) -> dict[str, int]:
        """Wrong bits over all points of all experiments, times two, by receiver, the fewest first."""
        names = next(iter(self.curves.values())).receivers
        total = {name: sum(one.total(name).half_errors for one in self.curves.values()) for name in names}
        return dict(sorted(total.items(), key=lambda one: one[1]))

    @property
    def ranked(self) -> tuple[str, ...]:
        """Receivers by their wrong bits over all points, the fewest first."""
        return tuple(self.half_errors)
