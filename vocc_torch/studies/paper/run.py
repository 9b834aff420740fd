"""``task=figures``: the paper's figures and claims, measured, drawn, scored and written as one report."""

import shlex
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig

import vocc_torch
from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file, write_atomically
from vocc_torch.measure import build, curve, executors, grid, sweep, timing
from vocc_torch.measure import config as configs
from vocc_torch.measure.plan import resolve_device
from vocc_torch.report import folder as run_folder
from vocc_torch.report import heatmap, page, styles, tensorboard, terminal
from vocc_torch.report.canvas import Figure, save_figure
from vocc_torch.studies.paper import FiguresConfig, evidence, figures, scorecard, words

TITLE = "The paper's whole evidence, reproduced and scored"


def run_figures(settings: configs.Settings, config: FiguresConfig, folder: Path) -> None:
    """Measure what the paper's figures and claims need, draw, score and report it.

    Args:
        settings: the configuration.
        config: the study's section of it.
        folder: the run's folder.

    Raises:
        VoccError: an unknown figure, focal length or locator, or whatever a stage refuses.
    """
    run_folder.refuse_results(folder, run_folder.LEDGERS)
    if (folder / "report.html").exists():
        there, named = configs.read_flat(folder / run_folder.CONFIG), figures.wanted_figures
        names = there.get("figures.names")
        if not isinstance(names, list) or named(names) != named(config.names):
            raise VoccError(f"name: {folder} holds a report of other figures: give another name=")
    plan, console = build.build_plan(settings, folder), terminal.Console()
    wanted, resumed = figures.paper_plan(config, plan), (folder / run_folder.LEDGERS).is_dir()
    report, watch = Report(folder, wanted), terminal.Stopwatch(console)
    # The ledgers are held to the end: a second run would write over the same report.
    with run_folder.resumable(settings, folder, console), ExitStack() as ledgers:
        if wanted.experiments:
            report.measure(settings, ledgers, watch)
        else:
            run_folder.write_config(settings, folder)
        # After the workers have ended: one of these figures is a measurement of time.
        with watch.stage("other figures"):
            source = evidence.Source(plan)
            for name in (name for name in wanted.figures if name in figures.EVIDENCE):
                one = figures.EVIDENCE[name](source)
                run_folder.write_rows(folder / "figures" / f"{name}.csv", one.rows)
                report.add(name, {name: one.draw()}, one.findings)
        with watch.stage("report"):
            report.score()
            if settings.tensorboard:
                with watch.stage("board"):
                    texts = {"configuration": run_folder.as_markdown(settings)}
                    board = folder / "tensorboard"
                    tensorboard.write_boards(board, report.tables(), report.drawn, texts=texts)
            report.write(settings, dict(watch.seconds), resumed)
        for claim, first, of in report.card.changed() if report.card else ():
            text = f"over {plan.budget.trainings} trainings: {claim.claim}: {first.verdict} -> {of.verdict}"
            console.print(f"{text} ({of.measured})", soft_wrap=True, highlight=False, markup=False)
    places = [("report", "report.html"), ("", "report.md")]
    run_folder.print_places(console, folder, places, settings.tensorboard)


