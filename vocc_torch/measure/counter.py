"""Count the errors of one point's blocks: every receiver on the same frames, with one or more locators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from vocc_torch.measure.frame_errors import Banks, FrameErrors, count_errors
from vocc_torch.measure.link import Link, Observation
from vocc_torch.measure.montecarlo import Label, Part, Tally
from vocc_torch.measure.plan import Experiment, Locator, Plan
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel


def group_of(experiment: Experiment, link: Link, seen: Observation) -> Tensor:
    """The group that each frame counts in, (B,) int64: its contrast bin, -1 outside all bins; else 0.

    A contrast on an edge between two bins belongs to the upper one; the last bin holds its upper edge too.
    """
    if experiment.axis != "contrast":
        return torch.zeros(len(seen.bits), dtype=torch.int64, device=seen.bits.device)
    contrast = link.simulator.contrast(seen.scene)
    edges = torch.tensor(experiment.values, dtype=contrast.dtype, device=contrast.device)
    groups = torch.bucketize(contrast, edges, right=True) - 1
    groups = torch.where(contrast == edges[-1], experiment.bins - 1, groups)
    return torch.where(groups < experiment.bins, groups, -1)


@dataclass(frozen=True)
class PointCounter:
    """Counts the errors of every receiver on blocks of one point, and compares every two of them.

    Errors are labelled (locator, receiver, group), comparisons of two receivers (locator, a, b, group), and
    with the locators ``paper`` and ``truth`` each receiver is compared with itself: (receiver, group).

    Args:
        plan: the study.
        link: simulation and front end.
        finders: the locators by name, None for true corners.
        banks: the receivers, trained with each of the locators.
        point: the point's name, which keys its random draws.
        model: the point's scenes.
    """

    plan: Plan
    link: Link
    finders: Mapping[str, PanelLocator | None]
    banks: Mapping[str, ReceiverBank]
    point: str
    model: SceneModel

    def __call__(self, parts: Sequence[Part]) -> list[dict[Label, Tally]]:
        """Count each part by label."""
        # Blocks known already may be missing between others, but only a budget's last one is used in part.
        assert all(part.frames == BLOCK_FRAMES for part in parts[:-1]), parts
        receivers = Banks([(name, self.banks[name]) for name in self.finders])
        errors = count_errors(
            self.link,
            self.finders,
            self.model,
            [BlockKey(self.plan.seed, self.point, part.block) for part in parts],
            receivers,
            preambles=receivers.needs_preambles,
            frames=sum(part.frames for part in parts),
            sorter=partial(group_of, self.plan.experiment),
        )
        starts = range(0, len(parts) * BLOCK_FRAMES, BLOCK_FRAMES)
        return [self._count(errors.of(frames=slice(start, start + BLOCK_FRAMES))) for start in starts]

    def _count(self, errors: FrameErrors) -> dict[Label, Tally]:
        """Count one block by label."""
        counts: dict[Label, Tally] = {}
        names, groups = self.plan.receiver.names, errors.groups
        assert groups is not None
        for group in np.unique(groups[groups >= 0]).tolist():
            here = errors.of(frames=groups == group)
            rows = {
                locator: range(start, start + len(names))
                for locator, start in zip(self.finders, range(0, len(here.found), len(names)), strict=True)
            }
            for locator, places in rows.items():
                own = here.of(slice(places.start, places.stop))
                counts |= {(locator, name, group): one for name, one in zip(names, own.counts, strict=True)}
                counts |= {(locator, names[a], names[b], group): pair for (a, b), pair in own.pairs.items()}
            if {"paper", "truth"} <= set(rows):
                for name, *two in zip(names, rows["paper"], rows["truth"], strict=True):
                    counts[name, group] = here.of(two).pairs[0, 1]
        return counts


@dataclass(frozen=True)
class PointJob:
    """A point as it is sent to a worker, which builds what it needs from it.

    Args:
        plan: the study.
        locators: names of the locators.
        banks: the receivers, trained with each of the locators.
        value: the axis value; without meaning for ``contrast``.
    """

    plan: Plan
    locators: tuple[Locator, ...]
    banks: Mapping[str, ReceiverBank]
    value: float

    def __call__(self, parts: Sequence[Part]) -> list[dict[Label, Tally]]:
        """Count each part by label."""
        return self.counter(Link.of(self.plan))(parts)

    @property
    def point(self) -> str:
        """The point's name, which keys its random draws."""
        return point_name(self.plan.experiment, self.value)

    def counter(self, link: Link) -> PointCounter:
        """Build what counts, on a link."""
        return PointCounter(
            self.plan,
            link,
            self.plan.receiver.finders(self.locators),
            self.banks,
            self.point,
            self.plan.experiment.model_at(self.plan.world, self.value),
        )


def point_name(experiment: Experiment, value: float) -> str:
    """Name a point; the name keys its random draws.

    Example:
        >>> point_name(Experiment("near", "distance_m", (5.0,)), 5.0)
        'near/distance_m=5'
    """
    if experiment.axis == "contrast":
        return experiment.name
    # Six digits may stand for two values, which would then share their draws.
    digits = f"{value:g}" if float(f"{value:g}") == value else repr(value)
    return f"{experiment.name}/{experiment.axis}={digits}"
