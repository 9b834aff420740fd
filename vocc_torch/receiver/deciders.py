"""What decides bits from readings: Fisher's discriminant, the greyscale baselines, and classifiers."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, Self

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind
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


class Decider(Protocol):
    """Scores LEDs from readings; :class:`~vocc_torch.receiver.classifiers.Guarded` classifiers are such."""

    @property
    def features(self) -> tuple[str, ...]:
        """Measurements that it needs: features, ``average`` or ``centre``."""

    @property
    def needs_patches(self) -> bool:
        """Whether it reads the whole panel, and not single pixels."""

    def score(self, readings: Readings, preambles: Preambles | None = None) -> Tensor:
        """Score every LED, (B,R,C) float64; at least 0 is On (Eq. 18)."""

    def to(self, device: torch.device) -> Self:
        """Copy it to a device."""


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

    needs_patches = True

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
        features, columns = (
            readings.features,
            [readings.names.index(name) for name in self.features],
        )
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

    @property
    def needs_patches(self) -> bool:
        """Whether it reads the whole panel."""
        return self.features != ("centre",)

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


def flda_decider(name: str, state: Mapping[str, Tensor]) -> FldaDecider:
    """Build FLDA from what :meth:`FldaDecider.model` gave.

    Raises:
        VoccError: statistics that are not finite.
    """
    flda = FLDA(n_features=len(FLDA_FEATURES[name]))
    flda.load_state_dict(state)
    if not bool(flda.direction.isfinite().all()):
        raise VoccError("its statistics are not finite")
    return FldaDecider(name, flda)
