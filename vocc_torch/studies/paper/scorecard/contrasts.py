"""Rules for contrasts: the paper's examples by Eqs 1 to 3, and the range of the contrast experiment."""

from __future__ import annotations

import torch

from vocc_torch.simulation.photometry import auto_iso_speed, grey_value, reflected_luminance_cd_m2
from vocc_torch.studies.paper.scorecard.judgement import Judgement, not_measured
from vocc_torch.studies.paper.scorecard.orders import Judge
from vocc_torch.studies.paper.scorecard.reading import Reading
from vocc_torch.studies.paper.scorecard.words import percent

BACKGROUND_GREYS = (86.0, 118.0)
"""Section IV-C: auto-ISO gives the background a grey value between these."""
BIN = 0.06
"""Width of a contrast bin, as in "30 to 36%"."""
WHITE = 255.0
GAMMA = 2.2
"""Table 1."""
REFLECTANCES = (0.18, 0.4)
"""Of the background and of an LED, section IV-C."""
ROUNDING = 0.005
"""A number quoted in whole per cent stands for this much on either side."""


def contrast_by_equations(ambient_lx: float, led_luminance_cd_m2: float, background_grey: float) -> float:
    """Contrast of On and Off LEDs before any blur, by Eqs 1 to 3, clipped at white.

    The luminous exposure is in proportion to luminance, and auto-ISO makes the background's grey what it is,
    so exposure time, f-number and K cancel.

    Example:
        >>> round(contrast_by_equations(32000.0, 500.0, 102.0), 3)
        0.031
    """
    ambient = torch.tensor(ambient_lx, dtype=torch.float64)
    background, off = (reflected_luminance_cd_m2(ambient, reflectance) for reflectance in REFLECTANCES)
    iso = auto_iso_speed(background, torch.tensor(background_grey, dtype=torch.float64), gamma=GAMMA)
    greys = [grey_value(seen, iso, gamma=GAMMA) for seen in (off, off + led_luminance_cd_m2)]
    dark, bright = (min(WHITE, float(grey)) for grey in greys)
    return (bright - dark) / WHITE


def contrast_example(stated_percent: int, ambient_lx: float, led_luminance_cd_m2: float) -> Judge:
    """Claim that a scene of Fig. 20 has the contrast stated.

    The paper leaves the scene's background grey open, so the measured contrast is carried over to the ends of
    its range; it agrees if the stated one, which is rounded, lies between.
    """

    def judge(reading: Reading) -> Judgement:
        seen = reading.finding("fig20", f"contrast_paper_scene_{stated_percent}")
        grey = reading.finding("fig20", f"background_grey_paper_scene_{stated_percent}")
        if seen is None or grey is None:
            return not_measured("Fig. 20")
        here = contrast_by_equations(ambient_lx, led_luminance_cd_m2, grey)
        ends = [contrast_by_equations(ambient_lx, led_luminance_cd_m2, g) for g in BACKGROUND_GREYS]
        low, high = (seen * end / here for end in sorted(ends))
        measured = (
            f"{percent(seen, 1)} at background grey {grey:g}, "
            f"{percent(low, 1)} to {percent(high, 1)} over greys 86 to 118"
        )
        if low - ROUNDING <= stated_percent / 100 <= high + ROUNDING:
            return Judgement("agree", measured, "", low, high)
        reason = f"Eqs 1 to 3 give {ambient_lx:g} lx with {led_luminance_cd_m2:g} cd/m2 {percent(here, 1)}"
        if ends[0] > ends[1]:
            reason += "; On LEDs are white (255) there"
        return Judgement("differ", measured, reason, low, high)

    return judge


def contrast_range(end: float, *, lower: bool) -> Judge:
    """Claim that the contrast experiment's frames begin, or end, at a contrast, to the width of a bin."""

    def judge(reading: Reading) -> Judgement:
        curves = reading.curves("contrast")
        if curves is None or not curves.values:
            return not_measured("experiment contrast")
        frames = {at: curves.counts[curves.receivers[0], at].frames for at in curves.values}
        filled = [at for at, count in frames.items() if count]
        middle = min(filled) if lower else max(filled)
        low, high = middle - BIN / 2, middle + BIN / 2
        extreme = _extreme_contrast(lower=lower)
        measured = (
            f"the {'lowest' if lower else 'highest'} bin with frames is {100 * low:.0f} to {percent(high)}; "
            f"by Eqs 1 to 3 the {'least' if lower else 'most'} is {percent(extreme, 1)}"
        )
        if low - 1e-9 <= end < high - 1e-9 or (not lower and abs(end - high) < 1e-9):
            return Judgement("agree", measured, "", low, high)
        beyond = sum(count for at, count in frames.items() if (at < end if lower else at > end))
        share = f"{percent(beyond / sum(frames.values()), 1)} of the frames lie beyond it"
        return Judgement("differ", measured, share if beyond else "no frame reaches it", low, high)

    return judge


def _extreme_contrast(*, lower: bool) -> float:
    """Give the least or the most contrast of the contrast experiment's scenes, by Eqs 1 to 3."""
    light = (32000.0, 500.0) if lower else (1000.0, 8000.0)
    contrasts = [contrast_by_equations(*light, grey) for grey in BACKGROUND_GREYS]
    return min(contrasts) if lower else max(contrasts)


def interference_grows(reading: Reading) -> Judgement:
    """Claim of Fig. 20 that blooming takes more away the higher the contrast is that scenes truly have."""
    lost, shares = [], []
    for name in ("true_6", "true_30", "true_50"):
        before = reading.finding("fig20", f"contrast_{name}")
        after = reading.finding("fig20", f"contrast_in_picture_{name}")
        if before is None or after is None:
            return not_measured("Fig. 20")
        lost.append(before - after)
        shares.append(f"{100 * (before - after) / before:.0f}" if before else "0")
    points = ", ".join(f"{100 * loss:.0f}" for loss in lost)
    measured = (
        f"blur takes {points} points from contrasts of 6, 30 and 50 %; "
        f"relative to the contrast that is {', '.join(shares)} %"
    )
    if lost[0] < lost[1] < lost[2]:
        return Judgement("agree", measured)
    return Judgement("differ", measured, "the points lost do not grow with the contrast")
