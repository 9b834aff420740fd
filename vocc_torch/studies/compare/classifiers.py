"""``task=classifiers``: many receivers on the same frames, with what they cost, and across scenes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from vocc_torch.errors import VoccError, demand_least, demand_word, section
from vocc_torch.measure.build import build_world
from vocc_torch.measure.config import Settings
from vocc_torch.measure.curve import COLUMNS, Curves
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.paired import mover_ratio, rate_ratio
from vocc_torch.measure.plan import Budget, Plan
from vocc_torch.measure.train import Training
from vocc_torch.receiver.classifiers import plugged
from vocc_torch.report import folder as run_folder
from vocc_torch.report import rate_tables, styles
from vocc_torch.report.terminal import BLANK, TableRow, print_rows
from vocc_torch.studies.compare import ComparisonConfig, figures
from vocc_torch.studies.compare.report import (
    counted,
    left_out_lines,
    numbers_of,
    write_report,
)
from vocc_torch.studies.run import (
    Case,
    Run,
    begin,
    scene_plan,
    write_training,
)


class ClassifierStudy(NamedTuple):
    """Many receivers along several axes, and across scenes.

    Args:
        plan: of the scene itself.
        config: the section of the configuration.
        home: name of the scene.
        plans: by experiment's name; they share world, receivers and budget.
        scene_plans: by name, plans of one kind of scenes, the home first; empty without pairs.
        left_out: receivers that were asked for and cannot be built here, and why.
    """

    plan: Plan
    config: ComparisonConfig
    home: str
    plans: Mapping[str, Plan]
    scene_plans: Mapping[str, Plan]
    left_out: Mapping[str, str]


def build_classifier_study(
    settings: Settings, comparison: ComparisonConfig
) -> ClassifierStudy:
    """Build the study that ``task=classifiers`` makes.

    Raises:
        VoccError: no experiment, an unknown name or point, or a value outside its range, named by its key.
    """
    plan, left_out = scene_plan(settings)
    if not comparison.experiments:
        raise VoccError(
            "comparison.experiments is empty: it must hold at least one experiment"
        )
    demand_word("comparison.reference", comparison.reference, plan.receiver.names)
    demand_least("comparison.", comparison, scene_frames=0, scene_training_frames=2)
    plans, home = {}, settings.scene.name
    for name, experiment in comparison.experiments.items():
        key = f"comparison.experiments.{name}"
        if experiment.row_axis:
            raise VoccError(
                f"{key} is a grid over {experiment.row_axis}: it must have one axis"
            )
        if experiment.axis == "contrast":
            raise VoccError.of(key, "over contrast", "over a value of a scene")
        with section(key, before="experiment"):
            plans[name] = replace(plan, experiment=experiment)
    for name, value in comparison.points.items():
        key = f"comparison.points.{name}"
        if name not in plans:
            raise VoccError(f"{key} is no experiment: known are {', '.join(plans)}")
        if value not in (values := plans[name].experiment.values):
            rule = f"one of {', '.join(f'{known:g}' for known in values)}"
            raise VoccError.of(key, f"{value:g}", rule)
    scenes = {home: plan}
    for name, scene in comparison.scenes.items():
        # The scene of the experiments may be among the shipped ones or not.
        if name != home:
            with section(f"comparison.scenes.{name}", before="scene"):
                world = build_world(replace(settings, scene=scene))
                scenes[name] = replace(plan, world=world)
    paired = comparison.scene_frames and len(scenes) > 1
    scene_plans = {
        name: few_frames(of_scene, comparison, name, at_home=name == home)
        for name, of_scene in scenes.items()
        if paired
    }
    return ClassifierStudy(plan, comparison, home, plans, scene_plans, left_out)


def few_frames(
    plan: Plan, config: ComparisonConfig, name: str, *, at_home: bool
) -> Plan:
    """Give the plan of a kind of scenes, whose classifiers learn from few frames.

    Args:
        plan: of these scenes.
        config: says how many frames.
        name: of the scenes, for the test frames.
        at_home: whether a classifier's own mix of scenes holds here.
    """
    most = config.scene_training_frames
    learners = []
    for learner in plan.receiver.classifiers:
        recipe = learner.training
        learners.append(
            replace(
                learner,
                training=replace(recipe, frames=min(most, recipe.frames)),
                frames=learner.frames and min(most, learner.frames),
                scene=learner.scene if at_home else {},
            )
        )
    training_frames = min(most, plan.budget.training_frames)
    return replace(
        plan,
        receiver=replace(plan.receiver, classifiers=tuple(learners)),
        budget=Budget(config.scene_frames, training_frames),
        experiment=replace(plan.experiment, name=f"scenes/{name}"),
    )


COSTS = ("training_s", "simulated_s", "training_frames", "parameters", "size_bytes")
"""Columns of what it took to make a receiver."""


def run_classifiers(
    settings: Settings, comparison: ComparisonConfig, folder: Path
) -> None:
    """Compare receivers, and report it.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    study = build_classifier_study(settings, comparison)
    first, *_ = study.plans.values()
    for classifier in first.receiver.classifiers:
        # What cannot be built is refused now, and not when its turn comes.
        plugged.classifier_of(classifier.build, classifier.inputs)
    others, curves = len(study.scene_plans), dict[str, Curves]()
    stages = 1 + len(study.plans) + others + bool(others)
    with begin(settings, folder, study.plan, stages) as run, run.pool:
        run.train(list(study.plans.values()))
        for name, plan in study.plans.items():
            stage = f"bit error rates over {name}"
            (curves[name],) = run.curves(plan, [plan], stage).values()
        lost, scenes = across_scenes(study, run)
    training = run.training(first)
    write_training(settings, first, training, folder)
    lines = [
        row for table in curves.values() for row in rate_tables.ber_rows(table)[1:]
    ]
    run_folder.write_rows(folder / "ber.csv", [COLUMNS, *lines])
    rate_tables.write_paired(folder / "paired.csv", curves.values())
    rows = classifier_rows(comparison, curves, training)
    print_classifiers(comparison, curves, rows, {**study.left_out, **lost})
    drawn = {}
    for name, table in curves.items():
        points = comparison.points
        place = f"{name}_{points[name]:g}" if name in points else ""
        drawn[name] = figures.curves_figure(table, rows, comparison.reference, place)
    if scenes:
        receivers = [row["receiver"] for row in rows]
        drawn["robustness"] = figures.scenes_figure(scenes, study.home, receivers)
    write_report(
        settings,
        folder,
        {"classifiers": rows, "robustness": scenes},
        drawn,
        tables={"": list(curves.values())},
        numbers={row["receiver"]: numbers_of(row) for row in rows},
    )