@dataclass
class Report:
    """What was measured and drawn: its files are written as it comes, the report shows it at the end.

    Args:
        folder: the run's folder.
        plan: what is measured.
        shown: the figures by name, in order: each with its ``name``, ``title`` and ``caption``; ``pictures``,
            PNG files relative to the folder with a caption each, the figure's own where that is empty;
            ``table``, its data likewise; and ``findings``, its numbers by name.
        drawn: their pictures, by file name without suffix.
        measured: the experiments by focal length (mm) and name.
        grids: ambient light by luminance, by locator.
        location: how much of the errors is location.
        card: the claims, or None where an experiment was left out.
    """

    folder: Path
    plan: figures.PaperPlan
    shown: dict[str, dict[str, Any]] = field(default_factory=dict)
    drawn: dict[str, Figure] = field(default_factory=dict)
    measured: dict[float, dict[str, curve.Measured]] = field(default_factory=dict)
    grids: dict[str, grid.Grid] = field(default_factory=dict)
    location: tuple[figures.LocationSplit, ...] = ()
    card: scorecard.Scorecard | None = None

    def measure(self, settings: configs.Settings, ledgers: ExitStack, watch: terminal.Stopwatch) -> None:
        """Run every study, each with a ledger, under a live view, and write its figures.

        Args:
            settings: the configuration.
            ledgers: holds the ledgers.
            watch: counts the time of each stage.

        Raises:
            VoccError: whatever a stage refuses.
        """
        ordered, begun = self.plan.studies(), time.perf_counter()
        frames, own = sum(study.frames for study in ordered), ordered[0]
        with executors.Workers.of(settings) as pool, terminal.ProgressView(frames) as view:
            opened = run_folder.open_ledgers(ledgers, self.folder, ordered, view.console)

            def say(what: str, stage: str, frames: str = "") -> None:
                nonlocal begun
                before, begun = begun, watch.lap(stage, begun)
                view.say(f"{what:<20} {frames:>13}   {begun - before:6.1f} s")

            def trained() -> None:
                run_folder.write_config(settings, self.folder)
                say("training", "training")

            def advance(study: sweep.Study, more: int) -> None:
                view.advance(study.key, more)

            def finished(study: sweep.Study, _: curve.Measured) -> None:
                say(study.key, study.plan.experiment.name.partition("/")[0], f"{study.frames} frames")

            campaign = sweep.run_campaign(
                ordered, pool, opened, trained=trained, advance=advance, finished=finished
            )
        self.add_rates(campaign)
        training = campaign.trainings[own.key][self.plan.locators[0]]
        run_folder.write_training(settings, own.plan, training, self.folder)

    def add_rates(self, campaign: sweep.Campaign) -> None:
        """Write the figures of bit error rates, and the comparisons of receivers.

        Raises:
            VoccError: no frame fell into any contrast bin.
        """
        self.measured, self.grids = self.plan.measured(campaign), self.plan.grids(campaign)
        own_mm, locator = self.plan.own
        for name, figure in figures.RATE_FIGURES.items():
            if name not in self.plan.experiments:
                continue
            by_focal_mm = {mm: measured[name] for mm, measured in self.measured.items()}
            if not all(curves.values for of in by_focal_mm.values() for curves in of.curves.values()):
                key, remedy = f"figures.experiments.{name}.values", "widen the bins or the scenes"
                raise VoccError(f"{key}: no frame fell into any contrast bin: {remedy}")
            path, rows = self.folder / "figures" / f"{figure}.csv", figures.rate_rows(by_focal_mm)
            run_folder.write_rows(path, rows, short=True)
            self.add(figure, figures.draw_rates(name, by_focal_mm, self.plan.own))
        if self.grids:
            run_folder.write_grid(self.folder / "figures" / "dimming.csv", self.grids)
            self.add("dimming", heatmap.grid_figures(self.grids, locator, figures.PAPER_RECEIVERS))
        self.location = figures.location_split(self.measured[own_mm])
        if any(split.receiver in figures.PAPER_RECEIVERS for split in self.location):
            lines = [figures.LOCATION_COLUMNS, *(split.row() for split in self.location)]
            run_folder.write_rows(self.folder / "location.csv", lines, short=True)
            self.add("location", {"location": figures.location_figure(self.location, own_mm)})
        curves = [one for of in self.measured[own_mm].values() for one in of.curves.values()]
        run_folder.write_paired(self.folder / "paired.csv", curves)

    def add(
        self, name: str, drawn: Mapping[str, Figure], findings: Mapping[str, float] | None = None
    ) -> None:
        """Save a figure's pictures and remember them for the report and the board."""
        for stem, figure in drawn.items():
            save_figure(figure, self.folder / "figures" / f"{stem}.png")
        about = words.FIGURES[name]
        captions = heatmap.CAPTIONS | about.get("captions", {})
        pictures = [(f"figures/{stem}.png", captions.get(stem.removeprefix(name), "")) for stem in drawn]
        told = {"table": f"figures/{name}.csv", **about, "pictures": pictures, "findings": findings or {}}
        self.shown[name] = {**told, "name": name, "title": about["title"].format(lens_mm=self.plan.own[0])}
        self.drawn |= drawn

    def score(self) -> None:
        """Judge the claims, if every experiment that they need was measured."""
        if set(figures.RATE_FIGURES) <= set(self.measured.get(self.plan.own[0], {})):
            numbers = {name: one["findings"] for name, one in self.shown.items()}
            readings = scorecard.readings_of(self.measured, numbers, self.plan.locators, self.grids)
            self.card = scorecard.score_all(readings, self.plan.own)
            fits = [scorecard.FIT_COLUMNS, *(fit.row() for fit in scorecard.fits(self.card))]
            run_folder.write_rows(self.folder / "scorecard.csv", self.card.rows(), short=True)
            run_folder.write_rows(self.folder / "fits.csv", fits, short=True)

    def tables(self) -> dict[str, list[curve.BerTable]]:
        """The TensorBoard's curves: the report's own focal length with each locator."""
        own_mm, _ = self.plan.own
        tables: dict[str, list[curve.BerTable]] = {}
        for one in self.measured.get(own_mm, {}).values():
            for locator, table in ((name, curves.table()) for name, curves in one.curves.items()):
                # TensorBoard has seven colours; NGR alone, which tells nothing, goes without one.
                shown = figures.only(table, [name for name in table.receivers if name != "flda_ngr"])
                tables.setdefault(f"{own_mm:g}mm-{locator}", []).append(shown)
        return tables

    def write(self, settings: configs.Settings, seconds: Mapping[str, float], resumed: bool) -> None:
        """Write ``report.md`` and ``report.html``, both or neither; what was not measured is left out.

        The template may name what this holds, and whatever :mod:`words` and :mod:`scorecard` hold.

        Args:
            settings: the configuration.
            seconds: wall-clock seconds by stage, in order.
            resumed: whether an earlier run had counted some of the frames.

        Raises:
            VoccError: a picture is missing, or a file cannot be written.
        """
        contrast = self.plan.experiments.get("contrast", {}).get(0.0)
        told = {"title": TITLE, "settings": settings, "seconds": seconds, "resumed": resumed}
        told |= {"configuration": configs.as_yaml(settings), "version": vocc_torch.__version__}
        given = HydraConfig.get().overrides.task if HydraConfig.initialized() else ["task=figures"]
        told |= {"overrides": shlex.join(word for word in given if not word.startswith("name="))}
        told |= {"machine": timing.describe_machine(resolve_device(settings.device))}
        told |= {"contrast_frames": contrast.frames_in_point if contrast else 0}
        told |= {"rate_names": list(figures.RATE_FIGURES.values()), "best_luminance": grid.best_luminance}
        told |= {"receivers": styles.receiver_styles(figures.PAPER_RECEIVERS)}
        names = vars(words) | vars(scorecard) | vars(self) | told
        text = page.render(__package__, "report.md.j2", **names)
        html = page.html(text, TITLE, self.folder)
        with atomic_file(self.folder / "report.md") as temporary:
            temporary.write_bytes(text.encode("utf-8", "replace"))
            write_atomically(self.folder / "report.html", html.encode("utf-8", "replace"))
