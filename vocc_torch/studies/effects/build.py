"""From the configuration to the study."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from vocc_torch.errors import VoccError
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings, effect_settings
from vocc_torch.measure.plan import Experiment
from vocc_torch.studies.effects.catalogue import Catalogue, Severity
from vocc_torch.studies.effects.config import EffectsConfig
from vocc_torch.studies.effects.plan import EffectStudy


def build_effect_study(settings: Settings, config: EffectsConfig, folder: Path) -> EffectStudy:
    """Build the study that ``task=effects`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan = build_plan(settings, folder)
    parts = {name: _mappings(part, f"effects.parts.{name}") for name, part in config.parts.items()}
    severities = {
        name: Severity(one.parameter, _numbers(one.values, f"effects.severity.{name}.values"))
        for name, one in config.severity.items()
    }
    catalogue = Catalogue(plan.world.effects, parts, severities, tuple(config.names))
    # All frames are of the scene itself: no experiment narrows them.
    own = Experiment("effects", "distance_m", (plan.world.scene.nearest_m,))
    return EffectStudy(
        replace(plan, experiment=own),
        catalogue,
        config.located_frames,
        config.severity_frames,
        config.repeats,
        settings.scene.name,
    )


def _mappings(part: object, key: str) -> dict[str, Any]:
    """Check that a part is a mapping of effects to mappings; the registry checks names and parameters."""
    if not isinstance(part, dict):
        raise VoccError(f"{key} is {part!r}: it must be a mapping of effects, each with its parameters")
    return effect_settings(part, key)


def _numbers(values: list[Any], key: str) -> tuple[float, ...]:
    """Check that a severity's values are numbers; whole numbers stay whole."""
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise VoccError(f"{key} has {value!r}: it must be finite numbers from harmless to harsh")
    return tuple(values)
