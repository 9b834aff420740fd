"""From the configuration to the study."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from vocc_torch.errors import VoccError, section
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.optional import without_absent
from vocc_torch.measure.plan import Experiment, parsed_scene, resolve_device
from vocc_torch.studies.tradeoff.config import TradeoffConfig
from vocc_torch.studies.tradeoff.plan import VARIED, RendererKnobs, TradeoffStudy

T = TypeVar("T")


def build_tradeoff_study(settings: Settings, config: TradeoffConfig, folder: Path) -> TradeoffStudy:
    """Build the study that ``task=tradeoff`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan = build_plan(settings, folder)
    receiver, left_out = without_absent(plan.receiver)
    plan = replace(plan, receiver=receiver)
    scenes = {}
    for name, scene in config.scenes.items():
        if not name.isidentifier() or not isinstance(scene, dict):
            raise VoccError(f"tradeoff.scenes.{name} is {scene!r}: it must be a word with values of scenes")
        scenes[name] = parsed_scene(scene, f"tradeoff.scenes.{name}")
    knobs = config.simulation
    devices, missing = _devices(config.devices)
    return TradeoffStudy(
        # All frames are of the study's own scenes: no experiment narrows them.
        replace(plan, experiment=Experiment("tradeoff", "distance_m", (plan.world.scene.nearest_m,))),
        locators=_once(config.locators),  # type: ignore[arg-type]  # checked by name in TradeoffStudy
        samples_per_led=_once(config.samples_per_led),
        gradients=_once(config.gradients),
        dtypes=_once(config.dtypes),
        varied=_once([one for one in VARIED if one in plan.receiver.names])
        if config.varied is None
        else _once(config.varied),
        combine=config.combine,  # type: ignore[arg-type]  # likewise
        devices=devices,
        batch_sizes=tuple(sorted(_once(config.batch_sizes))),
        frames=_once(config.frames),  # type: ignore[arg-type]  # likewise
        repeats=config.repeats,
        threads=config.threads,
        scenes=scenes,
        knobs=RendererKnobs(
            knobs.frames, tuple(knobs.kernel_sigmas), tuple(knobs.margins_px), _once(knobs.supersampling)
        ),
        scene_name=settings.scene.name,
        frames_a_preamble=config.frames_a_preamble,
        genie_frames=config.genie_frames,
        missing=missing,
        left_out=left_out,
    )


def _once(values: Sequence[T]) -> tuple[T, ...]:
    """Give values in their order, each once."""
    return tuple(dict.fromkeys(values))


def _devices(names: Sequence[str]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Give devices by their own names, and those that this machine does not have with the reason.

    Raises:
        VoccError: no device's name, or none that is there.
    """
    found: list[str] = []
    missing: dict[str, str] = {}
    for name in _once(names):
        try:
            with section("tradeoff.devices has", before="device is"):
                found.append(str(resolve_device(name)))
        except VoccError as error:
            if not name.startswith("cuda") or len(names) == 1:
                raise
            missing[name] = str(error).partition(", and ")[2].partition(":")[0]
    return _once(found), missing