def across_scenes(
    study: ClassifierStudy, run: Run
) -> tuple[dict[str, str], list[TableRow]]:
    """Train in every kind of scenes; test at home what was trained elsewhere, and elsewhere what was at home.

    Returns:
        Why scenes are left out, by name: no panel was found there, or a receiver could not learn from so few
        frames. And the rows of ``robustness.csv`` by scenes tested on, then scenes trained on, then receiver;
        those trained where they are tested are among them, and receivers that learn nothing are not.
    """
    plans, lost, home = dict(study.scene_plans), {}, study.home
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
        tested, trained = plans[name], [plans[other] for other in trained_on]
        receiver = replace(tested.receiver, names=tuple(learners))
        cases.append(Case(replace(tested, receiver=receiver), trained))
    outcomes = run.count(cases, "other scenes")
    rows = [
        scene_rows(outcome.errors, name, trained_on)
        for (name, trained_on), outcome in zip(sources.items(), outcomes, strict=True)
    ]
    return lost, [*chain.from_iterable(rows)]


def scene_rows(
    errors: FrameErrors, tested_on: str, trained_on: Sequence[str]
) -> Iterator[TableRow]:
    """Compare receivers with the same ones trained on the scenes of the test.

    Args:
        errors: in these scenes, of the trainings in order.
        tested_on: name of the scenes.
        trained_on: names of the scenes of the trainings.
    """
    at_home = trained_on.index(tested_on)
    for key in errors.keys:
        pair = errors.of(list(map(errors.place, (replace(key, training=at_home), key))))
        reference, counts = pair.counts
        yield {
            "trained_on": trained_on[key.training],
            "tested_on": tested_on,
            "receiver": key.receiver,
            **counted(counts),
            "panels_missed": counts.panels_missed,
            "ratio": rate_ratio(reference, counts, pair.pair(0, 1)) or BLANK,
        }


def classifier_rows(
    config: ComparisonConfig,
    curves: Mapping[str, Curves],
    training: Training,
) -> list[TableRow]:
    """Return the rows of ``classifiers.csv``: costs and rates of each receiver, the best receiver first.

    The best receiver has the fewest wrong bits over all points and trainings. Rates and ratios are those at
    the points of ``config``. After several trainings they are those of the algorithm.
    """
    first, *_ = curves.values()

    def half_errors(receiver: str) -> int:
        points = [(found, value) for found in curves.values() for value in found.values]
        return sum(found.tested(receiver, at).half_errors for found, at in points)

    rows = []
    for receiver in sorted(first.receivers, key=half_errors):
        costs = zip(COSTS, astuple(training.making(receiver)), strict=True)
        row: TableRow = {"receiver": receiver, **dict(costs)}
        for experiment, value in config.points.items():
            found, place = curves[experiment], f"{experiment}_{value:g}"
            row[f"{place}_ber"] = found.rate(receiver, value)
            row[f"{place}_ratio"] = ratio_to(config.reference, receiver, found, value)
        rows.append(row)
    return rows


def ratio_to(reference: str, receiver: str, curves: Curves, value: float) -> Estimate:
    """Return a receiver's rate divided by the reference's at a value; blank if the reference has no error.

    After several trainings the ratio is that of the algorithms, from the separate intervals of both rates.
    """
    if receiver == reference:
        return BLANK
    if curves.trained:
        over, under = (curves.rate(name, value) for name in (receiver, reference))
        return mover_ratio(over, under) if under.value else BLANK
    counts = curves.counts[reference, value], curves.counts[receiver, value]
    return rate_ratio(*counts, curves.pair(reference, receiver, value)) or BLANK


def print_classifiers(
    config: ComparisonConfig,
    tables: Mapping[str, Curves],
    rows: Sequence[TableRow],
    left_out: Mapping[str, str],
) -> None:
    """Print a row for each receiver, the best first."""
    columns = {"receiver": "receiver"}
    for name, value in config.points.items():
        place = styles.place_text(tables[name].axis, value)
        columns[f"{name}_{value:g}_ber"] = f"BER at\n{place}"
        columns[f"{name}_{value:g}_ratio"] = f"of\n{config.reference}"
    notes = ["Fewest wrong bits over all points first; 95 % intervals over frames."]
    notes += left_out_lines(left_out)
    # One decimal, so that the table fits 80 columns.
    shown = [{**row, "training_s": f"{row['training_s']:.1f}"} for row in rows]
    print_rows(shown, {**columns, "training_s": "train\ns"}, "\n".join(notes))
