"""``task=effects``, what each effect costs and does: its section of the configuration, without torch."""

from dataclasses import dataclass, field
from typing import Any


@dataclass
class Severity:
    """A parameter along which an effect becomes harsher.

    Args:
        parameter: ``effect.parameter``.
        values: numbers from harmless to harsh, at least one, rising or falling.
    """

    parameter: str = ""
    values: list[Any] = field(default_factory=list)


@dataclass
class EffectsConfig:
    """What ``task=effects`` looks at: see :class:`vocc_torch.studies.effects.plan.EffectStudy`.

    Args:
        names: some of the effects; all by default.
        located_frames: frames with the paper's locator where an effect fills the sensor; 0 leaves it out.
        severity_frames: frames at each severity, true corners; 0 leaves the severities out.
        repeats: timed rounds, at least 1.
        parts: what is added: by an effect's name, it with what it needs.
        severity: by an effect's name, the parameter along which it becomes harsher.
    """

    names: list[str] = field(default_factory=list)
    located_frames: int = 0
    severity_frames: int = 0
    repeats: int = 0
    parts: dict[str, Any] = field(default_factory=dict)
    # A Severity each; the command line adds none to a mapping of those.
    severity: dict[str, Any] = field(default_factory=dict)
