"""``task=effects``: its section of the configuration; nothing here needs torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass
class SeverityConfig:
    """See :class:`vocc_torch.studies.effects.Severity`."""

    parameter: str = ""
    values: list[Any] = field(default_factory=list)


@dataclass
class EffectsConfig:
    """What ``task=effects`` looks at: see :class:`vocc_torch.studies.effects.EffectStudy`."""

    names: list[str] = field(default_factory=list)
    located_frames: int = 0
    severity_frames: int = 0
    repeats: int = 0
    parts: dict[str, Any] = field(default_factory=dict)
    severity: dict[str, SeverityConfig] = field(default_factory=dict)
