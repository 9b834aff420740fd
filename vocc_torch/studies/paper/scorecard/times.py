"""Rules for processing times, Fig. 25: on whole frames, one at a time, as in the paper."""

from __future__ import annotations

import itertools
from typing import NamedTuple

from vocc_torch.studies.paper.scorecard.judgement import Judgement, not_measured
from vocc_torch.studies.paper.scorecard.orders import Judge
from vocc_torch.studies.paper.scorecard.reading import Reading
from vocc_torch.studies.paper.scorecard.words import listed, percent

TIME_FACTOR = 1.5
"""Ratios of processing times agree within this factor."""
WIDEST_FACTOR = 2.0
"""Beyond this ratio of its quartiles a time was measured too noisily to be judged."""
MOST_WAITED = 0.05
"""Largest share of the time for which the measurement may have waited for the processor."""
MUCH_LONGER = 0.5
"""Panel detection takes much longer than a stage that takes at most this share of its time."""
_AT = "_whole_frames_batch_"
_RISING = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
"""The bit detectors, the one that takes least in the paper first."""


class Quartiles(NamedTuple):
    """A median over the rounds, with its quartiles."""

    low: float
    median: float
    high: float


def time_is(name: str, quoted: float, digits: int = 0) -> Judge:
    """Claim that a ratio of processing times is the quoted one."""

    def judge(reading: Reading) -> Judgement:
        found = _quartiles(reading, name)
        if found is None:
            return not_measured(f"{name} of Fig. 25")
        ends = found.low, found.high
        measured = f"{_shown(found, digits)} one frame at a time{_in_batches(reading, name, digits)}"
        busy = _busy(reading)
        if busy:
            return Judgement("cannot say", measured, busy, *ends)
        if found.low <= 0 or found.high > WIDEST_FACTOR * found.low:
            reason = "too noisy: the quartiles are farther apart than a factor of 2"
            return Judgement("cannot say", measured, reason, *ends)
        if found.median / TIME_FACTOR <= quoted <= found.median * TIME_FACTOR:
            return Judgement("agree", measured, "", *ends)
        panel, three = (_quartiles(reading, f"ms_{stage}") for stage in ("panel_detection", "flda_3"))
        reason = "other software on another machine"
        if panel is not None and three is not None:
            reason += (
                f": panel detection takes {panel.median:.2g} ms a frame here, "
                f"three features {three.median:.2g} ms"
            )
        return Judgement("differ", measured, reason, *ends)

    return judge


def panel_detection_rules(reading: Reading) -> Judgement:
    """Claim that panel detection takes much longer than any bit detector: twice as long at least."""
    found = {name: shares for name in _RISING if (shares := _quartiles(reading, f"share_{name}")) is not None}
    if not found:
        return not_measured("Fig. 25")
    longest = max(found, key=lambda name: found[name].median)
    measured = f"the longest bit detection is {_shown(found[longest], 0)} of panel detection ({longest})"
    busy = _busy(reading)
    if busy:
        return Judgement("cannot say", measured, busy)
    if all(shares.high <= MUCH_LONGER for shares in found.values()):
        return Judgement("agree", measured)
    if any(shares.low > MUCH_LONGER for shares in found.values()):
        return Judgement("differ", measured, f"{longest} takes more than half as long")
    return Judgement("cannot say", measured, "too noisy: the quartiles of a share hold a half")


def times_rise(reading: Reading) -> Judgement:
    """Claim that each bit detector takes longer than the one before.

    One takes longer where its lower quartile lies above the other's upper one. NGR's extra cost was taken
    round by round, so three features take longer than two where its lower quartile is above 0.
    """
    found = {name: times for name in _RISING if (times := _quartiles(reading, f"ms_{name}")) is not None}
    extra = _quartiles(reading, "extra_cost_of_ngr")
    if len(found) < len(_RISING) or extra is None:
        return not_measured("the time of every bit detector of Fig. 25")
    measured = ", ".join(f"{name} {t.median:.2g} ms [{t.low:.2g}, {t.high:.2g}]" for name, t in found.items())
    busy = _busy(reading)
    if busy:
        return Judgement("cannot say", measured, busy)
    gaps = {
        f"{less} and {more}": (found[more].low - found[less].high, found[more].high - found[less].low)
        for less, more in itertools.pairwise(_RISING[:-1])
    }
    gaps["flda_2 and flda_3"] = (extra.low, extra.high)
    against = [pair for pair, (_, high) in gaps.items() if high < 0]
    if against:
        return Judgement("differ", measured, f"the other way round: {listed(against)}")
    open_ones = [pair for pair, (low, _) in gaps.items() if low <= 0]
    if open_ones:
        return Judgement("cannot say", measured, f"quartiles overlap: {listed(open_ones)}")
    return Judgement("agree", measured)


def _quartiles(reading: Reading, name: str) -> Quartiles | None:
    """Give a time, or a ratio of times, on whole frames; None where it was not measured."""
    found = [reading.finding("fig25", f"{name}{_AT}1{end}") for end in ("_low", "", "_high")]
    known = [value for value in found if value is not None]
    return Quartiles(*known) if len(known) == len(found) else None


def _busy(reading: Reading) -> str:
    """Say that the machine was busy with something else; nothing where it was not."""
    waited = reading.finding("fig25", "waited_share") or 0.0
    if waited <= MOST_WAITED:
        return ""
    return f"the processor was busy with something else for {percent(waited)} of the time"


def _in_batches(reading: Reading, name: str, digits: int) -> str:
    """Add the ratio in larger batches, by which nothing is judged: the paper has no batches."""
    start = f"{name}{_AT}"
    batches = sorted(
        int(size)
        for key in reading.findings.get("fig25", {})
        if key.startswith(start) and (size := key.removeprefix(start)).isdigit() and size != "1"
    )
    medians = {batch: reading.finding("fig25", f"{start}{batch}") for batch in batches}
    return "".join(
        f"; {percent(median, digits)} in batches of {batch}"
        for batch, median in medians.items()
        if median is not None
    )


def _shown(found: Quartiles, digits: int) -> str:
    """Write a median with its quartiles."""
    ends = f"{100 * found.low:.{digits}f} to {100 * found.high:.{digits}f}"
    return f"{percent(found.median, digits)} (quartiles {ends})"
