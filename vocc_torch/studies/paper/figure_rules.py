"""Rules for everything but bit error rates: a figure's numbers, processing times, dimming and equations.

**number.** Numbers of single pictures and of samples of 100 frames are compared as they are: they have no
interval, in the paper as here.

**time.** Processing times are ratios on one machine, with other software, of whole frames one at a time as in
the paper. *Cannot say* where the quartiles over the rounds are farther apart than a factor of 2, or where the
processor was busy with something else for more than 5 % of the time; *agree* where the median is within a
factor of 1.5 of the quoted ratio; else *differ*. An order of times, and "much longer" (twice at least), hold
where the quartiles do not overlap: *agree* or *differ* by them, else *cannot say*.

**best_luminance.** Each ambient light has candidates, than which no other luminance is surely better; over
all ambient lights together they miss a best one in 5 % of studies. *Agree* where two ambient lights share
none; *differ* where all have the same single one; else *cannot say*.

**equation.** What the paper's own numbers and equations give.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from itertools import combinations, pairwise

import numpy as np
import torch

from vocc_torch.measure.estimate import CONFIDENCE, Estimate
from vocc_torch.measure.grid import Grid, not_worse
from vocc_torch.simulation import photometry
from vocc_torch.studies.paper.judgement import Judgement, NotMeasuredError, PaperReading
from vocc_torch.studies.paper.words import listed, percent, place

TIME_FACTOR = 1.5
"""Ratios of processing times agree within this factor."""
WIDEST_FACTOR = 2.0
"""Beyond this ratio of its quartiles a time was measured too noisily to be judged."""
MOST_WAITED = 0.05
"""Largest share of the time for which the measurement may have waited for the processor."""
MUCH_SHORTER = 0.5
"""A stage is much shorter than panel detection that takes at most this share of its time."""
BACKGROUND_GREYS = (86.0, 118.0)
"""Section IV-C: auto-ISO gives the background a grey value between these."""
BIN = 0.06
"""Width of a contrast bin, as in "30 to 36%"."""
GAMMA = 2.2
"""Table 1."""
REFLECTANCES = (0.18, 0.4)
"""Of the background and of an LED, section IV-C."""
ROUNDING = 0.005
"""A number quoted in whole per cent stands for this much on either side."""


def number(
    reading: PaperReading,
    value: str = "",
    shows: str = "",
    otherwise: str = "",
    above: float = -math.inf,
    least: float = -math.inf,
    below: float = math.inf,
    most: float = math.inf,
    ascending: Sequence[str] = (),
    largest: str = "",
    of: Sequence[str] = (),
) -> Judgement:
    """Judge whether a figure's number lies within limits, or how several compare.

    Args:
        reading: what was measured.
        value: a number, such as ``fig12.auc_ngr``.
        shows: how to write what was measured, with numbers of the same figure in braces.
        otherwise: the reason where ``value`` does not lie within the limits.
        above: ``value`` must be above this.
        least: it must be at least this.
        below: it must be below this.
        most: it must be at most this.
        ascending: numbers of which each must be below the next.
        largest: a number that must be above each of ``of``.
        of: the numbers that it is compared with.
    """
    if not value:
        pairs = [(less, largest) for less in of] if largest else list(pairwise(ascending))
        return compared(reading, [largest, *of] if largest else ascending, pairs, ties=bool(largest))
    found, figure = reading.number(value), value.partition(".")[0]
    known: dict[str, float | str] = {
        name: ("a" if one else "no") if name.startswith("separable_") else one
        for name, one in reading.numbers[figure].items()
    }
    try:
        measured = shows.format_map(known)
    except KeyError as missing:
        raise NotMeasuredError(f"{missing.args[0]} of {figure}") from None
    return Judgement.of(above < found < below and least <= found <= most, measured, otherwise)


def compared(
    reading: PaperReading, names: Sequence[str], pairs: Sequence[tuple[str, str]], *, ties: bool
) -> Judgement:
    """Judge whether the first number of each pair is below the second; whether equal ones decide nothing."""
    words = {name: name.partition(".")[2].replace("auc_", "area of ").replace("_", " ") for name in names}
    values = {name: reading.number(name) for name in names}
    measured = ", ".join(f"{words[name]} {value:.7g}" for name, value in values.items())
    for less, more in pairs:
        if values[less] > values[more] or (values[less] == values[more] and not ties):
            return Judgement("differ", measured, f"{words[less]} is higher")
    if any(values[less] == values[more] for less, more in pairs):
        return Judgement("cannot say", measured, "equal in this sample")
    return Judgement("agree", measured)


def time(
    reading: PaperReading,
    ratio: str = "",
    quoted: float = 0.0,
    digits: int = 0,
    much_shorter: Sequence[str] = (),
    ascending: Sequence[str] = (),
) -> Judgement:
    """Judge a ratio of processing times, bit detection against panel detection, or an order.

    Args:
        reading: what was measured.
        ratio: the ratio's name in Fig. 25.
        quoted: what the paper has for it.
        digits: of the ratio in per cent.
        much_shorter: bit detectors that take much less time than panel detection.
        ascending: bit detectors of which each takes longer than the one before; the last, with NGR, is
            compared with the one before it round by round.
    """
    if ratio:
        judged = time_ratio(reading, ratio, quoted, digits)
    elif much_shorter:
        judged = all_much_shorter(reading, much_shorter)
    else:
        judged = times_rise(reading, ascending)
    waited = reading.numbers["fig25"].get("waited_share", 0.0)
    if not waited > MOST_WAITED:
        return judged
    busy = f"the processor was busy with something else for {percent(waited)} of the time"
    return Judgement("cannot say", judged.measured, busy, judged.low, judged.high)


def time_ratio(reading: PaperReading, ratio: str, quoted: float, digits: int) -> Judgement:
    """Judge a ratio of processing times by its quartiles; in batches it is only told."""
    found = _quartiles(reading, ratio)
    start = f"{ratio}_whole_frames_batch_"
    batches = {
        int(name.removeprefix(start)): value
        for name, value in reading.numbers["fig25"].items()
        if re.fullmatch(rf"{start}(?!1$)\d+", name)
    }
    measured = f"{_shown(found, digits)} one frame at a time"
    for size in sorted(batches):
        measured += f"; {percent(batches[size], digits)} in batches of {size}"
    ends = found.low, found.high
    if found.low <= 0 or found.high > WIDEST_FACTOR * found.low:
        reason = "too noisy: the quartiles are farther apart than a factor of 2"
        return Judgement("cannot say", measured, reason, *ends)
    reason = "other software on another machine"
    try:
        panel, three = (_quartiles(reading, f"ms_{stage}").value for stage in ("panel_detection", "flda_3"))
        reason += f": panel detection takes {panel:.2g} ms a frame here, three features {three:.2g} ms"
    except NotMeasuredError:
        pass
    near = found.value / TIME_FACTOR <= quoted <= found.value * TIME_FACTOR
    return Judgement.of(near, measured, reason, *ends)


def all_much_shorter(reading: PaperReading, detectors: Sequence[str]) -> Judgement:
    """Judge whether each bit detector takes much less time than panel detection."""
    found = {name: _quartiles(reading, f"share_{name}") for name in detectors}
    longest = max(found, key=lambda name: found[name].value)
    measured = f"the longest bit detection is {_shown(found[longest], 0)} of panel detection ({longest})"
    if all(share.high <= MUCH_SHORTER for share in found.values()):
        return Judgement("agree", measured)
    if any(share.low > MUCH_SHORTER for share in found.values()):
        return Judgement("differ", measured, f"{longest} takes more than half as long")
    return Judgement("cannot say", measured, "too noisy: the quartiles of a share hold a half")


def times_rise(reading: PaperReading, detectors: Sequence[str]) -> Judgement:
    """Judge whether each bit detector's quartiles lie above those of the one before."""
    found = {name: _quartiles(reading, f"ms_{name}") for name in detectors}
    extra = _quartiles(reading, "extra_cost_of_ngr")
    measured = ", ".join(f"{name} {t.value:.2g} ms [{t.low:.2g}, {t.high:.2g}]" for name, t in found.items())
    gaps = {
        f"{less} and {more}": (found[more].low - found[less].high, found[more].high - found[less].low)
        for less, more in pairwise(detectors)
    }
    gaps[" and ".join(detectors[-2:])] = extra.low, extra.high
    if against := [pair for pair, (_, high) in gaps.items() if high < 0]:
        return Judgement("differ", measured, f"the other way round: {listed(against)}")
    if open_ones := [pair for pair, (low, _) in gaps.items() if low <= 0]:
        return Judgement("cannot say", measured, f"quartiles overlap: {listed(open_ones)}")
    return Judgement("agree", measured)


