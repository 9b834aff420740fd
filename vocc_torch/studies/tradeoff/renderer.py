"""What each accuracy knob of the renderer costs, and how near it comes to whole frames in float64."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from vocc_torch.measure.link import block_keys
from vocc_torch.measure.plan import World, resolve_device
from vocc_torch.measure.timing import interleaved
from vocc_torch.rng import FrameKey
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.simulation.effects.optics import TRUNCATION_SIGMAS, Blooming
from vocc_torch.simulation.framing import lay_on_sensor
from vocc_torch.simulation.simulator import Framing
from vocc_torch.studies.tradeoff.knob_setting import KnobSetting
from vocc_torch.studies.tradeoff.plan import DTYPES, TradeoffStudy
from vocc_torch.studies.tradeoff.supersampling import Supersampled, can_sample
from vocc_torch.studies.tradeoff.times import threads
from vocc_torch.types import Frames, Scene

REFERENCE_SIGMAS = 8.0
"""Half width of the reference's kernel: beyond it lies 1e-15 of the light, as much as float64 rounds off."""

Knob = Literal["none", "dtype", "framing", "kernel", "margin", "sampled"]


@dataclass(frozen=True)
class _Setting:
    """Where the knobs stand; the one that is turned, and where to."""

    knob: Knob
    value: str
    framing: Framing
    dtype: torch.dtype
    sigmas: float | None = None
    margin_px: int = 0
    samples: int = 0


@dataclass(frozen=True, slots=True)
class _Truncated(Blooming):
    """Blooming whose kernel ends elsewhere."""

    sigmas: float = TRUNCATION_SIGMAS

    @property
    def reach_px(self) -> int:
        """Half width of the kernel."""
        return max(1, math.ceil(self.sigmas * self.sigma_px))


class _Cut(Simulator):
    """A simulator with a margin about its crops that is wider, or narrower, than it should be."""

    margin_px = 0

    def crop_px(self, nearest_m: float) -> tuple[int, int]:
        """Height and width of the crop, at least 8 px."""
        height, width = (
            max(8, min(side + 2 * self.margin_px, full))
            for side, full in zip(super().crop_px(nearest_m), self.camera.sensor_px, strict=True)
        )
        return height, width


def price_renderer(study: TradeoffStudy) -> list[KnobSetting]:
    """Turn each knob by itself; times are taken in the same rounds.

    Errors are those of grey values before quantisation, over whole sensors, against frames rendered whole in
    float64 with a kernel of 8 standard deviations. LEDs are drawn by the exact area of pixels that they
    cover, so there is no supersampling to set; what it would cost and do is measured beside, as ``sampled``.

    Args:
        study: the study; the scenes are its first kind.

    Returns:
        The knobs as the study has them, then a line for each other setting.
    """
    if not study.knobs.frames:
        return []
    shot = _Scenes.of(study)
    settings = _settings(study)
    calls = {str(place): _Render(study, one, shot) for place, one in enumerate(settings)}
    with threads(study.threads):
        timing = interleaved(calls, study.repeats, resolve_device(study.plan.world.device), warm_up=1)
        errors = _errors(study, settings, shot)
    priced = []
    for place, (one, (worst, rms, changed)) in enumerate(zip(settings, errors, strict=True)):
        spent = timing[str(place)]
        frames = calls[str(place)].frames
        cost = tuple(1e3 * s / frames for s in (spent.low_s, spent.median_s, spent.high_s))
        low, median, high = cost
        priced.append(
            KnobSetting(one.knob, one.value, (low, median, high), spent.repeats, frames, worst, rms, changed)
        )
    return priced


@dataclass(frozen=True)
class _Scenes:
    """What is rendered."""

    scene: Scene
    bits: Tensor
    keys: Sequence[FrameKey]
    model: SceneModel

    @classmethod
    def of(cls, study: TradeoffStudy) -> _Scenes:
        """Draw the frames."""
        name = next(iter(study.scenes))
        model, (key,) = study.model(name), block_keys(study.plan.seed, study.point(name), 1)
        scene, bits = model.draw(key, study.plan.world.panel.shape)
        scene = scene[: study.knobs.frames]
        # The first is as near as scenes come: what a narrow margin cuts off shows there.
        near = scene.distance_m.clone()
        near[0] = model.nearest_m
        keys = [FrameKey(key, frame) for frame in range(len(scene))]
        return cls(replace(scene, distance_m=near), bits[: len(scene)], keys, model)

    def rendered(self, simulator: Simulator, frames: int) -> Frames:
        """Render the first of them."""
        rows = slice(0, frames)
        return simulator.render(
            self.scene[rows], self.bits[rows], nearest_m=self.model.nearest_m, keys=self.keys[rows]
        )


