"""``recommendation.txt``: which receiver to take, in plain words, from what was measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from vocc_torch.show.text_table import interval_text, rate_text
from vocc_torch.studies.tradeoff.frontier import Offer, most_accurate, most_accurate_within, quickest_below
from vocc_torch.studies.tradeoff.knob_setting import KnobSetting
from vocc_torch.studies.tradeoff.price_list import PriceList
from vocc_torch.studies.tradeoff.tradeoff_basis import about, compared, counted_frames
from vocc_torch.studies.tradeoff.tradeoff_words import (
    FRAMES_PER_S,
    RATES,
    ber_text,
    frames_text,
    ms_text,
    scenes_text,
    setting_text,
    timed_text,
    wrapped,
)


def recommendation(prices: PriceList, knobs: Sequence[KnobSetting] = ()) -> str:
    """Say what to take: in short, then for each kind of scenes and frames, and what it rests on.

    Args:
        prices: what was measured.
        knobs: what was measured of the renderer.
    """
    lines = ["WHICH RECEIVER TO TAKE", "", *compared(prices), "", *headline(prices), "", "WHAT THIS RESTS ON"]
    lines += [*(f"  {line}" for line in about(prices)), "", "EVERY KIND OF SCENES AND FRAMES", ""]
    for scenes in prices.errors:
        for device, frames in prices.kinds:
            lines += [*_section(prices, scenes, device, frames), ""]
    lines += _renderer(knobs)
    return "\n".join(map(wrapped, lines)).rstrip() + "\n"


def headline(prices: PriceList) -> list[str]:
    """Say it for the first kind of frames and scenes alone, each receiver with its best batch size."""
    device, frames = prices.kinds[0]
    scenes = next(iter(prices.errors))
    offers = prices.offers(scenes, device, frames)
    what = _lower(frames_text(prices, scenes, frames))
    head = f"In short, for {what}, in batches; {scenes_text(prices, scenes)}:"
    answers = [*_within(prices, scenes, offers, brief=True), *_below(prices, offers, brief=True)]
    return [head, *(f"  {line}" for line in [*answers, *_possible(prices, scenes, offers)])]


def _section(prices: PriceList, scenes: str, device: str, frames: str) -> Iterator[str]:
    """Say what to take on one device, for one kind of frames and scenes."""
    where = "" if len(prices.machines) == 1 else f", on {device}"
    elsewhere = f"; {told}" if (told := timed_text(prices, scenes)) else ""
    yield f"{frames_text(prices, scenes, frames)}{where}; {scenes_text(prices, scenes)}{elsewhere}"
    best = prices.offers(scenes, device, frames)
    yield "  In batches, each receiver in its best one:"
    yield from (f"    {line}" for line in _answers(prices, scenes, best))
    if prices.batches(device, frames)[0] == 1 and len(prices.batches(device, frames)) > 1:
        yield "  A frame at a time, as it comes:"
        yield from (
            f"    {line}" for line in _answers(prices, scenes, prices.offers(scenes, device, frames, 1))
        )
    yield from (f"  {line}" for line in _possible(prices, scenes, best))


def _answers(prices: PriceList, scenes: str, offers: Sequence[Offer]) -> Iterator[str]:
    """Say what to take within each time and below each rate."""
    yield from _within(prices, scenes, offers)
    yield from _below(prices, offers)


def _within(prices: PriceList, scenes: str, offers: Sequence[Offer], *, brief: bool = False) -> Iterator[str]:
    """Say which receiver to take within each time, those with the same answer together."""
    answers: dict[str, list[int]] = {}
    for speed in FRAMES_PER_S:
        taken = most_accurate_within(offers, 1e3 / speed)
        answers.setdefault("" if taken is None else taken.name, []).append(speed)
    for name, speeds in answers.items():
        limit = _either([ms_text(1e3 / speed) for speed in speeds])
        rate = _either([str(speed) for speed in speeds])
        said = f"Under {limit} ms a frame{'' if brief else f' ({rate} frames a second)'}: "
        if not name:
            quickest = _quickest(offers)
            yield f"{said}none; the quickest is {_named(prices, quickest)}: {_spent(quickest, brief)}."
            continue
        offer = next(one for one in offers if one.name == name)
        rivals = "" if brief else _rivals(prices, scenes, offers, offer)
        yield f"{said}take {_offered(prices, offer, brief)}.{rivals}"


def told_of(prices: PriceList, scenes: str, device: str, frames: str) -> set[str]:
    """Give the names of all settings that the words name for one device and kind of frames and scenes.

    Args:
        prices: what was measured.
        scenes: the kind of scenes.
        device: the device.
        frames: ``whole`` or ``crops``.
    """
    every = [prices.offers(scenes, device, frames)]
    if prices.batches(device, frames)[0] == 1:
        every.append(prices.offers(scenes, device, frames, 1))
    told: set[str] = set()
    for offers in every:
        within = [most_accurate_within(offers, 1e3 / speed) for speed in FRAMES_PER_S]
        rivals = [_rival(prices, scenes, offers, one) for one in within if one is not None]
        below = [quickest_below(offers, rate) for rate in RATES]
        others = [_quickest(offers), _nearest(offers), most_accurate(offers)]
        told |= {one.name for one in (*within, *rivals, *below, *others) if one is not None}
    return told


def _quickest(offers: Sequence[Offer]) -> Offer:
    """Give the one to name where none keeps within a time."""
    return min(offers, key=lambda one: one.median_ms)


def _nearest(offers: Sequence[Offer]) -> Offer:
    """Give the one to name where none keeps below a rate."""
    return min(offers, key=lambda one: (one.ber_high, one.median_ms))


def _rival(prices: PriceList, scenes: str, offers: Sequence[Offer], offer: Offer) -> Offer | None:
    """Give the quickest of those that the frames do not tell from an offer, where it is quicker."""
    own = next(i for i, one in enumerate(offers) if one.name == offer.name)
    quicker = [offers[i] for i in prices.alike(scenes, own) if offers[i].high_ms < offer.low_ms]
    return min(quicker, key=lambda one: one.median_ms, default=None)


def _rivals(prices: PriceList, scenes: str, offers: Sequence[Offer], offer: Offer) -> str:
    """Name a quicker one that the frames do not tell from an offer, where there is one."""
    best = _rival(prices, scenes, offers, offer)
    if best is None:
        return ""
    return f" These frames do not tell its rate from that of a quicker one, {_offered(prices, best)}."


def _below(prices: PriceList, offers: Sequence[Offer], *, brief: bool = False) -> Iterator[str]:
    """Say which receiver to take for each rate, those with the same answer together."""
    nearest = _nearest(offers)
    answers: dict[tuple[str, bool], list[float]] = {}
    for rate in RATES:
        taken = quickest_below(offers, rate)
        key = ("", nearest.ber < rate) if taken is None else (taken.name, True)
        answers.setdefault(key, []).append(rate)
    for (name, likely), rates in answers.items():
        limit = _either([f"{rate:.0e}".replace("e-0", "e-") for rate in rates])
        said = f"For a BER below {limit}: "
        if name:
            offer = next(one for one in offers if one.name == name)
            yield f"{said}take {_offered(prices, offer, brief)}."
            continue
        why = f"{counted_frames(prices)} frames cannot show it" if likely else "none"
        yield f"{said}{why}; the nearest is {_named(prices, nearest)}: {_rate(nearest, brief)}."


def _possible(prices: PriceList, scenes: str, offers: Sequence[Offer]) -> list[str]:
    """Say how far the most accurate receiver is from what is possible, both on the same frames."""
    mark = prices.mark(scenes)
    if mark is None:
        return []
    rate, interval = mark
    frames = prices.marks[scenes].counts.frames
    limit = f"What is possible, by a decoder that knows the scene, in {frames} frames: "
    if rate == 0:
        limit += f"no error, BER < {rate_text(interval.high)}"
    else:
        limit += f"BER {rate_text(rate)} ({interval_text(rate, interval.low, interval.high)})"
    best = most_accurate(offers)
    own = next(c for setting, c in prices.where_marked(scenes).items() if setting.name == best.name)
    if own.bit_errors and rate:
        told = f"{own.ber / rate:.2g} times that"
    else:
        told = f"BER {rate_text(own.ber)}" if own.bit_errors else "no error"
    return [f"{limit}. The best here, {_named(prices, best)}, has {told} on the same {frames} frames."]


def _either(words: Sequence[str]) -> str:
    """Join words by commas and a last or."""
    return " or ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def _lower(text: str) -> str:
    """Begin with a small letter."""
    return text[:1].lower() + text[1:]


def _named(prices: PriceList, offer: Offer) -> str:
    """Name an offer's setting."""
    setting = next(one for one in prices.settings if one.name == offer.name)
    return setting_text(setting, prices.settings[0])


