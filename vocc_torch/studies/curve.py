"""``task=test``: train, measure bit error rates along an experiment's axis, and report them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.measure import sweep
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.curve import Curves
from vocc_torch.measure.ledger import Label, Ledger, Tally
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.paired import paired_interval
from vocc_torch.measure.plan import SCENE_FIELDS, Plan, identity
from vocc_torch.measure.sweep import point_name
from vocc_torch.measure.train import Training, trained_receiver
from vocc_torch.measure.workers import Workers
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.show import folder as run_folder
from vocc_torch.show.canvas import annotated, enlarged, save_figure
from vocc_torch.show.csv_file import ber_rows, write_paired, write_rows
from vocc_torch.show.plots import ber_figure, feature_histograms
from vocc_torch.show.styles import axis_label, receiver_styles, value_text
from vocc_torch.show.tensorboard import axis_steps, write_boards
from vocc_torch.show.terminal import StudyView, print_table, train_shown
from vocc_torch.simulation.framing import crop_origins_px, panel_centre_px


def run_test(settings: Settings, folder: Path) -> None:
    """Train, measure bit error rates along the experiment's axis or on its grid, and report them."""
    run_folder.refuse_unused(settings)
    run_folder.refuse_results(folder, run_folder.LEDGER)
    plan, console = build_plan(settings, folder), Console()
    # Made before the training, so that a wrong number is refused at once; it starts nothing yet.
    workers = Workers(settings.workers)
    _note_strangers(plan, console)
    if settings.tensorboard:
        try:
            axis_steps(plan.experiment.axis, sweep.axis_values(plan.experiment))
        except VoccError as error:
            hint = "give values further apart, or tensorboard=false"
            raise VoccError(f"experiment.values: {error}; {hint}") from None
    locator = plan.receiver.locator
    with (
        run_folder.resumable(settings, folder, console),
        # Held to the end: a second run would write over the same results.
        run_folder.open_ledger(folder / run_folder.LEDGER, identity(plan, [locator]), console) as ledger,
    ):
        run_folder.write_config(settings, folder)
        training = train_shown(plan, console)
        with workers:
            curves = _sweep(plan, training, ledger, workers, console)
        if not curves.values:
            fault = "no frame fell into any contrast bin"
            raise VoccError(f"experiment.values: {fault}: widen the bins or the scenes")
        _write(settings, plan, training, curves, folder)
    _print(settings, plan, curves, folder, console)


def _write(settings: Settings, plan: Plan, training: Training, curves: Curves, folder: Path) -> None:
    """Write tables, pictures, receiver and board."""
    table = curves.table()
    run_folder.write_training(settings, plan, training, folder)
    write_rows(folder / "ber.csv", ber_rows(table))
    write_paired(folder / "paired.csv", [curves])
    camera, panel = plan.world.camera, plan.world.panel.shape
    seen = f"{panel.rows} x {panel.columns} LEDs, {camera.focal_length_mm:g} mm lens"
    title = f"Bit error rate, experiment “{plan.experiment.name}”: {seen}"
    figure = ber_figure(table, axis_label(table.axis), title)
    save_figure(figure, folder / "ber.png")
    names = [name.upper() for name in FEATURE_NAMES]
    histograms = feature_histograms(training.features, training.bits, names)
    save_figure(histograms, folder / "features.png")
    if settings.tensorboard:
        pictures = sample_frames(plan, trained_receiver(plan, training))
        figures = {"BER": figure, "features by status": histograms}
        texts = {"configuration": run_folder.as_markdown(settings)}
        write_boards(folder / "tensorboard", {"": [table]}, figures, pictures, texts)


def _note_strangers(plan: Plan, console: Console) -> None:
    """Say where the test goes beyond the scenes that the receiver trains on."""
    trained = plan.experiment.training_model(plan.world)
    tested = [plan.experiment.model_at(plan.world, value) for value in sweep.monte_carlo_values(plan)]
    for name in SCENE_FIELDS:
        low = min(getattr(model, name).bounds[0] for model in tested)
        high = max(getattr(model, name).bounds[1] for model in tested)
        least, most = getattr(trained, name).bounds
        if low < least or high > most:
            beyond = f"{name} from {low:g} to {high:g}, and the receiver trains on {least:g} to {most:g}"
            note = f"note: this tests {beyond}; experiment=scenes keeps the scene's own"
            console.print(note, highlight=False, soft_wrap=True)


def _sweep(plan: Plan, training: Training, ledger: Ledger, workers: Workers, console: Console) -> Curves:
    """Measure every point under a live view."""
    locator, outcomes = plan.receiver.locator, {}
    study = sweep.Study(plan.experiment.name, plan, (locator,))
    banks = {study.key: {locator: training.bank(plan.receiver.names)}}
    axis, values, names = plan.experiment.axis, sweep.axis_values(plan.experiment), plan.receiver.names
    runs = len(sweep.monte_carlo_values(plan))
    with StudyView(axis, values, names, plan.frames_in_point, console, runs) as view:

        def show(_: sweep.Study, value: float, frames: int, tallies: Mapping[Label, Tally]) -> None:
            view.count(frames)
            view.show(sweep.points_of(plan, locator, value, tallies, "running"))

        for _, value, outcome in sweep.run_studies([study], banks, {study.key: ledger}, workers, show):
            outcomes[value] = outcome
            view.finish(sweep.points_of(plan, locator, value, outcome.counts, outcome.stopped_by))
    return sweep.measured(study, outcomes).curves[locator]


