"""The paper's Fig. 25 out of a price list: each bit detector's time over that of panel detection."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vocc_torch.measure.timing import quartiles
from vocc_torch.studies.paper.evidence_figures.timing import timing_figure
from vocc_torch.studies.tradeoff.price_list import BIT_DETECTION, Place, PriceList, Setting

_KINDS = {"whole": "whole_frames", "crops": "crops"}

Floats = NDArray[np.float64]


def shares_figure(prices: PriceList, paper_shares: Mapping[str, float]) -> Figure | None:
    """Draw Fig. 25 on the first device, or nothing where the paper's locator and receivers were not priced.

    Args:
        prices: what was measured.
        paper_shares: the paper's values by stage, panel detection first, then receivers.
    """
    panel, *receivers = paper_shares
    settings = [_setting(prices, name) for name in receivers]
    known = [one for one in settings if one is not None]
    if len(known) < len(settings):
        return None
    device = prices.places[0].device
    kinds = tuple(frames for name, frames in prices.kinds if name == device)
    batches = prices.batches(device, kinds[0])
    batches = tuple(dict.fromkeys((batches[0], batches[-1])))
    grid = (len(kinds), len(batches), -1, 3)
    times, shares, costs = [], [], []
    for place in (Place(device, frames, batch) for frames in kinds for batch in batches):
        rounds = [np.array(prices.spent[known[0], place].rounds_ms["locate"])]
        rounds += [_bit_detection(prices, one, place) for one in known]
        times += [quartiles(one) for one in rounds]
        shares += [quartiles(one / rounds[0]) for one in rounds]
        two, three = (rounds[1 + receivers.index(name)] for name in ("flda_2", "flda_3"))
        costs += [quartiles(three / two - 1), quartiles((three - two) / (rounds[0] + two))]
    first = [Place(device, kinds[0], batch) for batch in batches]
    return timing_figure(
        "Time of the paper's receivers (Fig. 25)",
        frames=tuple(_KINDS[kind] for kind in kinds),
        batches=batches,
        stages=(panel, *receivers),
        times_ms=np.reshape(times, grid),
        shares=np.reshape(shares, grid),
        ngr_costs=np.reshape(costs, grid),
        paper_shares=np.array(list(paper_shares.values())),
        rounds=tuple(len(prices.spent[known[0], place].rounds_ms["locate"]) for place in first),
        sensor_px=prices.sensor_px,
        machine=prices.machines[device],
        threads=prices.threads,
        waited_share=prices.waited_share,
    )


def _setting(prices: PriceList, receiver: str) -> Setting | None:
    """Find a receiver with the paper's locator, at the settings of most."""
    found = (one for one in prices.settings if (one.receiver, one.locator) == (receiver, "paper"))
    return next(found, None)


def _bit_detection(prices: PriceList, setting: Setting, place: Place) -> Floats:
    """Add what comes after panel detection, round by round, ms a frame."""
    rounds = prices.spent[setting, place].rounds_ms
    total: Floats = np.sum([rounds[stage] for stage in BIT_DETECTION], axis=0)
    return total
