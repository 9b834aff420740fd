"""``task=figures``: the paper's figures and claims, measured, drawn, scored and written as one report."""

from pathlib import Path

from vocc_torch.errors import VoccError
from vocc_torch.measure import config as configs
from vocc_torch.measure import grid
from vocc_torch.report import folder as run_folder
from vocc_torch.report import terminal
from vocc_torch.studies.paper import FiguresConfig
from vocc_torch.studies.paper.evidence.sample import Source
from vocc_torch.studies.paper.plan import (
    EVIDENCE,
    FIGURES,
    RATE_FIGURES,
    plan_figures,
)
from vocc_torch.studies.paper.report import Report
from vocc_torch.studies.paper.rules import Evidence
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
    evidence = {reading.name: Evidence({}, {}) for reading in plan.readings}
    report = Report(folder, plan, evidence)
    # The ledger is open to the end: a second run would write over the same report.
    with begin(settings, folder, plan.readings[0].plan, stages) as run:
        with watch.stage("bit error rates"):
            if plan.every_study:
                measure(settings, report, run)
        # After the workers have ended: one of these figures is a measurement of time.
        with watch.stage("other figures"):
            source = Source(plan.readings[0].plan)
            for name in filter(EVIDENCE.__contains__, plan.names):
                report.add(name, EVIDENCE[name](source, FIGURES[name]["title"]))
        with watch.stage("report"):
            report.write(settings, watch.seconds)
    places = [("report", "report.html"), ("", "report.md")]
    run_folder.print_places(run.console, folder, places, settings.tensorboard)


def measure(settings: configs.Settings, report: Report, run: Run) -> None:
    """Train and count for every study, draw the curves, and save the first reading's receiver.

    Raises:
        VoccError: no frame in any contrast bin, or whatever a stage refuses.
    """
    plan, evidence = report.plan, report.evidence
    every = [case for study in plan.every_study for case in study.cases]
    with run.pool:
        run.train([source for case in every for source in case.trained_on])
        for study in plan.studies:
            for reading, curves in study.curves(run).items():
                evidence[reading].experiments[study.experiment] = curves
        rows = [row.curves(run)[plan.readings[0].name] for row in plan.rows.values()]
    first = every[0].plan
    write_training(settings, first, run.training(first), report.folder)
    for name in evidence[plan.readings[0].name].experiments:
        report.add_rates(name, RATE_FIGURES[name])
    if rows:
        report.add_dimming(grid.Grid("ambient_lx", tuple(plan.rows), rows))
