"""``task=classifiers``: many receivers on the same frames, with what they cost, and across scenes."""

from collections.abc import Iterator
from pathlib import Path

from vocc_torch.files import write_atomically
from vocc_torch.measure import config, counts, estimate, executors, intervals
from vocc_torch.report import folder as run_folder
from vocc_torch.report import styles, tensorboard, terminal
from vocc_torch.studies.compare import RivalsConfig, rival_figures
from vocc_torch.studies.compare.rival_results import (
    Comparison,
    ratio_text,
    summary,
)
from vocc_torch.studies.compare.rivals import (
    build_classifier_study,
    compare_classifiers,
)
from vocc_torch.studies.compare.run import Run

ENDS = ("ber", "ber_low", "ber_high")
COUNTED = ("frames", "bits", "bit_errors", *ENDS)
RATIO = ("ratio", "ratio_low", "ratio_high")
WIDE_COLUMNS = 110
"""Least terminal width at which frames, parameters and sizes have columns too."""


def run_classifiers(
    settings: config.Settings, rivals: RivalsConfig, folder: Path
) -> None:
    """Compare receivers, and report it.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    run_folder.refuse_results(folder, run_folder.LEDGER)
    study = build_classifier_study(settings, rivals, folder)
    console = terminal.Console()
    ledger = folder / run_folder.LEDGER
    with (
        run_folder.resumable(settings, folder, console),
        run_folder.open_ledger(ledger, study.identity, console) as store,
    ):
        run_folder.write_config(settings, folder)
        stages = 3 + 2 * bool(study.scene_plans)
        with executors.Workers.of(settings) as pool:
            run = Run(pool, store, console, stages)
            comparison, training = compare_classifiers(study, run)
    run_folder.write_training(settings, study.base, training, folder)
    write_tables(folder, comparison)
    words = summary(comparison)
    write_atomically(folder / "summary.txt", words.encode())
    figures = {
        name: rival_figures.curves_figure(comparison, name)
        for name in comparison.curves
    }
    if comparison.transfers:
        figures["robustness"] = rival_figures.scenes_figure(comparison)
    tensorboard.write_figures(
        settings,
        folder,
        figures,
        {"": list(comparison.tables.values())},
        texts={"summary": f"```\n{words}\n```"},
        numbers=board_numbers(comparison),
    )
    print_table(comparison, console)
    words = summary(comparison, min(100, console.width))
    console.print(terminal.Text(words), soft_wrap=True)
    places = [
        ("table", "classifiers.csv"),
        ("points", "ber.csv"),
        ("pairs", "paired.csv"),
    ]
    places += [("scenes", "robustness.csv")] if comparison.transfers else []
    places += [("figure", f"{name}.png") for name in figures]
    run_folder.print_places(console, folder, places, settings.tensorboard)


def write_tables(folder: Path, comparison: Comparison) -> None:
    """Write points, pairs and costs and, where they were measured, the scenes.

    Args:
        folder: where they go.
        comparison: what was measured.

    Raises:
        VoccError: a file cannot be written.
    """
    head, *_ = run_folder.ber_rows(next(iter(comparison.tables.values())))
    rows = [
        row
        for table in comparison.tables.values()
        for row in run_folder.ber_rows(table)[1:]
    ]
    run_folder.write_rows(folder / "ber.csv", [head, *rows], short=True)
    run_folder.write_paired(folder / "paired.csv", comparison.curves.values())
    tables = {"classifiers": classifier_lines(comparison)}
    if comparison.transfers:
        tables["robustness"] = scene_lines(comparison)
    for name, lines in tables.items():
        run_folder.write_rows(folder / f"{name}.csv", lines, short=True)


def ends(found: estimate.Estimate | None) -> run_folder.Cells:
    """Give an estimate's cells."""
    return (None, None, None) if found is None else (found.value, found.low, found.high)


def counted(errors: counts.Counts) -> run_folder.Cells:
    """Give the cells of ``COUNTED``."""
    rate = intervals.ber_interval(errors)
    return errors.frames, errors.bits, errors.bit_errors, *ends(rate)


