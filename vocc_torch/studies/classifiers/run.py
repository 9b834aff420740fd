"""``task=classifiers``: many receivers on the same frames, with what they cost, and across scenes."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

from vocc_torch.files import write_atomically
from vocc_torch.measure import (
    config,
    counts,
    curve,
    estimate,
    executors,
    intervals,
    paired,
)
from vocc_torch.report import folder as run_folder
from vocc_torch.report import styles, tensorboard, terminal
from vocc_torch.studies.classifiers import RivalsConfig, figures
from vocc_torch.studies.classifiers.results import (
    GENIE,
    KNOWS,
    Comparison,
    ratio_text,
    summary,
)
from vocc_torch.studies.classifiers.study import (
    build_classifier_study,
    compare_classifiers,
)

_ENDS = ("ber", "ber_low", "ber_high")
_COUNTED = ("frames", "bits", "bit_errors", *_ENDS)
_ALGORITHM = ("ber_mean", "algorithm_low", "algorithm_high")
_RATIO = ("ratio", "ratio_low", "ratio_high")
_OF_ALGORITHM = (*_ALGORITHM, *(f"algorithm_{one}" for one in _RATIO))


def run_classifiers(
    settings: config.Settings, rivals: RivalsConfig, folder: Path
) -> None:
    """Compare receivers, and report it.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    run_folder.refuse_results(folder, run_folder.LEDGERS)
    study, console = (
        build_classifier_study(settings, rivals, folder),
        terminal.Console(),
    )
    with run_folder.resumable(settings, folder, console), ExitStack() as held:
        ledgers = run_folder.open_ledgers(
            held, folder, [*study.studies, *study.scene_studies], console
        )
        run_folder.write_config(settings, folder)
        frames = sum(one.frames for one in study.studies)
        view = held.enter_context(terminal.ProgressView(frames, console))
        pool = held.enter_context(executors.Workers.of(settings))
        stage = terminal.Stopwatch(console).stage
        comparison, training = compare_classifiers(study, ledgers, pool, stage, view)
    run_folder.write_training(settings, study.base, training, folder)
    write_tables(folder, comparison)
    words = summary(comparison)
    write_atomically(folder / "summary.txt", words.encode())
    drawn = {
        name: figures.curves_figure(comparison, name) for name in comparison.curves
    }
    if comparison.transfers:
        drawn["robustness"] = figures.scenes_figure(comparison)
    tables, texts = (
        {"": list(comparison.tables.values())},
        {"summary": f"```\n{words}\n```"},
    )
    numbers = board_numbers(comparison)
    tensorboard.write_figures(
        settings, folder, drawn, tables, texts=texts, numbers=numbers
    )
    print_table(comparison, console)
    console.print(
        terminal.Text(summary(comparison, min(100, console.width))), soft_wrap=True
    )
    places = [
        ("table", "classifiers.csv"),
        ("points", "ber.csv"),
        ("pairs", "paired.csv"),
    ]
    places += [("genie", "genie.csv")] if comparison.genie else []
    places += [("scenes", "robustness.csv")] if comparison.transfers else []
    places += [("figure", f"{name}.png") for name in drawn]
    run_folder.print_places(console, folder, places, settings.tensorboard)


def write_tables(folder: Path, comparison: Comparison) -> None:
    """Write points, pairs and costs and, where they were measured, the genie's points and the scenes.

    Args:
        folder: where they go.
        comparison: what was measured.

    Raises:
        VoccError: a file cannot be written.
    """
    rows = [
        row
        for table in comparison.tables.values()
        for row in run_folder.ber_rows(table)[1:]
    ]
    tables = {"ber": [curve.COLUMNS, *rows], "paired": paired_lines(comparison)}
    tables |= {"classifiers": classifier_lines(comparison)}
    tables |= {"genie": genie_lines(comparison)} if comparison.genie else {}
    tables |= {"robustness": scene_lines(comparison)} if comparison.transfers else {}
    for name, lines in tables.items():
        run_folder.write_rows(folder / f"{name}.csv", lines, short=True)


