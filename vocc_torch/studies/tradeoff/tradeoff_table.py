"""The price list on the terminal: a line for each receiver, the quickest first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from vocc_torch.show.text_table import interval_text, plain_table, rate_text
from vocc_torch.studies.tradeoff.frontier import Offer, frontier, most_accurate
from vocc_torch.studies.tradeoff.knob_setting import KnobSetting
from vocc_torch.studies.tradeoff.price_list import Place, PriceList, Setting
from vocc_torch.studies.tradeoff.tradeoff_advice import headline
from vocc_torch.studies.tradeoff.tradeoff_basis import about, compared
from vocc_torch.studies.tradeoff.tradeoff_words import (
    frames_text,
    ms_text,
    receiver_text,
    scenes_text,
    varied_text,
    wrapped,
)

_WIDE = 106
"""Least terminal width at which batch and training stand in the table."""

_WIDEST = 140
"""Least terminal width at which receivers' titles do too."""


def print_prices(prices: PriceList, console: Console | None = None) -> None:
    """Print the first kind of frames and scenes, and what to take of it.

    Args:
        prices: what was measured.
        console: where to print; standard output by default.
    """
    console = console or Console()
    device, frames = prices.kinds[0]
    scenes = prices.timed_scenes
    mark = "*" if console.options.ascii_only else "\N{BLACK DIAMOND}"
    for line in compared(prices):
        console.print(Text(wrapped(line)), soft_wrap=True)
    console.print(_table(prices, scenes, (device, frames), mark, console.width))
    said = [
        f"{mark} on the frontier: nothing is both quicker and better. {frames_text(prices, scenes, frames)}; "
        f"{scenes_text(prices, scenes)}. ms: median a frame in the best batch; alone: one frame at a time.",
        "",
        *headline(prices),
        "",
        *about(prices),
    ]
    for line in said:
        console.print(Text(wrapped(line)), soft_wrap=True)


def _table(prices: PriceList, scenes: str, kind: tuple[str, str], mark: str, width: int) -> Table:
    """Lay out a line for each receiver, then what is possible."""
    offers = prices.offers(scenes, *kind)
    kept = {one.name for one in frontier(offers)}
    single, wide = prices.batches(*kind)[0] == 1, width >= _WIDE
    table = plain_table()
    for head in ("", "receiver", "locator", ""):
        table.add_column(head, no_wrap=True)
    heads = ["ms", *(["alone\nms"] if single else []), "BER", "95 %"]
    for head in heads + (["batch", "training\ns", "weights"] if wide else []):
        table.add_column(head, justify="right", no_wrap=True)
    for setting, offer in sorted(
        zip(prices.settings, offers, strict=True), key=lambda pair: pair[1].median_ms
    ):
        on = offer.name in kept
        alone = [ms_text(prices.spent[setting, Place(*kind, 1)].total[1])] if single else []
        batch = str(prices.best_place(setting, *kind).batch)
        cells = [
            mark if on else "",
            receiver_text(setting.receiver) if width >= _WIDEST else setting.receiver,
            setting.locator,
            ", ".join(varied_text(setting, prices.settings[0])).replace(" gradient", ""),
            *(ms_text(offer.median_ms), *alone, *_rate(offer)),
            *((batch, *_made(prices, setting)) if wide else ()),
        ]
        table.add_row(*(Text(cell) for cell in cells), style="" if on else "dim")
    for cells in _mark_rows(prices, scenes, offers, single):
        table.add_row(*(Text(cell) for cell in cells), *(("",) * 3 if wide else ()))
    return table


def print_renderer(knobs: Sequence[KnobSetting], console: Console | None = None) -> None:
    """Print what the renderer's knobs cost and buy.

    Args:
        knobs: the settings.
        console: where to print; standard output by default.
    """
    console = console or Console()
    table = plain_table()
    table.add_column("renderer", no_wrap=True)
    table.add_column("")
    for head in ("ms", "worst error\ngrey values", "rms", "pixels\nchanged, %"):
        table.add_column(head, justify="right", no_wrap=True)
    for one in knobs:
        table.add_row(
            *("as set" if one.knob == "none" else one.knob, "" if one.knob == "none" else one.value),
            *(
                ms_text(one.cost_ms[1]),
                f"{one.worst_dn:.2g}",
                f"{one.rms_dn:.2g}",
                f"{100 * one.changed:.2g}",
            ),
        )
    console.print(table)


def _mark_rows(prices: PriceList, scenes: str, offers: Sequence[Offer], single: bool) -> Iterator[list[str]]:
    """Give the line of what is possible, and of the most accurate receiver on the same frames."""
    mark = prices.mark(scenes)
    if mark is None:
        return
    rate, interval = mark
    frames = f"{prices.marks[scenes].counts.frames} frames"
    untimed = [""] * (2 if single else 1)
    limit = Offer("possible", 1.0, 1.0, 1.0, rate, interval.low, interval.high)
    yield ["", "knows the scene", "", frames, *untimed, *_rate(limit)]
    best = most_accurate(offers)
    setting, counts = next(
        (one, c) for one, c in prices.where_marked(scenes).items() if one.name == best.name
    )
    told = rate_text(counts.ber) if counts.bit_errors else "no error"
    yield ["", setting.receiver, setting.locator, f"same {frames}", *untimed, told, ""]


def _rate(offer: Offer) -> tuple[str, str]:
    """Write a rate and its interval."""
    if offer.error_free:
        return f"< {rate_text(offer.ber_high)}", ""
    return rate_text(offer.ber), interval_text(offer.ber, offer.ber_low, offer.ber_high)


def _made(prices: PriceList, setting: Setting) -> tuple[str, str]:
    """Write what training took."""
    made = prices.making[setting]
    seconds = f"{made.training_s:.1f}" if made.frames else ""
    return seconds, "" if made.parameters is None else str(made.parameters)
