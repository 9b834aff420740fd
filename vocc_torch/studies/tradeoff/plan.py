"""What a price list is made of: the configurations, the scenes and how times are taken."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, get_args

import torch

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import Locator, Plan, narrowed, resolve_device
from vocc_torch.receiver.bank import FLDA_FEATURES
from vocc_torch.receiver.reader import Reader
from vocc_torch.simulation import Distribution, SceneModel
from vocc_torch.studies.tradeoff.price_list import Setting

Combine = Literal["one_at_a_time", "all"]
FrameKind = Literal["whole", "crops"]

DTYPES = {"float32": torch.float32, "float64": torch.float64}
"""Working precisions of rectification and features."""

LEAST_FRAMES = 48
"""Frames that the timed rounds meet at least, whatever the batch."""

VARIED = ("flda_3", "lmmse")
"""Receivers that are measured at further values, unless others are named: those of them that are compared."""

LEAST_CROP_PX = 8
"""Least side of a crop whose margin is cut."""

MOST_BATCH = 1024
"""Most frames at a time."""


@dataclass(frozen=True)
class RendererKnobs:
    """Where the renderer's knobs are put, one at a time.

    Args:
        frames: frames rendered for errors and in timed calls, at least 1; 0 leaves the renderer out.
        supersampling: samples along a pixel's side of the alternative to exact areas, 1 to 64.
        kernel_sigmas: half widths of the blooming kernel, in standard deviations, above 0.
        margins_px: what is added to each side of the crop, px; may be negative.

    Raises:
        VoccError: a number outside its range.
    """

    frames: int = 8
    kernel_sigmas: tuple[float, ...] = (2.0, 3.0, 6.0)
    margins_px: tuple[int, ...] = (-20, -16, 16, 64)
    supersampling: tuple[int, ...] = (1, 2, 4, 8, 16)

    def __post_init__(self) -> None:
        """Check every range."""
        if self.frames < 0:
            raise VoccError(f"tradeoff.simulation.frames is {self.frames}: it must be at least 0")
        for sigmas in self.kernel_sigmas:
            if not 0 < sigmas <= 16:
                key = "tradeoff.simulation.kernel_sigmas"
                raise VoccError(f"{key} has {sigmas:g}: it must be above 0 and at most 16")
        for samples in self.supersampling:
            if not 1 <= samples <= 64:
                raise VoccError(f"tradeoff.simulation.supersampling has {samples}: it must be from 1 to 64")


@dataclass(frozen=True)
class TradeoffStudy:
    """A study of what accuracy costs in time.

    The first of each list is where the other lists are gone through; every receiver is measured there with
    each of the locators, and those that are ``varied`` at the other values too.

    Args:
        plan: the world, the receivers and the budget, whose frames are counted for each kind of scenes; its
            experiment and the settings of its reader have no part in it.
        locators: what finds the panel.
        samples_per_led: K.
        gradients: kernels of the gradient.
        dtypes: working precisions of rectification and features.
        varied: receivers that are measured at further values.
        combine: ``one_at_a_time`` varies one of K, gradient and precision, ``all`` takes every combination.
        devices: where times are taken; errors are counted on the first.
        batch_sizes: frames at a time.
        frames: what is handed to the receiver.
        repeats: timed rounds, at least 1; small batches have more, so that all meet as many frames.
        threads: threads within an operation while times are taken; 0 for torch's own choice.
        scenes: kinds of scenes by name: what they narrow.
        knobs: the renderer's.
        scene_name: what results call the scene.
        frames_a_preamble: frames of data that a pair of frames of known bits serves, at least 1; errors are
            counted with a pair for each.
        genie_frames: frames of each kind of scenes for a decoder that knows the scene; 0 for none.
        missing: devices that were asked for and are not there, and why.
        left_out: receivers that were asked for and cannot be built here, and why.

    Raises:
        VoccError: a value outside its range or an unknown name.
    """

    plan: Plan
    locators: tuple[Locator, ...] = ("paper",)
    samples_per_led: tuple[int, ...] = (8,)
    gradients: tuple[str, ...] = ("sobel",)
    dtypes: tuple[str, ...] = ("float32",)
    varied: tuple[str, ...] = ()
    combine: Combine = "one_at_a_time"
    devices: tuple[str, ...] = ("cpu",)
    batch_sizes: tuple[int, ...] = (1, 32)
    frames: tuple[FrameKind, ...] = ("whole", "crops")
    repeats: int = 11
    threads: int = 1
    scenes: Mapping[str, Mapping[str, Distribution]] = field(default_factory=lambda: {"mixture": {}})
    knobs: RendererKnobs = field(default_factory=RendererKnobs)
    scene_name: str = ""
    frames_a_preamble: int = 1
    genie_frames: int = 0
    missing: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check every list and every number, before any work is done."""
        for name in (
            "locators",
            "samples_per_led",
            "gradients",
            "dtypes",
            "devices",
            "batch_sizes",
            "frames",
        ):
            _check_list(name, getattr(self, name))
        for name, known in (("locators", get_args(Locator)), ("dtypes", tuple(DTYPES))):
            _check_known(name, getattr(self, name), known)
        _check_known("frames", self.frames, get_args(FrameKind))
        _check_known("combine", (self.combine,), get_args(Combine))
        _check_known("varied", self.varied, self.plan.receiver.names)
        for batch in self.batch_sizes:
            if not 1 <= batch <= MOST_BATCH:
                raise VoccError(f"tradeoff.batch_sizes has {batch}: it must be from 1 to {MOST_BATCH}")
        for name, least in (("repeats", 1), ("threads", 0), ("frames_a_preamble", 1), ("genie_frames", 0)):
            if getattr(self, name) < least:
                raise VoccError(f"tradeoff.{name} is {getattr(self, name)}: it must be at least {least}")
        if not self.scenes:
            raise VoccError("tradeoff.scenes is empty: it must name at least one kind of scenes")
        for name in self.scenes:
            self.model(name)
        for name in ("target_frame_errors", "precision"):
            value = getattr(self.plan.budget, name)
            if value is not None:
                rule = "it must be null for task=tradeoff, which compares receivers on the same frames"
                raise VoccError(f"budget.{name} is {value}: {rule}")
        for device in self.devices:
            resolve_device(device)
        for setting in self.settings:
            self.reader(setting)
            self._check_patch(setting)
        self._check_margins()

    @cached_property
    def settings(self) -> tuple[Setting, ...]:
        """The configurations: every receiver with every locator, then the varied ones."""
        base = (self.samples_per_led[0], self.gradients[0], self.dtypes[0])
        found = [
            Setting(name, locator, *base) for locator in self.locators for name in self.plan.receiver.names
        ]
        found += [
            self._told_apart(Setting(name, locator, *values))
            for locator in self.locators
            for name in self.varied
            for values in self._values()
        ]
        return tuple(dict.fromkeys(found))

    def _told_apart(self, setting: Setting) -> Setting:
        """Put what a receiver does not look at where the others have it."""
        name = setting.receiver
        plugged_in = {one.name: one.inputs.features for one in self.plan.receiver.classifiers}
        if "gri" not in (*FLDA_FEATURES.get(name, ()), *plugged_in.get(name, ())):
            setting = replace(setting, gradient=self.gradients[0])
        if name != "center_greyscale":
            return setting
        return replace(setting, samples_per_led=self.samples_per_led[0], dtype=self.dtypes[0])

    def _values(self) -> list[tuple[int, str, str]]:
        """K, gradient and precision of the varied receivers."""
        every = [(k, g, d) for k in self.samples_per_led for g in self.gradients for d in self.dtypes]
        if self.combine == "all":
            return every
        base = every[0]
        return [one for one in every if sum(a != b for a, b in zip(one, base, strict=True)) <= 1]

    def reader(self, setting: Setting) -> Reader:
        """Give a setting's rectification and features.

        Raises:
            VoccError: a value that no reader has.
        """
        try:
            return Reader(self.plan.world.panel.shape, setting.samples_per_led, setting.gradient)  # type: ignore[arg-type]  # checked there
        except VoccError as error:
            said = str(error).replace("receiver.samples_per_led is", "tradeoff.samples_per_led has")
            raise VoccError(said.replace("receiver.gradient is", "tradeoff.gradients has")) from None

    def plan_of(self, setting: Setting) -> Plan:
        """Give the plan that trains a setting's receiver, and no other."""
        own = tuple(one for one in self.plan.receiver.classifiers if one.name == setting.receiver)
        receiver = replace(
            self.plan.receiver,
            names=(setting.receiver,),
            locator=setting.locator,  # type: ignore[arg-type]  # one of the study's own
            reader=self.reader(setting),
            classifiers=own,
        )
        return replace(self.plan, receiver=receiver)

    def model(self, scenes: str) -> SceneModel:
        """Give the scenes of a kind.

        Raises:
            VoccError: a value outside its range.
        """
        return narrowed(self.plan.world.scene, self.scenes[scenes], f"tradeoff.scenes.{scenes}")

    def point(self, scenes: str) -> str:
        """Name the point that keys the draws of a kind of scenes."""
        return f"tradeoff/{scenes}"

    def rounds(self, batch: int) -> int:
        """Timed rounds with batches of a size."""
        return max(self.repeats, -(-LEAST_FRAMES // batch))

    @property
    def timed_frames(self) -> int:
        """Frames that times are taken on: whole batches of every size."""
        return max(LEAST_FRAMES, *self.batch_sizes)

    def _check_margins(self) -> None:
        """Refuse margins that leave nothing of the crop."""
        if not self.knobs.frames:
            return
        nearest_m = self.model(next(iter(self.scenes))).nearest_m
        least = min(self.plan.world.simulator().crop_px(nearest_m))
        for margin in self.knobs.margins_px:
            if least + 2 * margin < LEAST_CROP_PX:
                allowed = f"it must be at least {math.ceil((LEAST_CROP_PX - least) / 2)}"
                key = "tradeoff.simulation.margins_px"
                raise VoccError(
                    f"{key} has {margin}: {allowed}, so that {LEAST_CROP_PX} px of a crop are left"
                )

    def _check_patch(self, setting: Setting) -> None:
        """Refuse a K that a classifier's patch does not go into."""
        for one in self.plan.receiver.classifiers:
            patch = one.inputs.patch
            if one.name == setting.receiver and patch and setting.samples_per_led % patch.samples:
                key = f"classifiers.{one.name}.inputs.patch.samples"
                raise VoccError(
                    f"tradeoff.samples_per_led has {setting.samples_per_led}: "
                    f"it must be a multiple of {key}, {patch.samples}"
                )


def trained_alike(setting: Setting) -> Setting:
    """Give the setting whose training serves this one: precision does not take part in it.

    Example:
        >>> trained_alike(Setting("flda_2", "paper", 8, "sobel", "float64")).dtype
        'float32'
    """
    return replace(setting, dtype="float32")


def is_flda(name: str) -> bool:
    """Whether a receiver is one of the paper's, with features and FLDA.

    Example:
        >>> is_flda("flda_3"), is_flda("center_greyscale")
        (True, False)
    """
    return name in FLDA_FEATURES


def _check_list(name: str, values: Sequence[object]) -> None:
    """Refuse an empty list."""
    if not values:
        raise VoccError(f"tradeoff.{name} is empty: it must hold at least one value")


def _check_known(name: str, values: Sequence[str], known: Sequence[str]) -> None:
    """Refuse a value that is not known."""
    for value in values:
        if value not in known:
            raise VoccError(f"tradeoff.{name} has {value!r}: it must be of {', '.join(known)}")
