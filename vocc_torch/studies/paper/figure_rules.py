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

What the paper's own numbers and equations give are numbers too: see :func:`derived`.
"""

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from vocc_torch.measure.estimate import CONFIDENCE, Estimate
from vocc_torch.measure.grid import Grid, not_worse
from vocc_torch.simulation import photometry
from vocc_torch.studies.paper.evidence.panels import PAPER_SCENES
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
EXTREMES = ((32000.0, 500.0), (1000.0, 8000.0))
"""Ambient light (lx) and LED luminance (cd/m2) of the least and of the most contrast, section IV-C."""
OUTSIDE = ((0.0, 0.06), (0.54, 1.0))
"""Contrasts that no frame has by section IV-D-1."""


def number(
    reading: PaperReading,
    value: str = "",
    shows: str = "",
    otherwise: str = "",
    above: float = -math.inf,
    least: float = -math.inf,
    below: float = math.inf,
    most: float = math.inf,
    ends: Sequence[str] = (),
    ascending: Sequence[str] = (),
    largest: str = "",
    of: Sequence[str] = (),
) -> Judgement:
    """Judge whether a figure's number lies within limits, or how several compare.

    Args:
        reading: what was measured.
        value: a number, such as ``fig12.auc_ngr``, or one that follows: see :func:`derived`.
        shows: how to write what was measured, with numbers of the same figure in braces.
        otherwise: the reason where ``value`` does not lie within the limits, with numbers likewise.
        above: ``value`` must be above this.
        least: it must be at least this.
        below: it must be below this.
        most: it must be at most this.
        ends: names of numbers that are the ends of an interval, where there is one.
        ascending: numbers of which each must be below the next.
        largest: a number that must be above each of ``of``.
        of: the numbers that it is compared with.
    """
    if value:
        figure = value.partition(".")[0]
        found = derived(reading, figure)
        at = replace(reading, numbers={figure: found}).number(value)
        known = {one: ("a" if n else "no") if one.startswith("separable_") else n for one, n in found.items()}
        try:
            texts = [text.format_map(known) for text in (shows, otherwise)]
        except KeyError as missing:
            raise NotMeasuredError(f"{missing.args[0]} of {figure}") from None
        measured, reason = (re.sub(r"(?<=\d)%", " %", text) for text in texts)
        holds = above < at < below and least <= at <= most
        low, high = (found[end] for end in ends) if ends else (None, None)
        return Judgement("agree" if holds else "differ", measured, "" if holds else reason, low, high)
    names = [largest, *of] if largest else list(ascending)
    words = {name: name.partition(".")[2].replace("auc_", "area of ").replace("_", " ") for name in names}
    values = {name: reading.number(name) for name in names}
    measured = ", ".join(f"{words[name]} {one:.7g}" for name, one in values.items())
    pairs = [(less, largest) for less in of] if largest else list(itertools.pairwise(ascending))
    for less, more in pairs:
        if values[less] > values[more] or (values[less] == values[more] and not largest):
            return Judgement("differ", measured, f"{words[less]} is higher")
    if any(values[less] == values[more] for less, more in pairs):
        return Judgement("cannot say", measured, "equal in this sample")
    return Judgement("agree", measured)


def derived(reading: PaperReading, figure: str) -> Mapping[str, float]:
    """Numbers that follow from the paper's equations and from what was measured; others are a figure's own.

    Args:
        reading: what was measured.
        figure: ``paper``: from the paper's own numbers alone. ``link`` and ``frames``: bits a second, and the
            contrast bins that hold frames. ``scene_6`` to ``scene_50``: a scene of Fig. 20; the paper leaves
            its background grey open, so the contrast measured is carried over to the ends of the range of
            grey. ``blur``: what blooming takes from the contrast that scenes truly have (Fig. 20). Any other
            is a figure.

    Raises:
        NotMeasuredError: what they rest on was not measured.
    """
    if figure == "paper":
        return paper_numbers()
    if figure == "link":
        every = [one for name in reading.experiments for one in reading.curves(name).counts.values()]
        if not every:
            raise NotMeasuredError("a frame")
        bits = every[0].bits / every[0].frames
        return {"bits": bits, "kbps": bits * 100 / 1000}
    if figure == "frames":
        curves = reading.curves("contrast")
        frames = {value: curves.counts[curves.receivers[0], value].frames for value in curves.values}
        least, most, total = min(frames), max(frames), sum(frames.values())
        below, above = (sum(n for value, n in frames.items() if a < value < b) for a, b in OUTSIDE)
        extremes = [contrast_by_equations(*light, grey) for light in EXTREMES for grey in BACKGROUND_GREYS]
        return {
            **{"lowest_from": least - BIN / 2, "lowest_to": least + BIN / 2, "least": min(extremes)},
            **{"highest_from": most - BIN / 2, "highest_to": most + BIN / 2, "most": max(extremes)},
            **{"below": below / total, "above": above / total},
        }
    if figure.startswith("scene_"):
        stated = int(figure.removeprefix("scene_"))
        seen, grey = (reading.number(f"fig20.{n}_paper_{figure}") for n in ("contrast", "background_grey"))
        here = contrast_by_equations(*PAPER_SCENES[stated], grey)
        ends = (contrast_by_equations(*PAPER_SCENES[stated], one) for one in BACKGROUND_GREYS)
        low, high = sorted(seen * end / here for end in ends)
        apart = max(low - stated / 100, stated / 100 - high)
        return {"seen": seen, "grey": grey, "low": low, "high": high, "here": here, "apart": apart}
    if figure == "blur":
        found: dict[str, float] = {}
        for stated in PAPER_SCENES:
            true, left = (reading.number(f"fig20.contrast_{n}true_{stated}") for n in ("", "in_picture_"))
            found |= {f"points_{stated}": 100 * (true - left), f"share_{stated}": 1 - left / true}
        points = (found[f"points_{stated}"] for stated in PAPER_SCENES)
        return found | {"growth": min(more - less for less, more in itertools.pairwise(points))}
    return reading.numbers.get(figure, {})


def paper_numbers() -> dict[str, float]:
    """Numbers that follow from the paper's own, by its equations; ``worst_misfit`` in units of rounding."""
    dark, bright = BACKGROUND_GREYS
    follow = {
        "gain_ambient": (1 - 5.0 / 6.6, 0.24, 0.01),
        "gain_contrast": (1 - 3.9 / 5.3, 0.26, 0.01),
        "time_of_ngr": (14 / 12 - 1, 0.17, 0.01),
        "time_of_ngr_in_total": ((14 - 12) / (100 + 12), 0.0178, 0.001),
    }
    return {
        "transmission": float(photometry.transmission(torch.tensor(70.0, dtype=torch.float64), 40_000.0)),
        "half_exposure_grey": photometry.MIDDLE_GREY * 0.5 ** (1 / GAMMA),
        # By Eq. 1 the ISO speed is in proportion to grey^gamma / illuminance, whatever N and K are.
        "iso_ratio": 32000 / 1000 * (bright / dark) ** GAMMA,
        "worst_misfit": max(abs(stated - one) / rounding for one, stated, rounding in follow.values()),
        **{name: one for name, (one, _, _) in follow.items()},
    }


