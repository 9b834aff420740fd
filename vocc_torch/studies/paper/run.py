"""``task=figures``: the paper's figures and claims, measured, drawn, scored and written as one report."""

from pathlib import Path

from vocc_torch.errors import VoccError
from vocc_torch.measure import config as configs
from vocc_torch.measure import curve, sweep
from vocc_torch.measure.plan import Locator
from vocc_torch.report import folder as run_folder
from vocc_torch.report import terminal
from vocc_torch.studies.paper import FiguresConfig
from vocc_torch.studies.paper.evidence.sample import Source
from vocc_torch.studies.paper.plan import (
    EVIDENCE,
    FIGURES,
    RATE_FIGURES,
    FigurePlan,
    Measured,
    plan_figures,
)
from vocc_torch.studies.paper.report import Report
from vocc_torch.studies.run import Run, begin, write_training


def run_figures(
    settings: configs.Settings, config: FiguresConfig, folder: Path
) -> None:
    """Measure what the paper's figures and claims need, draw, score and report it.

    Args:
        settings: the configuration.
        config: the study's section of it.
        folder: the run's folder.

    Raises:
        VoccError: an unknown figure or reading, or whatever a stage refuses.
    """
    if (folder / "report.html").exists():
        before = configs.read_flat(folder / run_folder.CONFIG)
        for key in ("names", "readings"):
            if before.get(f"figures.{key}") != getattr(config, key):
                raise VoccError(
                    f"name: {folder} holds a report of other figures.{key}: give another name="
                )
    plan = plan_figures(settings, config)
    watch, stages = terminal.Stopwatch(terminal.Console()), 1 + len(plan.every_study)
    # The ledger is open to the end: a second run would write over the same report.
    with begin(settings, folder, plan.readings[0].plan, stages) as run:
        with watch.stage("bit error rates"):
            measured = measure(settings, plan, run, folder) if plan.every_study else {}
            report = Report(folder, plan, plan.evidence(measured))
            for experiment in plan.experiments:
                report.add_rates(experiment, RATE_FIGURES[experiment])
            if (cells := plan.grid(measured)) is not None:
                report.add_dimming(cells)
        # After the workers have ended: one of these figures is a measurement of time.
        with watch.stage("other figures"):
            source = Source(plan.readings[0].plan)
            for name in plan.names:
                if name in EVIDENCE:
                    report.add(name, EVIDENCE[name](source, FIGURES[name]["title"]))
        with watch.stage("report"):
            report.write(settings, watch.seconds)
    places = [("report", "report.html"), ("", "report.md")]
    run_folder.print_places(run.console, folder, places, settings.tensorboard)


def measure(
    settings: configs.Settings, plan: FigurePlan, run: Run, folder: Path
) -> Measured:
    """Train and count for every study, and save the first reading's receiver.

    Raises:
        VoccError: whatever a stage refuses.
    """
    every = [case for study in plan.every_study for case in study.cases]
    measured = dict[tuple[str, Locator], curve.Curves]()
    with run.pool:
        run.train([source for case in every for source in case.trained_on])
        for study in plan.every_study:
            counted = run.count(study.cases, study.name)
            values = study.plan.experiment.simulated_values
            outcomes = dict(zip(values, counted, strict=True))
            for locator in study.locators:
                curves = sweep.curves_at(study.plan, locator, outcomes)
                measured[study.name, locator] = curves
    first = every[0].plan
    write_training(settings, first, run.training(first), folder)
    return measured