def _quartiles(reading: PaperReading, name: str) -> Estimate:
    """A time, or a ratio of times, on whole frames one at a time: the median with the quartiles."""
    at = f"fig25.{name}_whole_frames_batch_1"
    return Estimate(*(reading.number(f"{at}{end}") for end in ("", "_low", "_high")))


def _shown(found: Estimate, digits: int) -> str:
    """Write a median with its quartiles."""
    ends = f"{100 * found.low:.{digits}f} to {100 * found.high:.{digits}f}"
    return f"{percent(found.value, digits)} (quartiles {ends})"


def best_luminance(reading: PaperReading, receiver: str) -> Judgement:
    """Judge whether a receiver's best LED luminance differs between levels of ambient light."""
    grid = reading.dimming
    if grid is None or receiver not in grid.receivers:
        raise NotMeasuredError("the map of ambient light by LED luminance")
    held = candidates(grid, receiver)
    measured = ", ".join(
        f"{place(grid.column_axis, *sorted(held[at]))} at {place(grid.row_axis, grid.rows[at])}"
        for at in (0, len(grid.rows) - 1)
    )
    if any(not one & other for one, other in combinations(held, 2)):
        return Judgement("agree", measured)
    if all(len(one) == 1 for one in held):
        return Judgement("differ", measured, "the same luminance is best under every ambient light")
    shared = sorted(set.intersection(*held))
    reason = "candidates overlap from one ambient light to any other"
    if shared:
        reason = f"{place(grid.column_axis, *shared)} may be the best under every ambient light"
    return Judgement("cannot say", measured, reason)


