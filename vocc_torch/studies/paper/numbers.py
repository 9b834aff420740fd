"""Numbers that claims are judged by and no figure shows: of the paper's equations, of bins, of dimming."""

import math

import torch

from vocc_torch.measure import curve, grid
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.plan import Plan
from vocc_torch.simulation import photometry
from vocc_torch.studies.paper.evidence.panels import BACKGROUND_GREYS

FRAMES_PER_S = 100
"""Table 1."""
BIN = 0.06
"""Width of a contrast bin, as in "30 to 36%"."""


def setup_numbers(plan: Plan) -> dict[str, Estimate]:
    """Numbers of section IV-C and IV-D that follow from others by the paper's equations.

    ``worst_misfit`` is of the quoted gains and times, in units of their rounding.
    """
    gamma = plan.world.camera.gamma
    range_of_greys = BACKGROUND_GREYS[-1] / BACKGROUND_GREYS[0]
    follow = [
        (1 - 5.0 / 6.6, 0.24, 0.01),
        (1 - 3.9 / 5.3, 0.26, 0.01),
        (14 / 12 - 1, 0.17, 0.01),
        ((14 - 12) / (100 + 12), 0.0178, 0.001),
    ]
    numbers = {
        "kbps": plan.world.panel.shape.leds * FRAMES_PER_S / 1000,
        "transmission": float(
            photometry.transmission(torch.tensor(70.0, dtype=torch.float64), 40_000.0)
        ),
        "half_exposure_grey": photometry.MIDDLE_GREY * 0.5 ** (1 / gamma),
        # By Eq. 1 the ISO speed is in proportion to grey^gamma / illuminance, whatever N and K are.
        "iso_ratio": 32000 / 1000 * range_of_greys**gamma,
        "worst_misfit": max(
            abs(found - stated) / rounding for found, stated, rounding in follow
        ),
    }
    return {
        f"setup.{name}": Estimate(value, value, value)
        for name, value in numbers.items()
    }


def bin_numbers(curves: curve.Curves) -> dict[str, Estimate]:
    """Upper edges of the lowest and the highest contrast bin with frames."""
    edges = {"lowest_bin_to": curves.values[0], "highest_bin_to": curves.values[-1]}
    return {
        f"contrast.{name}": Estimate(*[value + BIN / 2] * 3)
        for name, value in edges.items()
    }


def dimming_numbers(cells: grid.Grid) -> dict[str, Estimate]:
    """How far the best LED luminances of the levels of ambient light are apart, in octaves, by receiver."""
    numbers = {}
    for receiver in cells.receivers:
        bests = grid.best_luminance(cells, receiver)
        lowest = [best.candidates_cd_m2[0] for best in bests]
        highest = [best.candidates_cd_m2[-1] for best in bests]
        middles = [best.middle_cd_m2 for best in bests]
        least = max(0.0, math.log2(max(lowest) / min(highest)))
        most = math.log2(max(highest) / min(lowest))
        octaves = math.log2(max(middles) / min(middles))
        numbers[f"dimming.octaves_{receiver}"] = Estimate(octaves, least, most)
    return numbers
