"""The locators by name, and their settings as a model file holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Literal, get_args

from vocc_torch.errors import VoccError
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.refined import RefinedLocator

LocatorName = Literal["paper", "refined"]
PanelLocator = PaperLocator | RefinedLocator


def locator_named(name: LocatorName, paper: PaperLocator) -> PanelLocator:
    """Return the locator of a name, with the settings of the paper's, which both use.

    Raises:
        VoccError: an unknown name.

    Example:
        >>> locator_named("refined", PaperLocator(closing_px=9)).paper.closing_px
        9
    """
    if name not in get_args(LocatorName):
        raise VoccError(f"receiver.locator is {name!r}: it must be {' or '.join(get_args(LocatorName))}")
    return RefinedLocator(paper) if name == "refined" else paper


def locator_settings(locator: PanelLocator) -> dict[str, object]:
    """Return a locator's settings for a model file; those of the paper's carry no name.

    Example:
        >>> locator_settings(RefinedLocator())["name"]
        'refined'
    """
    if isinstance(locator, PaperLocator):
        return asdict(locator)
    return {"name": "refined", **asdict(locator)}


def locator_from(settings: Mapping[str, Any]) -> PanelLocator:
    """Build a locator from what :func:`locator_settings` gave.

    Raises:
        TypeError: an unknown setting.
        ValueError: an unknown name.

    Example:
        >>> locator_from(locator_settings(RefinedLocator(min_share=0.9))).min_share
        0.9
    """
    rest = dict(settings)
    name = rest.pop("name", "paper")
    if name == "paper":
        return PaperLocator(**rest)
    if name != "refined":
        raise ValueError(f"its locator is {name!r}")
    return RefinedLocator(**{**rest, "paper": PaperLocator(**rest["paper"])})
