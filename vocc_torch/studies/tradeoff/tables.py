"""The price list as ``tradeoff.csv``, as a table on the terminal and as rows of TensorBoard's HPARAMS tab."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text
from torch.utils.tensorboard import SummaryWriter

from vocc_torch.errors import VoccError
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.stage_times import STAGES
from vocc_torch.show.folder import write_rows
from vocc_torch.show.styles import ends_text, rate_text
from vocc_torch.show.terminal import plain_table
from vocc_torch.studies.tradeoff.price_list import Place, PriceList
from vocc_torch.studies.tradeoff.prices import most_accurate, pareto_frontier
from vocc_torch.studies.tradeoff.words import frames_text, ms_text, receiver_text, scenes_text, varied_text

Cells = dict[str, str | int | float | None]

LEAST_WIDTH = {
    **{"": 0, "receiver": 0, "locator": 0, "other": 0, "ms": 0, "alone\nms": 0, "BER": 0, "95 %": 96},
    **{"batch": 112, "training\ns": 112, "weights": 112},
}
"""Columns on the terminal, and the least width at which they stand there."""

WIDTH_WITH_TITLES = 146
"""Least terminal width at which receivers have their titles too."""


def write_prices(path: str | Path, prices: PriceList) -> None:
    """Write a line for each setting and place, and blank ones for devices that are not there.

    Numbers have five digits, more than any time or rate has.

    Raises:
        VoccError: the file cannot be written.
    """

    def cell(value: str | int | float | None) -> str | int | float | None:
        return f"{float(f'{value:.5g}'):.15g}" if isinstance(value, float) else value

    rows = list(price_rows(prices))
    head = list(rows[0])
    write_rows(path, [head, *([cell(row.get(name)) for name in head] for row in rows)])


def price_rows(prices: PriceList) -> Iterator[Cells]:
    """Lines of ``tradeoff.csv`` by column, some columns for each kind of scenes.

    Times are ms a frame, medians over the rounds with lower and upper quartile, on frames of
    ``timed_scenes``. Stages are added round by round: their medians make up the total's but for chance.
    ``preambles_ms`` is reading and measuring the frames of known bits that a threshold comes from.
    ``share_of_detection`` is bit detection's time over panel detection's, as in the paper's Fig. 25.
    ``frontier`` compares receivers with the same batch size, ``frontier_of_best_batches`` each with its own
    best one. ``surely_beaten`` marks those whose rate is higher than that of ``beaten_by``, which is no
    slower by the median, by paired intervals of all pairs that hold together at 95 % (Bonferroni).
    ``possible_ber`` is the rate of a decoder that knows the scene on the first ``possible_test_frames`` of
    the same frames, and ``ber_on_possible_frames`` the line's own rate on these: compare the two. In
    ``possible_proven_frames`` of them no bits can be likelier than those that the decoder gave.
    ``end_to_end`` is the time of ``end_to_end_of`` in one go over the sum of its stages.
    """
    for place in prices.places:
        rates = {scenes: _rate_cells(prices, scenes, place) for scenes in prices.errors}
        for row, setting in enumerate(prices.settings):
            times, cost = prices.times.by_place[setting, place], prices.costs[setting]
            cells = _ends("total{}_ms", times.total)
            for stage in STAGES:
                cells |= _ends(f"{stage}{{}}_ms", times.stage(stage))
            cells |= {"frames_per_s": 1e3 / times.total.value, **_ends("share_of_detection{}", times.share)}
            for scenes, every in rates.items():
                cells |= {f"{scenes}_{name}": value for name, value in every[row].items()}
            yield {
                **asdict(setting),
                **asdict(place),
                "rounds": times.rounds,
                "best_batch": int(place == prices.best_place(setting, place.device, place.frames)),
                **cells,
                "training_s": cost.training_s,
                "training_simulated_s": cost.simulated_s,
                "training_frames": cost.frames,
                "parameters": cost.parameters,
                "size_bytes": cost.size_bytes,
                "timed_scenes": prices.timed_scenes,
                "error_device": prices.error_device,
                "end_to_end": prices.times.end_to_end[place],
                "end_to_end_of": prices.times.in_one_go,
                "threads": prices.times.threads,
                "waited_share": round(prices.times.waited_share, 4),
                "machine": prices.times.machines[place.device],
            }
    for device in prices.missing:
        for frames, batch in dict.fromkeys((place.frames, place.batch) for place in prices.places):
            for setting in prices.settings:
                absent = Place(device, frames, batch)
                yield {**asdict(setting), **asdict(absent), "machine": "not measured"}


def _rate_cells(prices: PriceList, scenes: str, place: Place) -> list[Cells]:
    """Cells of one kind of scenes for every setting, and of what is possible on the same frames."""
    points = prices.points(scenes, place.device, place.frames, place.batch)
    kept = {one.name for one in pareto_frontier(points)}
    best = {one.name for one in pareto_frontier(prices.points(scenes, place.device, place.frames))}
    own, mark = prices.where_referenced(scenes), prices.references.get(scenes)
    rows: list[Cells] = []
    for setting, point, (rival, sure) in zip(
        prices.settings, points, prices.beaten_by(scenes, points), strict=True
    ):
        counts = prices.counts(scenes)[setting]
        in_best = place == prices.best_place(setting, place.device, place.frames)
        rows.append(
            {
                "test_frames": counts.frames,
                "bit_errors": f"{counts.bit_errors:.15g}",
                "frame_errors": counts.frame_errors,
                "panels_missed": counts.panels_missed,
                **_ends("ber{}", point.ber),
                "frontier": int(point.name in kept),
                "beaten_by": rival,
                "surely_beaten": int(sure),
                "frontier_of_best_batches": int(point.name in best) if in_best else None,
                "possible_test_frames": mark.counts.frames if mark else None,
                "possible_proven_frames": mark.proven if mark else None,
                "possible_frame_ms": 1e3 * mark.seconds_a_frame if mark else None,
                **_ends("possible_ber{}", prices.reference(scenes)),
                "ber_on_possible_frames": own[setting].ber if own else None,
            }
        )
    return rows


def _ends(name: str, one: Estimate | None) -> Cells:
    """Name a number and the ends of its interval."""
    values = (None, None, None) if one is None else (one.value, one.low, one.high)
    return {name.format(part): value for part, value in zip(("", "_low", "_high"), values, strict=True)}


def print_prices(prices: PriceList, words: str, console: Console) -> None:
    """Print the first kind of frames and scenes, and what to take of it.

    Args:
        prices: what was measured.
        words: the recommendation, of which the short part is printed.
        console: where to print.
    """
    kind, scenes = prices.kinds[0], prices.timed_scenes
    mark = "*" if console.options.ascii_only else "\N{BLACK DIAMOND}"
    console.print(_table(prices, scenes, kind, mark, console.width))
    note = (
        f"{mark} on the frontier: nothing is both quicker and better. For "
        f"{frames_text(prices, scenes, kind[1])}; {scenes_text(prices, scenes)}. ms: median a frame in the "
        "best batch; alone: one frame at a time."
    )
    console.print(Text(note))
    console.print(Text(words.partition("EVERY KIND OF")[0].rstrip()), soft_wrap=True)


def _table(prices: PriceList, scenes: str, kind: tuple[str, str], mark: str, width: int) -> Table:
    """Lay out a line for each receiver, the quickest first, then what is possible."""
    points, single = prices.points(scenes, *kind), prices.batches(*kind)[0] == 1
    kept = {one.name for one in pareto_frontier(points)}
    rows: list[tuple[Cells, str]] = []
    for setting, point in sorted(
        zip(prices.settings, points, strict=True), key=lambda pair: pair[1].time_ms.value
    ):
        cost, first = prices.costs[setting], point.name in kept
        cells: Cells = {
            "": mark if first else "",
            "receiver": receiver_text(setting.receiver) if width >= WIDTH_WITH_TITLES else setting.receiver,
            "locator": setting.locator,
            "other": ", ".join(varied_text(setting, prices.settings[0])).replace(" gradient", ""),
            "ms": ms_text(point.time_ms.value),
            **_rate(point.ber),
            "batch": prices.best_place(setting, *kind).batch,
            "training\ns": f"{cost.training_s:.1f}" if cost.frames else None,
            "weights": cost.parameters,
        }
        if single:
            cells["alone\nms"] = ms_text(prices.times.by_place[setting, Place(*kind, 1)].total.value)
        rows.append((cells, "" if first else "dim"))
    rate, own = prices.reference(scenes), prices.where_referenced(scenes)
    if rate is not None:
        frames = f"{prices.references[scenes].counts.frames} frames"
        best = next(setting for setting in own if setting.name == most_accurate(points).name)
        told = rate_text(own[best].ber) if own[best].bit_errors else "no error"
        same = {"receiver": best.receiver, "locator": best.locator, "other": f"same {frames}", "BER": told}
        rows += [({"receiver": "knows the scene", "other": frames, **_rate(rate)}, ""), ({**same}, "")]
    table = plain_table()
    shown = [head for head, least in LEAST_WIDTH.items() if width >= least and head in rows[0][0]]
    for head in shown:
        left = head in ("", "receiver", "locator", "other")
        table.add_column(head.replace("other", ""), justify="left" if left else "right", no_wrap=True)
    for cells, style in rows:
        texts = ("" if cells.get(head) is None else str(cells[head]) for head in shown)
        table.add_row(*map(Text, texts), style=style)
    return table


def _rate(ber: Estimate) -> Cells:
    """Write a rate and its interval, or its limit."""
    if ber.value == 0:
        return {"BER": f"< {rate_text(ber.high)}", "95 %": ""}
    return {"BER": rate_text(ber.value), "95 %": ends_text(ber.low, ber.high)}


def write_price_board(folder: str | Path, prices: PriceList) -> None:
    """Write a run of TensorBoard for each configuration: its settings, rates, times and training cost.

    Raises:
        VoccError: the folder cannot be written.
    """
    try:
        for setting in prices.settings:
            numbers = {f"ber/{scenes}": prices.counts(scenes)[setting].ber for scenes in prices.errors}
            for device, frames in prices.kinds:
                where = frames if len(prices.times.machines) == 1 else f"{device}_{frames}"
                best, alone = prices.best_place(setting, device, frames), Place(device, frames, 1)
                numbers[f"ms/{where}"] = prices.times.by_place[setting, best].total.value
                if alone in prices.places:
                    numbers[f"latency_ms/{where}"] = prices.times.by_place[setting, alone].total.value
            for name in ("training_s", "parameters", "size_bytes"):
                if (value := getattr(prices.costs[setting], name)) is not None:
                    numbers[f"making/{name}"] = float(value)
            with SummaryWriter(str(Path(folder) / setting.name)) as writer:
                # The run's own folder: any other would make a run more.
                writer.add_hparams(asdict(setting), numbers, run_name=".")
    except OSError as error:
        raise VoccError(f"cannot write {folder}: {error.strerror or error}") from error
