"""``task=classifiers``: many receivers on the same frames, with what they cost, and across scenes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import NamedTuple

from vocc_torch.errors import VoccError
from vocc_torch.measure import curve, sweep
from vocc_torch.measure.config import Settings
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.paired import mover_ratio, paired_interval, rate_ratio
from vocc_torch.measure.runner import Outcome
from vocc_torch.measure.train import Making
from vocc_torch.receiver.classifiers import plugged
from vocc_torch.report import folder as run_folder
from vocc_torch.report import rate_tables, run_ledgers, styles
from vocc_torch.studies.compare import RivalsConfig, figures
from vocc_torch.studies.compare.report import (
    Row,
    counted,
    ends,
    number,
    numbers_of,
    print_rows,
    rate,
    ratio,
    word,
    write_report,
)
from vocc_torch.studies.compare.rivals import ClassifierStudy, build_classifier_study
from vocc_torch.studies.compare.run import Case, Run, comparison

COSTS = ("training_s", "simulated_s", "training_frames", "parameters", "size_bytes")
"""Columns of what it took to make a receiver."""


class Transfer(NamedTuple):
    """A receiver that learned from some scenes, tested on others.

    Args:
        trained_on: name of the scenes that it learned from.
        tested_on: name of the scenes of the test.
        receiver: its name.
        counts: its errors.
        ratio: its rate over that of the same receiver trained on the scenes of the test, on the same frames;
            None where the latter made no error.
        worse: whether it is worse than that, by a paired 95 % interval.
    """

    trained_on: str
    tested_on: str
    receiver: str
    counts: Counts
    ratio: Estimate | None
    worse: bool


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
    """

    reference: str
    costs: Mapping[str, Making]
    points: Mapping[str, float]
    curves: Mapping[str, curve.Curves]
    transfers: Sequence[Transfer] = ()
    home: str = ""

    @cached_property
    def tables(self) -> dict[str, curve.BerTable]:
        """Each experiment's points."""
        return {name: curves.table() for name, curves in self.curves.items()}

    def rate(self, experiment: str, receiver: str) -> Estimate:
        """Give a receiver's rate at an experiment's point: the algorithm's after several trainings."""
        rows = self.tables[experiment].of(receiver)
        return next(row.rate for row in rows if row.value == self.points[experiment])

    def ratio(self, experiment: str, receiver: str) -> Estimate | None:
        """Give a receiver's rate over the reference's there; None where the latter made no error.

        After several trainings it is that of the algorithms, by the intervals of both, which takes no credit
        for their frames being the same.
        """
        reference, curves = self.reference, self.curves[experiment]
        if receiver == reference:
            return None
        if curves.trained:
            under = self.rate(experiment, reference)
            over = self.rate(experiment, receiver)
            return mover_ratio(over, under) if under.value else None
        at = self.points[experiment]
        counts = curves.counts[reference, at], curves.counts[receiver, at]
        return rate_ratio(*counts, curves.pair(reference, receiver, at))

    @cached_property
    def ranked(self) -> tuple[str, ...]:
        """Receivers by their wrong bits over all points and trainings, the fewest first."""

        def half_errors(name: str) -> int:
            return sum(
                curves.tested(name, value).half_errors
                for curves in self.curves.values()
                for value in curves.values
            )

        return tuple(sorted(self.costs, key=half_errors))