def paired_lines(comparison: Comparison) -> Iterator[run_folder.Cells]:
    """Compare every receiver with the reference at every point: head and lines of ``paired.csv``.

    ``difference`` is the receiver's rate less the reference's, ``ratio`` the one over the other: empty where
    the reference made no error; ``receiver_worse`` and ``reference_worse`` count frames.
    """
    head = (
        "experiment",
        "axis",
        "value",
        "locator",
        "receiver",
        "reference",
        "frames",
        "difference",
    )
    worse = ("receiver_worse", "reference_worse", "sign_test_p")
    yield (*head, "difference_low", "difference_high", "real", *_RATIO, *worse)
    reference = comparison.reference
    for name, curves in comparison.curves.items():
        for value in curves.values:
            for receiver in (one for one in curves.receivers if one != reference):
                pair, ratio = (
                    curves.pair(receiver, reference, value),
                    comparison.ratio(name, receiver, value),
                )
                found = paired.paired_interval(pair)
                place = (
                    name,
                    curves.axis,
                    value,
                    curves.locator,
                    receiver,
                    reference,
                    pair.frames,
                )
                apart = (*_ends(found), int(found.real), *_ends(ratio))
                yield (
                    *place,
                    *apart,
                    pair.a_worse,
                    pair.b_worse,
                    paired.sign_test(pair),
                )


def _ends(found: estimate.Estimate | None) -> Sequence[float | None]:
    """Give an estimate's cells."""
    return (None, None, None) if found is None else (found.value, found.low, found.high)


def _counted(made: counts.Counts) -> run_folder.Cells:
    """Give the cells of ``_COUNTED``."""
    return (
        made.frames,
        made.bits,
        made.bit_errors,
        *_ends(intervals.ber_interval(made)),
    )


def classifier_lines(comparison: Comparison) -> Iterator[run_folder.Cells]:
    """Give head and lines of ``classifiers.csv``: what each receiver costs, its rates, the best first.

    ``bits_ms`` is the time from the rectified panel to a frame's bits. Rates are at the summary's points,
    after the first training; those of the algorithms stand at the end where there are several.
    """
    costs = (
        "training_s",
        "simulated_s",
        "training_frames",
        "parameters",
        "size_bytes",
        "bits_ms",
    )
    points = [
        f"{name}_{at:g}_{what}"
        for name, at in comparison.points.items()
        for what in (*_ENDS, *_RATIO)
    ]
    several = ["trainings"] if comparison.trainings > 1 else []
    for name, at in comparison.points.items() if several else ():
        several += [f"{name}_{at:g}_{what}" for what in _OF_ALGORITHM]
    yield ("receiver", *costs, *points, *several)
    for receiver in comparison.ranked:
        made = comparison.costs[receiver]
        took = (
            made.training_s,
            made.simulated_s,
            made.frames,
            made.parameters,
            made.size_bytes,
        )
        line: list[str | int | float | None] = [
            receiver,
            *took,
            comparison.decision_ms.get(receiver),
        ]
        for experiment, value in comparison.points.items():
            row = comparison.row(experiment, receiver, value)
            line += [getattr(row, what) for what in _ENDS]
            line += _ends(comparison.first_ratio(experiment, receiver, value))
        line += [comparison.trainings] if several else []
        for experiment, value in comparison.points.items() if several else ():
            line += [
                getattr(comparison.row(experiment, receiver, value), what)
                for what in _ALGORITHM
            ]
            line += _ends(comparison.ratio(experiment, receiver, value))
        yield line


def genie_lines(comparison: Comparison) -> Iterator[run_folder.Cells]:
    """Give head and lines of ``genie.csv``, a line a point.

    ``best_receivers`` have the fewest wrong bits on the genie's frames: all that do, with spaces between.
    """
    head = ("proven", "seconds_a_frame", "best_receivers", "best_bit_errors")
    yield ("experiment", "axis", "value", *_COUNTED, *head)
    for name, points in comparison.genie.items():
        for value, one in sorted(points.items()):
            least = one.receivers[one.best[0]].bit_errors if one.best else None
            told = (
                one.genie.proven,
                one.genie.seconds_a_frame,
                " ".join(one.best),
                least,
            )
            yield (
                name,
                comparison.curves[name].axis,
                value,
                *_counted(one.genie.counts),
                *told,
            )


