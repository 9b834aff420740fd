"""``task=effects``: what each effect costs and does, alone and with all others, and over its severity."""

from pathlib import Path

from rich.console import Console

from vocc_torch.files import write_atomically
from vocc_torch.measure.config import Settings
from vocc_torch.measure.workers import Workers
from vocc_torch.show import folder as run_folder
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.tensorboard import write_boards
from vocc_torch.show.terminal import ProgressView, Stopwatch
from vocc_torch.studies.effects import EffectsConfig, figures, tables
from vocc_torch.studies.effects.plan import build_effect_study
from vocc_torch.studies.effects.results import EffectResults, frames_to_do, measure_costs, run_effects


def run_effects_task(settings: Settings, config: EffectsConfig, folder: Path) -> None:
    """Measure what effects cost and do, and report it.

    Raises:
        VoccError: an unknown effect, a value outside its range, or whatever a stage refuses.
    """
    run_folder.refuse_unused(settings)
    run_folder.refuse_results(folder)
    study, console = build_effect_study(settings, config, folder), Console()
    workers, watch = Workers(settings.workers), Stopwatch()
    with watch.stage("times"), console.status("timing every scene"):
        costs = measure_costs(study)
    with watch.stage("bit errors"), ProgressView(frames_to_do(study), console) as view, workers:
        results = run_effects(study, costs, workers, view.advance)
    for stage, seconds in watch.seconds.items():
        console.print(f"{stage:<12} {seconds:6.1f} s", highlight=False)
    run_folder.write_config(settings, folder)
    places = write_results(results, folder, settings)
    tables.print_effects(results, console)
    run_folder.print_places(console, folder, places.items(), settings.tensorboard)


def write_results(results: EffectResults, folder: Path, settings: Settings) -> dict[str, str]:
    """Write tables, pictures, the report and the board; return the names of the files by what they are."""
    tables.write_effects(folder / "effects.csv", results)
    places = {"table": "effects.csv", "figure": "effects.png"}
    places |= {"report": "effects.md", "pictures": "gallery.png"}
    drawn = {"effects": figures.effects_figure(results)}
    if results.severities:
        tables.write_severities(folder / "severity.csv", results)
        drawn["severity"] = figures.severity_figure(results)
        places |= {"severity": "severity.csv", "curves": "severity.png"}
    drawn["gallery"] = figures.gallery_figure(results.study)
    for name, figure in drawn.items():
        save_figure(figure, folder / f"{name}.png")
    write_atomically(folder / "effects.md", tables.report(results).encode())
    if settings.tensorboard:
        texts = {"configuration": run_folder.as_markdown(settings)}
        write_boards(folder / "tensorboard", {}, drawn, {}, texts)
    return places
