"""``task=figures``: the paper's figures and claims, measured, drawn, scored and written as one report."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from vocc_torch.errors import VoccError
from vocc_torch.measure import config as configs
from vocc_torch.measure import executors, sweep
from vocc_torch.report import folder as run_folder
from vocc_torch.report import run_ledgers, terminal
from vocc_torch.studies.paper import FiguresConfig
from vocc_torch.studies.paper.evidence.sample import Source
from vocc_torch.studies.paper.plan import (
    EVIDENCE,
    FIGURES,
    RATE_FIGURES,
    FigurePlan,
    plan_figures,
)
from vocc_torch.studies.paper.report import Report


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
    run_folder.refuse_results(folder, run_ledgers.LEDGERS)
    if (folder / "report.html").exists():
        before = configs.read_flat(folder / run_folder.CONFIG)
        for key, value in (("names", config.names), ("readings", config.readings)):
            if before.get(f"figures.{key}") != value:
                raise VoccError(
                    f"name: {folder} holds a report of other figures.{key}: give another name="
                )
    plan, console = plan_figures(settings, config, folder), terminal.Console()
    watch = terminal.Stopwatch(console)
    # The ledgers are open to the end: a second run would write over the same report.
    with run_ledgers.resumable(settings, folder, console), ExitStack() as ledgers:
        with watch.stage("bit error rates"):
            campaign = sweep.Campaign({}, {})
            if ordered := plan.every_study():
                campaign = measure(settings, plan, ordered, folder, ledgers)
            run_folder.write_config(settings, folder)
            report = Report(folder, plan, plan.evidence(campaign))
            for name in plan.names:
                if name in RATE_FIGURES.values():
                    report.add_rates(name)
            if (cells := plan.grid(campaign)) is not None:
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
    run_folder.print_places(console, folder, places, settings.tensorboard)


def measure(
    settings: configs.Settings,
    plan: FigurePlan,
    ordered: Sequence[sweep.Study],
    folder: Path,
    ledgers: ExitStack,
) -> sweep.Campaign:
    """Run every study, each with a ledger, under a live view, and save the first reading's receiver.

    Args:
        settings: the configuration.
        plan: the figures.
        ordered: its studies.
        folder: the run's folder.
        ledgers: closes the ledgers.

    Raises:
        VoccError: whatever a stage refuses.
    """
    total = sum(study.frames for study in ordered)
    with executors.Workers.of(settings) as pool, terminal.ProgressView(total) as view:
        opened = run_ledgers.open_ledgers(ledgers, folder, ordered, view.console)

        def advance(study: sweep.Study, frames: int) -> None:
            view.advance(study.key, frames)

        def finished(study: sweep.Study, _: sweep.Measured) -> None:
            view.say(f"measured {study.key}")

        campaign = sweep.run_campaign(
            ordered, pool, opened, advance=advance, finished=finished
        )
    training = campaign.trainings[ordered[0].key][plan.readings[0].locator]
    run_ledgers.write_training(settings, ordered[0].plan, training, folder)
    return campaign
