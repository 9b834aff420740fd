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
from vocc_torch.rng import BLOCK_FRAMES, BlockKey


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
class PointJob:
    """Counts the errors of every receiver on blocks of one point, and compares every two of them.

    It can be pickled; a worker builds what it needs from it. Errors are labelled (locator, receiver, group),
    comparisons of two receivers (locator, a, b, group), and with the locators ``paper`` and ``truth`` each
    receiver is compared with itself: (receiver, group).

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

    @property
    def point(self) -> str:
        """The point's name, which keys its random draws."""
        return point_name(self.plan.experiment, self.value)

    def __call__(self, parts: Sequence[Part]) -> list[dict[Label, Tally]]:
        """Count each part by label."""
        return self.counted(parts, Link.of(self.plan))

    def counted(self, parts: Sequence[Part], link: Link) -> list[dict[Label, Tally]]:
        """Count each part by label on a link, whose own locator stands for the plan's."""
        # Blocks known already may be missing between others, but only a budget's last one is used in part.
        assert all(part.frames == BLOCK_FRAMES for part in parts[:-1]), parts
        plan, receivers = self.plan, Banks([(name, self.banks[name]) for name in self.locators])
        finders = plan.receiver.finders(self.locators)
        if plan.receiver.locator in finders:
            finders[plan.receiver.locator] = link.locator
        errors = count_errors(
            link,
            finders,
            plan.experiment.model_at(plan.world, self.value),
            [BlockKey(plan.seed, self.point, part.block) for part in parts],
            receivers,
            preambles=receivers.needs_preambles,
            frames=sum(part.frames for part in parts),
            sorter=partial(group_of, plan.experiment),
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
            first = {locator: place * len(names) for place, locator in enumerate(self.locators)}
            for locator, start in first.items():
                own = here.of(slice(start, start + len(names)))
                counts |= {(locator, name, group): one for name, one in zip(names, own.counts, strict=True)}
                counts |= {(locator, names[a], names[b], group): pair for (a, b), pair in own.pairs.items()}
            if "paper" in first and "truth" in first:
                for row, name in enumerate(names):
                    two = here.of([first["paper"] + row, first["truth"] + row])
                    counts[name, group] = two.pairs[0, 1]
        return counts


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