def scene_lines(comparison: Comparison) -> Iterator[run_folder.Cells]:
    """Give head and lines of ``robustness.csv``, a line for each pair of scenes and receiver.

    ``ratio``: to the same receiver trained on the scenes of the test; empty where that one made no error.
    """
    head = ("trained_on", "tested_on", "receiver", *_COUNTED)
    yield (*head, "frame_errors", "panels_missed", *_RATIO)
    for one in comparison.transfers:
        wrong = (one.counts.frame_errors, one.counts.panels_missed, *_ends(one.ratio))
        yield (
            one.trained_on,
            one.tested_on,
            one.receiver,
            *_counted(one.counts),
            *wrong,
        )


def board_numbers(comparison: Comparison) -> dict[str, dict[str, float]]:
    """Give each receiver's rates at the summary's points, and its costs, for its row of the HPARAMS tab."""
    numbers: dict[str, dict[str, float]] = {}
    for receiver in [*comparison.ranked, *([GENIE] if comparison.genie else [])]:
        told: dict[str, float | None] = {
            "bits_ms": comparison.decision_ms.get(receiver)
        }
        for experiment, value in comparison.points.items():
            point = f"{experiment}_{styles.value_text(value)}"
            if rate := comparison.rate(experiment, receiver, value):
                told[f"BER/{point}"] = rate.value
            if ratio := comparison.ratio(experiment, receiver, value):
                told[f"of_{comparison.reference}/{point}"] = ratio.value
        if made := comparison.costs.get(receiver):
            told |= {
                "making/training_s": made.training_s,
                "making/training_frames": made.frames,
            }
            told |= {
                "making/parameters": made.parameters,
                "making/size_bytes": made.size_bytes,
            }
        numbers[receiver] = {
            what: float(given) for what, given in told.items() if given is not None
        }
    return numbers


def print_table(comparison: Comparison, console: terminal.Console) -> None:
    """Print a line for each receiver, the best first, and the genie's above them.

    Under a rate stands its interval. What learns nothing has no training.

    Args:
        comparison: what was measured.
        console: where to print.
    """
    # On a wide terminal there are frames, parameters and size too.
    wide, of = console.width >= 110, f"of\n{comparison.reference}"
    heads = [
        head
        for name in comparison.points
        for head in (f"BER at\n{comparison.point_label(name)}", of)
    ]
    costs = [
        "training\ns",
        *(["frames", "para-\nmeters", "kB"] if wide else []),
        "bits\nms",
    ]
    table = terminal.plain_table("receiver", *heads, *costs)
    table.columns[0].justify, table.columns[0].no_wrap, table.columns[0].overflow = (
        "left",
        False,
        "fold",
    )
    for receiver in [*([GENIE] if comparison.genie else []), *comparison.ranked]:
        line = [KNOWS if receiver == GENIE else receiver]
        for name, value in comparison.points.items():
            row, ratio = (
                comparison.row(name, receiver, value),
                comparison.ratio(name, receiver, value),
            )
            rate = comparison.rate(name, receiver, value)
            text = "" if rate is None else styles.rate_text(rate.value or rate.high)
            if rate is not None and rate.value:
                text += f"\n{styles.ends_text(rate.low, rate.high)}"
            elif rate is not None:
                text = f"< {text}"
            if row is not None and row.error_free and receiver == GENIE:
                # A limit would tell of the genie's few frames alone.
                text = f"0 of\n{row.bits} bits"
            line += [text, "" if ratio is None else ratio_text(ratio)]
        if made := comparison.costs.get(receiver):
            spent, parameters = comparison.decision_ms[receiver], made.parameters
            size = (
                f"{made.size_bytes / 1000:.3g}"
                if made.frames and made.size_bytes is not None
                else ""
            )
            more = [
                str(made.frames or ""),
                "" if parameters is None else str(parameters),
                size,
            ]
            line += [
                f"{made.training_s:.1f}" if made.frames else "",
                *(more if wide else []),
            ]
            line.append(f"{spent:.2g}" if spent < 9.95 else f"{spent:.0f}")
        table.add_row(
            *(
                terminal.Text(cell, style="dim" if receiver == GENIE else "")
                for cell in line
            )
        )
    console.print(table)
