"""From located panels to what every classifier decides on: grey levels and features of each LED."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, get_args

import torch
from torch import Tensor

from vocc_torch.errors import (
    VoccError,
    demand_kind,
    demand_within,
    demand_word,
    whole_number,
)
from vocc_torch.plugins import PlugIn, blamed
from vocc_torch.receiver.features import (
    FEATURE_NAMES,
    Gradient,
    checked_greys,
    led_measures,
)
from vocc_torch.receiver.pixel_cells import read_pixels
from vocc_torch.receiver.resample import cell_size_px, centre_greys, rectify
from vocc_torch.types import (
    Frames,
    Panels,
    PanelShape,
    finite_tensor,
    without_autocast,
)

GREYS = ("average", "centre")
"""Grey levels of an LED."""

# An eighth of a gigabyte in float32, and a whole one while they are measured.
_MOST_SAMPLES = 1 << 25


class Greys(NamedTuple):
    """Grey levels of each LED, (B,R,C) both, in digital numbers: its cell's mean and its centre pixel."""

    average: Tensor
    centre: Tensor


class Readings(NamedTuple):
    """What the receiver measures of each LED.

    Args:
        features: (B,R,C,N) float64: AGR, GRI and NGR, then those from outside.
        greys: grey levels of each LED.
        patches: (B,1,(R+2)K,(C+2)K) the rectified panels.
        cell_px: (B,2) mean width and height of a cell in the image, px.
        names: of the N features.
    """

    features: Tensor
    greys: Greys
    patches: Tensor
    cell_px: Tensor
    names: tuple[str, ...] = FEATURE_NAMES