def run_classifiers(settings: Settings, rivals: RivalsConfig, folder: Path) -> None:
    """Compare receivers, and report it.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    study = build_classifier_study(settings, rivals, folder)
    first = next(iter(study.plans.values()))
    for classifier in first.receiver.classifiers:
        # What cannot be built is refused now, and not when its turn comes.
        plugged.classifier_of(classifier.build, classifier.inputs)
    stages = 2 + len(study.scene_plans) + bool(study.scene_plans)
    with comparison(settings, folder, study.plan, stages) as run, run.pool:
        found, left_out = compare_classifiers(study, run)
    run_ledgers.write_training(settings, first, run.training(first), folder)
    write_points(folder, found)
    rows = classifier_rows(found)
    print_comparison(found, rows, left_out)
    drawn = {name: figures.curves_figure(found, name) for name in found.curves}
    if found.transfers:
        drawn["robustness"] = figures.scenes_figure(found)
    write_report(
        settings,
        folder,
        {"classifiers": rows, "robustness": scene_rows(found)},
        drawn,
        ["ber.csv", "paired.csv"],
        tables={"": list(found.tables.values())},
        numbers={str(row["receiver"]): numbers_of(row) for row in rows},
    )


def compare_classifiers(
    study: ClassifierStudy, run: Run
) -> tuple[ReceiverComparison, dict[str, str]]:
    """Train all receivers, and measure them along every axis and across scenes.

    Returns:
        What was measured, and what was left out with the reason.

    Raises:
        VoccError: what cannot be trained, or a worker that was ended from outside.
    """
    plans, config = study.plans, study.config
    run.train(list(plans.values()))
    cases = [
        Case(plan, [plan], value)
        for plan in plans.values()
        for value in plan.experiment.values
    ]
    outcomes, curves = iter(run.count(cases, "bit error rates")), {}
    for name, plan in plans.items():
        keys = {name: Key(plan.receiver.locator, name) for name in plan.receiver.names}
        experiment = plan.experiment
        points = dict(zip(experiment.values, outcomes, strict=False))
        curves[name] = sweep.curves_of(experiment.name, experiment.axis, keys, points)
    making = run.training(next(iter(plans.values()))).making
    costs = {name: making(name) for name in study.plan.receiver.names}
    lost, transfers = across_scenes(study, run)
    found = ReceiverComparison(
        config.reference, costs, config.points, curves, transfers, study.home
    )
    return found, {**study.left_out, **lost}


def across_scenes(
    study: ClassifierStudy, run: Run
) -> tuple[dict[str, str], list[Transfer]]:
    """Train in every kind of scenes; test at home what was trained elsewhere, and elsewhere what was at home.

    Returns:
        Why scenes are left out, by name: no panel was found there, or a receiver could not learn from so few
        frames. And by scenes tested on, then scenes trained on, then receiver, the comparisons; those trained
        where they are tested are among them, and receivers that learn nothing are not.
    """
    plans, lost, home = dict(study.scene_plans), dict[str, str](), study.home
    for name, plan in study.scene_plans.items():
        try:
            run.train([plan], f"training in {name}")
        except VoccError as error:
            lost[name] = str(error)
            del plans[name]
    if home in lost or len(plans) < 2:
        return lost, []
    making = run.training(plans[home]).making
    learners = [name for name in plans[home].receiver.names if making(name).frames]
    sources = {name: list(plans) if name == home else [home, name] for name in plans}
    cases = []
    for name, trained_on in sources.items():
        receiver = replace(plans[name].receiver, names=tuple(learners))
        tested = replace(plans[name], receiver=receiver)
        cases.append(Case(tested, [plans[other] for other in trained_on]))
    transfers: list[Transfer] = []
    for (name, trained_on), outcome in zip(
        sources.items(), run.count(cases, "other scenes"), strict=True
    ):
        transfers += transfers_of(outcome, name, trained_on, learners)
    return lost, transfers


def transfers_of(
    outcome: Outcome,
    tested_on: str,
    trained_on: Sequence[str],
    receivers: Sequence[str],
) -> Iterator[Transfer]:
    """Compare receivers with the same ones trained on the scenes of the test."""
    errors = outcome.errors
    locator = errors.keys[0].locator
    at_home = trained_on.index(tested_on)
    for (training, scenes), name in product(enumerate(trained_on), receivers):
        keys = [Key(locator, name, of) for of in (at_home, training)]
        pair = errors.of(list(map(errors.place, keys)))
        reference, counts = pair.counts
        ratio = rate_ratio(reference, counts, pair.pairs[0, 1])
        worse = paired_interval(pair.pairs[0, 1]).high < 0
        yield Transfer(scenes, tested_on, name, counts, ratio, worse)


def write_points(folder: Path, found: ReceiverComparison) -> None:
    """Write ``ber.csv`` and ``paired.csv`` of all experiments."""
    tables = [rate_tables.ber_rows(table) for table in found.tables.values()]
    rows = [row for table in tables for row in table[1:]]
    run_folder.write_rows(folder / "ber.csv", [tables[0][0], *rows], short=True)
    rate_tables.write_paired(folder / "paired.csv", found.curves.values())


def classifier_rows(found: ReceiverComparison) -> list[Row]:
    """Give the rows of ``classifiers.csv``: what each receiver costs, and its rates, the best first.

    Rates and ratios are at the table's points; after several trainings they are the algorithms'.
    """
    rows: list[Row] = []
    for receiver in found.ranked:
        costs = zip(COSTS, astuple(found.costs[receiver]), strict=True)
        row: Row = {"receiver": receiver, **dict(costs)}
        for experiment, value in found.points.items():
            place = f"{experiment}_{value:g}"
            row |= ends(f"{place}_ber", found.rate(experiment, receiver))
            row |= ends(f"{place}_ratio", found.ratio(experiment, receiver))
        rows.append(row)
    return rows


def scene_rows(found: ReceiverComparison) -> list[Row]:
    """Give the rows of ``robustness.csv``: a row for each pair of scenes and receiver."""
    return [
        {
            "trained_on": move.trained_on,
            "tested_on": move.tested_on,
            "receiver": move.receiver,
            **counted(move.counts),
            "frame_errors": move.counts.frame_errors,
            "panels_missed": move.counts.panels_missed,
            **ends("ratio", move.ratio),
        }
        for move in found.transfers
    ]


def print_comparison(
    found: ReceiverComparison, rows: Sequence[Row], left_out: Mapping[str, str]
) -> None:
    """Print a row for each receiver, the best first."""
    columns = [("receiver", "receiver", word)]
    for name, value in found.points.items():
        unit = styles.axis_label(found.curves[name].axis).partition("(")[2].rstrip(")")
        point, place = (
            f"{styles.value_text(value)} {unit}".rstrip(),
            f"{name}_{value:g}",
        )
        columns.append((f"BER at\n{point}", f"{place}_ber", rate))
        columns.append((f"of\n{found.reference}", f"{place}_ratio", ratio))
    notes = ["Fewest wrong bits over all points first; 95 % intervals over frames."]
    notes += [f"Left out: {name}, since {why}." for name, why in left_out.items()]
    columns.append(("train\ns", "training_s", number))
    print_rows(rows, columns, "\n".join(notes))
