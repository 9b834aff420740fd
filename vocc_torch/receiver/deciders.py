"""What decides bits from readings: Fisher's discriminant, the greyscale baselines, and classifiers."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind
from vocc_torch.receiver.classifiers import plugged
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.features import greyscale_scores, preamble_threshold
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.reader import Greys, Readings

FLDA_FEATURES: dict[str, tuple[str, ...]] = {
    "flda_agr": ("agr",),
    "flda_gri": ("gri",),
    "flda_ngr": ("ngr",),
    "flda_agr_ngr": ("agr", "ngr"),
    "flda_2": ("agr", "gri"),
    "flda_3": ("agr", "gri", "ngr"),
}
"""Features of each FLDA receiver."""

GREYSCALE_RECEIVERS = {"center_greyscale": "centre", "average_greyscale": "average"}
"""The paper's baselines, which need preambles."""


class Preambles(NamedTuple):
    """Grey levels of the all-On and the all-Off frame of the same scenes."""

    on: Greys
    off: Greys


@dataclass(frozen=True)
class FldaDecider:
    """Fisher's discriminant on some of the features.

    Args:
        name: of an FLDA receiver.
        classifier: fitted on these features.

    Raises:
        VoccError: an unknown name, or another number of features.
    """

    name: str
    classifier: FLDA

    def __post_init__(self) -> None:
        """Check the name and the number of features."""
        if self.name not in tuple(FLDA_FEATURES):
            raise VoccError.of(
                "receiver name", repr(self.name), f"one of {', '.join(FLDA_FEATURES)}"
            )
        if self.classifier.n_features != len(self.features):
            count = self.classifier.n_features
            raise VoccError(
                f"classifier has {count} features: {self.name} needs {len(self.features)}"
            )

    @property
    def features(self) -> tuple[str, ...]:
        """Measurements that it needs."""
        return FLDA_FEATURES[self.name]

    def score(self, readings: Readings, preambles: Preambles | None = None) -> Tensor:
        """Score every LED."""
        features = readings.features
        columns = [readings.names.index(name) for name in self.features]
        if columns != list(range(features.shape[-1])):
            features = features[..., columns]
        if features.device.type == "cpu":
            return self.classifier.decision_function(features.double())
        # A look at every score would make the host wait for the accelerator.
        return self.classifier.unchecked_scores(features)

    def to(self, device: torch.device) -> "FldaDecider":
        """Copy it to a device."""
        return FldaDecider(self.name, copy.deepcopy(self.classifier).to(device))

    def model(self) -> tuple[dict[str, Any], dict[str, Tensor]]:
        """What a model file keeps of it: settings and arrays."""
        return {}, self.classifier.state_dict()


@dataclass(frozen=True)
class GreyDecider:
    """A grey level, compared with the middle between two preambles.

    Args:
        name: of a greyscale receiver.
    """

    name: str

    @property
    def features(self) -> tuple[str, ...]:
        """Measurements that it needs."""
        return (GREYSCALE_RECEIVERS[self.name],)

    def score(self, readings: Readings, preambles: Preambles | None = None) -> Tensor:
        """Score every LED.

        Raises:
            VoccError: there are no preambles.
        """
        if preambles is None:
            raise VoccError(
                f"receiver {self.name} needs preamble frames, and none were given"
            )
        (level,) = self.features
        takes = preambles.on, preambles.off, readings.greys
        on, off, greys = (getattr(take, level) for take in takes)
        return greyscale_scores(greys, preamble_threshold(on, off))

    def to(self, device: torch.device) -> "GreyDecider":
        """Give itself: it holds nothing."""
        return self


Decider = FldaDecider | GreyDecider | Guarded
"""What scores LEDs from readings."""


def decider_of(
    name: str, classifier: FLDA | FldaDecider | Guarded
) -> FldaDecider | Guarded:
    """Return the classifier of a saved receiver: by its name, or FLDA on named features.

    Raises:
        VoccError: neither, a name that is not the classifier's, or another number of features.
    """
    demand_kind("classifier", classifier, torch.nn.Module, Guarded, FldaDecider)
    if isinstance(classifier, torch.nn.Module):
        return FldaDecider(name, classifier)
    if name != classifier.name:
        raise VoccError.of(
            "receiver name", repr(name), f"its classifier's, {classifier.name!r}"
        )
    return classifier


def decider_from(
    name: str,
    settings: Mapping[str, Any] | None,
    arrays: Mapping[str, Tensor],
    plug_ins: Sequence[str] = (),
) -> FldaDecider | Guarded:
    """Build what decides from what its ``model`` gave; FLDA has no settings.

    Raises:
        VoccError: statistics that are not finite, or as :func:`plugged.loaded`.
    """
    if settings:
        return plugged.loaded(settings, arrays, plug_ins)
    flda = FLDA(n_features=len(FLDA_FEATURES[name]))
    flda.load_state_dict(arrays)
    if not bool(flda.direction.isfinite().all()):
        raise VoccError("its statistics are not finite")
    return FldaDecider(name, flda)
