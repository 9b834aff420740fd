"""``task=effects``: what each effect costs and does, alone and with all others, and over its severity."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from vocc_torch.files import write_atomically
from vocc_torch.measure.config import Settings
from vocc_torch.measure.workers import Workers
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.folder import as_markdown as settings_as_markdown
from vocc_torch.show.folder import print_place, refuse_results, refuse_unused, write_config
from vocc_torch.show.quiet import quiet_threads
from vocc_torch.show.report import as_markdown
from vocc_torch.show.stopwatch import Stopwatch
from vocc_torch.show.terminal_campaign import CampaignView
from vocc_torch.studies.effects.build import build_effect_study
from vocc_torch.studies.effects.config import EffectsConfig
from vocc_torch.studies.effects.costs import measure_costs
from vocc_torch.studies.effects.effects_csv import write_effects, write_severities
from vocc_torch.studies.effects.effects_figure import effects_figure
from vocc_torch.studies.effects.effects_gallery import gallery_figure
from vocc_torch.studies.effects.effects_report import effects_report
from vocc_torch.studies.effects.effects_table import print_effects
from vocc_torch.studies.effects.gallery_pictures import gallery_pictures
from vocc_torch.studies.effects.plan import EffectStudy
from vocc_torch.studies.effects.severity_figure import severity_figure
from vocc_torch.studies.effects.study import EffectResults, frames_to_do, run_effects


def run_effects_task(settings: Settings, config: EffectsConfig, folder: Path) -> None:
    """Measure what effects cost and do, and report it.

    Raises:
        VoccError: an unknown effect, a value outside its range, or whatever a stage refuses.
    """
    refuse_unused(settings)
    refuse_results(folder)
    study, console = build_effect_study(settings, config, folder), Console()
    results = _measure(study, Workers(settings.workers), console)
    _write(settings, study, results, folder)
    print_effects(results.table, console)
    _print_places(console, settings, results, folder)


def _measure(study: EffectStudy, workers: Workers, console: Console) -> EffectResults:
    """Time every scene, and then count errors with all the workers."""
    watch = Stopwatch()
    with watch.stage("times"), console.status("timing every scene"):
        costs = measure_costs(study)
    with (
        watch.stage("bit errors"),
        CampaignView(frames_to_do(study), console) as view,
        workers,
    ):
        results = run_effects(study, costs, workers, view.advance)
    for stage, seconds in watch.seconds.items():
        console.print(f"{stage:<12} {seconds:6.1f} s", highlight=False)
    return results


def _write(settings: Settings, study: EffectStudy, results: EffectResults, folder: Path) -> None:
    """Write tables, pictures, the report and the board."""
    table, curves = results.table, results.severities
    write_config(settings, folder)
    write_effects(folder / "effects.csv", table)
    figures = {"effects": effects_figure(table)}
    if curves:
        write_severities(folder / "severity.csv", curves)
        figures["severity"] = severity_figure(curves, table)
    about = f"{study.model.nearest_m:g} m; the middle of the scene's ambient light and LED luminance"
    title = "One panel under each effect, at its harshest"
    figures["gallery"] = gallery_figure(gallery_pictures(study), title, about)
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")
    report = effects_report(table, [folder / f"{name}.png" for name in figures])
    write_atomically(folder / "effects.md", as_markdown(report, folder).encode())
    if settings.tensorboard:
        from vocc_torch.show.tensorboard import write_boards

        texts = {"configuration": settings_as_markdown(settings)}
        with quiet_threads():
            write_boards(folder / "tensorboard", {}, figures, {}, texts)


def _print_places(console: Console, settings: Settings, results: EffectResults, folder: Path) -> None:
    """Say where the results are."""
    places = {"table": "effects.csv", "figure": "effects.png", "report": "effects.md"}
    places["pictures"] = "gallery.png"
    if results.severities:
        places |= {"severity": "severity.csv", "curves": "severity.png"}
    for what, name in places.items():
        print_place(console, what, folder / name)
    if settings.tensorboard:
        from vocc_torch.show.tensorboard import board_hint

        print_place(console, "board", board_hint(folder / "tensorboard"))
