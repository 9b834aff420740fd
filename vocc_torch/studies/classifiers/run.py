"""``task=classifiers``: many receivers on the same frames, with what they cost, and across scenes."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from vocc_torch.files import write_atomically
from vocc_torch.measure import curve, intervals
from vocc_torch.measure.config import Settings
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.paired import paired_interval, sign_test
from vocc_torch.measure.plan import identity
from vocc_torch.measure.workers import Workers
from vocc_torch.show import folder as run_folder
from vocc_torch.show import styles, tensorboard
from vocc_torch.show.canvas import Figure, save_figure
from vocc_torch.show.terminal import Console, ProgressView, Text, plain_table
from vocc_torch.studies.classifiers import RivalsConfig
from vocc_torch.studies.classifiers.figures import curves_figure, scenes_figure
from vocc_torch.studies.classifiers.plan import build_classifier_study
from vocc_torch.studies.classifiers.results import GENIE, KNOWS, Comparison, ratio_text, summary
from vocc_torch.studies.classifiers.study import compare_classifiers

_WIDE = 110
"""Columns from which frames, parameters and size stand in the terminal's table too."""

_ENDS = ("ber", "ber_low", "ber_high")
_RATIO = ("ratio", "ratio_low", "ratio_high")
_WORSE = ("receiver_worse", "reference_worse")


def run_classifiers(settings: Settings, config: RivalsConfig, folder: Path) -> None:
    """Compare receivers, and report it.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    run_folder.refuse_unused(settings)
    run_folder.refuse_results(folder, run_folder.LEDGERS)
    study, console = build_classifier_study(settings, config, folder), Console()
    frames = sum(plan.frames_in_point * len(plan.experiment.values) for plan in study.plans.values())
    with run_folder.resumable(settings, folder, console), ExitStack() as held:
        ledgers = {}
        for name, plan in study.plans.items():
            path = folder / run_folder.LEDGERS / f"{name}.sqlite"
            ledger = run_folder.open_ledger(path, identity(plan, (study.locator,)), console)
            ledgers[name] = held.enter_context(ledger)
        run_folder.write_config(settings, folder)
        view = held.enter_context(ProgressView(frames, console))
        workers = held.enter_context(Workers(settings.workers))

        @contextmanager
        def stage(name: str) -> Iterator[None]:
            view.advance(name, 0)
            begun = time.perf_counter()
            yield
            view.say(f"{name:<20} {time.perf_counter() - begun:6.1f} s")

        comparison, training = compare_classifiers(study, ledgers, workers, stage, view.advance)
    run_folder.write_training(settings, study.base, training, folder)
    write_tables(folder, comparison)
    words = summary(comparison)
    write_atomically(folder / "summary.txt", words.encode())
    figures = {name: curves_figure(comparison, name) for name in comparison.curves}
    if comparison.transfers:
        figures["robustness"] = scenes_figure(comparison)
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")
    if settings.tensorboard:
        texts = {"configuration": run_folder.as_markdown(settings), "summary": f"```\n{words}\n```"}
        write_board(folder / "tensorboard", comparison, figures, texts)
    print_table(comparison, console)
    console.print(Text(summary(comparison, min(100, console.width))), soft_wrap=True)
    places = {"table": "classifiers.csv", "points": "ber.csv", "pairs": "paired.csv"}
    places |= {"genie": "genie.csv"} if comparison.genie else {}
    places |= {"scenes": "robustness.csv"} if comparison.transfers else {}
    pictures = [("figure", f"{name}.png") for name in figures]
    run_folder.print_places(console, folder, [*places.items(), *pictures], settings.tensorboard)


def write_tables(folder: Path, comparison: Comparison) -> None:
    """Write points, pairs and costs and, where they were measured, the genie's points and the scenes.

    Args:
        folder: where they go.
        comparison: what was measured.

    Raises:
        VoccError: a file cannot be written.
    """
    rows = [row for table in comparison.tables.values() for row in run_folder.ber_rows(table)[1:]]
    run_folder.write_rows(folder / "ber.csv", [curve.COLUMNS, *rows])
    files = {"paired": paired_lines, "classifiers": classifier_lines}
    files |= {"genie": genie_lines} if comparison.genie else {}
    files |= {"robustness": scene_lines} if comparison.transfers else {}
    for name, lines in files.items():
        texts = (
            ["" if one is None else run_folder.cell_text(one) for one in row] for row in lines(comparison)
        )
        run_folder.write_rows(folder / f"{name}.csv", texts)


def paired_lines(comparison: Comparison) -> Iterator[run_folder.Cells]:
    """Compare every receiver with the reference at every point: head and lines of ``paired.csv``.

    ``difference`` is the receiver's rate less the reference's, ``ratio`` the one over the other: empty where
    the reference made no error; ``receiver_worse`` and ``reference_worse`` count frames.
    """
    head = ("experiment", "axis", "value", "locator", "receiver", "reference", "frames", "difference")
    yield (*head, "difference_low", "difference_high", "real", *_RATIO, *_WORSE, "sign_test_p")
    reference = comparison.reference
    for name, curves in comparison.curves.items():
        for value in curves.values:
            for receiver in (one for one in curves.receivers if one != reference):
                paired = curves.pair(receiver, reference, value)
                found, ratio = paired_interval(paired), comparison.ratio(name, receiver, value)
                place = (name, curves.axis, value, curves.locator, receiver, reference, paired.frames)
                worse = (paired.a_worse, paired.b_worse, sign_test(paired))
                yield (*place, *_cells(found), int(found.real), *_cells(ratio), *worse)


def _cells(estimate: Estimate | None) -> Sequence[float | None]:
    """Give an estimate's cells."""
    return (None, None, None) if estimate is None else (estimate.value, estimate.low, estimate.high)


