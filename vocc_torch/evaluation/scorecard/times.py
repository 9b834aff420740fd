"""Rules for processing times, Fig. 25: ratios on whole frames, one at a time and in batches."""

from __future__ import annotations

import math

from vocc_torch.evaluation.scorecard.judgement import Judgement, not_measured
from vocc_torch.evaluation.scorecard.orders import Judge
from vocc_torch.evaluation.scorecard.reading import Reading
from vocc_torch.evaluation.scorecard.words import percent

TIME_FACTOR = 1.5
"""Ratios of processing times agree within this factor."""
MOST_WAITED = 0.05
"""Largest share of the time for which the measurement may have waited for the processor."""


def time_is(name: str, quoted: float, digits: int = 0) -> Judge:
    """Claim that a ratio of processing times is the quoted one, on whole frames as in the paper."""

    def judge(reading: Reading) -> Judgement:
        found = _times(reading, name)
        if not found:
            return not_measured(f"{name} of Fig. 25")
        low, high = min(found.values()), max(found.values())
        measured = _times_text(found, digits)
        waited = reading.finding("fig25", "waited_share") or 0.0
        if waited > MOST_WAITED:
            reason = f"the processor was busy with something else for {percent(waited)} of the time"
            return Judgement("cannot say", measured, reason, low, high)
        if low / TIME_FACTOR <= quoted <= high * TIME_FACTOR:
            return Judgement("agree", measured, "", low, high)
        panel, three = (
            reading.finding("fig25", f"ms_{stage}_whole_frames_batch_1")
            for stage in ("panel_detection", "flda_3")
        )
        reason = "other software on another machine"
        if panel is not None and three is not None:
            reason += f": panel detection takes {panel:.2g} ms a frame here, three features {three:.2g} ms"
        return Judgement("differ", measured, reason, low, high)

    return judge


def panel_detection_rules(reading: Reading) -> Judgement:
    """Claim that panel detection takes much longer than any bit detector: twice as long at least."""
    stages = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
    found = {
        f"{stage}, {at}": share for stage in stages for at, share in _times(reading, f"share_{stage}").items()
    }
    if not found:
        return not_measured("Fig. 25")
    longest = max(found, key=lambda name: found[name])
    measured = f"the longest bit detection is {percent(found[longest])} of panel detection ({longest})"
    if found[longest] <= 0.5:
        return Judgement("agree", measured)
    return Judgement("differ", measured, f"{longest} takes more than half as long")


def _times(reading: Reading, name: str) -> dict[str, float]:
    """Give a ratio of times on whole frames by the size of the batches."""
    start = f"{name}_whole_frames_"
    return {
        key.removeprefix(start).replace("_", " "): value
        for key, value in reading.findings.get("fig25", {}).items()
        if key.startswith(start) and math.isfinite(value)
    }


def _times_text(found: dict[str, float], digits: int) -> str:
    """Write ratios of times by batch."""
    return ", ".join(f"{percent(value, digits)} ({at})" for at, value in found.items())
