"""The price list on the terminal: a line for each receiver, the quickest first."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.text import Text

from vocc_torch.evaluation.frontier import Offer, frontier
from vocc_torch.evaluation.knob_setting import KnobSetting
from vocc_torch.evaluation.price_list import Place, PriceList, Setting
from vocc_torch.reporting.text_table import interval_text, plain_table, rate_text
from vocc_torch.reporting.tradeoff_advice import about, compared, headline
from vocc_torch.reporting.tradeoff_words import (
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
    scenes = next(iter(prices.errors))
    offers = prices.offers(scenes, device, frames)
    kept = {one.name for one in frontier(offers)}
    table = plain_table()
    for head in ("", "receiver", "locator", ""):
        table.add_column(head, no_wrap=True)
    single = prices.batches(device, frames)[0] == 1
    wide = console.width >= _WIDE
    heads = ["ms", *(["alone\nms"] if single else []), "BER", "95 %"]
    for head in heads + (["batch", "training\ns", "weights"] if wide else []):
        table.add_column(head, justify="right", no_wrap=True)
    mark = "*" if console.options.ascii_only else "\N{BLACK DIAMOND}"
    for setting, offer in sorted(
        zip(prices.settings, offers, strict=True), key=lambda pair: pair[1].median_ms
    ):
        on = offer.name in kept
        batch = prices.best_place(setting, device, frames).batch
        alone = []
        if single:
            alone = [ms_text(prices.spent[setting, Place(device, frames, 1)].total[1])]
        cells = [
            mark if on else "",
            receiver_text(setting.receiver) if console.width >= _WIDEST else setting.receiver,
            setting.locator,
            ", ".join(varied_text(setting, prices.settings[0])).replace(" gradient", ""),
            *(ms_text(offer.median_ms), *alone, *_rate(offer)),
            *((str(batch), *_made(prices, setting)) if wide else ()),
        ]
        table.add_row(*(Text(cell) for cell in cells), style="" if on else "dim")
    if (mark_row := _mark_row(prices, scenes, single)) is not None:
        table.add_row(*(Text(cell) for cell in mark_row), *(("",) * 3 if wide else ()))
    for line in compared(prices):
        console.print(Text(wrapped(line)), soft_wrap=True)
    console.print(table)
    said = [
        f"{mark} on the frontier: nothing is both quicker and better. {frames_text(prices, frames)}; "
        f"{scenes_text(prices, scenes)}. ms: median a frame in the best batch; alone: one frame at a time.",
        "",
        *headline(prices),
        "",
        *about(prices),
    ]
    for line in said:
        console.print(Text(wrapped(line)), soft_wrap=True)


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


def _mark_row(prices: PriceList, scenes: str, single: bool) -> list[str] | None:
    """Give the line of what is possible."""
    mark = prices.mark(scenes)
    if mark is None:
        return None
    rate, interval = mark
    limit = Offer("possible", 1.0, 1.0, 1.0, rate, interval.low, interval.high)
    return ["", "knows the scene", "", "", "", *([""] if single else []), *_rate(limit)]


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