def classifier_lines(comparison: Comparison) -> Iterator[run_folder.Cells]:
    """Give head and lines of ``classifiers.csv``: what each receiver costs, its rates, the best first.

    ``bits_ms`` is the time from the rectified panel to a frame's bits. Rates are at the summary's points.
    """
    costs = ("training_s", "simulated_s", "training_frames", "parameters", "size_bytes", "bits_ms")
    points = [f"{name}_{at:g}_{what}" for name, at in comparison.points.items() for what in (*_ENDS, *_RATIO)]
    yield ("receiver", *costs, *points)
    for receiver in comparison.ranked:
        made = comparison.costs[receiver]
        took = (made.training_s, made.simulated_s, made.frames, made.parameters, made.size_bytes)
        line: list[str | int | float | None] = [receiver, *took, comparison.decision_ms.get(receiver)]
        for experiment, value in comparison.points.items():
            row = comparison.row(experiment, receiver, value)
            line += [getattr(row, what) for what in _ENDS]
            line += _cells(comparison.ratio(experiment, receiver, value))
        yield line


def genie_lines(comparison: Comparison) -> Iterator[run_folder.Cells]:
    """Give head and lines of ``genie.csv``, a line a point.

    ``best_receivers`` have the fewest wrong bits on the genie's frames: all that do, with spaces between.
    """
    head = ("experiment", "axis", "value", "frames", "bits", "bit_errors", *_ENDS)
    yield (*head, "proven", "seconds_a_frame", "best_receivers", "best_bit_errors")
    for name, points in comparison.genie.items():
        for value, one in sorted(points.items()):
            counts, best = one.genie.counts, one.best
            place = (name, comparison.curves[name].axis, value)
            least = one.receivers[best[0]].bit_errors if best else None
            found = (counts.frames, counts.bits, counts.bit_errors, *_cells(intervals.ber_interval(counts)))
            yield (*place, *found, one.genie.proven, one.genie.seconds_a_frame, " ".join(best), least)


