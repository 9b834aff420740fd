"""Rules for what the paper's section IV-C states and its own equations decide."""

from __future__ import annotations

import math

import torch

from vocc_torch.simulation.photometry import MIDDLE_GREY, transmission
from vocc_torch.studies.paper.scorecard.contrasts import BACKGROUND_GREYS, GAMMA
from vocc_torch.studies.paper.scorecard.judgement import Judgement, not_measured
from vocc_torch.studies.paper.scorecard.orders import Judge
from vocc_torch.studies.paper.scorecard.reading import Reading
from vocc_torch.studies.paper.scorecard.words import percent


def transmission_is(quoted: float, distance_m: float, visibility_m: float) -> Judge:
    """Claim of Eq. 20: the air's transmission at a distance, to four digits."""
    value = float(transmission(torch.tensor(distance_m, dtype=torch.float64), visibility_m))

    def judge(reading: Reading) -> Judgement:
        measured = f"{value:.5f}"
        return (
            Judgement("agree", measured)
            if round(value, 4) == quoted
            else Judgement("differ", measured, "by Eq. 20")
        )

    return judge


def net_rate_is(kbps: float, frames_per_s: float) -> Judge:
    """Claim that the bits of a frame at the camera's frame rate give the net data rate."""

    def judge(reading: Reading) -> Judgement:
        every = (reading.curves(name) for name in reading.experiments)
        counts = next((c for curves in every if curves for c in curves.counts.values() if c.frames), None)
        if counts is None:
            return not_measured("a frame")
        found = counts.bits / counts.frames * frames_per_s / 1000
        measured = (
            f"{found:g} kbps: {counts.bits / counts.frames:g} bits a frame, {frames_per_s:g} frames a second"
        )
        if math.isclose(found, kbps):
            return Judgement("agree", measured)
        return Judgement("differ", measured, "the panel has another number of LEDs")

    return judge


def half_of_middle_grey(reading: Reading) -> Judgement:
    """Claim that a grey of 86 has half the exposure of middle grey, 118 (Eq. 1)."""
    value = MIDDLE_GREY * 0.5 ** (1 / GAMMA)
    measured = f"118 x 0.5^(1/2.2) = {value:.1f}"
    return Judgement("agree" if round(value) == BACKGROUND_GREYS[0] else "differ", measured)


def quoted_gains_follow(reading: Reading) -> Judgement:
    """Claim that the paper's numbers fit each other: to a point, for they are rounded (1.78 % to a tenth)."""
    follow = (
        (0.24, 1 - 5.0 / 6.6, 0.01),
        (0.26, 1 - 3.9 / 5.3, 0.01),
        (0.17, 14 / 12 - 1, 0.01),
        (0.0178, (14 - 12) / (100 + 12), 0.001),
    )
    measured = ", ".join(percent(found, 1) for _, found, _ in follow)
    fit = all(abs(stated - found) <= rounding for stated, found, rounding in follow)
    return Judgement("agree" if fit else "differ", measured)


def iso_range_suffices(reading: Reading) -> Judgement:
    """Claim that ISO 100 to 3200 gives greys of 86 to 118 from 1000 to 32000 lx.

    By Eq. 1 the ISO speed needed is in proportion to grey^gamma / illuminance, whatever N and K are.
    """
    dark, bright = BACKGROUND_GREYS
    needed, there = 32000 / 1000 * (bright / dark) ** GAMMA, 3200 / 100
    measured = f"ISO speeds of {needed:.0f} to 1 are needed, 100 to 3200 is {there:.0f} to 1"
    if needed <= there * (1 + 1e-9):
        return Judgement("agree", measured)
    return Judgement("differ", measured, "by Eq. 1, whatever the f-number and K")
