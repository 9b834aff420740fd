"""``recommendation.txt``: which receiver to take, in plain words, from what was measured."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from vocc_torch.evaluation.frontier import Offer, most_accurate_within, quickest_below
from vocc_torch.evaluation.price_list import KnobSetting, PriceList, Setting
from vocc_torch.reporting.text_table import interval_text, rate_text

FRAMES_PER_S = (1000, 100, 60, 30)
"""Rates of cameras, and of an industrial one that is fast: the time limits."""

RATES = (1e-2, 1e-3, 1e-4, 1e-5)
"""Limits of the bit error rate."""

_CORNERS = {"truth": "true corners", "paper": "the paper's locator", "refined": "the refined locator"}


def setting_text(setting: Setting, base: Setting) -> str:
    """Name a setting by its receiver and locator, and by what it varies.

    Args:
        setting: what to name.
        base: what needs no telling.

    Example:
        >>> base = Setting("flda_3", "paper", 8, "sobel", "float32")
        >>> setting_text(Setting("lmmse", "refined", 4, "sobel", "float64"), base)
        'lmmse with the refined locator, K 4, float64'
    """
    return ", ".join([f"{setting.receiver} with {_CORNERS[setting.locator]}", *varied_text(setting, base)])


def varied_text(setting: Setting, base: Setting) -> list[str]:
    """Name what a setting varies.

    Example:
        >>> base = Setting("flda_3", "paper", 8, "sobel", "float32")
        >>> varied_text(Setting("flda_3", "paper", 8, "central", "float32"), base)
        ['central gradient']
    """
    said = [] if setting.samples_per_led == base.samples_per_led else [f"K {setting.samples_per_led}"]
    said += [] if setting.gradient == base.gradient else [f"{setting.gradient} gradient"]
    return said + ([] if setting.dtype == base.dtype else [setting.dtype])


def ms_text(ms: float) -> str:
    """Write a time in three digits.

    Example:
        >>> [ms_text(value) for value in (0.03333, 0.5, 1.0, 33.333, 142.2)]
        ['0.0333', '0.500', '1.00', '33.3', '142']
    """
    digits = 0 if ms >= 99.95 else 1 if ms >= 9.995 else 2 if ms >= 0.9995 else 3 if ms >= 0.09995 else 4
    return f"{ms:.{digits}f}"


def ber_text(offer: Offer) -> str:
    """Write a rate with its interval, or the limit where there were no errors.

    Example:
        >>> ber_text(Offer("a", 1, 1, 1, 6.6e-4, 4.9e-4, 1.2e-3)), ber_text(Offer("b", 1, 1, 1, 0, 0, 1e-5))
        ('BER 6.6e-4 (4.9-12e-4)', 'no error, BER < 1.0e-5')
    """
    if offer.error_free:
        return f"no error, BER < {rate_text(offer.ber_high)}"
    return f"BER {rate_text(offer.ber)} ({interval_text(offer.ber, offer.ber_low, offer.ber_high)})"


def recommendation(prices: PriceList, knobs: Sequence[KnobSetting] = ()) -> str:
    """Say what to take, for each kind of frames and scenes.

    Args:
        prices: what was measured.
        knobs: what was measured of the renderer.
    """
    lines = ["WHICH RECEIVER TO TAKE", ""]
    for scenes in prices.errors:
        for device, frames in prices.kinds:
            lines += [*_section(prices, scenes, device, frames), ""]
    lines += _renderer(knobs)
    return "\n".join([*(wrapped(line) for line in [*lines, *about(prices)]), ""])


def wrapped(line: str) -> str:
    r"""Break a line at 110 characters, with what follows under its text.

    Example:
        >>> [len(part) <= 110 for part in wrapped("  " + 40 * "word ").split("\n")]
        [True, True]
    """
    indent = " " * (len(line) - len(line.lstrip()))
    return textwrap.fill(line, 110, subsequent_indent=f"{indent}  ", break_on_hyphens=False)


def headline(prices: PriceList) -> list[str]:
    """Say it for the first kind of frames and scenes alone."""
    device, frames = prices.kinds[0]
    return list(_section(prices, next(iter(prices.errors)), device, frames))


def about(prices: PriceList) -> list[str]:
    """Say what the numbers rest on."""
    waited = (
        f" For {100 * prices.waited_share:.0f} % of it other work had the processor: take them with care."
    )
    (test_frames,) = {counts.frames for name in prices.errors for counts in prices.counts(name).values()}
    thread = "one thread" if prices.threads == 1 else f"{prices.threads} threads"
    apart = [abs(ratio - 1) for ratio in prices.end_to_end.values()]
    return [
        f"Bit error rates: {test_frames} frames of each kind of scenes, the same for all receivers, with "
        "95 % intervals; a receiver keeps below a rate where its whole interval does.",
        "Times: medians over interleaved rounds, with quartiles; a receiver keeps within a time where its "
        "upper quartile does. Rendering and preambles are not in them.",
        *_preambles(prices),
        f"Stages are timed one by one; a receiver in one go came within {100 * max(apart):.0f} % of the sum.",
        *(f"Measured on {name}: {what}; {thread}." for name, what in prices.machines.items()),
        *([waited.strip()] if prices.waited_share >= 0.05 else []),
    ]


def _preambles(prices: PriceList) -> list[str]:
    """Say which receivers need frames of known bits."""
    given = dict.fromkeys(setting.receiver for setting in prices.settings)
    names = [name for name in given if name in ("center_greyscale", "average_greyscale")]
    if not names:
        return []
    return [f"Frames of known bits before each scene, which others do without: {' and '.join(names)}."]


def frames_text(prices: PriceList, frames: str) -> str:
    """Say what the receiver is handed."""
    height, width = prices.sensor_px if frames == "whole" else prices.crop_px
    what = "Whole frames" if frames == "whole" else "Crops of the panel's surroundings"
    return f"{what}, {width} x {height} px"


def scenes_text(prices: PriceList, scenes: str) -> str:
    """Name a kind of scenes."""
    return f"{prices.scene} scenes, {scenes.replace('_', ' ')}".strip()


def _section(prices: PriceList, scenes: str, device: str, frames: str) -> Iterator[str]:
    """Say what to take on one device, for one kind of frames and scenes."""
    where = "" if len(prices.machines) == 1 else f", on {device}"
    yield f"{frames_text(prices, frames)}{where}; {scenes_text(prices, scenes)}"
    best = prices.offers(scenes, device, frames)
    yield "  In batches, each receiver in its best one:"
    yield from _within(prices, scenes, best)
    yield from _below(prices, best)
    if prices.batches(device, frames)[0] == 1 and len(prices.batches(device, frames)) > 1:
        yield "  A frame at a time, as it comes:"
        single = prices.offers(scenes, device, frames, 1)
        yield from _within(prices, scenes, single)
        yield from _below(prices, single)


def _within(prices: PriceList, scenes: str, offers: Sequence[Offer]) -> Iterator[str]:
    """Say which receiver to take within each time, those with the same answer together."""
    answers: dict[str, list[int]] = {}
    for speed in FRAMES_PER_S:
        taken = most_accurate_within(offers, 1e3 / speed)
        answers.setdefault("" if taken is None else taken.name, []).append(speed)
    for name, speeds in answers.items():
        limit = _either([ms_text(1e3 / speed) for speed in speeds])
        rate = _either([str(speed) for speed in speeds])
        said = f"    Under {limit} ms a frame ({rate} frames a second): "
        if not name:
            quickest = min(offers, key=lambda one: one.high_ms)
            least = f"the quickest is {_named(prices, quickest)}, {_spent(quickest)}"
            yield f"{said}none; {least}."
            continue
        offer = next(one for one in offers if one.name == name)
        rivals = _rivals(prices, scenes, offers, offer)
        yield f"{said}take {_named(prices, offer)}: {ber_text(offer)}, {_spent(offer)}.{rivals}"


def _rivals(prices: PriceList, scenes: str, offers: Sequence[Offer], offer: Offer) -> str:
    """Name the quickest of those that the frames do not tell from an offer, where it is quicker."""
    own = next(i for i, one in enumerate(offers) if one.name == offer.name)
    quicker = [offers[i] for i in prices.alike(scenes, own) if offers[i].high_ms < offer.low_ms]
    if not quicker:
        return ""
    best = min(quicker, key=lambda one: one.median_ms)
    return (
        f" These frames do not tell it from {_named(prices, best)}, which is quicker: "
        f"{ber_text(best)}, {_spent(best)}."
    )


def _below(prices: PriceList, offers: Sequence[Offer]) -> Iterator[str]:
    """Say which receiver to take for each rate, those with the same answer together."""
    answers: dict[str, list[float]] = {}
    for rate in RATES:
        taken = quickest_below(offers, rate)
        answers.setdefault("" if taken is None else taken.name, []).append(rate)
    for name, rates in answers.items():
        limit = _either([f"{rate:.0e}".replace("e-0", "e-") for rate in rates])
        said = f"    For a BER below {limit}: "
        if not name:
            best = min(offers, key=lambda one: (one.ber_high, one.median_ms))
            yield f"{said}none is sure; the nearest is {_named(prices, best)}, {ber_text(best)}."
            continue
        offer = next(one for one in offers if one.name == name)
        yield f"{said}take {_named(prices, offer)}: {ber_text(offer)}, {_spent(offer)}."


def _either(words: Sequence[str]) -> str:
    """Join words by commas and a last or."""
    return " or ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def _named(prices: PriceList, offer: Offer) -> str:
    """Name an offer's setting."""
    setting = next(one for one in prices.settings if one.name == offer.name)
    return setting_text(setting, prices.settings[0])


def _spent(offer: Offer) -> str:
    """Write an offer's time."""
    return f"{ms_text(offer.median_ms)} ms ({ms_text(offer.low_ms)}-{ms_text(offer.high_ms)})"


def _renderer(knobs: Sequence[KnobSetting]) -> list[str]:
    """Say what the renderer's knobs cost and buy."""
    if not knobs:
        return []
    usual, *turned = knobs
    lines = [
        "THE RENDERER",
        f"  As set: {ms_text(usual.cost_ms[1])} ms a frame, grey values within {usual.worst_dn:.2g} of "
        "frames rendered whole in float64.",
    ]
    for one in turned:
        ratio = one.cost_ms[1] / usual.cost_ms[1]
        lines.append(
            f"  {one.knob} {one.value}: {ms_text(one.cost_ms[1])} ms ({ratio:.2f} times), within "
            f"{one.worst_dn:.2g}; {100 * one.changed:.2g} % of the panel's pixels differ in 8 bits."
        )
    return [*lines, ""]
