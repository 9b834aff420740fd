"""What a comparison of many receivers measured: rates, costs, other scenes."""

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
from vocc_torch.report import styles


@dataclass(frozen=True)
class Transfer:
    """A receiver that learned from some scenes, tested on others.

    Args:
        receiver: its name.
        trained_on: name of the scenes that it learned from.
        tested_on: name of the scenes of the test.
        counts: its errors.
        at_home: errors of the same receiver trained on the scenes of the test, on the same frames.
        paired: the receiver trained on the scenes of the test (a) compared with this one (b).
    """

    receiver: str
    trained_on: str
    tested_on: str
    counts: Counts
    at_home: Counts
    paired: PairedCounts

    @property
    def ratio(self) -> estimate.Estimate | None:
        """Its rate over that of the receiver at home; None where the latter made no error."""
        return rate_ratio(self.at_home, self.counts, self.paired)

    @property
    def surely_worse(self) -> bool:
        """Whether it is worse than the receiver at home, by a 95 % interval."""
        return paired_interval(self.paired).high < 0


@dataclass(frozen=True)
class ReceiverComparison:
    """All that was measured of many receivers.

    Args:
        reference: the receiver that the others are compared with.
        costs: what training took, by receiver.
        points: of each experiment the value that the table states.
        curves: by experiment.
        transfers: across scenes, all of them with ``home`` on one side.
        home: name of the scenes of the experiments.
        left_out: what was asked for and is missing, and why.
    """

    reference: str
    costs: Mapping[str, train.Making]
    points: Mapping[str, float]
    curves: Mapping[str, curve.Curves] = field(default_factory=dict)
    transfers: Sequence[Transfer] = ()
    home: str = ""
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

    def rate(self, experiment: str, receiver: str, value: float) -> estimate.Estimate:
        """Give a receiver's rate at a point: the algorithm's where it was trained several times."""
        rows = {row.value: row for row in self.tables[experiment].of(receiver)}
        return rows[value].rate

    def ratio(
        self, experiment: str, receiver: str, value: float
    ) -> estimate.Estimate | None:
        """Give a receiver's rate over the reference's at a point; None where the latter made no error.

        After several trainings it is that of the algorithms, by the intervals of both, which takes no credit
        for their frames being the same.
        """
        if receiver == self.reference:
            return None
        if self.trainings > 1:
            rate = self.rate(experiment, receiver, value)
            reference = self.rate(experiment, self.reference, value)
            return mover_ratio(rate, reference) if reference.value else None
        curves = self.curves[experiment]
        return rate_ratio(
            curves.counts[self.reference, value],
            curves.counts[receiver, value],
            curves.pair(self.reference, receiver, value),
        )

    @cached_property
    def ranked(self) -> tuple[str, ...]:
        """Receivers by their wrong bits over all points and trainings, the fewest first."""

        def half_errors(name: str) -> int:
            return sum(
                curves.tested(name, value).half_errors
                for curves in self.curves.values()
                for value in curves.values
            )

        names = next(iter(self.curves.values())).receivers
        return tuple(sorted(names, key=half_errors))

    def point_label(self, experiment: str) -> str:
        """Write the value that the table states, with its unit, such as "70 m"."""
        label = styles.axis_label(self.curves[experiment].axis)
        unit = label.partition("(")[2].rstrip(")")
        return f"{styles.value_text(self.points[experiment])} {unit}".rstrip()


def ratio_text(ratio: estimate.Estimate) -> str:
    """Write a ratio as a fraction or a multiple; a limit where the receiver made no error.

    Example:
        >>> ratios = (0, 0, 0.0027), (0.031, 0.02, 0.05), (4.2, 3.0, 6.0)
        >>> [ratio_text(estimate.Estimate(*ends)) for ends in ratios]
        ['< 1/370', '1/32', '4.2 x']
    """
    limit = "" if ratio.value else "< "
    value = ratio.value or ratio.high
    if value > 0.95:
        return f"{limit}{float(f'{value:.2g}'):g} x"
    return f"{limit}1/{float(f'{1 / value:.2g}'):g}"