@dataclass(frozen=True, slots=True)
class Reader:
    """Rectify located panels and measure their LEDs.

    An autocast around it is switched off: convolutions of half precision would turn bits.

    Args:
        shape: rows and columns of the panel.
        samples_per_led: K, samples along an LED cell's side, 2 to 64; a rectified panel has at most 2^25.
        gradient: ``sobel`` (Kornia) or ``central`` (Eq. 6).
        more: features from outside, functions of the rectified panels (B,1,(R+2)K,(C+2)K) and the panel's
            shape that give (B,R,C).
        disc_share: an LED's diameter over the pitch, above 0 to 1, to measure whole pixels of the box about
            the discs; None measures the resampled cells.

    Raises:
        VoccError: a value outside its range, or a feature's name twice.

    Example:
        >>> frames = Frames.whole(torch.full((1, 1, 40, 40), 50, dtype=torch.uint8))
        >>> corners = torch.tensor([[[8.0, 8.0], [32.0, 8.0], [32.0, 32.0], [8.0, 32.0]]])
        >>> Reader(PanelShape(4, 4)).read(frames, Panels.known(corners)).features[0, 0, 0].tolist()
        [1.0, 0.0, 1.0]
    """

    shape: PanelShape = field(default_factory=PanelShape)
    samples_per_led: int = 8
    gradient: Gradient = "sobel"
    more: tuple[PlugIn, ...] = ()
    disc_share: float | None = None

    def __post_init__(self) -> None:
        """Check every range."""
        demand_kind("shape", self.shape, PanelShape)
        whole_number("receiver.samples_per_led", self.samples_per_led, 2, 64)
        samples = (
            (self.shape.rows + 2) * (self.shape.columns + 2) * self.samples_per_led**2
        )
        if samples > _MOST_SAMPLES:
            panel = f"a panel of {self.shape.rows} x {self.shape.columns} LEDs would have {samples} samples"
            refusal = f"receiver.samples_per_led is {self.samples_per_led}"
            raise VoccError(f"{refusal}: {panel}, at most 2^25 are allowed")
        demand_word("receiver.gradient", self.gradient, get_args(Gradient))
        demand_within("disc_share", self.disc_share, 0, 1, above=True, null=True)
        if len({*self.names, *GREYS}) < len(self.names) + len(GREYS):
            raise VoccError.of(
                "receiver.features", [*self.names], f"each once, and none of {GREYS}"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """The features that it measures, in their order."""
        return *FEATURE_NAMES, *(plug_in.name for plug_in in self.more)

    def read(
        self, frames: Frames, panels: Panels, needed: Collection[str] | None = None
    ) -> Readings:
        """Measure every LED of B frames with located panels; one not found reads finite, without meaning.

        Args:
            frames: B frames.
            panels: where the panel is in each.
            needed: see :meth:`measure`; for the centres alone no panel is resampled.

        Raises:
            VoccError: frames that do not fit the panels, corners that are not finite, or at a panel in
                floating frames what is no grey value, NaN or negative.
        """
        patches = None
        if self.is_rectified(needed):
            (patches,) = self.rectify([frames], panels)
        return self.measure(frames, panels, patches, needed)

    def is_rectified(self, needed: Collection[str] | None) -> bool:
        """Whether panels are resampled for what is needed: for all but the centres alone."""
        return needed is None or {*needed} != {"centre"}

    def rectify(self, takes: Sequence[Frames], panels: Panels) -> list[Tensor]:
        """Resample the panel in each take, as :func:`vocc_torch.receiver.resample.rectify` does.

        Raises:
            VoccError: what :meth:`read` refuses.
        """
        for take in takes:
            demand_kind("frames", take, Frames)
        demand_kind("panels", panels, Panels)
        with without_autocast(takes[0].grey.device):
            patches = [
                rectify(take, panels, self.shape, self.samples_per_led)
                for take in takes
            ]
        for take, patch in zip(takes, patches, strict=True):
            # Bytes cannot be anything else than grey values.
            if take.grey.is_floating_point():
                checked_greys(patch, "frames.grey at a panel")
        return patches

    def measure(
        self,
        frames: Frames,
        panels: Panels,
        patches: Tensor | None,
        needed: Collection[str] | None = None,
    ) -> Readings:
        """Measure located panels; values that are not needed are zero.

        Args:
            frames: B frames.
            panels: where the panel is in each.
            patches: what :meth:`rectify` gave of the frames; None will do where ``centre`` alone is needed.
            needed: some of the features and of ``GREYS``; None for all.

        Raises:
            VoccError: what :meth:`read` refuses, or a feature from outside that fails.
        """
        names = {*self.names, *GREYS} if needed is None else {*needed}
        shape, sizes = self.shape, cell_size_px(panels.corners_px, self.shape)
        measures: dict[str, Tensor] = {}
        with without_autocast(frames.grey.device):
            if self.disc_share is not None:
                measures = read_pixels(
                    frames, panels.corners_px, shape, self.disc_share, self.gradient
                )
            else:
                if "centre" in names:
                    measures["centre"] = centre_greys(frames, panels, shape)
                if patches is not None:
                    measures |= led_measures(
                        patches, shape, *sizes, self.gradient, names - {"centre"}
                    )
            patches = frames.grey[..., :0, :0] if patches is None else patches
            for plug_in in self.more:
                if plug_in.name in names:
                    measures[plug_in.name] = self._outside(plug_in, patches)
        none = sizes[0].new_zeros(frames.grey.shape[0], shape.rows, shape.columns)
        columns = [
            measures[name] if name in names & measures.keys() else none
            for name in (*self.names, *GREYS)
        ]
        features = torch.stack(columns[: -len(GREYS)], dim=-1).double()
        greys = Greys(*columns[-len(GREYS) :])
        return Readings(
            features, greys, patches, torch.stack(sizes, dim=-1), self.names
        )

    def _outside(self, feature: PlugIn, patches: Tensor) -> Tensor:
        """Measure a feature from outside, (B,R,C) float64."""
        with blamed(f"feature {feature.name}"):
            values = feature.made(patches, self.shape)
        size = (patches.shape[0], self.shape.rows, self.shape.columns)
        return finite_tensor(f"feature {feature.name} gave", values, size).double()
