"""What each task does and writes: studies and reports put together."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console

from vocc_torch.assembly import build_plan
from vocc_torch.config import AppConfig, as_yaml
from vocc_torch.errors import VoccError
from vocc_torch.evaluation.curve import BerTable, Point
from vocc_torch.files import write_atomically
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.reporting.csv_file import write_table
from vocc_torch.reporting.plots import ber_figure, feature_histograms, save_figure
from vocc_torch.reporting.styles import axis_label
from vocc_torch.reporting.tensorboard import axis_steps, board_hint, write_board
from vocc_torch.reporting.terminal import StudyView, print_table
from vocc_torch.studies.decode import (
    COLUMNS,
    Reading,
    annotated,
    bits_csv,
    decode,
    receiver_for,
    save_picture,
)
from vocc_torch.studies.gallery import sample_frames
from vocc_torch.studies.link import Link
from vocc_torch.studies.plan import Plan
from vocc_torch.studies.sweep import axis_values, frames_in_point, monte_carlo_values, sweep_point
from vocc_torch.studies.train import Training, train, trained_receiver

DOUBTFUL_SCORE = 0.6
"""Noise that fills a 4:3 picture scores 0.56; of the paper's scenes one in fifty scores less than this."""


def run_train(settings: AppConfig, folder: Path) -> None:
    """Train FLDA and write the receiver."""
    _prepare(settings, folder)
    plan, console = build_plan(settings, folder), Console()
    training = _train(plan, console)
    _write_training(settings, plan, training, folder)
    console.print(f"receiver  {folder / 'receiver.pt'}", soft_wrap=True, highlight=False)


def run_test(settings: AppConfig, folder: Path) -> None:
    """Train, measure bit error rates along the experiment's axis, and report them."""
    _prepare(settings, folder)
    plan, console = build_plan(settings, folder), Console()
    if settings.tensorboard:
        _check_steps(plan)
    training = _train(plan, console)
    table = BerTable(_sweep(plan, training, console))
    if not len(table):
        raise VoccError(
            "experiment.values: no frame fell into any contrast bin: widen the bins or the scenes"
        )
    _write_training(settings, plan, training, folder)
    write_table(folder / "ber.csv", table)
    figure = ber_figure(table, axis_label(table.axis), _title(plan))
    save_figure(figure, folder / "ber.png")
    histograms = feature_histograms(
        training.features, training.bits, [name.upper() for name in FEATURE_NAMES]
    )
    save_figure(histograms, folder / "features.png")
    if settings.tensorboard:
        pictures = sample_frames(plan, trained_receiver(plan, training))
        figures = {"BER": figure, "features by status": histograms}
        texts = {"configuration": _as_markdown(settings)}
        with _quiet_threads():
            write_board(folder / "tensorboard", table, figures, pictures, texts)
    print_table(table, console)
    _print_left_out(console, plan, table)
    _print_places(console, settings, folder)


def run_decode(settings: AppConfig, folder: Path) -> None:
    """Decode a recording and write its bits and annotated pictures.

    Raises:
        VoccError: no input, or an input without a panel.
    """
    _prepare(settings, folder)
    if settings.input is None:
        raise VoccError("input is null: task=decode needs input=PICTURE, a folder of pictures or a video")
    if not 1 <= settings.decode.scale <= 16:
        raise VoccError(f"decode.scale is {settings.decode.scale}: it must be from 1 to 16")
    source, console = Path(settings.input), Console()
    if not source.exists():
        raise VoccError(f"input {source} does not exist: give a picture, a folder of pictures or a video")
    plan = build_plan(settings, folder)
    receiver = receiver_for(plan, None if settings.model is None else Path(settings.model))
    try:
        rows, best = _read(settings, receiver, source, folder)
    except BaseException:
        shutil.rmtree(folder / "annotated", ignore_errors=True)
        raise
    if best is None:
        hint = "see receiver.location for the locator's limits, and decode.channel for coloured LEDs"
        raise VoccError(f"input {source} shows no panel in {len(rows)} of {len(rows)} frames: {hint}")
    write_atomically(folder / "bits.csv", bits_csv(rows))
    write_atomically(folder / "config.yaml", as_yaml(settings).encode())
    if settings.model is None:
        receiver.save(folder / "receiver.pt")
    found = sum(bool(row[COLUMNS.index("bits")]) for row in rows)
    _show_bits(console, best, f"{found} of {len(rows)} frames show a panel")
    console.print(f"bits      {folder / 'bits.csv'}", soft_wrap=True, highlight=False)


def _read(
    settings: AppConfig, receiver: Receiver, source: Path, folder: Path
) -> tuple[list[list[str]], Reading | None]:
    """Decode every frame and write the annotated pictures; give the rows and the reading of most margin."""
    rows, best, names = [], None, set[str]()
    for reading in decode(receiver, source, settings.decode.channel):  # type: ignore[arg-type]  # checked there
        rows.append(reading.row())
        if not reading.found:
            continue
        if settings.decode.annotate and reading.frame.time_s is None:
            stem = Path(reading.frame.source).stem
            # a.png and a.jpg of one folder are two pictures
            name = reading.frame.source if stem in names else stem
            names.add(stem)
            save_picture(annotated(reading, settings.decode.scale), folder / "annotated" / f"{name}.png")
        best = reading if best is None or reading.margin > best.margin else best
    return rows, best


