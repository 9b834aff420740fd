"""A scene as it is written: values and effects, how sure they are, and what the recording does not tell."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from typing import NamedTuple

import numpy as np
import yaml
from scipy import stats

from vocc_torch.arrays import Floats
from vocc_torch.extras.calibrate import CalibrateConfig
from vocc_torch.extras.calibrate.fit import SURE, Of, RecordingFit
from vocc_torch.extras.calibrate.reading import Footage
from vocc_torch.extras.calibrate.surround import Falloff, Surround
from vocc_torch.extras.calibrate.transfer import TransferCurve
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.report.page import render

WORDS = yaml.safe_load((resources.files(__package__) / "sentences.yaml").read_text())
CODED = 12.0
"""Standard deviations from which coefficients lie on multiples of their steps."""
CODED_GAIN = 30.0
"""Gain that an effect needs in coded pictures."""


class Value(NamedTuple):
    """A value of the scene, as the recording tells it.

    Args:
        key: below ``scene``, such as ``effects.blooming.sigma_px``.
        setting: a number, or a distribution over the recording.
        deviation: standard deviation of the number, or of the distribution's middle; NaN where it is taken
            from the configuration.
        note: what it explains, or where it is from.
    """

    key: str
    setting: float | Sequence[object]
    deviation: float = math.nan
    note: str = ""

    @property
    def middle(self) -> float:
        """The number, or the middle of the distribution."""
        if isinstance(self.setting, Sequence):
            return float(
                np.mean([v for v in self.setting if isinstance(v, int | float)])
            )
        return self.setting

    @property
    def remark(self) -> str:
        """The comment that stands above it."""
        parts = (
            self.note,
            f"+- {SURE * self.deviation:.2g} (95 %)"
            if math.isfinite(self.deviation)
            else "",
        )
        return "; ".join(filter(None, parts))

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of the 95 % interval."""
        return self.middle - SURE * self.deviation, self.middle + SURE * self.deviation


class Named(NamedTuple):
    """An effect that was tried, and whether the recording asks for it.

    Args:
        effect: its name.
        asked: whether it is in the scene.
        criterion: what was compared, in words.
        gain: by how much the criterion favours the effect.
        threshold: the gain from which it is named.
        explains: what it explains.
    """

    effect: str
    asked: bool
    criterion: str
    gain: float = 0.0
    threshold: float = 0.0
    explains: str = ""


@dataclass
class Findings:
    """A scene from a recording, while it is found and when it is, with all that its page shows.

    Args:
        camera: whose picture it is.
        panel: whose LEDs they are.
        config: what the recording cannot tell.
        footage: the frames.
        fit: the last fit.
        around: the picture around the panel.
        fall: how light falls off there.
        coded: the likeliest JPEG quality, and how sure it is.
        curve: the photon transfer curve; None for too few frames.
        loose: whether the recording tells gamma and blur no better than coding or their bounds let it.
        bound: where gamma ran to, if that is no camera's.
        values: of the scene and its effects, each with what it explains.
        effects: all that were tried.
        unknown: what the recording does not tell, in sentences.
        doubts: what the model does not explain, in sentences.
    """

    camera: Camera
    panel: LedPanel
    config: CalibrateConfig
    footage: Footage
    fit: RecordingFit
    around: Surround
    fall: Falloff
    coded: tuple[int, float] = (0, 0.0)
    curve: TransferCurve | None = None
    loose: bool = False
    bound: float | None = None
    values: list[Value] = field(default_factory=list)
    effects: list[Named] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)

    def text(self, name: str, source: str) -> str:
        """Write the scene as YAML, each value beside what it explains and how sure it is."""
        return render(
            __package__,
            "scene.yaml.j2",
            scene=self,
            name=name,
            source=source,
            inline=inline,
        )

    def of(self, effect: str) -> list[Value]:
        """Give an effect's values."""
        return [
            value for value in self.values if value.key.startswith(f"effects.{effect}.")
        ]

    def tried(self, effect: str, gain: float, threshold: float = 0.0) -> bool:
        """Note an effect, and say whether the recording asks for it."""
        criterion, explains = WORDS["effects"][effect]
        asked = gain > threshold
        self.effects.append(Named(effect, asked, criterion, gain, threshold, explains))
        return asked

    def judge(
        self, effect: str, simple: RecordingFit, rich: RecordingFit
    ) -> RecordingFit:
        """Keep the richer of two fits where Schwarz's criterion favours it, in units of its own noise."""
        gain = (simple.misfit - rich.misfit) / rich.scale
        gain -= (rich.values - simple.values) * math.log(rich.pixels)
        # What coding leaves hangs together over its blocks.
        return rich if self.tried(effect, gain, CODED_GAIN * self.is_coded) else simple

    @property
    def is_coded(self) -> bool:
        """Whether pictures are coded."""
        return self.coded[1] > CODED

    def derived(self, of: Of) -> tuple[Floats, Floats, float]:
        """Derive a value of every frame; coded ones err alike, as the panel lies in the blocks' grid."""
        values, frame_values, common = self.fit.derived(of)
        return (
            values,
            frame_values,
            math.hypot(common, float(np.median(frame_values)) * self.is_coded),
        )

    def tell(self, key: str, setting: float, deviation: float = math.nan) -> None:
        """Note a value."""
        self.note(Value(key, setting, deviation, WORDS["values"].get(key, "")))

    def over(self, key: str, of: Of, least: float = -math.inf) -> None:
        """Note a value of every frame."""
        self.note(spread(key, self.derived(of), WORDS["values"][key], least))

    def note(self, value: Value) -> None:
        """Note a value; without an interval where it hangs on a gamma that the recording does not tell."""
        if value.key in WORDS["by_gamma"] and self.loose:
            note = "; ".join(
                filter(None, (value.note, "no interval: gamma is not determined"))
            )
            value = value._replace(deviation=math.nan, note=note)
        self.values.append(value)

    def say(self, word: str, when: bool = True, **values: object) -> None:
        """Note a sentence of ``sentences.yaml``, where it is so: what is not told, or not explained."""
        if when:
            doubt = WORDS["doubts"].get(word)
            (self.doubts if doubt else self.unknown).append(
                (doubt or WORDS["sentences"][word]).format(**values)
            )

    def asked(self, effect: str) -> bool:
        """Say whether the recording asks for an effect."""
        return any(named.effect == effect and named.asked for named in self.effects)


