"""The locators by name: the paper's, one that fits the lattice of LEDs, and a learned one."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any

import torch

from vocc_torch.errors import VoccError, shown
from vocc_torch.plugins import TARGET, ModuleFile, PlugIn, demand_plain
from vocc_torch.receiver.learned import LearnedLocator
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.outside_locator import OutsideLocator, PanelLocator
from vocc_torch.receiver.refined import RefinedLocator

LOCATORS = ("paper", "refined", "learned")
"""The locators that ship, by name."""

STATING = ("learned",)
"""Those of them that state false alarms; they take longer than the others."""

_OWN = (PaperLocator, RefinedLocator, LearnedLocator)


def locator_named(
    name: str, paper: PaperLocator, false_alarms: float = 1e-3
) -> PaperLocator | RefinedLocator | LearnedLocator:
    """Return the locator of a name, with the settings of the paper's, which ``refined`` uses too.

    Args:
        name: one of ``LOCATORS``.
        paper: the settings of the paper's.
        false_alarms: in a frame without a panel, at which ``learned`` finds one, above 0.

    Raises:
        VoccError: an unknown name.

    Example:
        >>> locator_named("refined", PaperLocator(closing_px=9)).paper.closing_px
        9
    """
    if name not in LOCATORS:
        raise VoccError.of("receiver.locator", repr(name), " or ".join(LOCATORS))
    if name == "learned":
        return LearnedLocator(false_alarms=false_alarms)
    return RefinedLocator(paper) if name == "refined" else paper


def plugged_locator(plug_in: PlugIn) -> PanelLocator:
    """Give the locator that a plug-in names: of the package's own classes the very object.

    Raises:
        VoccError: one of the package's own that cannot be built.

    Example:
        >>> plugged_locator(PlugIn.of("locators.mine", "vocc_torch.receiver.learned.LearnedLocator"))
        LearnedLocator(weights=None, false_alarms=0.001)
    """
    if plug_in.target.startswith("vocc_torch.") and isinstance(plug_in.made, _OWN):
        own: PanelLocator = plug_in.made
        if isinstance(own, LearnedLocator):
            own.net(torch.device("cpu"))  # weights that cannot be read are told before any work
        return own
    return OutsideLocator(plug_in)


def locator_settings(locator: PanelLocator) -> dict[str, object]:
    """Return a locator's settings for a model file; those of the paper's carry no name.

    Raises:
        VoccError: a locator from outside that was not built from settings.

    Example:
        >>> locator_settings(RefinedLocator())["name"]
        'refined'
    """
    if isinstance(locator, OutsideLocator):
        return locator.plug_in.settings
    names = {RefinedLocator: "refined", LearnedLocator: "learned"}
    if not isinstance(locator, _OWN):
        ours = ", ".join(LOCATORS)
        rule = f"{ours}, or one named by FILE.py:NAME or PACKAGE.MODULE.NAME, to be saved"
        raise VoccError.of("receiver.locator", shown(locator), rule)
    own = {**({"name": names[type(locator)]} if type(locator) in names else {}), **asdict(locator)}
    if isinstance(locator, LearnedLocator) and locator.weights:
        file = Path(locator.weights).resolve()
        own |= {"weights": str(file), "digest": ModuleFile(str(file)).digest}
    return own


def locator_words(locator: PanelLocator) -> tuple[str, dict[str, dict[str, object]]]:
    """Return a locator's name in a configuration, and what ``locators`` has to say of it there.

    Raises:
        VoccError: what :func:`locator_settings` refuses.

    Example:
        >>> locator_words(RefinedLocator())
        ('refined', {})
    """
    own: dict[str, Any] = locator_settings(locator)
    if TARGET in own:
        return own["name"], {own["name"]: {TARGET: own[TARGET], **own["arguments"]}}
    name = own.get("name", "paper")
    paper = locator.paper if isinstance(locator, RefinedLocator) else PaperLocator()
    if name == "paper" or locator == locator_named(name, paper, own.get("false_alarms", 1e-3)):
        return name, {}
    return f"own_{name}", {f"own_{name}": _built(locator)}


def _built(part: Any) -> dict[str, object]:
    """Say of which class an object is, with the arguments that are not its own defaults."""
    kind = type(part)
    given = {one.name: getattr(part, one.name) for one in fields(part)}
    told = {name: one for name, one in given.items() if one != getattr(kind(), name)}
    inner = {name: _built(one) if is_dataclass(one) else one for name, one in told.items()}
    return {TARGET: f"{kind.__module__}.{kind.__name__}", **inner}


def locator_from(settings: Mapping[str, Any], admitted: Sequence[str] = ()) -> PanelLocator:
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
    rest = dict(settings)
    demand_plain("receiver.locator", rest)
    name = rest.pop("name", "paper")
    if name not in LOCATORS:
        raise ValueError(f"its locator is {name!r}")
    if name == "learned":
        made_with = rest.pop("digest", "")
        if made_with and ModuleFile(str(rest["weights"])).digest != made_with:
            raise VoccError(f"receiver.locator: {rest['weights']} holds other weights than it was made with")
        return LearnedLocator(**rest)
    paper = PaperLocator(**(rest if name == "paper" else rest.pop("paper")))
    return paper if name == "paper" else RefinedLocator(paper, **rest)
