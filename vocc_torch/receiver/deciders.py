"""What decides bits from readings: Fisher's discriminant, the greyscale baselines, and classifiers."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind, demand_word
from vocc_torch.receiver.classifiers import plugged
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.features import (
    FEATURE_NAMES,
    greyscale_scores,
    preamble_threshold,
)
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


RECEIVER_NAMES = (*GREYSCALE_RECEIVERS, *FLDA_FEATURES)
"""Every receiver that can be named."""


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
        demand_word("receiver name", self.name, (*FLDA_FEATURES,))
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


Bank = Mapping[str, Decider]
"""Receivers by name, in the order of the results, that decide on the same readings."""


def bank_of(
    names: Sequence[str], flda: FLDA, plugged_in: Mapping[str, Guarded] | None = None
) -> Bank:
    """Give named receivers, ready to decide.

    Args:
        names: of the receivers.
        flda: fitted on all three features; the receivers on fewer features follow from the same statistics.
        plugged_in: trained classifiers by name.

    Raises:
        VoccError: an unknown name.
    """
    demand_kind("flda", flda, FLDA)
    bank: dict[str, Decider] = {}
    learned = plugged_in or {}
    for name in check_receivers(names, (*learned,)):
        if name in FLDA_FEATURES:
            bank[name] = FldaDecider(name, flda.select(feature_indices(name)))
        else:
            bank[name] = learned.get(name) or GreyDecider(name)
    return bank


def check_receivers(
    names: Sequence[str], plugged_in: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the names, or refuse the first unknown or repeated one.

    Args:
        names: receivers.
        plugged_in: names of classifiers that are known too.

    Raises:
        VoccError: no name, an unknown name or a repeated one.

    Example:
        >>> check_receivers(["flda_3", "average_greyscale"])
        ('flda_3', 'average_greyscale')
    """
    known = (*RECEIVER_NAMES, *plugged_in)
    for name in names:
        if name not in known:
            raise VoccError(
                f"receiver.names has {name!r}: known receivers are {', '.join(known)}"
            )
    if not names or len(set(names)) != len(names):
        raise VoccError(
            f"receiver.names is {list(names)}: it must hold at least one name, each once"
        )
    return tuple(names)


def needs_preambles(names: Sequence[str]) -> bool:
    """Whether any of the named receivers needs preamble frames.

    Example:
        >>> needs_preambles(["flda_3"])
        False
    """
    return any(name in GREYSCALE_RECEIVERS for name in names)


def feature_indices(name: str) -> list[int]:
    """Columns of the readings' features that an FLDA receiver uses.

    Example:
        >>> feature_indices("flda_2")
        [0, 1]
    """
    return [FEATURE_NAMES.index(feature) for feature in FLDA_FEATURES[name]]


def decider_of(name: str, classifier: FLDA | Guarded) -> FldaDecider | Guarded:
    """Return the classifier of a saved receiver: by its name, or FLDA on named features.

    Raises:
        VoccError: neither, a name that is not the classifier's, or another number of features.
    """
    demand_kind("classifier", classifier, torch.nn.Module, Guarded)
    if isinstance(classifier, torch.nn.Module):
        return FldaDecider(name, classifier)
    if name != classifier.name:
        raise VoccError.of(
            "receiver name", repr(name), f"its classifier's, {classifier.name!r}"
        )
    return classifier


def model_of(
    decider: FldaDecider | Guarded,
) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Take what a model file keeps of a classifier, settings and arrays; FLDA has no settings.

    Raises:
        VoccError: as :func:`plugged.model_of`.
    """
    if isinstance(decider, FldaDecider):
        return {}, decider.classifier.state_dict()
    return plugged.model_of(decider)


def classifier_from(
    name: str,
    settings: Mapping[str, Any] | None,
    arrays: Mapping[str, Tensor],
    plug_ins: Sequence[str] = (),
) -> FLDA | Guarded:
    """Build the classifier from what :func:`model_of` gave.

    Raises:
        VoccError: statistics that are not finite, or as :func:`plugged.loaded`.
    """
    if settings:
        return plugged.loaded(settings, arrays, plug_ins)
    flda = FLDA(n_features=len(FLDA_FEATURES[name]))
    flda.load_state_dict(arrays)
    if not bool(flda.direction.isfinite().all()):
        raise VoccError("its statistics are not finite")
    return flda
