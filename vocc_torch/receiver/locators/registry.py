"""The locators that ship by name, and their settings in configurations and model files."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

from vocc_torch.errors import VoccError, shown
from vocc_torch.plugins import TARGET, PlugIn, demand_plain
from vocc_torch.receiver.locators.detector import DetectorLocator
from vocc_torch.receiver.locators.outside import OutsideLocator
from vocc_torch.receiver.locators.paper import PaperLocator
from vocc_torch.receiver.locators.protocol import PanelLocator
from vocc_torch.receiver.locators.refined import RefinedLocator

LOCATORS: dict[str, type[PanelLocator]] = {
    kind.name: kind for kind in (PaperLocator, RefinedLocator, DetectorLocator)
}
"""The locators that ship, by name."""


def locator_named(
    name: str, paper: PaperLocator, false_alarms: float = 1e-2
) -> PanelLocator:
    """Return the locator of a name, with what a configuration says of all of them.

    Args:
        name: one of ``LOCATORS``.
        paper: the limits of blobs.
        false_alarms: in a frame without a panel, at which one is found, above 0; of those that state them.

    Raises:
        VoccError: an unknown name.

    Example:
        >>> locator_named("refined", PaperLocator(closing_px=9)).paper.closing_px
        9
    """
    if name not in LOCATORS:
        raise VoccError.of("receiver.locator", repr(name), " or ".join(LOCATORS))
    return LOCATORS[name].of(paper, false_alarms)


def plugged_locator(plug_in: PlugIn) -> PanelLocator:
    """Give the locator that a plug-in names: of the package's own classes the very object.

    Raises:
        VoccError: one of the package's own that cannot be built.

    Example:
        >>> plugged_locator(PlugIn.of("locators.mine", "vocc_torch.receiver.locators.DetectorLocator")).name
        'detector'
    """
    if plug_in.target.startswith("vocc_torch.") and ships(plug_in.made):
        locator: PanelLocator = plug_in.made
        locator.check()
        return locator
    return OutsideLocator(plug_in)


def ships(locator: object) -> bool:
    """Whether a locator is one of the package's own."""
    return isinstance(locator, PanelLocator) and LOCATORS.get(locator.name) is type(
        locator
    )


def locator_settings(locator: PanelLocator) -> dict[str, Any]:
    """Return a locator's settings for a model file.

    Raises:
        VoccError: a locator from outside that was not built from settings.

    Example:
        >>> locator_settings(RefinedLocator())["name"]
        'refined'
    """
    if not ships(locator) and not isinstance(locator, OutsideLocator):
        rule = f"{', '.join(LOCATORS)}, or one named by FILE.py:NAME or PACKAGE.MODULE.NAME, to be saved"
        raise VoccError.of("receiver.locator", shown(locator), rule)
    return locator.settings


def locator_from(
    settings: Mapping[str, Any], admitted: Sequence[str] = ()
) -> PanelLocator:
    """Build a locator from what :func:`locator_settings` gave.

    Args:
        settings: of the locator.
        admitted: Python files and packages that the user names.

    Raises:
        TypeError: an unknown setting.
        ValueError: an unknown name.
        VoccError: one from outside that is not admitted.

    Example:
        >>> locator_from(locator_settings(RefinedLocator(min_share=0.9))).min_share
        0.9
    """
    if TARGET in settings:
        return OutsideLocator(PlugIn.admitted("receiver.locator", settings, admitted))
    values = dict(settings)
    demand_plain("receiver.locator", values)
    name = values.pop("name", PaperLocator.name)
    if name not in LOCATORS:
        raise ValueError(f"its locator is {name!r}, none of {', '.join(LOCATORS)}")
    return LOCATORS[name].from_settings(values)


def locator_words(locator: PanelLocator) -> tuple[str, dict[str, dict[str, object]]]:
    """Return a locator's name in a configuration, and what ``locators`` has to say of it there.

    Raises:
        VoccError: what :func:`locator_settings` refuses.

    Example:
        >>> locator_words(RefinedLocator())
        ('refined', {})
    """
    settings = locator_settings(locator)
    if TARGET in settings:
        name = settings["name"]
        return name, {name: {TARGET: settings[TARGET], **settings["arguments"]}}
    keys: Any = getattr(locator, "paper", locator), settings.get("false_alarms")
    if locator == type(locator).of(*keys):
        return locator.name, {}
    name = f"own_{locator.name}"
    return name, {name: _described(locator)}


def _described(part: Any) -> dict[str, object]:
    """Describe a dataclass by its class and the arguments that are not its defaults."""
    kind = type(part)
    values = {field.name: getattr(part, field.name) for field in fields(part)}
    changed = {
        name: value for name, value in values.items() if value != getattr(kind(), name)
    }
    inner = {
        name: _described(value) if is_dataclass(value) else value
        for name, value in changed.items()
    }
    return {TARGET: f"{kind.__module__}.{kind.__name__}", **inner}