def _print(settings: Settings, plan: Plan, curves: Curves, folder: Path, console: Console) -> None:
    """Print the table, what was left out, where receivers differ for certain, and where the results are."""
    table = curves.table()
    print_table(table, console)
    lines = []
    rows = table.of(table.receivers[0])
    drawn, counted = plan.frames_in_point, sum(row.frames for row in rows)
    whole = all(row.stopped_by == "frames" for row in rows)
    if plan.experiment.axis == "contrast" and whole and counted < drawn:
        outside = f"{drawn - counted} of {drawn} frames"
        lines.append(f"{outside} have a contrast outside the bins and are not counted")
    if empty := [f"{value:g}" for value in sweep.axis_values(plan.experiment) if value not in table.values]:
        lines.append(f"no frame fell into the bins about {', '.join(empty)}: they are not in the results")
    reference = plan.receiver.save
    if reference in curves.receivers and (told := compared(curves, reference)):
        label = receiver_styles([reference])[reference].label
        lines += [f"\nOn the same frames, against {label} (95 %, paired):", *(f"  {line}" for line in told)]
    for line in lines:
        console.print(line, soft_wrap=True, highlight=False)
    places = {"table": "ber.csv", "pairs": "paired.csv", "figure": "ber.png", "receiver": "receiver.pt"}
    run_folder.print_places(console, folder, places.items(), settings.tensorboard)


SAMPLES = 4
"""Frames drawn for each point."""
SCALE = 6
"""Enlargement: a panel is some 30 pixels wide."""
WIDEST_PX = 1200
"""Widest enlarged frame: a crop of a near panel is large enough as it is."""


def sample_frames(plan: Plan, receiver: Receiver) -> dict[str, NDArray[np.uint8]]:
    """Draw the first frames of each point, plain above and annotated below.

    Args:
        plan: the study.
        receiver: decides the bits that are drawn; where the study takes the true corners, so does it.

    Returns:
        Point name to picture, (H,W,3) uint8.
    """
    # Whole frames enlarged would be pictures of gigabytes; the decisions on crops are the same.
    plan = replace(plan, world=replace(plan.world, framing="crop"), batch_frames=SAMPLES)
    link, pictures = Link.of(plan), {}
    receiver = receiver.to(link.simulator.device)
    for value in sweep.monte_carlo_values(plan):
        name, model = point_name(plan.experiment, value), plan.experiment.model_at(plan.world, value)
        seen = next(link.observe(model, block_keys(plan.seed, name, SAMPLES), preambles=False))
        read = receiver(seen.frames, seen.panels)
        shown = link.simulator.crop_px(model.nearest_m)
        centre = panel_centre_px(seen.scene, link.simulator.camera)
        places = crop_origins_px(centre, shown, link.simulator.camera.sensor_px)
        rows = []
        for i in range(len(seen.frames)):
            pixels, origin = seen.frames.grey[i, 0], seen.frames.origin_px[i]
            if tuple(pixels.shape) == seen.frames.sensor_px:  # a scene that needs the whole sensor
                left, top = places[i].tolist()
                pixels, origin = pixels[top : top + shown[0], left : left + shown[1]], places[i]
            grey = pixels.round().clamp(0, 255).byte().cpu().numpy()
            colour = np.repeat(grey[..., None], 3, axis=2)
            scale = max(1, min(SCALE, WIDEST_PX // grey.shape[1]))
            plain = drawn = np.asarray(enlarged(colour, scale))
            if read.found[i]:
                corners = (read.corners_px[i].cpu() - origin.cpu()).numpy()
                drawn = np.asarray(annotated(colour, corners, read.bits[i].cpu().numpy(), scale))
            rows.append(np.concatenate([plain, drawn]))
        pictures[name] = np.concatenate(rows, axis=1)
    return pictures


def compared(curves: Curves, reference: str) -> list[str]:
    """Say in a line for each other receiver where it differs from a reference for certain.

    Args:
        curves: an experiment.
        reference: a receiver in it.

    Example:
        >>> compared(Curves("d", "distance_m", "truth", ("flda_3",), (), {}, {}, {}), "flda_3")
        []
    """
    lines = []
    for name, style in receiver_styles(curves.receivers).items():
        if name == reference:
            continue
        places: dict[str, list[str]] = {"worse": [], "better": []}
        for value in curves.values:
            found = paired_interval(curves.pair(name, reference, value))
            if found.real:
                places["worse" if found.value > 0 else "better"].append(value_text(value))
        parts = [f"{word} at {', '.join(values)}" for word, values in places.items() if values]
        lines.append(f"{style.label}: {'; '.join(parts) or 'no difference shown'}")
    return lines
