"""Many receivers on the same frames: rates against a reference, the genie's mark, prices, other scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import BerTable, Curves, Point
from vocc_torch.measure.estimate import Estimate, joint_confidence
from vocc_torch.measure.paired import PairedCounts, paired_interval
from vocc_torch.measure.relative import rate_ratio as rate_ratio
from vocc_torch.measure.train import Making

GENIE = "genie"
"""The mark's name among receivers."""


@dataclass(frozen=True)
class Mark:
    """What is possible at one point: the genie, and the receivers on those very frames.

    Args:
        counts: the genie's.
        proven: frames of which no bits are likelier than those that it gave.
        seconds_a_frame: what it takes.
        receivers: counts of the receivers on the same frames.
    """

    counts: Counts
    proven: int
    seconds_a_frame: float
    receivers: Mapping[str, Counts]

    @property
    def best(self) -> tuple[str, ...]:
        """The receivers with the fewest wrong bits on these frames.

        Example:
            >>> two = {"a": Counts(64, 4096, 2, 2, 2), "b": Counts(64, 4096)}
            >>> Mark(Counts(64, 4096), 64, 0.02, two).best
            ('b',)
        """
        least = min((one.half_errors for one in self.receivers.values()), default=0)
        return tuple(name for name, one in self.receivers.items() if one.half_errors == least)

    @property
    def lowest(self) -> bool:
        """Whether no receiver has fewer wrong bits on these frames."""
        return all(self.counts.half_errors <= one.half_errors for one in self.receivers.values())


@dataclass(frozen=True)
class Transfer:
    """A receiver that learnt from some scenes, tested on others.

    Args:
        receiver: its name.
        trained_on: name of the scenes that it learnt from.
        tested_on: name of the scenes of the test.
        counts: what it got wrong.
        at_home: counts of the same receiver trained on the scenes of the test, on the same frames.
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

    def worse(self, comparisons: int = 1) -> bool:
        """Whether it is surely worse than the one trained there.

        Args:
            comparisons: how many are told of together, at least 1: 95 % holds for all of them (Bonferroni).
        """
        return paired_interval(self.paired, joint_confidence(comparisons)).high < 0


@dataclass(frozen=True)
class Rivals:
    """All that was measured of many receivers.

    Args:
        reference: the receiver that the others are compared with.
        curves: by experiment.
        making: what it took to make each receiver.
        bits_ms: time of a frame from the rectified panel to its bits, by receiver.
        points: of each experiment the value that the summary tells.
        marks: the genie's, by experiment and value; empty where there are none.
        unmarked: why there are none, by experiment.
        transfers: across scenes, all of them with ``home`` on one side.
        lost: why scenes are not among ``transfers``, by name.
        home: name of the scenes of the experiments.
        most_training_frames: of a receiver in ``transfers``.
        left_out: receivers that were asked for and cannot be built here, and why.
    """

    reference: str
    curves: Mapping[str, Curves]
    making: Mapping[str, Making]
    bits_ms: Mapping[str, float]
    points: Mapping[str, float]
    marks: Mapping[str, Mapping[float, Mark]] = field(default_factory=dict)
    unmarked: Mapping[str, str] = field(default_factory=dict)
    transfers: Sequence[Transfer] = ()
    lost: Mapping[str, str] = field(default_factory=dict)
    home: str = ""
    most_training_frames: int = 0
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def receivers(self) -> tuple[str, ...]:
        """Names in the order of the results."""
        return next(iter(self.curves.values())).receivers

    @property
    def learners(self) -> tuple[str, ...]:
        """Receivers that learnt from frames."""
        return tuple(name for name in self.receivers if self.making[name].frames)

    def tables(self) -> dict[str, BerTable]:
        """Give each experiment's points, the genie's last."""
        tables = {}
        for name, curves in self.curves.items():
            marked = [
                Point(name, curves.axis, value, GENIE, curves.locator, mark.counts, "frames")
                for value, mark in sorted(self.marks.get(name, {}).items())
            ]
            tables[name] = BerTable([*curves.points(), *marked])
        return tables

    def ratio(self, experiment: str, receiver: str, value: float) -> Estimate | None:
        """Give a receiver's rate over the reference's at a point; None where that one made no error."""
        curves = self.curves[experiment]
        counts = curves.counts
        if receiver == self.reference:
            return None
        paired = curves.pair(self.reference, receiver, value)
        return rate_ratio(counts[self.reference, value], counts[receiver, value], paired)

    def ranked(self) -> tuple[str, ...]:
        """Receivers by their wrong bits over all points of all experiments, the fewest first."""

        def wrong(name: str) -> int:
            return sum(curves.total(name).half_errors for curves in self.curves.values())

        return tuple(sorted(self.receivers, key=wrong))