def contrast_by_equations(ambient_lx: float, luminance_cd_m2: float, background_grey: float) -> float:
    """Contrast of On and Off LEDs before any blur, by Eqs 1 to 3, clipped at white.

    The luminous exposure is in proportion to luminance, and auto-ISO makes the background's grey what it is,
    so exposure time, f-number and K cancel.

    Example:
        >>> round(contrast_by_equations(32000.0, 500.0, 102.0), 3)
        0.031
    """
    background, off = (ambient_lx * share / math.pi for share in REFLECTANCES)
    seen = (off / background, (off + luminance_cd_m2) / background)
    dark, bright = (min(255.0, background_grey * math.pow(ratio, 1 / GAMMA)) for ratio in seen)
    return (bright - dark) / 255


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
        found = {name: quartiles(reading, f"share_{name}") for name in much_shorter}
        longest = max(found, key=lambda name: found[name].value)
        share = quartiles_text(found[longest])
        measured = f"the longest bit detection is {share} of panel detection ({longest})"
        gaps = {name: (MUCH_SHORTER - one.high, MUCH_SHORTER - one.low) for name, one in found.items()}
        judged = parted(gaps, measured, "more than half as long:", "too noisy, the quartiles hold a half:")
    else:
        found = {name: quartiles(reading, f"ms_{name}") for name in ascending}
        gaps = {
            f"{less} and {more}": (found[more].low - found[less].high, found[more].high - found[less].low)
            for less, more in itertools.pairwise(ascending)
        }
        extra = quartiles(reading, "extra_cost_of_ngr")
        gaps[" and ".join(ascending[-2:])] = extra.low, extra.high
        texts = (f"{name} {t.value:.2g} ms [{t.low:.2g}, {t.high:.2g}]" for name, t in found.items())
        measured = ", ".join(texts)
        judged = parted(gaps, measured, "the other way round:", "quartiles overlap:")
    waited = reading.numbers["fig25"].get("waited_share", 0.0)
    if not waited > MOST_WAITED:
        return judged
    busy = f"the processor was busy with something else for {percent(waited)} of the time"
    return replace(judged, verdict="cannot say", reason=busy)