def _offered(prices: PriceList, offer: Offer, brief: bool = False) -> str:
    """Name an offer's setting, with its rate and time."""
    return f"{_named(prices, offer)}: {_rate(offer, brief)}, {_spent(offer, brief)}"


def _rate(offer: Offer, brief: bool) -> str:
    """Write an offer's rate, with its interval or without."""
    if brief:
        return f"BER < {rate_text(offer.ber_high)}" if offer.error_free else f"BER {rate_text(offer.ber)}"
    return ber_text(offer)


def _spent(offer: Offer, brief: bool) -> str:
    """Write an offer's time, with its quartiles or without."""
    spread = "" if brief else f" ({ms_text(offer.low_ms)}-{ms_text(offer.high_ms)})"
    return f"{ms_text(offer.median_ms)} ms{spread}"


def _renderer(knobs: Sequence[KnobSetting]) -> list[str]:
    """Say what the renderer's knobs cost and buy."""
    if not knobs:
        return []
    usual, *turned = knobs
    lines = [
        "WHAT THE RENDERER'S KNOBS COST AND BUY",
        f"  As set: {ms_text(usual.cost_ms[1])} ms a frame, grey values within {usual.worst_dn:.2g} of "
        "frames rendered whole in float64.",
    ]
    for one in turned:
        ratio = one.cost_ms[1] / usual.cost_ms[1]
        lines.append(
            f"  {_knob(one)}: {ms_text(one.cost_ms[1])} ms ({ratio:.2f} times), within "
            f"{one.worst_dn:.2g}; {100 * one.changed:.2g} % of the panel's pixels differ in 8 bits."
        )
    if any(one.knob == "sampled" for one in turned):
        lines.append(
            "  Sampling LEDs at points is an alternative that is not used: here LEDs cover exact areas."
        )
    return lines


def _knob(one: KnobSetting) -> str:
    """Name a setting of the renderer."""
    if one.knob == "sampled":
        return f"LEDs sampled at {one.value} points a pixel"
    return {"kernel": "blooming kernel cut at ", "margin": "crop "}.get(one.knob, f"{one.knob} ") + one.value
