"""``task=classifiers``: many receivers on the same frames, with what they cost, and across scenes."""

from pathlib import Path

from vocc_torch.measure import config
from vocc_torch.report import folder as run_folder
from vocc_torch.report import rate_tables, run_ledgers, terminal
from vocc_torch.studies.compare import RivalsConfig, rival_figures
from vocc_torch.studies.compare.rival_results import ReceiverComparison, ratio_text
from vocc_torch.studies.compare.rivals import (
    build_classifier_study,
    compare_classifiers,
)
from vocc_torch.studies.compare.run import (
    Row,
    comparison,
    counted,
    ends,
    numbers_of,
    rate_texts,
    write_report,
)


def run_classifiers(
    settings: config.Settings, rivals: RivalsConfig, folder: Path
) -> None:
    """Compare receivers, and report it.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    study = build_classifier_study(settings, rivals, folder)
    stages = 2 + 2 * bool(study.scene_plans)
    with comparison(settings, folder, study.identity, stages) as run, run.pool:
        found, training = compare_classifiers(study, run)
    run_ledgers.write_training(settings, study.base, training, folder)
    write_points(folder, found)
    print_table(found, terminal.Console())
    rows = classifier_rows(found)
    figures = {name: rival_figures.curves_figure(found, name) for name in found.curves}
    if found.transfers:
        figures["robustness"] = rival_figures.scenes_figure(found)
    write_report(
        settings,
        folder,
        {
            "classifiers": rows,
            "robustness": scene_rows(found),
        },
        figures,
        ["ber.csv", "paired.csv"],
        tables={"": list(found.tables.values())},
        numbers={str(row["receiver"]): numbers_of(row) for row in rows},
    )


def write_points(folder: Path, found: ReceiverComparison) -> None:
    """Write ``ber.csv`` and ``paired.csv`` of all experiments."""
    tables = [rate_tables.ber_rows(table) for table in found.tables.values()]
    rows = [row for table in tables for row in table[1:]]
    run_folder.write_rows(folder / "ber.csv", [tables[0][0], *rows], short=True)
    rate_tables.write_paired(folder / "paired.csv", found.curves.values())


def classifier_rows(found: ReceiverComparison) -> list[Row]:
    """Give the rows of ``classifiers.csv``: what each receiver costs, and its rates, the best first.

    Rates and ratios are at the table's points; after several trainings they are the algorithms'.
    """
    rows: list[Row] = []
    for receiver in found.ranked:
        cost = found.costs[receiver]
        row: Row = {"receiver": receiver, "training_s": cost.training_s}
        row |= {"simulated_s": cost.simulated_s, "training_frames": cost.frames}
        row |= {"parameters": cost.parameters, "size_bytes": cost.size_bytes}
        for experiment, value in found.points.items():
            place, point = f"{experiment}_{value:g}", (experiment, receiver, value)
            row |= ends(f"{place}_ber", found.rate(*point))
            row |= ends(f"{place}_ratio", found.ratio(*point))
        rows.append(row)
    return rows


def scene_rows(found: ReceiverComparison) -> list[Row]:
    """Give the rows of ``robustness.csv``: a row for each pair of scenes and receiver.

    ``ratio``: to the same receiver trained on the scenes of the test; empty where that made no error.
    """
    return [
        {
            "trained_on": move.trained_on,
            "tested_on": move.tested_on,
            "receiver": move.receiver,
            **counted(move.counts),
            "frame_errors": move.counts.frame_errors,
            "panels_missed": move.counts.panels_missed,
            **ends("ratio", move.ratio),
        }
        for move in found.transfers
    ]


def print_table(found: ReceiverComparison, console: terminal.Console) -> None:
    """Print a row for each receiver, the best first."""
    heads = ["receiver"]
    for name in found.points:
        heads += [f"BER at\n{found.point_label(name)}", f"of\n{found.reference}"]
    table = terminal.plain_table(*heads, "train\ns")
    table.columns[0].justify = "left"
    for receiver in found.ranked:
        row, cost = [receiver], found.costs[receiver]
        for name, value in found.points.items():
            ratio = found.ratio(name, receiver, value)
            rate = found.rate(name, receiver, value)
            row.append("\n".join(rate_texts(rate)).rstrip())
            row.append("" if ratio is None else ratio_text(ratio))
        row.append(f"{cost.training_s:.1f}" if cost.frames else "")
        table.add_row(*map(terminal.Text, row))
    console.print(table)
    notes = ["Fewest wrong bits over all points first; 95 % intervals over frames."]
    notes += [f"Left out: {name}, since {why}." for name, why in found.left_out.items()]
    for note in notes:
        console.print(terminal.Text(note, style="dim"), soft_wrap=True)
