"""Readings of what the paper leaves open, by name or from a file."""

from collections.abc import Sequence
from dataclasses import asdict
from importlib.resources import files as resources
from typing import Any

from vocc_torch.errors import VoccError, section
from vocc_torch.files import read_file
from vocc_torch.measure import build, config
from vocc_torch.measure.schema import typed
from vocc_torch.simulation.effects import PHYSICAL_ORDER
from vocc_torch.studies.paper.scorecard import PaperReading
from vocc_torch.yaml_text import parse_yaml

SECTIONS = ("scene", "camera", "panel", "receiver")
"""Parts of the configuration that a reading may set."""


def load_readings(
    names: Sequence[str], settings: config.Settings
) -> tuple[PaperReading, ...]:
    """Give readings by name, and those of files, in order.

    Args:
        names: of ``readings.yaml``, or files of the same form, which end in ``.yaml``.
        settings: what the readings change.

    Raises:
        VoccError: no reading, a reading given twice, an unknown name, or a file that has no readings.
    """
    text = resources(__package__).joinpath("readings.yaml").read_text("utf-8")
    shipped = parsed(text, "readings.yaml")
    chosen = []
    for name in names:
        if name in shipped:
            chosen.append((name, shipped[name]))
        elif name.endswith(".yaml"):
            content = read_file(name, "figures.readings").decode("utf-8", "replace")
            chosen += parsed(content, name).items()
        else:
            rule = f"one of {', '.join(shipped)}, or a file that ends in .yaml"
            raise VoccError.of("figures.readings", repr(name), rule)
    if not chosen or len(dict(chosen)) < len(chosen):
        rule = "at least one reading, each once"
        raise VoccError.of("figures.readings", list(names), rule)
    known = config.Settings.__dataclass_fields__
    plain = {name: at for name, at in asdict(settings).items() if name in known}
    absent = {kind.name for kind in PHYSICAL_ORDER} - {*settings.scene.effects}
    readings = []
    for name, entry in chosen:
        with section(f"figures.readings.{name}"):
            changes: list[Any] = [{"experiment": {}}]
            for key, value in entry["set"].items():
                if key.partition(".")[0] not in SECTIONS:
                    rule = f"one that begins with {', '.join(SECTIONS)}"
                    raise VoccError.of("a key", repr(key), rule)
                # Of an effect that the scene does not name there is nothing to read.
                if key.removeprefix("scene.effects.").partition(".")[0] not in absent:
                    for part in reversed(key.split(".")):
                        value = {part: value}
                    changes.append(value)
            plan = build.build_plan(typed(config.Settings, plain, *changes))
            plan.world.simulator()  # a wrong effect is refused now
            about = {"values": entry["set"], "why": entry["why"]}
            readings.append(PaperReading(name=name, plan=plan, **about))
    return tuple(readings)


def parsed(text: str, path: str) -> dict[str, dict[str, Any]]:
    """Parse a file of readings.

    Raises:
        VoccError: anything but names with ``why`` and ``set``.

    Example:
        >>> parsed("far: {why: no text, set: {camera.focal_length_mm: 50}}", "mine.yaml")
        {'far': {'why': 'no text', 'set': {'camera.focal_length_mm': 50}}}
    """
    key = f"figures.readings: {path}"
    entries = parse_yaml(text, key)
    if not isinstance(entries, dict) or not entries:
        entries = {path: None}
    for name, entry in entries.items():
        match entry:
            case {"why": _, "set": dict(), **others} if not others:
                config.demand_file_word(key, str(name))
            case _:
                rule = "a name with why: and set: below it"
                raise VoccError.of(key, repr(name), rule)
    return dict(entries)