def scene_lines(comparison: Comparison) -> Iterator[run_folder.Cells]:
    """Give head and lines of ``robustness.csv``, a line for each pair of scenes and receiver.

    ``ratio``: to the same receiver trained on the scenes of the test; empty where that one made no error.
    """
    head = ("trained_on", "tested_on", "receiver", "frames", "bits", "bit_errors", *_ENDS)
    yield (*head, "frame_errors", "panels_missed", *_RATIO)
    for one in comparison.transfers:
        counts = one.counts
        found = (counts.frames, counts.bits, counts.bit_errors, *_cells(intervals.ber_interval(counts)))
        wrong = (counts.frame_errors, counts.panels_missed, *_cells(one.ratio))
        yield (one.trained_on, one.tested_on, one.receiver, *found, *wrong)


def write_board(
    folder: Path, comparison: Comparison, figures: Mapping[str, Figure], texts: Mapping[str, str]
) -> None:
    """Write a TensorBoard with a run for each receiver, and one for the genie.

    A receiver's row of the HPARAMS tab has its rates at the summary's points and its costs too.

    Args:
        folder: the folder that TensorBoard is to be pointed at.
        comparison: what was measured.
        figures: figures by name.
        texts: Markdown by name.

    Raises:
        VoccError: the folder cannot be written.
    """
    numbers: dict[str, dict[str, float]] = {}
    for receiver in [*comparison.ranked, *([GENIE] if comparison.genie else [])]:
        told: dict[str, float | None] = {}
        for experiment, value in comparison.points.items():
            point = f"{experiment}_{styles.value_text(value)}"
            row = comparison.row(experiment, receiver, value)
            ratio = comparison.ratio(experiment, receiver, value)
            told[f"BER/{point}"] = None if row is None else row.ber
            told[f"of_{comparison.reference}/{point}"] = None if ratio is None else ratio.value
        if made := comparison.costs.get(receiver):
            told |= {"making/training_s": made.training_s, "making/training_frames": made.frames}
            told |= {"making/parameters": made.parameters, "making/size_bytes": made.size_bytes}
        told["bits_ms"] = comparison.decision_ms.get(receiver)
        numbers[receiver] = {what: float(given) for what, given in told.items() if given is not None}
    tensorboard.write_boards(folder, {"": list(comparison.tables.values())}, figures, {}, texts, numbers)


def print_table(comparison: Comparison, console: Console) -> None:
    """Print a line for each receiver, the best first, and the genie's above them.

    Under a rate stands its interval. What learns nothing has no training.

    Args:
        comparison: what was measured.
        console: where to print.
    """
    wide, of = console.width >= _WIDE, f"of\n{comparison.reference}"
    heads = [head for name in comparison.points for head in (f"BER at\n{comparison.point_label(name)}", of)]
    costs = ["training\ns", *(["frames", "para-\nmeters", "kB"] if wide else []), "bits\nms"]
    table = plain_table("receiver", *heads, *costs)
    table.columns[0].justify, table.columns[0].no_wrap, table.columns[0].overflow = "left", False, "fold"
    for receiver in [*([GENIE] if comparison.genie else []), *comparison.ranked]:
        line = [KNOWS if receiver == GENIE else receiver]
        for name, value in comparison.points.items():
            row, ratio = comparison.row(name, receiver, value), comparison.ratio(name, receiver, value)
            text = "" if row is None else styles.point_text(row)
            if row is not None and not row.error_free:
                text += f"\n{styles.ends_text(row.ber_low, row.ber_high)}"
            elif row is not None and receiver == GENIE:
                # A limit would tell of the genie's few frames alone.
                text = f"0 of\n{row.bits} bits"
            line += [text, "" if ratio is None else ratio_text(ratio)]
        if receiver == GENIE:
            line += [""] * len(costs)
        else:
            made, spent = comparison.costs[receiver], comparison.decision_ms[receiver]
            size = f"{made.size_bytes / 1000:.3g}" if made.frames and made.size_bytes is not None else ""
            more = [str(made.frames or ""), "" if made.parameters is None else str(made.parameters), size]
            line += [f"{made.training_s:.1f}" if made.frames else "", *(more if wide else [])]
            line.append(f"{spent:.2g}" if spent < 9.95 else f"{spent:.0f}")
        table.add_row(*(Text(cell, style="dim" if receiver == GENIE else "") for cell in line))
    console.print(table)
