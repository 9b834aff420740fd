"""From the configuration to the study."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from vocc_torch.errors import VoccError, section
from vocc_torch.measure.build import build_plan, without_absent
from vocc_torch.measure.config import SceneSettings, Settings
from vocc_torch.measure.plan import Plan
from vocc_torch.studies.classifiers.config import RivalsConfig
from vocc_torch.studies.classifiers.plan import RivalStudy


def build_rival_study(settings: Settings, config: RivalsConfig, folder: Path) -> RivalStudy:
    """Build the study that ``task=classifiers`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan = build_plan(settings, folder)
    receiver, left_out = without_absent(plan.receiver)
    plan = replace(plan, receiver=receiver)
    plans = {}
    for name, one in config.experiments.items():
        key = f"rivals.experiments.{name}"
        if one.row_axis is not None:
            raise VoccError(f"{key} is a grid over {one.row_axis}: it must have one axis")
        with section(key, before="experiment"):
            plans[name] = replace(plan, experiment=one)
    return RivalStudy(
        plans,
        reference=config.reference,
        points=config.points,
        genie_frames=config.genie_frames,
        home=settings.scene.name,
        # The scene of the experiments may be among the shipped ones or not.
        scenes={
            name: replace(_abroad(settings, scene, name, folder), receiver=receiver)
            for name, scene in config.scenes.items()
            if name != settings.scene.name
        },
        scene_frames=config.scene_frames,
        scene_training_frames=config.scene_training_frames,
        left_out=left_out,
    )


def _abroad(settings: Settings, scene: SceneSettings, name: str, folder: Path) -> Plan:
    """The plan of another scene; its refusals name the scene's own key."""
    with section(f"rivals.scenes.{name}", before="scene"):
        return build_plan(replace(settings, scene=scene), folder)
