"""The price list as ``tradeoff.csv``, as a table on the terminal and as rows of TensorBoard's HPARAMS tab."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from itertools import compress
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text
from torch.utils.tensorboard import SummaryWriter

from vocc_torch.errors import VoccError
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.stage_times import STAGES
from vocc_torch.show.csv_file import write_rows
from vocc_torch.show.text_table import ends_text, plain_table, rate_text
from vocc_torch.studies.tradeoff.plan import Setting
from vocc_torch.studies.tradeoff.price_list import Place, PriceList
from vocc_torch.studies.tradeoff.prices import most_accurate, pareto_frontier
from vocc_torch.studies.tradeoff.words import frames_text, ms_text, receiver_text, scenes_text, varied_text

Cells = dict[str, str | int | float | None]

_WITH_INTERVALS = 96
"""Least terminal width at which intervals stand in the table."""

_WIDE = 112
"""Least terminal width at which batch and training do too."""

_WIDEST = 146
"""Least terminal width at which receivers' titles do too."""


def write_prices(path: str | Path, prices: PriceList) -> None:
    """Write a line for each setting and place, and blank ones for devices that are not there.

    Raises:
        VoccError: the file cannot be written.
    """
    rows = list(price_rows(prices))
    head = list(rows[0])
    write_rows(path, [head, *([row.get(name) for name in head] for row in rows)])


