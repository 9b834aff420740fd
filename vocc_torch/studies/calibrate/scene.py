"""A scene as it is written: values and effects, how sure they are, and the light that they stand for."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import yaml
from scipy import stats
from torch import Tensor

from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.show.page import render
from vocc_torch.simulation.effects.sensor import Photoelectrons
from vocc_torch.simulation.photometry import MIDDLE_GREY
from vocc_torch.studies.calibrate.fit import SURE, RecordingFit

Derived = tuple[Tensor, Tensor, float]
"""A value of every frame (B,), its own standard deviation (B,), and what that adds which all share."""
UNKNOWN_LX = 8000.0
"""Illuminance where nothing tells it: an overcast day. Only ratios of light matter then."""


@dataclass(frozen=True)
class Value:
    """A value of the scene, as the recording tells it.

    Args:
        key: below ``scene``, such as ``effects.blooming.sigma_px``.
        given: a number, or a distribution over the recording.
        deviation: standard deviation of the number, or of the distribution's middle; NaN where it is taken
            from the configuration.
        note: what it explains, or where it is from.
    """

    key: str
    given: float | Sequence[object]
    deviation: float = math.nan
    note: str = ""

    @property
    def middle(self) -> float:
        """The number, or the middle of the distribution."""
        if isinstance(self.given, Sequence):
            return float(np.mean([v for v in self.given if isinstance(v, int | float)]))
        return self.given

    @property
    def remark(self) -> str:
        """The comment that stands above it."""
        sure = f"+- {SURE * self.deviation:.2g} (95 %)" if math.isfinite(self.deviation) else ""
        return "; ".join(part for part in (self.note, sure) if part)

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of the 95 % interval."""
        return self.middle - SURE * self.deviation, self.middle + SURE * self.deviation


@dataclass(frozen=True)
class Named:
    """An effect that was tried, and whether the recording asks for it.

    Args:
        effect: its name.
        asked: whether it is in the scene.
        criterion: what was compared, in words.
        gain: by how much the criterion favours the effect.
        needed: the gain from which it is named.
        explains: what it explains.
    """

    effect: str
    asked: bool
    criterion: str
    gain: float = 0.0
    needed: float = 0.0
    explains: str = ""


@dataclass(kw_only=True)
class Calibrated:
    """A scene from a recording.

    Args:
        camera: whose picture it is.
        panel: whose LEDs they are.
        values: of the scene and its effects, each with what it explains.
        effects: all that were tried.
        unknown: what the recording does not tell, in sentences.
        doubts: what the model does not explain, in sentences.
    """

    camera: Camera
    panel: LedPanel
    values: list[Value] = field(default_factory=list)
    effects: list[Named] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)

    def of(self, effect: str) -> list[Value]:
        """Give an effect's values."""
        return [one for one in self.values if one.key.startswith(f"effects.{effect}.")]

    def text(self, name: str, source: str) -> str:
        """Write the scene as YAML, each value beside what it explains and how sure it is."""
        return render(__package__, "scene.yaml.j2", scene=self, name=name, source=source, inline=inline)


def inline(value: object) -> str:
    """Write a value on one line of YAML; seven digits are more than a recording tells."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(inline, value)) + "]"
    if isinstance(value, float):
        value = float(f"{value:.7g}")
    text: str = yaml.safe_dump(value, default_flow_style=True)
    return text.removesuffix("...\n").strip()


def spread(key: str, derived: Derived, note: str, least: float = -math.inf) -> Value:
    """Describe a value of every frame: a number where it stays, and where it moves a range of like scatter.

    It moves where its scatter exceeds what its uncertainty allows by chi-squared's 99.9 %.

    Args:
        key: of the value.
        derived: as :meth:`vocc_torch.studies.calibrate.fit.RecordingFit.derived` gives it.
        note: what it is.
        least: the lowest value allowed.
    """
    each, deviation, common = derived
    weights = 1 / deviation.clamp(min=1e-12).square()
    middle, count = float((weights * each).sum() / weights.sum()), len(each)
    misfit = float((weights * (each - middle).square()).sum())
    if count < 2 or misfit <= stats.chi2.ppf(0.999, count - 1):
        scatter = max(1.0, misfit / max(count - 1, 1)) / float(weights.sum())
        return Value(key, max(middle, least), math.hypot(math.sqrt(scatter), common), note)
    mean, half = float(each.mean()), math.sqrt(3) * float(each.std())  # a uniform one's of that scatter
    ends = ["uniform", max(mean - half, least), max(mean + half, least)]
    alone = float(each.std() / math.sqrt(count) * stats.t.ppf(0.975, count - 1)) / SURE
    return Value(key, ends, math.hypot(alone, common), f"{note}, over the recording")


def linear(fit: RecordingFit, name: str) -> Tensor:
    """Give a fitted level as light, (B,)."""
    return (fit.value(name) / MIDDLE_GREY) ** fit.of_all[0]


def veil(fit: RecordingFit, panel: LedPanel) -> float:
    """Give the luminance of a veil that makes Off LEDs and background as alike as they are, at 1 lx.

    Both reflect the same daylight: where their ratio is nearer to 1 than that of their reflectances, a veil
    lies over both.
    """
    ratio = float(linear(fit, "off").median() / linear(fit, "background").median())
    share = panel.background_reflectance
    return max(0.0, (panel.led_reflectance - ratio * share) / (ratio - 1) / math.pi) if ratio > 1 else 0.0


def illuminance(electrons: float, camera: Camera, seen_cd_m2: float, efficiency: float) -> float:
    """Say which illuminance gives a pixel of the background so many electrons, lx.

    Args:
        electrons: that the photon transfer curve counts.
        camera: whose picture it is.
        seen_cd_m2: luminance that the background has at 1 lx, with any veil.
        efficiency: the quantum efficiency.
    """
    exposure = 10 * seen_cd_m2 * camera.exposure_time_s / (camera.calibration_constant * camera.f_number**2)
    return electrons / (Photoelectrons(efficiency).electrons_per_lx_s(camera) * exposure)


def of_size(camera: Camera, height: int, width: int) -> tuple[Camera, str]:
    """Give the camera whose whole picture has the recording's size, and say what was taken.

    A recording of the same shape is the whole sensor, scaled; another one is a part of it about the middle.
    """
    if (camera.height_px, camera.width_px) == (height, width):
        return camera, ""
    told = f"the frames are {width} x {height} px and camera= says {camera.width_px} x {camera.height_px}: "
    if camera.height_px * width == camera.width_px * height:
        return replace(camera, width_px=width, height_px=height), told + "taken for the whole sensor, scaled"
    wide = camera.sensor_width_mm * width / camera.width_px
    made = replace(camera, width_px=width, height_px=height, sensor_width_mm=wide)
    return made, told + "taken for the middle of it, with pixels of the same size"
