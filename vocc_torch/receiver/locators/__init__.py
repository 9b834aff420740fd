"""Locators: the protocol, the locators that ship, and your own."""

from .detector import DetectorLocator
from .outside import OutsideLocator
from .paper import PaperLocator
from .protocol import PanelLocator
from .refined import RefinedLocator
from .registry import (
    LOCATORS,
    locator_from,
    locator_named,
    locator_settings,
    locator_words,
    plugged_locator,
)

__all__ = [
    "LOCATORS",
    "DetectorLocator",
    "OutsideLocator",
    "PanelLocator",
    "PaperLocator",
    "RefinedLocator",
    "locator_from",
    "locator_named",
    "locator_settings",
    "locator_words",
    "plugged_locator",
]
