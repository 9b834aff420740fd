"""The receivers by name, all deciding on the same readings."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.features import FEATURE_NAMES, greyscale_scores, preamble_threshold
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.reader import Greys, Readings
from vocc_torch.types import PanelShape

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


def check_receivers(names: Sequence[str], plugged_in: Sequence[str] = ()) -> tuple[str, ...]:
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
            raise VoccError(f"receiver.names has {name!r}: known receivers are {', '.join(known)}")
    if not names or len(set(names)) != len(names):
        raise VoccError(f"receiver.names is {list(names)}: it must hold at least one name, each once")
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


class Preambles(NamedTuple):
    """Grey levels of the all-On and the all-Off frame of the same scenes."""

    on: Greys
    off: Greys


class ReceiverBank:
    """Named receivers that share one pass of location and measurement.

    Args:
        names: receivers to run, in the order of the results.
        flda: fitted on all three features; the receivers on fewer features follow from the same statistics.
        plugged_in: trained classifiers by name.
        more: those of them that learn, from each further training.

    Raises:
        VoccError: an unknown name.
    """

    def __init__(
        self,
        names: Sequence[str],
        flda: FLDA,
        plugged_in: Mapping[str, Guarded] | None = None,
        more: "Sequence[ReceiverBank]" = (),
    ) -> None:
        demand_kind("flda", flda, FLDA)
        self.plugged_in, self.more = dict(plugged_in or {}), tuple(more)
        self.names = check_receivers(names, tuple(self.plugged_in))
        chosen = [name for name in self.names if name in FLDA_FEATURES]
        self.classifiers = {name: flda.select(feature_indices(name)) for name in chosen}

    @property
    def needed(self) -> frozenset[str]:
        """What is measured for them: some of ``agr``, ``gri``, ``ngr``, ``average``, ``centre``."""
        read = {**FLDA_FEATURES, **{name: (level,) for name, level in GREYSCALE_RECEIVERS.items()}}
        parts = (read.get(name) or self.plugged_in[name].inputs.features for name in self.names)
        return frozenset(what for part in parts for what in part)

    @property
    def needs_patches(self) -> bool:
        """Whether any receiver reads the whole panel, and not single pixels."""
        return any(name != "center_greyscale" for name in self.names)

    def scores(self, readings: Readings, preambles: Preambles | None) -> dict[str, Tensor]:
        """Score every LED with every receiver: name to (B,R,C) float64, at least 0 is On.

        Raises:
            VoccError: a greyscale receiver without preambles.
        """
        found: dict[str, Tensor] = {}
        shape = PanelShape(*readings.features.shape[1:3])
        for name in self.names:
            if name in FLDA_FEATURES:
                features = readings.features[..., feature_indices(name)]
                found[name] = self.classifiers[name].decision_function(features)
            elif name in self.plugged_in:
                classifier = self.plugged_in[name]
                seen = classifier.inputs.of(readings, readings.cell_px, shape)
                found[name] = classifier.decision_function(seen)
            elif preambles is None:
                raise VoccError(f"receiver {name} needs preamble frames, and none were given")
            else:
                takes = (preambles.on, preambles.off, readings.greys)
                on, off, greys = (getattr(take, GREYSCALE_RECEIVERS[name]) for take in takes)
                found[name] = greyscale_scores(greys, preamble_threshold(on, off))
        return found
