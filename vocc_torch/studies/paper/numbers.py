"""Numbers of dimming that claims are judged by."""

import math

from vocc_torch.measure import grid
from vocc_torch.measure.estimate import Estimate


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
