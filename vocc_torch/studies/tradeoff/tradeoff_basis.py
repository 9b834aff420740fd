"""What the price list's words rest on: what was compared, on which frames, and how times were taken."""

from __future__ import annotations

from vocc_torch.studies.tradeoff.price_list import PriceList
from vocc_torch.studies.tradeoff.tradeoff_words import GREYSCALE_RECEIVERS, ms_text, preamble_text, told_text


def compared(prices: PriceList) -> list[str]:
    """Say what was compared and where the picture is."""
    receivers = dict.fromkeys(setting.receiver for setting in prices.settings)
    locators = dict.fromkeys(setting.locator for setting in prices.settings)
    places = "1 way" if len(locators) == 1 else f"{len(locators)} ways"
    return [
        f"Compared: {_count(len(receivers), 'receiver')} with {places} to find the panel, "
        f"{_count(len(prices.settings), 'setting')} in all, on the same {counted_frames(prices)} frames of "
        "each kind of scenes. The picture is tradeoff.png, the table tradeoff.csv."
    ]


def about(prices: PriceList) -> list[str]:
    """Say what the numbers rest on."""
    thread = "one thread" if prices.threads == 1 else f"{prices.threads} threads"
    apart = [abs(ratio - 1) for ratio in prices.end_to_end.values()]
    waited = f"For {100 * prices.waited_share:.0f} % of the time other work had the processor"
    return [
        f"Bit error rates (BER): {counted_frames(prices)} frames of each kind of scenes, with 95 % "
        "intervals; a receiver keeps below a rate where its whole interval does.",
        "Times: medians over interleaved rounds, with quartiles, each call right after an untimed one of the "
        "same stage on other frames; stages are added round by round. A receiver keeps within a time where "
        "its upper quartile does. Rendering is not in them.",
        *_timed(prices),
        *_preambles(prices),
        f"Stages are timed one by one; {prices.in_one_go} in one go came within {100 * max(apart):.0f} % of "
        "the sum.",
        *_compared(prices),
        *(f"Measured on {name}: {what}; {thread}." for name, what in prices.machines.items()),
        *(f"Not measured on {name}: {why}." for name, why in prices.missing.items()),
        *(f"Left out: {name}, since {why}." for name, why in prices.left_out.items()),
        *_searched(prices),
        *_refused(prices),
        *([f"{waited}: take times with care."] if prices.waited_share >= 0.05 else []),
    ]


def _timed(prices: PriceList) -> list[str]:
    """Say whose frames were timed, where there are others."""
    if len(prices.errors) == 1:
        return []
    return [
        f"Frames were timed of {told_text(prices.timed_scenes)} alone; these times stand for every kind of "
        "scenes, whose panels may take longer or shorter to find."
    ]


def _compared(prices: PriceList) -> list[str]:
    """Say what surely beaten means in the pictures and the table."""
    if len(prices.settings) == 1:
        return []
    pairs = len(prices.settings) * (len(prices.settings) - 1) // 2
    return [
        "Surely beaten, in pictures and table: one no slower by the median has a lower rate, by paired "
        f"intervals that hold for all {pairs} pairs of a kind of scenes together at 95 % (Bonferroni)."
    ]


def _refused(prices: PriceList) -> list[str]:
    """Say where and why it was not measured what is possible."""
    reasons: dict[str, list[str]] = {}
    for scenes, why in prices.no_marks.items():
        reasons.setdefault(why, []).append(told_text(scenes))
    return [
        f"What is possible was not measured ({', '.join(names)}): {why}." for why, names in reasons.items()
    ]


def _preambles(prices: PriceList) -> list[str]:
    """Say which receivers need frames of known bits, and what they cost."""
    given = dict.fromkeys(setting.receiver for setting in prices.settings)
    names = [name for name in given if name in GREYSCALE_RECEIVERS]
    if not names:
        return []
    served = prices.frames_a_preamble
    share = f"{100 * served / (served + 2):.0f} %"
    return [
        f"Only {' and '.join(names)} need frames of known bits. Times include {preamble_text(prices)}, which "
        f"also take the channel: {share} of the frames carry data."
    ]


def _searched(prices: PriceList) -> list[str]:
    """Say how sure it is what is possible."""
    if not prices.marks:
        return []
    parts = []
    for scenes, one in prices.marks.items():
        told = f"{told_text(scenes)}, {ms_text(1e3 * one.frame_s)} ms each"
        parts.append(f"{one.proven} of {one.counts.frames} frames ({told})")
    return [
        f"What is possible is searched for; no bits can be likelier than those found in {', '.join(parts)}."
    ]


def _count(number: int, what: str) -> str:
    """Write a number of things."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def counted_frames(prices: PriceList) -> int:
    """Frames of each kind of scenes that errors were counted on."""
    (frames,) = {counts.frames for name in prices.errors for counts in prices.counts(name).values()}
    return frames