def candidates(grid: Grid, receiver: str) -> list[set[float]]:
    """The luminances that may be the best under each ambient light; all sets hold in 95 % of studies."""
    tail = (1 - CONFIDENCE) / max(1, len(grid.columns) - 1) / len(grid.rows)
    held = not_worse(grid.ber(receiver), *grid.one_sided(receiver, tail))
    return [{float(value) for value in np.array(grid.columns)[row]} for row in held]


def equation(reading: PaperReading, name: str, **arguments: float) -> Judgement:
    """Judge by the paper's equations.

    Args:
        reading: what was measured.
        name: of the equation, a key of ``EQUATIONS``.
        arguments: of that equation's function.
    """
    return EQUATIONS[name](reading, **arguments)


def net_data_rate(reading: PaperReading, kbps: float, frames_per_s: float) -> Judgement:
    """Judge whether the bits of a frame at the camera's frame rate give the net data rate."""
    every = (reading.curves(name).counts.values() for name in reading.experiments)
    counts = next((one for counts in every for one in counts if one.frames), None)
    if counts is None:
        raise NotMeasuredError("a frame")
    bits = counts.bits / counts.frames
    found = bits * frames_per_s / 1000
    measured = f"{found:g} kbps: {bits:g} bits a frame, {frames_per_s:g} frames a second"
    return Judgement.of(math.isclose(found, kbps), measured, "the panel has another number of LEDs")


def transmission(reading: PaperReading, quoted: float, distance_m: float, visibility_m: float) -> Judgement:
    """Judge the air's transmission at a distance, to four digits (Eq. 20)."""
    found = float(photometry.transmission(torch.tensor(distance_m, dtype=torch.float64), visibility_m))
    return Judgement.of(round(found, 4) == quoted, f"{found:.5f}", "by Eq. 20")


def half_exposure(reading: PaperReading) -> Judgement:
    """Judge whether a grey of 86 has half the exposure of middle grey, 118 (Eq. 1)."""
    value = photometry.MIDDLE_GREY * 0.5 ** (1 / GAMMA)
    measured = f"118 x 0.5^(1/2.2) = {value:.1f}"
    return Judgement.of(round(value) == BACKGROUND_GREYS[0], measured, "by Eq. 1")


def gains_follow(reading: PaperReading) -> Judgement:
    """Judge whether the paper's numbers fit each other: to a point, for they are rounded."""
    gains = (0.24, 1 - 5.0 / 6.6, 0.01), (0.26, 1 - 3.9 / 5.3, 0.01)
    times = (0.17, 14 / 12 - 1, 0.01), (0.0178, (14 - 12) / (100 + 12), 0.001)
    follow = (*gains, *times)
    fit = all(abs(stated - found) <= rounding for stated, found, rounding in follow)
    measured = ", ".join(percent(found, 1) for _, found, _ in follow)
    return Judgement.of(fit, measured, "they do not fit each other")


def iso_range(reading: PaperReading) -> Judgement:
    """Judge whether ISO 100 to 3200 gives greys of 86 to 118 from 1000 to 32000 lx.

    By Eq. 1 the ISO speed needed is in proportion to grey^gamma / illuminance, whatever N and K are.
    """
    dark, bright = BACKGROUND_GREYS
    needed, there = 32000 / 1000 * (bright / dark) ** GAMMA, 3200 / 100
    measured = f"ISO speeds of {needed:.0f} to 1 are needed, 100 to 3200 is {there:.0f} to 1"
    holds = needed <= there * (1 + 1e-9)
    return Judgement.of(holds, measured, "by Eq. 1, whatever the f-number and K")


