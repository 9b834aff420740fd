"""What a comparison of many receivers measured: rates, costs, other scenes; and its summary."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from vocc_torch.measure import curve, estimate, train
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.paired import (
    PairedCounts,
    mover_ratio,
    paired_interval,
    rate_ratio,
)
from vocc_torch.report import page, styles


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
    def ratio(self) -> estimate.Estimate | None:
        """Its rate over that of the receiver trained there; None where that one made no error."""
        return rate_ratio(self.at_home, self.counts, self.paired)

    def surely_worse(self, comparisons: int = 1) -> bool:
        """Whether it is worse than the one trained there, by intervals that hold together at 95 %.

        Args:
            comparisons: how many are stated together, at least 1.
        """
        return (
            paired_interval(self.paired, estimate.joint_confidence(comparisons)).high
            < 0
        )


@dataclass(frozen=True)
class Comparison:
    """All that was measured of many receivers.

    Args:
        reference: the receiver that the others are compared with.
        costs: what training took, by receiver.
        points: of each experiment the value that the summary states.
        curves: by experiment.
        decision_ms: time of a frame from the rectified panel to its bits, by receiver.
        transfers: across scenes, all of them with ``home`` on one side.
        lost_scenes: why scenes are not among ``transfers``, by name.
        home: name of the scenes of the experiments.
        most_training_frames: of a receiver in ``transfers``.
        left_out: receivers that were asked for and cannot be built here, and why.
    """

    reference: str
    costs: Mapping[str, train.Making]
    points: Mapping[str, float]
    curves: Mapping[str, curve.Curves] = field(default_factory=dict)
    decision_ms: Mapping[str, float] = field(default_factory=dict)
    transfers: Sequence[Transfer] = ()
    lost_scenes: Mapping[str, str] = field(default_factory=dict)
    home: str = ""
    most_training_frames: int = 0
    left_out: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def tables(self) -> dict[str, curve.BerTable]:
        """Each experiment's points."""
        return {name: curves.table() for name, curves in self.curves.items()}

    @property
    def trainings(self) -> int:
        """How often every receiver was trained."""
        rows = (row for table in self.tables.values() for row in table)
        return max((row.trainings for row in rows), default=1)

    def row(self, experiment: str, receiver: str, value: float) -> curve.Row | None:
        """Find a point."""
        rows = self.tables[experiment].of(receiver)
        return next((row for row in rows if row.value == value), None)

    def rate(
        self, experiment: str, receiver: str, value: float
    ) -> estimate.Estimate | None:
        """Give a receiver's rate at a point: the algorithm's where it was trained several times."""
        row = self.row(experiment, receiver, value)
        if row is None:
            return None
        return row.algorithm or estimate.Estimate(row.ber, row.ber_low, row.ber_high)

    def ratio(
        self, experiment: str, receiver: str, value: float
    ) -> estimate.Estimate | None:
        """Give a receiver's rate over the reference's at a point; None where that one made no error.

        After several trainings it is that of the algorithms, by the intervals of both, which takes no credit
        for their frames being the same.
        """
        if receiver == self.reference:
            return None
        if self.trainings > 1:
            rate = self.rate(experiment, receiver, value)
            reference = self.rate(experiment, self.reference, value)
            if not (rate and reference and reference.value):
                return None
            return mover_ratio(rate, reference)
        curves = self.curves[experiment]
        return rate_ratio(
            curves.counts[self.reference, value],
            curves.counts[receiver, value],
            curves.pair(self.reference, receiver, value),
        )

    @cached_property
    def half_errors(self) -> dict[str, int]:
        """Wrong bits over all points of all experiments, times two, by receiver, the fewest first.

        After several trainings they are those of all of them.
        """
        names = next(iter(self.curves.values())).receivers
        total = {
            name: sum(
                curves.tested(name, value).half_errors
                for curves in self.curves.values()
                for value in curves.values
            )
            for name in names
        }
        return dict(sorted(total.items(), key=lambda item: item[1]))

    @property
    def ranked(self) -> tuple[str, ...]:
        """Receivers by their wrong bits over all points, the fewest first."""
        return tuple(self.half_errors)

    def point_label(self, experiment: str) -> str:
        """Write the value that the summary states, with its unit, such as "70 m"."""
        label = styles.axis_label(self.curves[experiment].axis)
        unit = label.partition("(")[2].rstrip(")")
        return f"{styles.value_text(self.points[experiment])} {unit}".rstrip()


def ratio_text(ratio: estimate.Estimate, most: bool = False) -> str:
    """Write a ratio as a fraction or a multiple; a limit where the receiver made no error.

    Args:
        ratio: the ratio and its interval.
        most: write the high end alone.

    Example:
        >>> ratios = (0, 0, 0.0027), (0.031, 0.02, 0.05), (4.2, 3.0, 6.0)
        >>> [ratio_text(estimate.Estimate(*one)) for one in ratios]
        ['< 1/370', '1/32', '4.2 x']
    """
    limit = "< " if ratio.value == 0 and not most else ""
    value = ratio.high if limit or most else ratio.value
    if value > 0.95:
        return f"{limit}{value:.2g} x" if value < 99.5 else f"{limit}{value:.0f} x"
    part = 1 / value
    return (
        f"{limit}1/{part:.2g}"
        if part < 9.95
        else f"{limit}1/{float(f'{part:.2g}'):.0f}"
    )


def summary(comparison: Comparison, width: int = 100) -> str:
    """Say which receiver is best, what it costs, and where it fails.

    Args:
        comparison: what was measured.
        width: columns that a line may take.
    """
    ranked, wrong = comparison.ranked, comparison.half_errors
    reference = comparison.reference
    learners = [
        name for name in ranked if comparison.costs[name].frames and name != reference
    ]
    best = learners[0] if learners and comparison.points else None
    apart = [move for move in comparison.transfers if move.trained_on != move.tested_on]
    moved = {move.receiver for move in apart}
    names = [name for name in ranked if name in moved]
    stated = [name for name in names if name in (names[0], reference)]
    apart = [move for move in apart if move.receiver in stated]
    apart.sort(key=lambda move: -move.ratio.value if move.ratio else -float("inf"))
    text = page.render(
        __package__,
        "summary.txt.j2",
        comparison=comparison,
        best=best,
        tied=[name for name in learners[1:] if best and wrong[name] == wrong[best]],
        stated=stated,
        comparisons=len(apart),
        worse=[move for move in apart if move.surely_worse(len(apart))],
        ratio_text=ratio_text,
        value_text=styles.value_text,
    )
    parts = text.strip().split("\n\n")
    lines = [textwrap.fill(part, width, break_on_hyphens=False) for part in parts]
    return "\n\n".join(lines) + "\n"