def _prepare(settings: AppConfig, folder: Path) -> None:
    """Refuse what the task would pass over, and a folder that holds results, before any work is done."""
    if settings.task != "decode":
        for name in ("input", "model"):
            value = getattr(settings, name)
            if value is not None:
                raise VoccError(
                    f"{name} is {value!r}: it must be null for task={settings.task}; only task=decode uses it"
                )
    holds = sorted(entry.name for entry in folder.iterdir()) if folder.is_dir() else []
    if holds:
        raise VoccError(f"name: {folder} already holds {holds[0]}: give another name=, or delete the folder")


def _check_steps(plan: Plan) -> None:
    """Refuse values that TensorBoard cannot tell apart, before any work is done."""
    try:
        axis_steps(plan.experiment.axis, axis_values(plan.experiment))
    except VoccError as error:
        raise VoccError(
            f"experiment.values: {error}; give values further apart, or tensorboard=false"
        ) from None


def _train(plan: Plan, console: Console) -> Training:
    """Train under a spinner, and say what was learnt from."""
    with console.status(f"training on {plan.budget.training_frames} frames"):
        training = train(plan)
    missed = f", {training.missed} without a located panel left out" if training.missed else ""
    console.print(f"trained on {training.frames} frames{missed}", highlight=False)
    return training


def _sweep(plan: Plan, training: Training, console: Console) -> list[Point]:
    """Measure every point under a live view."""
    link, points = Link.of(plan), []
    values = axis_values(plan.experiment)
    frames = frames_in_point(plan)
    runs = monte_carlo_values(plan)
    with StudyView(plan.experiment.axis, values, plan.receiver.names, frames, console, len(runs)) as view:
        for value in runs:
            measured = sweep_point(plan, link, training.flda, value, view.advance, view.show)
            view.finish(measured)
            points += measured
    return points


def _write_training(settings: AppConfig, plan: Plan, training: Training, folder: Path) -> None:
    """Write the receiver and the configuration it came from."""
    trained_receiver(plan, training).save(folder / "receiver.pt")
    write_atomically(folder / "config.yaml", as_yaml(settings).encode())


@contextmanager
def _quiet_threads() -> Iterator[None]:
    """Keep TensorBoard's writing thread from printing the OSError that ``write_board`` then raises."""
    shown = threading.excepthook
    threading.excepthook = lambda failure: None if issubclass(failure.exc_type, OSError) else shown(failure)
    try:
        yield
    finally:
        threading.excepthook = shown


def _title(plan: Plan) -> str:
    """Say what the BER figure shows."""
    camera, panel = plan.world.camera, plan.world.panel.shape
    seen = f"{panel.rows} x {panel.columns} LEDs, {camera.focal_length_mm:g} mm lens"
    return f"Bit error rate, experiment “{plan.experiment.name}”: {seen}"


def _as_markdown(settings: AppConfig) -> str:
    """The configuration as TensorBoard shows text."""
    return "```yaml\n" + as_yaml(settings) + "\n```"


def _print_left_out(console: Console, plan: Plan, table: BerTable) -> None:
    """Say how many frames of a contrast experiment fell outside its bins."""
    rows = table.of(table.receivers[0])
    drawn, counted = frames_in_point(plan), sum(row.frames for row in rows)
    whole = all(row.stopped_by == "frames" for row in rows)
    if plan.experiment.axis == "contrast" and whole and counted < drawn:
        text = f"{drawn - counted} of {drawn} frames have a contrast outside the bins and are not counted"
        console.print(text, soft_wrap=True, highlight=False)


def _print_places(console: Console, settings: AppConfig, folder: Path) -> None:
    """Say where the results are."""
    for name, what in (("ber.csv", "table"), ("ber.png", "figure"), ("receiver.pt", "receiver")):
        console.print(f"{what:<9} {folder / name}", soft_wrap=True, highlight=False)
    if settings.tensorboard:
        console.print(f"board     {board_hint(folder / 'tensorboard')}", soft_wrap=True, highlight=False)


def _show_bits(console: Console, reading: Reading, summary: str) -> None:
    """Print the bits as they sit on the panel."""
    plain = console.options.ascii_only
    on, off = ("#", ".") if plain else ("●", "·")
    for row in reading.bits:
        console.print("  " + " ".join(on if bit else off for bit in row), highlight=False)
    console.print(reading.text, soft_wrap=True, highlight=False)
    others = f"; {reading.candidates} blobs could have been the panel" if reading.candidates > 1 else ""
    doubt = ", which may be no panel" if reading.panel_score < DOUBTFUL_SCORE else ""
    score = f"panel score {reading.panel_score:.2f}{doubt}"
    where = reading.frame.source + ("" if reading.frame.time_s is None else f", frame {reading.frame.index}")
    judged = f"{where}: least margin {reading.margin:.3g}, {score}{others}; {summary}"
    console.print(judged, soft_wrap=True, highlight=False)
