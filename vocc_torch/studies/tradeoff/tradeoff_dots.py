"""Receivers as the picture of the price list shows them: where, how strongly and under which name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from vocc_torch.show.styles import Style, receiver_styles
from vocc_torch.studies.tradeoff.frontier import Offer, frontier
from vocc_torch.studies.tradeoff.price_list import PriceList, Setting
from vocc_torch.studies.tradeoff.tradeoff_advice import told_of
from vocc_torch.studies.tradeoff.tradeoff_words import ms_text, varied_text

FillStyle = Literal["full", "none", "left", "bottom"]
Rank = Literal["frontier", "perhaps", "beaten"]

FACES: tuple[FillStyle, ...] = ("full", "none", "left", "bottom")
"""How the markers of the locators are filled, in their order."""

STRENGTH: dict[Rank, float] = {"frontier": 1.0, "perhaps": 0.75, "beaten": 0.4}
"""Opacity by rank."""

LOCATED_BY = {"truth": "true corners", "paper": "the paper's locator", "refined": "the refined locator"}
_SHORT = {"truth": "true corners", "paper": "paper's", "refined": "refined"}


@dataclass(frozen=True)
class Dot:
    """A receiver as it is drawn.

    Args:
        offer: what it costs and gives.
        setting: what it is.
        style: its colour, marker and title.
        face: how its marker is filled.
        rank: on the frontier; beaten, but in its rate perhaps by chance; or surely beaten.
        varied: what it has other than most receivers.
        told: whether the recommendation in words names it.
    """

    offer: Offer
    setting: Setting
    style: Style
    face: FillStyle
    rank: Rank
    varied: tuple[str, ...]
    told: bool

    def label(self, *, with_locator: bool) -> str:
        """Write its name, what it varies and its time."""
        located = (_SHORT[self.setting.locator],) if with_locator else ()
        return f"{', '.join([self.style.label, *self.varied, *located])}   {ms_text(self.offer.median_ms)} ms"


def dots_of(prices: PriceList, scenes: str, device: str, frames: str) -> list[Dot]:
    """Say how each receiver is drawn, each with its best batch size, in the order of the settings."""
    offers = prices.offers(scenes, device, frames)
    kept = {one.name for one in frontier(offers)}
    sure = [surely for _, surely in prices.beaten_by(scenes, offers)]
    told = told_of(prices, scenes, device, frames)
    styles = receiver_styles(setting.receiver for setting in prices.settings)
    locators = list(dict.fromkeys(setting.locator for setting in prices.settings))
    faces = {name: FACES[place % len(FACES)] for place, name in enumerate(locators)}
    return [
        Dot(
            offer,
            setting,
            styles[setting.receiver],
            faces[setting.locator],
            "frontier" if offer.name in kept else "beaten" if surely else "perhaps",
            tuple(varied_text(setting, prices.settings[0])),
            setting.name in told,
        )
        for setting, offer, surely in zip(prices.settings, offers, sure, strict=True)
    ]
