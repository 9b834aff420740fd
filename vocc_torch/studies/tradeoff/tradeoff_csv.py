"""``tradeoff.csv`` and ``renderer.csv``: what receivers, and the renderer's knobs, cost and give."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from vocc_torch.show.csv_file import cell_text, write_lines
from vocc_torch.studies.tradeoff.frontier import frontier
from vocc_torch.studies.tradeoff.knob_setting import KnobSetting
from vocc_torch.studies.tradeoff.price_list import STAGES, Place, PriceList, Quartiles, Setting

_Cell = str | int | float

_PARTS = ("", "low_", "high_")
_SETTING = ("receiver", "locator", "samples_per_led", "gradient", "dtype")
_PLACE = ("device", "frames", "batch", "rounds", "best_batch")
_TIMES = tuple(f"{what}_{part}ms" for what in ("total", *STAGES) for part in _PARTS)
_SHARES = tuple(f"share_of_detection{part and '_' + part.rstrip('_')}" for part in _PARTS)
_RATES = (
    *("test_frames", "bit_errors", "frame_errors", "panels_missed", "ber", "ber_low", "ber_high"),
    *("frontier", "beaten_by", "surely_beaten", "frontier_of_best_batches"),
)
_MAKING = ("training_s", "training_simulated_s", "training_frames", "parameters", "size_bytes")
_MARK = (
    *("possible_test_frames", "possible_proven_frames", "possible_frame_ms"),
    *("possible_ber", "possible_ber_low", "possible_ber_high", "ber_on_possible_frames"),
)
_FACTS = ("timed_scenes", "error_device", "end_to_end", "end_to_end_of", "threads", "waited_share", "machine")

RENDERER_COLUMNS = (
    *("knob", "value", "median_ms", "low_ms", "high_ms", "rounds", "frames_a_call"),
    *("worst_error_dn", "rms_error_dn", "pixels_changed", "threads", "machine"),
)
"""Columns of ``renderer.csv``. Errors are those of grey values against frames rendered whole in float64, in
digital numbers before quantisation: the worst on the sensor, and the root mean square about the panel;
``pixels_changed`` is the share of pixels there whose 8-bit value differs."""


def columns(scenes: Sequence[str]) -> tuple[str, ...]:
    """Name the columns of ``tradeoff.csv``, some of them for each kind of scenes.

    Times are ms a frame, medians over the rounds with lower and upper quartile, on frames of
    ``timed_scenes``. Stages are added round by round: their medians make up the total's but for chance.
    ``share_of_detection`` is bit detection's time over panel detection's, as in the paper's Fig. 25.
    ``frontier`` compares receivers with the same batch size, ``frontier_of_best_batches`` each with its own
    best one; ``surely_beaten`` marks those whose rate is higher than that of ``beaten_by``, which is no
    slower by the median. Sure is said of the rates, by paired intervals of all pairs of settings that hold
    together at 95 % (Bonferroni).
    ``possible_ber`` is what a decoder that knows the scene reaches on the first ``possible_test_frames`` of
    the same frames, and ``ber_on_possible_frames`` the line's own rate on these: compare the two. In
    ``possible_proven_frames`` of them no bits can be likelier than those that the decoder gave.
    ``preambles_ms`` is reading and measuring the frames of known bits that a threshold comes from.
    ``end_to_end`` is the time of ``end_to_end_of`` in one go over the sum of its stages.

    Example:
        >>> "mixture_ber_high" in columns(["mixture"])
        True
    """
    rates = tuple(f"{name}_{what}" for name in scenes for what in (*_RATES, *_MARK))
    return (*_SETTING, *_PLACE, *_TIMES, "frames_per_s", *_SHARES, *rates, *_MAKING, *_FACTS)


def write_prices(path: str | Path, prices: PriceList) -> None:
    """Write a line for each setting and place.

    Args:
        path: the file, replaced whole.
        prices: the price list.

    Raises:
        VoccError: the file cannot be written.
    """
    lines = ([cell_text(cell) for cell in line] for line in _lines(prices))
    write_lines(path, columns(list(prices.errors)), lines)


def write_renderer(path: str | Path, knobs: Sequence[KnobSetting], threads: int, machine: str) -> None:
    """Write a line for each setting of the renderer's knobs.

    Args:
        path: the file, replaced whole.
        knobs: the settings.
        threads: threads within an operation.
        machine: what was measured on.

    Raises:
        VoccError: the file cannot be written.
    """
    lines: list[list[_Cell]] = []
    for one in knobs:
        cost: list[_Cell] = [*_three(one.cost_ms), one.rounds, one.frames_a_call]
        errors: list[_Cell] = [_short(one.worst_dn), _short(one.rms_dn), _short(one.changed)]
        lines.append([one.knob, one.value, *cost, *errors, threads, machine])
    write_lines(path, RENDERER_COLUMNS, ([cell_text(cell) for cell in line] for line in lines))


def _lines(prices: PriceList) -> Iterator[list[_Cell]]:
    """Give the lines of ``tradeoff.csv``."""
    best = {
        (setting, device, frames): prices.best_place(setting, device, frames)
        for setting in prices.settings
        for device, frames in prices.kinds
    }
    marks = {scenes: _marks(prices, scenes) for scenes in prices.errors}
    for place in prices.places:
        rates = [list(_rates(prices, scenes, place)) for scenes in prices.errors]
        for row, setting in enumerate(prices.settings):
            spent = prices.spent[setting, place]
            is_best = best[setting, place.device, place.frames] == place
            about: list[_Cell] = [getattr(setting, name) for name in _SETTING]
            about += [place.device, place.frames, place.batch, len(spent.rounds_ms["read"]), int(is_best)]
            times = [_three(spent.total), *(_three(spent.stage(stage)) for stage in STAGES)]
            share = ["", "", ""] if spent.share is None else _three(spent.share)
            speed = _short(1e3 / spent.total[1])
            errors = [
                cell
                for scenes, kind in zip(prices.errors, rates, strict=True)
                for cell in (*kind[row][:-1], kind[row][-1] if is_best else "", *marks[scenes][row])
            ]
            facts = [prices.timed_scenes, prices.error_device, _short(prices.end_to_end[place])]
            yield [
                *about,
                *(cell for three in times for cell in three),
                *(speed, *share, *errors, *_making(prices, setting), *facts),
                *(prices.in_one_go, prices.threads, round(prices.waited_share, 4)),
                prices.machines[place.device],
            ]
    yield from _missing(prices)


def _missing(prices: PriceList) -> Iterator[list[_Cell]]:
    """Give lines without numbers for devices that were asked for and are not there."""
    blank = len(columns(list(prices.errors))) - len(_SETTING) - 4
    known = dict.fromkeys((place.frames, place.batch) for place in prices.places)
    for device in prices.missing:
        for frames, batch in known:
            for setting in prices.settings:
                about: list[_Cell] = [getattr(setting, name) for name in _SETTING]
                yield [*about, device, frames, batch, *[""] * blank, "not measured"]


def _marks(prices: PriceList, scenes: str) -> list[list[_Cell]]:
    """Give the cells of what is possible, and of what each setting does on the same frames."""
    mark = prices.mark(scenes)
    if mark is None:
        return [[""] * len(_MARK)] * len(prices.settings)
    rate, interval = mark
    made = prices.marks[scenes]
    numbers = [_short(one) for one in (1e3 * made.frame_s, rate, interval.low, interval.high)]
    own = (counts.ber for counts in prices.where_marked(scenes).values())
    return [[made.counts.frames, made.proven, *numbers, _short(ber)] for ber in own]


def _rates(prices: PriceList, scenes: str, place: Place) -> Iterator[list[_Cell]]:
    """Give the cells of one kind of scenes for every setting."""
    alike = prices.offers(scenes, place.device, place.frames, place.batch)
    kept = {one.name for one in frontier(alike)}
    best = {one.name for one in frontier(prices.offers(scenes, place.device, place.frames))}
    beaten = prices.beaten_by(scenes, alike)
    for setting, offer, (rival, sure) in zip(prices.settings, alike, beaten, strict=True):
        counts = prices.counts(scenes)[setting]
        yield [
            *(counts.frames, counts.bit_errors, counts.frame_errors, counts.panels_missed),
            *(_short(offer.ber), _short(offer.ber_low), _short(offer.ber_high)),
            *(int(offer.name in kept), rival, int(sure), int(offer.name in best)),
        ]


def _making(prices: PriceList, setting: Setting) -> list[_Cell]:
    """Give what a receiver took to make; blank where it is not known."""
    made = prices.making[setting]
    simulated = "" if made.simulated_s is None else _short(made.simulated_s)
    numbers = ("" if value is None else value for value in (made.parameters, made.size_bytes))
    return [_short(made.training_s), simulated, made.frames, *numbers]


def _three(quartiles: Quartiles) -> list[_Cell]:
    """Give median, lower and upper quartile."""
    low, median, high = quartiles
    return [_short(median), _short(low), _short(high)]


def _short(value: float) -> float:
    """Keep five digits: no time has more, and no rate."""
    return float(f"{value:.5g}")
