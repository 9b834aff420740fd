"""Readings of what the paper leaves open, by name or from a file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from importlib.resources import files as resources
from pathlib import Path
from typing import Any

from vocc_torch.errors import VoccError, section
from vocc_torch.files import read_file
from vocc_torch.hardware import Camera
from vocc_torch.measure import build, config
from vocc_torch.measure.config import PanelSettings, ReceiverSettings
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.schema import whole
from vocc_torch.simulation.effects import PHYSICAL_ORDER
from vocc_torch.yaml_text import parse_yaml

SECTIONS = ("scene", "camera", "panel", "receiver")
"""Parts of the configuration that a reading may set."""


@dataclass(frozen=True)
class PaperReading:
    """One way to fill what the paper leaves open.

    Args:
        name: a word.
        values: by the key of the configuration, such as ``panel.board_reflectance``.
        why: what in the text allows it.
        plan: the study under this reading, at any experiment.
    """

    name: str
    values: Mapping[str, Any]
    why: str
    plan: Plan

    @property
    def locator(self) -> str:
        """Where the panel's corners come from."""
        return self.plan.receiver.locator


def load_readings(
    names: Sequence[str], settings: config.Settings, folder: Path
) -> tuple[PaperReading, ...]:
    """Give readings by name, and those of files, in order.

    Args:
        names: of ``readings.yaml``, or files of the same form, which end in ``.yaml``.
        settings: what the readings change.
        folder: of the run.

    Raises:
        VoccError: no reading, a reading given twice, an unknown name, or a file that has no readings.
    """
    text = resources(__package__).joinpath("readings.yaml").read_text("utf-8")
    shipped = parsed(text, "readings.yaml")
    chosen: list[tuple[str, dict[str, Any]]] = []
    for name in names:
        if name in shipped:
            chosen.append((name, shipped[name]))
            continue
        if not name.endswith(".yaml"):
            rule = f"one of {', '.join(shipped)}, or a file that ends in .yaml"
            raise VoccError.of("figures.readings", repr(name), rule)
        content = read_file(name, "figures.readings").decode("utf-8", "replace")
        chosen += parsed(content, name).items()
    if not chosen or len(dict(chosen)) < len(chosen):
        rule = "at least one reading, each once"
        raise VoccError.of("figures.readings", list(names), rule)
    readings = []
    for name, entry in chosen:
        with section(f"figures.readings.{name}"):
            changed = replace(
                settings,
                camera=whole(Camera, settings.camera),
                panel=whole(PanelSettings, settings.panel),
                receiver=whole(ReceiverSettings, settings.receiver),
            )
            for key, value in entry["set"].items():
                if key.partition(".")[0] not in SECTIONS:
                    raise VoccError.of(
                        "a key",
                        repr(key),
                        f"one that begins with {', '.join(SECTIONS)}",
                    )
                if not of_absent_effect(settings, key):
                    changed = with_value(changed, key, value)
            readings.append(
                PaperReading(
                    name, entry["set"], entry["why"], build.build_plan(changed, folder)
                )
            )
    return tuple(readings)


def of_absent_effect(settings: config.Settings, key: str) -> bool:
    """Whether a key belongs to an effect that the scene does not name: there is nothing to read."""
    effect = key.removeprefix("scene.effects.").partition(".")[0]
    known = {kind.name for kind in PHYSICAL_ORDER}
    return effect in known - {*settings.scene.effects}


def parsed(text: str, path: str) -> dict[str, dict[str, Any]]:
    """Parse a file of readings.

    Raises:
        VoccError: anything but names with ``why`` and ``set``.

    Example:
        >>> parsed("far: {why: no text, set: {camera.focal_length_mm: 50}}", "mine.yaml")
        {'far': {'why': 'no text', 'set': {'camera.focal_length_mm': 50}}}
    """
    entries = parse_yaml(text, f"figures.readings: {path}")
    for name, entry in (
        entries.items() if isinstance(entries, dict) and entries else [(path, None)]
    ):
        well_formed = (
            isinstance(entry, dict)
            and {*entry} == {"why", "set"}
            and isinstance(entry["set"], dict)
        )
        if not well_formed:
            raise VoccError.of(
                f"figures.readings: {path}",
                repr(name),
                "a name with why: and set: below it",
            )
        config.demand_file_word(f"figures.readings: {path}", str(name))
    return dict(entries)


def with_value(node: Any, path: str, value: object, key: str = "") -> Any:
    """Set a key of a dataclass or a mapping, and of those below it.

    Args:
        node: the dataclass or mapping, which stays as it is.
        path: the key, such as ``panel.board_reflectance``.
        value: its value, which the dataclass checks.
        key: the whole key, where ``path`` is its end.

    Raises:
        VoccError: an unknown key.

    Example:
        >>> from vocc_torch.hardware import Camera
        >>> with_value({"camera": Camera()}, "camera.focal_length_mm", 18.0)["camera"].focal_length_mm
        18.0
    """
    name, _, rest = path.partition(".")
    mapping = isinstance(node, dict)
    children = (
        node
        if mapping
        else {known.name: getattr(node, known.name) for known in fields(node)}
    )
    if name not in children and (rest or not mapping):
        raise VoccError.of(key or path, f"unknown at {name}", ", ".join(children))
    below = with_value(children[name], rest, value, key or path) if rest else value
    return {**node, name: below} if mapping else replace(node, **{name: below})