def price_rows(prices: PriceList) -> Iterator[Cells]:
    """Give the lines of ``tradeoff.csv`` by column, some columns for each kind of scenes.

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
    references = {scenes: list(_reference_cells(prices, scenes)) for scenes in prices.errors}
    for place in prices.places:
        rates = {scenes: list(_rate_cells(prices, scenes, place)) for scenes in prices.errors}
        for row, setting in enumerate(prices.settings):
            times = prices.times.by_place[setting, place]
            best = prices.best_place(setting, place.device, place.frames) == place
            cells: Cells = {
                **asdict(setting),
                **asdict(place),
                "rounds": times.rounds,
                "best_batch": int(best),
            }
            cells |= _ends("total{}_ms", times.total)
            for stage in STAGES:
                cells |= _ends(f"{stage}{{}}_ms", times.stage(stage))
            cells["frames_per_s"] = _short(1e3 / times.total.value)
            cells |= _ends("share_of_detection{}", times.share)
            for scenes, kind in rates.items():
                kind[row]["frontier_of_best_batches"] = (
                    kind[row]["frontier_of_best_batches"] if best else None
                )
                own = {**kind[row], **references[scenes][row]}
                cells |= {f"{scenes}_{name}": value for name, value in own.items()}
            cost = prices.costs[setting]
            yield {
                **cells,
                "training_s": _short(cost.training_s),
                "training_simulated_s": None if cost.simulated_s is None else _short(cost.simulated_s),
                "training_frames": cost.frames,
                "parameters": cost.parameters,
                "size_bytes": cost.size_bytes,
                "timed_scenes": prices.timed_scenes,
                "error_device": prices.error_device,
                "end_to_end": _short(prices.times.end_to_end[place]),
                "end_to_end_of": prices.times.in_one_go,
                "threads": prices.times.threads,
                "waited_share": _plain(round(prices.times.waited_share, 4)),
                "machine": prices.times.machines[place.device],
            }
    timed = dict.fromkeys((place.frames, place.batch) for place in prices.places)
    for device in prices.missing:
        for frames, batch in timed:
            for setting in prices.settings:
                place = Place(device, frames, batch)
                yield {**asdict(setting), **asdict(place), "machine": "not measured"}


def _rate_cells(prices: PriceList, scenes: str, place: Place) -> Iterator[Cells]:
    """Give the cells of one kind of scenes for every setting."""
    points = prices.points(scenes, place.device, place.frames, place.batch)
    kept = {one.name for one in pareto_frontier(points)}
    best = {one.name for one in pareto_frontier(prices.points(scenes, place.device, place.frames))}
    beaten = prices.beaten_by(scenes, points)
    for setting, point, (rival, sure) in zip(prices.settings, points, beaten, strict=True):
        counts = prices.counts(scenes)[setting]
        yield {
            "test_frames": counts.frames,
            "bit_errors": _plain(counts.bit_errors),
            "frame_errors": counts.frame_errors,
            "panels_missed": counts.panels_missed,
            **_ends("ber{}", point.ber),
            "frontier": int(point.name in kept),
            "beaten_by": rival,
            "surely_beaten": int(sure),
            "frontier_of_best_batches": int(point.name in best),
        }


def _reference_cells(prices: PriceList, scenes: str) -> Iterator[Cells]:
    """Give the cells of what is possible, and of what each setting does on the same frames."""
    rate, own = prices.reference(scenes), prices.where_referenced(scenes)
    made = prices.references.get(scenes)
    for setting in prices.settings:
        yield {
            "possible_test_frames": None if made is None else made.counts.frames,
            "possible_proven_frames": None if made is None else made.proven,
            "possible_frame_ms": None if made is None else _short(1e3 * made.seconds_a_frame),
            **_ends("possible_ber{}", rate),
            "ber_on_possible_frames": None if made is None else _short(own[setting].ber),
        }


def _ends(name: str, one: Estimate | None) -> Cells:
    """Name a number and the ends of its interval."""
    values = (None, None, None) if one is None else tuple(map(_short, (one.value, one.low, one.high)))
    return {name.format(part): value for part, value in zip(("", "_low", "_high"), values, strict=True)}


def _short(value: float) -> int | float:
    """Keep five digits: no time has more, and no rate."""
    return _plain(float(f"{value:.5g}"))


def _plain(value: float) -> int | float:
    """Write whole numbers without a point."""
    return int(value) if float(value).is_integer() else value


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
    points = prices.points(scenes, *kind)
    kept = {one.name for one in pareto_frontier(points)}
    intervals, wide, widest = (width >= least for least in (_WITH_INTERVALS, _WIDE, _WIDEST))
    single = prices.batches(*kind)[0] == 1
    heads = (
        "",
        "receiver",
        "locator",
        "",
        "ms",
        "alone\nms",
        "BER",
        "95 %",
        "batch",
        "training\ns",
        "weights",
    )
    shown = (*[True] * 5, single, True, intervals, wide, wide, wide)
    table = plain_table()
    for place, head in enumerate(heads):
        if shown[place]:
            table.add_column(head, justify="left" if place < 4 else "right", no_wrap=True)
    for setting, point in sorted(
        zip(prices.settings, points, strict=True), key=lambda pair: pair[1].time_ms.value
    ):
        cost = prices.costs[setting]
        cells = [
            mark if point.name in kept else "",
            receiver_text(setting.receiver) if widest else setting.receiver,
            setting.locator,
            ", ".join(varied_text(setting, prices.settings[0])).replace(" gradient", ""),
            ms_text(point.time_ms.value),
            ms_text(prices.times.by_place[setting, Place(*kind, 1)].total.value) if single else "",
            *_rate(point.ber),
            str(prices.best_place(setting, *kind).batch),
            f"{cost.training_s:.1f}" if cost.frames else "",
            "" if cost.parameters is None else str(cost.parameters),
        ]
        table.add_row(*map(Text, compress(cells, shown)), style="" if point.name in kept else "dim")
    rate, own = prices.reference(scenes), prices.where_referenced(scenes)
    if rate is not None:
        frames = f"{prices.references[scenes].counts.frames} frames"
        best = next(setting for setting in own if setting.name == most_accurate(points).name)
        told = rate_text(own[best].ber) if own[best].bit_errors else "no error"
        for cells in (
            ["", "knows the scene", "", frames, "", "", *_rate(rate), "", "", ""],
            ["", best.receiver, best.locator, f"same {frames}", "", "", told, "", "", "", ""],
        ):
            table.add_row(*map(Text, compress(cells, shown)))
    return table


def _rate(ber: Estimate) -> tuple[str, str]:
    """Write a rate and its interval."""
    if ber.value == 0:
        return f"< {rate_text(ber.high)}", ""
    return rate_text(ber.value), ends_text(ber.low, ber.high)


def write_price_board(folder: str | Path, prices: PriceList) -> None:
    """Write a run of TensorBoard for each configuration: its settings, rates, times and training cost.

    Raises:
        VoccError: the folder cannot be written.
    """
    try:
        for setting in prices.settings:
            with SummaryWriter(str(Path(folder) / setting.name)) as writer:
                # The run's own folder: any other would make a run more.
                writer.add_hparams(asdict(setting), _board_numbers(prices, setting), run_name=".")
    except OSError as error:
        raise VoccError(f"cannot write {folder}: {error.strerror or error}") from error


def _board_numbers(prices: PriceList, setting: Setting) -> dict[str, float]:
    """Give what was measured of a setting."""
    numbers = {f"ber/{scenes}": prices.counts(scenes)[setting].ber for scenes in prices.errors}
    for device, frames in prices.kinds:
        where = frames if len(prices.times.machines) == 1 else f"{device}_{frames}"
        best = prices.best_place(setting, device, frames)
        numbers[f"ms/{where}"] = prices.times.by_place[setting, best].total.value
        if (alone := (setting, Place(device, frames, 1))) in prices.times.by_place:
            numbers[f"latency_ms/{where}"] = prices.times.by_place[alone].total.value
    cost = prices.costs[setting]
    making = {"training_s": cost.training_s, "parameters": cost.parameters, "size_bytes": cost.size_bytes}
    return numbers | {f"making/{name}": float(value) for name, value in making.items() if value is not None}
