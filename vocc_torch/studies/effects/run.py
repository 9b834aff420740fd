"""``task=effects``: what each effect costs and does, alone and with all others, and over its severity."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from vocc_torch.files import write_atomically
from vocc_torch.measure.config import Settings
from vocc_torch.measure.workers import Workers
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.folder import as_markdown, print_places, refuse_results, refuse_unused, write_config
from vocc_torch.show.page import render
from vocc_torch.show.terminal import ProgressView, Stopwatch
from vocc_torch.studies.effects import EffectsConfig, tables
from vocc_torch.studies.effects.figures import effects_figure
from vocc_torch.studies.effects.gallery import gallery_figure, gallery_pictures, severity_figure
from vocc_torch.studies.effects.plan import build_effect_study
from vocc_torch.studies.effects.results import EffectResults, frames_to_do, measure_costs, run_effects


def run_effects_task(settings: Settings, config: EffectsConfig, folder: Path) -> None:
    """Measure what effects cost and do, and report it.

    Raises:
        VoccError: an unknown effect, a value outside its range, or whatever a stage refuses.
    """
    refuse_unused(settings)
    refuse_results(folder)
    study, console = build_effect_study(settings, config, folder), Console()
    workers, watch = Workers(settings.workers), Stopwatch()
    with watch.stage("times"), console.status("timing every scene"):
        costs = measure_costs(study)
    with watch.stage("bit errors"), ProgressView(frames_to_do(study), console) as view, workers:
        results = run_effects(study, costs, workers, view.advance)
    for stage, seconds in watch.seconds.items():
        console.print(f"{stage:<12} {seconds:6.1f} s", highlight=False)
    write_config(settings, folder)
    places = _write(results, folder, settings)
    tables.print_effects(results, console)
    print_places(console, folder, places.items(), settings.tensorboard)


def _write(results: EffectResults, folder: Path, settings: Settings) -> dict[str, str]:
    """Write tables, pictures, the report and the board; return the names of the files by what they are."""
    study = results.study
    tables.write_effects(folder / "effects.csv", results)
    places = {"table": "effects.csv", "figure": "effects.png"}
    places |= {"report": "effects.md", "pictures": "gallery.png"}
    figures = {"effects": effects_figure(results)}
    if results.severities:
        tables.write_severities(folder / "severity.csv", results)
        figures["severity"] = severity_figure(results)
        places |= {"severity": "severity.csv", "curves": "severity.png"}
    about = f"{study.model.nearest_m:g} m; the middle of the scene's ambient light and LED luminance"
    title = "One panel under each effect, at its harshest"
    figures["gallery"] = gallery_figure(gallery_pictures(study), title, about)
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")
    write_atomically(folder / "effects.md", report(results).encode())
    if settings.tensorboard:
        from vocc_torch.show.tensorboard import write_boards

        write_boards(folder / "tensorboard", {}, figures, {}, {"configuration": as_markdown(settings)})
    return places


def report(results: EffectResults) -> str:
    """Write the table and the pictures as Markdown, for a reader who was not there."""
    readings, shown = tables.readings_of(results), results.study.shown
    base = [tables.base_counts(results, reading, shown) for reading in readings]
    return render(
        __package__,
        "effects.md.j2",
        results=results,
        readings=readings,
        base=["" if one is None else tables.thousandths(one.ber, sign=False) for one in base],
        scene=tables.scene_text(results),
        notes=tables.notes(results),
        ms=tables.ms_text,
        signs=tables.signs_of,
        thousandths=tables.thousandths,
        interval=tables.interval_text,
    )
