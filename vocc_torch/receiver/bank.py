"""The receivers by name, all deciding on the same readings."""

from collections.abc import Mapping, Sequence
from typing import Self

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.deciders import FLDA_FEATURES as FLDA_FEATURES
from vocc_torch.receiver.deciders import GREYSCALE_RECEIVERS as GREYSCALE_RECEIVERS
from vocc_torch.receiver.deciders import Decider, FldaDecider, GreyDecider
from vocc_torch.receiver.deciders import Preambles as Preambles
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.reader import Readings

RECEIVER_NAMES = (*GREYSCALE_RECEIVERS, *FLDA_FEATURES)
"""Every receiver that can be named."""


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


class ReceiverBank:
    """Named receivers that share one pass of location and measurement.

    Args:
        names: receivers to run, in the order of the results.
        flda: fitted on all three features; the receivers on fewer features follow from the same statistics.
        plugged_in: trained classifiers by name.

    Raises:
        VoccError: an unknown name.
    """

    deciders: dict[str, Decider]

    def __init__(
        self,
        names: Sequence[str],
        flda: FLDA,
        plugged_in: Mapping[str, Guarded] | None = None,
    ) -> None:
        demand_kind("flda", flda, FLDA)
        plugged_in, self.deciders = plugged_in or {}, {}
        for name in check_receivers(names, tuple(plugged_in)):
            if name in FLDA_FEATURES:
                self.deciders[name] = FldaDecider(
                    name, flda.select(feature_indices(name))
                )
            else:
                self.deciders[name] = (
                    plugged_in[name] if name in plugged_in else GreyDecider(name)
                )

    @classmethod
    def of(cls, deciders: Mapping[str, Decider]) -> Self:
        """Put what decides together, by name."""
        bank = cls.__new__(cls)
        bank.deciders = dict(deciders)
        return bank

    @property
    def names(self) -> tuple[str, ...]:
        """The receivers, in the order of the results."""
        return tuple(self.deciders)

    @property
    def needed(self) -> frozenset[str]:
        """Measurements that they need: some of ``agr``, ``gri``, ``ngr``, ``average``, ``centre``."""
        return frozenset(
            name for decider in self.deciders.values() for name in decider.features
        )

    @property
    def needs_patches(self) -> bool:
        """Whether any receiver reads the whole panel, and not single pixels."""
        return any(d.features != ("centre",) for d in self.deciders.values())

    def to(self, device: torch.device) -> Self:
        """Copy them to a device."""
        return self.of(
            {name: decider.to(device) for name, decider in self.deciders.items()}
        )

    def scores(
        self, readings: Readings, preambles: Preambles | None
    ) -> dict[str, Tensor]:
        """Score every LED with every receiver: name to (B,R,C) float64, at least 0 is On.

        Raises:
            VoccError: a greyscale receiver without preambles.
        """
        return {
            name: decider.score(readings, preambles)
            for name, decider in self.deciders.items()
        }