def time_ratio(reading: PaperReading, ratio: str, quoted: float, digits: int) -> Judgement:
    """Judge a ratio of processing times by its quartiles; in batches it is only told."""
    found, fig25, at = quartiles(reading, ratio), reading.numbers["fig25"], "whole_frames_batch"
    measured = f"{quartiles_text(found, digits)} one frame at a time"
    for name, share in fig25.items():
        if (size := re.fullmatch(rf"{ratio}_{at}_(\d+)", name)) and size[1] != "1":
            measured += f"; {percent(share, digits)} in batches of {size[1]}"
    if found.low <= 0 or found.high > WIDEST_FACTOR * found.low:
        reason = "too noisy: the quartiles are farther apart than a factor of 2"
        return Judgement("cannot say", measured, reason, found.low, found.high)
    if found.value / TIME_FACTOR <= quoted <= found.value * TIME_FACTOR:
        return Judgement("agree", measured, "", found.low, found.high)
    reason = "other software on another machine"
    panel, three = (fig25.get(f"ms_{stage}_{at}_1") for stage in ("panel_detection", "flda_3"))
    if panel and three:
        reason += f": panel detection takes {panel:.2g} ms a frame here, three features {three:.2g} ms"
    return Judgement("differ", measured, reason, found.low, found.high)


def parted(gaps: Mapping[str, tuple[float, float]], measured: str, against: str, overlap: str) -> Judgement:
    """Judge whether all gaps are above 0, from the ends that their quartiles leave.

    Args:
        gaps: ends of each gap by what lies on its two sides.
        measured: in words.
        against: before the gaps that are below 0, in the reason.
        overlap: before those that may be either.
    """
    if below := [name for name, (_, high) in gaps.items() if high < 0]:
        return Judgement("differ", measured, f"{against} {listed(below)}")
    if unsure := [name for name, (low, _) in gaps.items() if low < 0]:
        return Judgement("cannot say", measured, f"{overlap} {listed(unsure)}")
    return Judgement("agree", measured)


def quartiles(reading: PaperReading, name: str) -> Estimate:
    """A time, or a ratio of times, on whole frames one at a time: the median with the quartiles."""
    at = f"fig25.{name}_whole_frames_batch_1"
    return Estimate(*(reading.number(f"{at}{end}") for end in ("", "_low", "_high")))


def quartiles_text(found: Estimate, digits: int = 0) -> str:
    """Write a share of a time with its quartiles."""
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
    if any(not one & other for one, other in itertools.combinations(held, 2)):
        return Judgement("agree", measured)
    if all(len(one) == 1 for one in held):
        return Judgement("differ", measured, "the same luminance is best under every ambient light")
    reason = "candidates overlap from one ambient light to any other"
    if shared := sorted(set.intersection(*held)):
        reason = f"{place(grid.column_axis, *shared)} may be the best under every ambient light"
    return Judgement("cannot say", measured, reason)


def candidates(grid: Grid, receiver: str) -> list[set[float]]:
    """The luminances that may be the best under each ambient light; all sets hold in 95 % of studies."""
    tail = (1 - CONFIDENCE) / max(1, len(grid.columns) - 1) / len(grid.rows)
    held = not_worse(grid.ber(receiver), *grid.intervals(receiver, tail))
    return [{float(value) for value in np.array(grid.columns)[row]} for row in held]