def inline(value: object) -> str:
    """Write a value on one line of YAML; seven digits are more than a recording tells."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(inline, value)) + "]"
    if isinstance(value, float):
        value = float(f"{value:.7g}")
    text: str = yaml.safe_dump(value, default_flow_style=True)
    return text.removesuffix("...\n").strip()


def spread(
    key: str, derived: tuple[Floats, Floats, float], note: str, least: float = -math.inf
) -> Value:
    """Describe a value of every frame: a number where it stays, and where it moves a range of like scatter.

    It moves where its scatter exceeds what its uncertainty allows by chi-squared's 99.9 %.

    Args:
        key: of the value.
        derived: the value of every frame, how sure it is, and how sure what all frames have in common.
        note: what it is.
        least: the lowest value allowed.
    """
    values, deviation, common = derived
    weights, count = 1 / deviation.clip(min=1e-12) ** 2, len(values)
    middle = float((weights * values).sum() / weights.sum())
    misfit = float((weights * (values - middle) ** 2).sum())
    if count < 2 or misfit <= stats.chi2.ppf(0.999, count - 1):
        scatter = max(1.0, misfit / max(count - 1, 1)) / float(weights.sum())
        return Value(
            key, max(middle, least), math.hypot(math.sqrt(scatter), common), note
        )
    mean, scatter = float(values.mean()), float(values.std(ddof=1))
    half = math.sqrt(3) * scatter  # a uniform range of that scatter
    ends = ["uniform", max(mean - half, least), max(mean + half, least)]
    alone = scatter / math.sqrt(count) * stats.t.ppf(0.975, count - 1) / SURE
    return Value(key, ends, math.hypot(alone, common), f"{note}, over the recording")


def of_size(camera: Camera, height: int, width: int) -> tuple[Camera, str]:
    """Give the camera whose whole picture has the recording's size, and say what was taken.

    A recording of the same shape is the whole sensor, scaled; another one is a part of it about the middle.
    """
    if (camera.height_px, camera.width_px) == (height, width):
        return camera, ""
    refusal = f"the frames are {width} x {height} px and camera= says {camera.width_px} x {camera.height_px}: "
    if camera.height_px * width == camera.width_px * height:
        return replace(
            camera, width_px=width, height_px=height
        ), refusal + "they are treated as the whole sensor, scaled"
    wide = camera.sensor_width_mm * width / camera.width_px
    fitted = replace(camera, width_px=width, height_px=height, sensor_width_mm=wide)
    return (
        fitted,
        refusal
        + "they are treated as the middle of the sensor, with pixels of the same size",
    )
