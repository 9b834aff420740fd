"""A scene as it is written: values and effects, how sure they are, and what the recording does not tell."""

import math
from dataclasses import dataclass, field
from importlib import resources
from typing import NamedTuple

import numpy as np
import yaml
from scipy import stats

from vocc_torch.arrays import Floats
from vocc_torch.extras.calibrate import CalibrateConfig
from vocc_torch.extras.calibrate.fit import SURE
from vocc_torch.extras.calibrate.model import Of, RecordingFit
from vocc_torch.extras.calibrate.reading import Footage
from vocc_torch.extras.calibrate.surround import SETTINGS, Falloff
from vocc_torch.extras.calibrate.transfer import TransferCurve
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.report.page import render

WORDS = yaml.safe_load((resources.files(__package__) / "sentences.yaml").read_text())


class Value(NamedTuple):
    """A value of the scene, as the recording tells it.

    Args:
        key: below ``scene``, such as ``effects.blooming.sigma_px``.
        low: the number, or the low end of its range over the recording.
        high: the number, or the high end.
        deviation: standard deviation of the number, or of the range's middle; NaN where it is taken from the
            configuration.
        note: what it explains, or where it is from.
    """

    key: str
    low: float
    high: float
    deviation: float = math.nan
    note: str = ""


class Named(NamedTuple):
    """An effect that was tried, and whether the recording asks for it.

    Args:
        effect: its name.
        gain: by how much the criterion favours the effect.
        threshold: the gain from which it is named.
    """

    effect: str
    gain: float
    threshold: float

    @property
    def asked(self) -> bool:
        """Whether it is in the scene."""
        return self.gain > self.threshold


@dataclass
class Findings:
    """A scene from a recording, while it is found and when it is, with all that its page shows.

    Args:
        camera: whose picture it is.
        panel: whose LEDs they are.
        config: what the recording cannot tell.
        footage: the frames.
        fit: the last fit.
        coded: the likeliest JPEG quality, and how sure it is.
        coarse: how many pixels of the camera are one of the fit's, along a side.
        fall: how light falls off towards the corners.
        curve: the photon transfer curve; None for too few frames.
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
    coded: tuple[int, float]
    coarse: int
    fall: Falloff = field(default_factory=Falloff)
    curve: TransferCurve | None = None
    bound: float | None = None
    values: list[Value] = field(default_factory=list)
    effects: list[Named] = field(default_factory=list)
    unknown: list[str] = field(default_factory=WORDS["always"].copy)
    doubts: list[str] = field(default_factory=list)

    @property
    def is_coded(self) -> bool:
        """Whether pictures are coded."""
        return self.coded[1] > SETTINGS.coded_sigmas

    @property
    def loose(self) -> bool:
        """Whether the recording tells gamma and blur no better than coding or their bounds let it."""
        return self.is_coded or self.bound is not None

    def text(self, name: str, source: str) -> str:
        """Write the scene as YAML, each value beside what it explains and how sure it is."""
        about = {"scene": self, "name": name, "source": source, "sure": SURE}
        words = WORDS["effects"]
        return render(__package__, "scene.yaml.j2", inline=inline, words=words, **about)

    def tried(self, effect: str, gain: float = 1.0, threshold: float = 0.0) -> bool:
        """Note an effect, and say whether the recording asks for it."""
        self.effects.append(Named(effect, gain, threshold))
        return self.effects[-1].asked

    def tell(
        self, key: str, value: float, deviation: float = math.nan, note: str = ""
    ) -> None:
        """Note a number."""
        note = note or WORDS["values"].get(key, "")
        self.note(Value(key, value, value, deviation, note))

    def derived(self, of: Of) -> tuple[Floats, Floats, float]:
        """Derive a value of every frame; coded ones err alike, as the panel lies in the blocks' grid."""
        values, deviations, common = self.fit.derived(of)
        alike = float(np.median(deviations)) * self.is_coded
        return values, deviations, math.hypot(common, alike)

    def over(self, key: str, of: Of, least: float = -math.inf) -> Value:
        """Note a value of every frame."""
        value = spread(key, self.derived(of), WORDS["values"][key], least)
        self.note(value)
        return value

    def note(self, value: Value) -> None:
        """Note a value; without an interval where it hangs on a gamma that the recording does not tell."""
        if self.loose and value.key in WORDS["by_gamma"]:
            note = f"{value.note}; no interval: gamma is not determined".removeprefix(
                "; "
            )
            value = value._replace(deviation=math.nan, note=note)
        self.values.append(value)

    def say(self, word: str, when: bool = True, **values: object) -> None:
        """Note a sentence of ``sentences.yaml``, where it is so: what is not told, or not explained."""
        for name, sentences in (("doubts", self.doubts), ("sentences", self.unknown)):
            if when and word in WORDS[name]:
                sentences.append(WORDS[name][word].format(**values))


def inline(value: float) -> str:
    """Write a number as YAML; seven digits are more than a recording tells.

    Example:
        >>> inline(1e-5 / 3), inline(8)
        ('3.333333e-06', '8')
    """
    text: str = yaml.safe_dump(float(f"{value:.7g}") if value % 1 else value)
    return text.split()[0]


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
    weights, freedom = 1 / deviation.clip(min=1e-12) ** 2, max(len(values) - 1, 1)
    middle = float(np.average(values, weights=weights))
    misfit = float((weights * (values - middle) ** 2).sum())
    low = high = middle
    error = math.sqrt(max(1.0, misfit / freedom) / float(weights.sum()))
    if misfit > stats.chi2.ppf(0.999, freedom):
        scatter = float(values.std(ddof=1))
        half = math.sqrt(3) * scatter  # a uniform range of that scatter
        low, high = float(values.mean()) - half, float(values.mean()) + half
        error = scatter / math.sqrt(len(values)) * stats.t.ppf(0.975, freedom) / SURE
        note = f"{note}, over the recording"
    return Value(
        key, max(low, least), max(high, least), math.hypot(error, common), note
    )
