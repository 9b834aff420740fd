"""A receiver cut into its stages, so that each can be timed and none does more than the receiver needs."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from vocc_torch.receiver.bank import FLDA_FEATURES, GREYSCALE_RECEIVERS
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.features import (
    FEATURE_NAMES,
    average_greyscale_ratio,
    cell_means,
    gradient_radial_inwardness,
    greyscale_scores,
    neighbour_greyscale_ratio,
    preamble_threshold,
)
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.reader import Greys, Reader, Readings
from vocc_torch.receiver.rectification import cell_size_px, centre_greys, rectify
from vocc_torch.studies.tradeoff.plan import DTYPES
from vocc_torch.studies.tradeoff.price_list import Setting
from vocc_torch.types import Frames, Panels


@dataclass(frozen=True)
class Chain:
    """One configuration of the receiver, stage by stage.

    The decisions are those of :class:`vocc_torch.receiver.bank.ReceiverBank`, whose receivers share their
    measurements; here each measures what it needs and no more.

    Args:
        setting: what it is.
        locator: what finds the panel, or None for the simulator's corners.
        reader: panel shape, K and gradient.
        decider: FLDA on the receiver's own features, a classifier that plugs in, or None for a threshold.
    """

    setting: Setting
    locator: PanelLocator | None
    reader: Reader
    decider: FLDA | Guarded | None

    @property
    def rectifies(self) -> bool:
        """Whether it reads the whole panel, and not single pixels."""
        return self.setting.receiver != "center_greyscale"

    @property
    def needs_preambles(self) -> bool:
        """Whether it needs frames of known bits."""
        return self.setting.receiver in GREYSCALE_RECEIVERS

    def rectify(self, frames: Frames, panels: Panels) -> Tensor | None:
        """Resample located panels, (B,1,(R+2)K,(C+2)K)."""
        if not self.rectifies:
            return None
        reader, dtype = self.reader, DTYPES[self.setting.dtype]
        return rectify(frames, panels, reader.shape, reader.samples_per_led, dtype)

    def features(self, frames: Frames, panels: Panels, patches: Tensor | None) -> Tensor:
        """Measure what the receiver decides on: (B,R,C) grey values or (B,R,C,F)."""
        name, shape = self.setting.receiver, self.reader.shape
        if patches is None:
            return centre_greys(frames, panels, shape)
        if self.decider is None:
            return cell_means(patches, shape)[:, 1:-1, 1:-1]
        if isinstance(self.decider, FLDA):
            measured, _ = self._measured(panels, patches, FLDA_FEATURES[name])
            return torch.stack(measured, dim=-1).to(torch.float64)
        inputs = self.decider.inputs
        measured, cell_px = self._measured(panels, patches, inputs.features)
        # The others are not looked at.
        blank = patches.new_zeros(len(patches), shape.rows, shape.columns)
        known = dict(zip(inputs.features, measured, strict=True))
        features = torch.stack([known.get(one, blank) for one in FEATURE_NAMES], dim=-1)
        readings = Readings(features.to(torch.float64), Greys(blank, blank), patches, cell_px)
        return inputs.of(readings, cell_px, shape)

    def _measured(self, panels: Panels, patches: Tensor, names: Sequence[str]) -> tuple[list[Tensor], Tensor]:
        """Measure some of the paper's features, (B,R,C) each, and the cells' size (B,2), px."""
        shape = self.reader.shape
        width, height = cell_size_px(panels.corners_px, shape)
        means = cell_means(patches, shape) if {"agr", "ngr"} & {*names} else None
        measured = []
        for name in names:
            if name == "gri":
                gradient = self.reader.gradient
                measured.append(gradient_radial_inwardness(patches, shape, width, height, gradient))
            else:
                assert means is not None
                ratio = average_greyscale_ratio if name == "agr" else neighbour_greyscale_ratio
                measured.append(ratio(means))
        return measured, torch.stack([width, height], dim=-1)

    def threshold(self, preambles: Sequence[Frames], panels: Panels) -> Tensor | None:
        """Learn the threshold (B,1,1) from the all-On and the all-Off frame; None for other receivers."""
        if not self.needs_preambles:
            return None
        on, off = (self.features(take, panels, self.rectify(take, panels)) for take in preambles)
        return preamble_threshold(on, off)

    def classify(self, measured: Tensor, threshold: Tensor | None) -> Tensor:
        """Decide, (B,R,C) bool, True = On."""
        if threshold is not None:
            return greyscale_scores(measured, threshold) >= 0
        assert self.decider is not None
        return self.decider.decision_function(measured) >= 0

    def decide(self, frames: Frames, panels: Panels, threshold: Tensor | None) -> Tensor:
        """Do all that comes after panel detection."""
        return self.classify(self.features(frames, panels, self.rectify(frames, panels)), threshold)

    def to(self, device: torch.device) -> Chain:
        """Give the receiver on another device."""
        if isinstance(self.decider, FLDA):
            return replace(self, decider=self.decider.select(range(self.decider.n_features)).to(device))
        return replace(self, decider=None if self.decider is None else _moved(self.decider, device))


def _moved(guarded: Guarded, device: torch.device) -> Guarded:
    """Give a copy of a classifier whose tensors, wherever it holds them, are on a device."""
    packed = io.BytesIO()
    torch.save(guarded.classifier, packed)
    packed.seek(0)
    # Packed two lines above, so there is nothing in it that was not here.
    classifier = torch.load(packed, map_location=device, weights_only=False)
    return Guarded(guarded.name, classifier, guarded.inputs, guarded.home)