def _settings(study: TradeoffStudy) -> list[_Setting]:
    """List where the knobs are put."""
    world = study.plan.world
    usual = _Setting("none", "as set", world.framing, world.dtype)
    found = [usual]
    for name, dtype in DTYPES.items():
        if dtype != world.dtype:
            found.append(replace(usual, knob="dtype", value=name, dtype=dtype))
    framings: tuple[Framing, ...] = ("crop", "filled", "full")
    found += [
        replace(usual, knob="framing", value=framing, framing=framing)
        for framing in framings
        if framing != world.framing
    ]
    if "blooming" in world.effects:
        found += [
            replace(usual, knob="kernel", value=f"{sigmas:g} sigma", sigmas=sigmas)
            for sigmas in study.knobs.kernel_sigmas
        ]
    if world.framing != "full":
        found += [
            replace(usual, knob="margin", value=f"{margin:+d} px", margin_px=margin)
            for margin in study.knobs.margins_px
        ]
    if can_sample(world):
        found += [
            replace(usual, knob="sampled", value=f"{samples} x {samples}", samples=samples)
            for samples in study.knobs.supersampling
        ]
    return found


def _simulator(world: World, setting: _Setting, *, quantised: bool = True) -> Simulator:
    """Build a simulator with its knobs there."""
    effects = {
        name: settings
        for name, settings in world.effects.items()
        if quantised or name not in ("quantization", "jpeg")
    }
    kind = Supersampled if setting.samples else _Cut
    simulator = kind(
        world.camera,
        world.panel,
        effects,
        framing=setting.framing,
        device=resolve_device(world.device),
        dtype=setting.dtype,
    )
    if isinstance(simulator, Supersampled):
        simulator.samples = setting.samples
    elif isinstance(simulator, _Cut):
        simulator.margin_px = setting.margin_px
    if setting.sigmas is not None:
        simulator.effects = tuple(
            _Truncated(effect.sigma_px, setting.sigmas) if isinstance(effect, Blooming) else effect
            for effect in simulator.effects
        )
    return simulator


class _Render:
    """Renders the same frames at each call; a single one where frames are whole."""

    def __init__(self, study: TradeoffStudy, setting: _Setting, scenes: _Scenes) -> None:
        self.simulator = _simulator(study.plan.world, setting)
        self.scenes = scenes
        self.frames = 1 if setting.framing == "full" else len(scenes.scene)

    def __call__(self) -> Frames:
        """Render."""
        return self.scenes.rendered(self.simulator, self.frames)


def _errors(
    study: TradeoffStudy, settings: Sequence[_Setting], scenes: _Scenes
) -> list[tuple[float, float, float]]:
    """Compare each setting's grey values with the reference: worst, root mean square, share changed."""
    world, frames = study.plan.world, len(scenes.scene)
    reference = _simulator(
        world, _Setting("none", "", "full", torch.float64, REFERENCE_SIGMAS), quantised=False
    )
    simulators = [_simulator(world, one, quantised=False) for one in settings]
    usual = Simulator(world.camera, world.panel, world.effects).crop_px(scenes.model.nearest_m)
    sums = [[0.0, 0.0, 0.0] for _ in settings]
    pixels = 0
    for frame in range(frames):
        one = _Scenes(
            scenes.scene[frame : frame + 1],
            scenes.bits[frame : frame + 1],
            scenes.keys[frame : frame + 1],
            scenes.model,
        )
        truth = one.rendered(reference, 1).grey
        near = _near(reference, one, usual)
        pixels += truth[near].numel()
        for found, simulator in zip(sums, simulators, strict=True):
            seen = _whole(one.rendered(simulator, 1))
            apart = (seen - truth).abs()
            found[0] = max(found[0], float(apart.max()))
            found[1] += float(apart[near].square().sum())
            found[2] += int((seen[near].round() != truth[near].round()).sum())
    return [(worst, math.sqrt(squares / pixels), changed / pixels) for worst, squares, changed in sums]


def _near(reference: Simulator, one: _Scenes, size: tuple[int, int]) -> tuple[slice, ...]:
    """Give the pixels of the usual crop about the panel."""
    corners = reference.true_panels(one.scene, one.keys).corners_px[0]
    middle_x, middle_y = corners.mean(dim=0).round().long().tolist()
    rows, columns = (
        slice(max(0, at - side // 2), at + side // 2)
        for at, side in zip((middle_y, middle_x), size, strict=True)
    )
    return slice(None), slice(None), rows, columns


def _whole(frames: Frames) -> Tensor:
    """Give whole frames in float64, the surround laid about crops."""
    grey = frames.grey.to(torch.float64)
    if frames.surround is None:
        return grey
    return lay_on_sensor(grey, frames.surround.to(torch.float64), frames.origin_px, frames.sensor_px)