def contrast_by_equations(ambient_lx: float, luminance_cd_m2: float, background_grey: float) -> float:
    """Contrast of On and Off LEDs before any blur, by Eqs 1 to 3, clipped at white.

    The luminous exposure is in proportion to luminance, and auto-ISO makes the background's grey what it is,
    so exposure time, f-number and K cancel.

    Example:
        >>> round(contrast_by_equations(32000.0, 500.0, 102.0), 3)
        0.031
    """
    ambient = torch.tensor(ambient_lx, dtype=torch.float64)
    background, off = (photometry.reflected_luminance_cd_m2(ambient, share) for share in REFLECTANCES)
    grey = torch.tensor(background_grey, dtype=torch.float64)
    iso = photometry.auto_iso_speed(background, grey, gamma=GAMMA)
    greys = [photometry.grey_value(seen, iso, gamma=GAMMA) for seen in (off, off + luminance_cd_m2)]
    dark, bright = (min(255.0, float(grey)) for grey in greys)
    return (bright - dark) / 255


def contrast(
    reading: PaperReading, stated_percent: float, ambient_lx: float, luminance_cd_m2: float
) -> Judgement:
    """Judge whether a scene of Fig. 20 has the contrast stated.

    The paper leaves the scene's background grey open, so the measured contrast is carried over to the ends of
    its range; it agrees if the stated one, which is rounded, lies between.
    """
    scene = f"paper_scene_{stated_percent:g}"
    seen, grey = (reading.number(f"fig20.{what}_{scene}") for what in ("contrast", "background_grey"))
    here = contrast_by_equations(ambient_lx, luminance_cd_m2, grey)
    ends = [contrast_by_equations(ambient_lx, luminance_cd_m2, one) for one in BACKGROUND_GREYS]
    low, high = (seen * end / here for end in sorted(ends))
    measured = f"{percent(seen, 1)} at background grey {grey:g}, "
    measured += f"{percent(low, 1)} to {percent(high, 1)} over greys 86 to 118"
    reason = f"Eqs 1 to 3 give {ambient_lx:g} lx with {luminance_cd_m2:g} cd/m2 {percent(here, 1)}"
    reason += "; On LEDs are white (255) there" if ends[0] > ends[1] else ""
    holds = low - ROUNDING <= stated_percent / 100 <= high + ROUNDING
    return Judgement.of(holds, measured, reason, low, high)


def contrast_range(
    reading: PaperReading, lowest: float | None = None, highest: float | None = None
) -> Judgement:
    """Judge whether the contrast of the experiment's frames begins, or ends, at a value, to a bin's width."""
    curves = reading.curves("contrast")
    frames = {at: curves.counts[curves.receivers[0], at].frames for at in curves.values}
    filled = [at for at, count in frames.items() if count]
    if not filled:
        raise NotMeasuredError("experiment contrast")
    if highest is None:
        assert lowest is not None
        pick, which, end, light = min, ("lowest", "least"), lowest, (32000.0, 500.0)
        outside = [count for at, count in frames.items() if at < end]
    else:
        pick, which, end, light = max, ("highest", "most"), highest, (1000.0, 8000.0)
        outside = [count for at, count in frames.items() if at > end]
    low, high = pick(filled) - BIN / 2, pick(filled) + BIN / 2
    extreme = pick(contrast_by_equations(*light, grey) for grey in BACKGROUND_GREYS)
    measured = f"the {which[0]} bin with frames is {100 * low:.0f} to {percent(high)}; "
    measured += f"by Eqs 1 to 3 the {which[1]} is {percent(extreme, 1)}"
    share = percent(sum(outside) / sum(frames.values()), 1)
    reason = f"{share} of the frames lie beyond it" if any(outside) else "no frame reaches it"
    holds = low - 1e-9 <= end < high - 1e-9 or (highest is not None and abs(end - high) < 1e-9)
    return Judgement.of(holds, measured, reason, low, high)


def interference(reading: PaperReading) -> Judgement:
    """Judge whether blooming takes more away the higher the contrast is that scenes truly have (Fig. 20)."""
    before, after = (
        [reading.number(f"fig20.{what}_true_{scene}") for scene in (6, 30, 50)]
        for what in ("contrast", "contrast_in_picture")
    )
    lost = [whole - left for whole, left in zip(before, after, strict=True)]
    shares = [loss / whole if whole else 0.0 for loss, whole in zip(lost, before, strict=True)]
    points, relative = (", ".join(f"{100 * one:.0f}" for one in each) for each in (lost, shares))
    measured = f"blur takes {points} points from contrasts of 6, 30 and 50 %; "
    measured += f"relative to the contrast that is {relative} %"
    reason = "the points lost do not grow with the contrast"
    return Judgement.of(lost[0] < lost[1] < lost[2], measured, reason)


EQUATIONS: dict[str, Callable[..., Judgement]] = {
    rule.__name__: rule
    for rule in (
        *(net_data_rate, transmission, half_exposure, gains_follow, iso_range),
        *(contrast, contrast_range, interference),
    )
}
"""Every equation by its name in ``claims.yaml``."""