def classifier_lines(comparison: Comparison) -> Iterator[run_folder.Cells]:
    """Give head and lines of ``classifiers.csv``: what each receiver costs, its rates, the best first.

    ``bits_ms`` is the time from the rectified panel to a frame's bits. Rates and ratios are at the summary's
    points; after several trainings they are the algorithms'.
    """
    points = [
        f"{name}_{at:g}_{quantity}"
        for name, at in comparison.points.items()
        for quantity in (*ENDS, *RATIO)
    ]
    costs = ("training_s", "simulated_s", "training_frames", "parameters", "size_bytes")
    yield ("receiver", *costs, "bits_ms", *points)
    for receiver in comparison.ranked:
        cost = comparison.costs[receiver]
        line: list[str | int | float | None] = [
            receiver,
            cost.training_s,
            cost.simulated_s,
            cost.frames,
            cost.parameters,
            cost.size_bytes,
            comparison.decision_ms.get(receiver),
        ]
        for experiment, value in comparison.points.items():
            line += ends(comparison.rate(experiment, receiver, value))
            line += ends(comparison.ratio(experiment, receiver, value))
        yield line


def scene_lines(comparison: Comparison) -> Iterator[run_folder.Cells]:
    """Give head and lines of ``robustness.csv``, a line for each pair of scenes and receiver.

    ``ratio``: to the same receiver trained on the scenes of the test; empty where that one made no error.
    """
    head = ("trained_on", "tested_on", "receiver", *COUNTED)
    yield (*head, "frame_errors", "panels_missed", *RATIO)
    for move in comparison.transfers:
        place = move.trained_on, move.tested_on, move.receiver
        wrong = move.counts.frame_errors, move.counts.panels_missed
        yield (*place, *counted(move.counts), *wrong, *ends(move.ratio))


def board_numbers(comparison: Comparison) -> dict[str, dict[str, float]]:
    """Give each receiver's rates at the summary's points, and its costs, for its row of the HPARAMS tab."""
    numbers: dict[str, dict[str, float]] = {}
    for receiver in comparison.ranked:
        row: dict[str, float | None] = {"bits_ms": comparison.decision_ms.get(receiver)}
        for experiment, value in comparison.points.items():
            point = f"{experiment}_{styles.value_text(value)}"
            if rate := comparison.rate(experiment, receiver, value):
                row[f"BER/{point}"] = rate.value
            if ratio := comparison.ratio(experiment, receiver, value):
                row[f"of_{comparison.reference}/{point}"] = ratio.value
        if cost := comparison.costs.get(receiver):
            row |= {
                "making/training_s": cost.training_s,
                "making/training_frames": cost.frames,
                "making/parameters": cost.parameters,
                "making/size_bytes": cost.size_bytes,
            }
        numbers[receiver] = {
            name: float(number) for name, number in row.items() if number is not None
        }
    return numbers


def print_table(comparison: Comparison, console: terminal.Console) -> None:
    """Print a line for each receiver, the best first.

    Under a rate stands its interval. What learns nothing has no training.

    Args:
        comparison: what was measured.
        console: where to print.
    """
    wide = console.width >= WIDE_COLUMNS
    heads = ["receiver"]
    for name in comparison.points:
        heads += [f"BER at\n{comparison.point_label(name)}"]
        heads += [f"of\n{comparison.reference}"]
    heads += ["training\ns", *(["frames", "para-\nmeters", "kB"] if wide else [])]
    table = terminal.plain_table(*heads, "bits\nms")
    first = table.columns[0]
    first.justify, first.no_wrap, first.overflow = "left", False, "fold"
    for receiver in comparison.ranked:
        line = [receiver]
        for name, value in comparison.points.items():
            ratio = comparison.ratio(name, receiver, value)
            line.append(point_text(comparison, name, receiver, value))
            line.append("" if ratio is None else ratio_text(ratio))
        cost = comparison.costs.get(receiver)
        if cost is not None:
            learned = cost.frames > 0
            size = cost.size_bytes if learned else None
            line.append(f"{cost.training_s:.1f}" if learned else "")
            if wide:
                line.append(str(cost.frames or ""))
                line.append("" if cost.parameters is None else str(cost.parameters))
                line.append("" if size is None else f"{size / 1000:.3g}")
            line.append(f"{comparison.decision_ms[receiver]:.2g}")
        table.add_row(*map(terminal.Text, line))
    console.print(table)


def point_text(
    comparison: Comparison, experiment: str, receiver: str, value: float
) -> str:
    """Write a rate with its interval below, or its limit."""
    rate = comparison.rate(experiment, receiver, value)
    if rate is None:
        return ""
    if rate.value:
        interval = styles.ends_text(rate.low, rate.high)
        return f"{styles.rate_text(rate.value)}\n{interval}"
    return f"< {styles.rate_text(rate.high)}"
