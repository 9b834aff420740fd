"""``task=train``, and ``task=test``: bit error rates along an axis or on a grid, and their report."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from vocc_torch.errors import VoccError
from vocc_torch.measure import (
    build,
    config,
    curve,
    grid,
    sweep,
    timing,
    train,
)
from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Plan
from vocc_torch.plugins import PlugIn
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.report import folder as run_folder
from vocc_torch.report import (
    heatmap,
    led_plots,
    page,
    plots,
    rate_tables,
    samples,
    styles,
    tensorboard,
    terminal,
)
from vocc_torch.report.annotation import annotated, enlarged
from vocc_torch.rng import BlockKey
from vocc_torch.studies.run import Run, begin, cases_of, write_training


def run_train(settings: config.Settings, folder: Path) -> None:
    """Train FLDA and write the receiver."""
    plan, console = build.build_plan(settings), terminal.Console()
    with run_folder.resumable(settings, folder, console):
        samples.write_samples(folder, plan, ["train"])
        learners = 1 + len(plan.receiver.classifiers)
        with terminal.ProgressView(learners, console, unit="") as view:
            training = train.train(plan, partial(view.advance, "training"))
        write_training(settings, plan, training, folder)
    run_folder.say(console, *terminal.trained_lines(training), kept(plan))
    run_folder.print_places(console, folder, [("receiver", "receiver.pt")])


def run_test(settings: config.Settings, folder: Path) -> None:
    """Train, measure bit error rates along the experiment's axis or on its grid, and report them.

    A grid is a curve for each of its rows.

    Raises:
        VoccError: values that TensorBoard cannot tell apart, or whatever a stage refuses.
    """
    plan, console = build.build_plan(settings), terminal.Console()
    drawing = {}
    if target := plan.budget.sampling:
        drawing["prepare"] = PlugIn.of("budget.sampling", target).made
    if settings.tensorboard:
        demand_steps(plan.experiment)
    # Held to the end: a second run would write over the same results.
    with begin(settings, folder, plan, 2) as run, run.pool, timing.threads(1):
        samples.write_samples(folder, plan)
        run.train([plan])
        training = run.training(plan)
        run_folder.say(console, *terminal.trained_lines(training))
        curves = count_curves(run, plan, **drawing)
        figures = write_results(settings, plan, training, curves, folder)
    for measured in curves:
        if plan.experiment.row_axis:
            run_folder.say(console, f"\n{measured.experiment}")
        terminal.print_table(measured, console)
        run_folder.say(console, *notes_on(plan, measured))
    run_folder.say(console, kept(plan))
    written = [("table", "ber.csv"), ("pairs", "paired.csv")]
    written += [("figure", f"{name}.png") for name in figures]
    written += [("receiver", "receiver.pt")]
    run_folder.print_places(console, folder, written, settings.tensorboard)


def count_curves(run: Run, plan: Plan, **drawing: sweep.Prepare) -> list[curve.Curves]:
    """Count a curve, or each of a grid's rows, and print a line for every value.

    Args:
        run: workers, store and console.
        plan: the study, which is trained.
        **drawing: ``prepare`` of :func:`vocc_torch.measure.sweep.outcomes`.

    Raises:
        VoccError: no frame in any contrast bin.
    """
    rows, locator = plan.rows().values(), plan.receiver.locator
    jobs = [run.job(case) for row in rows for case in cases_of(row, [plan])]
    curves = []
    with run.stage("bit error rates", plan.frames_in_point * len(jobs)) as advance:
        outcomes = sweep.outcomes(jobs, run.pool, run.store, advance, **drawing)
        for row in rows:
            found = {}
            for at in row.experiment.simulated_values:
                found[at] = next(outcomes)
                points = sweep.curves_at(row, locator, {at: found[at]})
                rates = run.console.is_terminal
                run_folder.say(run.console, *terminal.point_lines(points, rates=rates))
            curves.append(sweep.curves_at(row, locator, found))
            if not curves[-1].values:
                raise VoccError(
                    "experiment.values: no frame fell into any contrast bin:"
                    " widen the bins or the scenes"
                )
    return curves


def demand_steps(experiment: config.Experiment) -> None:
    """Refuse values that TensorBoard cannot tell apart.

    Raises:
        VoccError: with what to give instead.
    """
    try:
        tensorboard.axis_steps(experiment.axis, experiment.result_values)
    except VoccError as error:
        raise VoccError(
            f"experiment.values: {error};"
            " give values further apart, or tensorboard=false"
        ) from None


def kept(plan: Plan) -> str:
    """Say which receiver is saved, and with which locator."""
    locator = plan.receiver.locator
    if locator == "truth":
        locator = "paper: a recording has no true corners"
    return f"receiver.pt holds {plan.receiver.save} with the locator {locator}"


def write_results(
    settings: config.Settings,
    plan: Plan,
    training: train.Training,
    curves: Sequence[curve.Curves],
    folder: Path,
) -> list[str]:
    """Write tables, pictures, receiver and board of a curve, or of a grid's rows.

    Args:
        settings: the run's.
        plan: the study.
        training: the trained receivers.
        curves: what was measured, by row.
        folder: where they go.

    Returns:
        The names of the figures.
    """
    write_training(settings, plan, training, folder)
    rate_tables.write_paired(folder / "paired.csv", curves)
    names, board = plan.receiver.names, {}
    if axis := plan.experiment.row_axis:
        cells = grid.Grid(axis, plan.experiment.rows, curves)
        rate_tables.write_grid(folder / "ber.csv", cells)
        figures = {f"dimming_{cells.locator}": heatmap.dimming_figure(cells, names)}
        titles = (f"{axis}={at:g}" for at in cells.rows)
        tables = {title: [row] for title, row in zip(titles, curves, strict=True)}
    else:
        (table,) = curves
        run_folder.write_rows(folder / "ber.csv", rate_tables.ber_rows(table))
        camera, panel = plan.world.camera, plan.world.panel.shape
        title = (
            f"Bit error rate, experiment “{plan.experiment.name}”:"
            f" {panel.rows} x {panel.columns} LEDs, {camera.focal_length_mm:g} mm lens"
        )
        features = [
            name.upper() if name in FEATURE_NAMES else name
            for name in plan.receiver.reader.names
        ]
        tables = {"": [table]}
        figures = {
            "ber": plots.ber_figure(table, title),
            "features": led_plots.feature_histograms(
                training.features, training.bits, features
            ),
        }
        if settings.tensorboard:
            receiver = train.trained_receiver(plan, training)
            board["images"] = sample_frames(plan, receiver)
    tensorboard.write_figures(settings, folder, figures, tables, **board)
    return list(figures)


def notes_on(plan: Plan, curves: curve.Curves) -> list[str]:
    """Say what is not in the results, where errors come from, and which receivers differ from the reference."""
    reference, names = plan.receiver.reference, curves.receivers
    totals = {name: curves.total(name) for name in names}
    best = min(totals, key=lambda name: totals[name].ber)
    differences = {
        name: {
            styles.value_text(value): curves.difference(name, reference, value)
            for value in curves.values
        }
        for name in names
        if reference in names and curves.errors and name != reference
    }
    text = page.render(
        __package__,
        "notes.txt.j2",
        plan=plan,
        curves=curves,
        best=best,
        counts=totals[best],
        is_spent=all(row.stopped_by == "frames" for row in curves.of(best)),
        differences=differences,
    )
    return text.splitlines()


def sample_frames(plan: Plan, receiver: Receiver) -> dict[str, plots.Pixels]:
    """Draw the first frames of each point, plain above and annotated below.

    Args:
        plan: the study.
        receiver: decides the bits that are drawn; where the study takes the true corners, so does it.

    Returns:
        Point name to picture, (H,W,3) uint8.
    """
    most = 4  # frames for each point
    # Whole frames enlarged would be pictures of gigabytes; the decisions on crops are the same.
    plan = replace(plan, world=replace(plan.world, framing="crop"), batch_frames=most)
    link, pictures = Link.of(plan), {}
    receiver = receiver.to(link.simulator.device)
    for name, model in sweep.scenes_of(plan, "test").items():
        key, columns = BlockKey(plan.seed, name, 0), []
        observation = next(link.observe(model, [key], preambles=False))
        read = receiver(observation.frames, observation.panels)
        crops = samples.crops(link.simulator, key, model, most, model.nearest_m)
        for i, crop in enumerate(crops):
            # A panel is some 30 pixels wide; a crop of a near one is large enough as it is.
            scale = max(1, min(6, 1200 // crop.pixels.shape[1]))
            plain = drawn = enlarged(crop.pixels, scale)
            if read.found[i]:
                corners = (read.corners_px[i].cpu() - crop.origin_px).numpy()
                bits = read.bits[i].cpu().numpy()
                drawn = annotated(crop.pixels, corners, bits, scale)
            columns.append(np.concatenate([plain, drawn]))
        pictures[name] = np.concatenate(columns, axis=1)
    return pictures
