"""Rows exposed one after the other, while the panel goes on to its next symbol."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.geometry import led_centres_m
from vocc_torch.simulation.view import view_of

MOST_SYMBOLS = 1001
"""Most symbols that a panel may show during its readout."""

LONGEST_S = 1e6
"""Longest time on offer, s."""


@dataclass(frozen=True, slots=True)
class RollingShutter(Effect):
    """Row i of the sensor is exposed over ``[t_i, t_i + T]``, ``t_i = i readout_s / (height - 1)``.

    The panel shows symbol after symbol, each for ``symbol_s``. The symbol that was sent with the frame, the
    truth, is the one that shows in the middle of the exposure of the row that the panel's centre lies in (or
    of the sensor's row nearest to it). Camera and panel are not synchronised: that moment is uniform over
    the truth's ``symbol_s``. The symbols before and after it are data, each LED On or Off with equal chance.
    A row receives each symbol's light for the share of T during which that symbol shows.

    Each picture has a phase and neighbours of its own, a preamble too: it stands amid data, and what it
    mixes with is not known to the receiver. Symbols are drawn outwards from the truth, so the nearer ones do
    not depend on how many there are. Those that show during the readout of the panel and of a cell around it
    are drawn; farther rows, where the panel is not, keep the first or the last of them. The rest of the scene
    does not change with time, and nothing is taken to move. Sampled: not differentiable in the timing.

    Source: C.-K. Liang, L.-W. Chang and H. H. Chen, "Analysis and compensation of rolling shutter effect",
    IEEE Trans. Image Process. 17(8), 2008; C. Danakis et al., "Using a CMOS camera sensor for visible light
    communication", IEEE Globecom Workshops, 2012.

    Args:
        readout_s: from the start of the first row's exposure to that of the last row's, s, above 0 and at
            most 1e6; most cameras take 5 to 30 ms.
        symbol_s: how long the panel shows a symbol, s, at least the camera's exposure time and at most 1e6.

    Raises:
        VoccError: a value outside its range; when called, a symbol shorter than the exposure, or more than
            1001 symbols.

    Example:
        >>> RollingShutter(readout_s=0.016, symbol_s=1 / 30).readout_s
        0.016
    """

    readout_s: float
    symbol_s: float

    name: ClassVar[str] = "rolling_shutter"
    takes: ClassVar[Quantity] = Quantity.SYMBOLS
    gives: ClassVar[Quantity] = Quantity.SYMBOLS
    sampled: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the ranges that do not need the camera."""
        self.demand("readout_s", 0, LONGEST_S, above=True, hint="leave the effect out for a global shutter")
        self.demand("symbol_s", 0, LONGEST_S, above=True)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Put each frame's (B,R,C) bits amid the symbols that show during the panel's readout.

        Returns:
            (B,K,R,C) bool, K odd, in the order in which they show; the truth is number ``K // 2``.
        """
        timing = self._timing(context)
        before_and_after = np.empty((len(value), timing.around, 2, *value.shape[1:]), dtype=np.uint8)
        for symbols, generator in zip(before_and_after, timing.generators, strict=True):
            symbols[:] = generator.integers(2, size=symbols.shape, dtype=np.uint8)
        data = torch.from_numpy(before_and_after).to(value.device).bool()
        return torch.cat([data[:, :, 0].flip(1), value.unsqueeze(1), data[:, :, 1]], dim=1)

    def row_shares(self, context: Context, height: int) -> Tensor:
        """Give the share of each pixel row's exposure during which each symbol shows.

        Args:
            context: the frames; ``origin_px`` says which of the sensor's rows comes first.
            height: rows of the frame or crop.

        Returns:
            (B,K,height) float64, 0 to 1; they add to 1 in each row. The symbols are those of a call.
        """
        timing = self._timing(context)
        rows = torch.arange(height, dtype=torch.float64, device=timing.edges_s.device)
        if context.origin_px is not None:
            rows = rows + context.origin_px[:, 1:].to(rows)
        begins = self._begins_s(rows - timing.centre_row.unsqueeze(-1), context)
        # The share of the exposure that is over when a symbol begins: telescopes to 1 over all symbols.
        over = (timing.edges_s.unsqueeze(-1) - begins.unsqueeze(1)) / context.camera.exposure_time_s
        return over.clamp_(0, 1).diff(dim=1)

    def _begins_s(self, rows: Tensor, context: Context) -> Tensor:
        """When a row so many below the panel's centre is first exposed; 0 is mid exposure of the centre."""
        camera = context.camera
        return rows * (self.readout_s / max(camera.height_px - 1, 1)) - camera.exposure_time_s / 2

    def _timing(self, context: Context) -> _Timing:
        """Draw each frame's phase, and find the symbols that show during the readout of its panel."""
        self._check(context)
        top, centre, bottom = _panel_rows(context)
        generators = context.generators(self.name)
        draws = torch.tensor([g.random() for g in generators], dtype=torch.float64, device=top.device)
        truth_s = -draws * self.symbol_s
        begins, ends = self._begins_s(top - centre, context), self._begins_s(bottom - centre, context)
        ends = ends + context.camera.exposure_time_s
        first = torch.floor((begins - truth_s) / self.symbol_s)
        last = torch.ceil((ends - truth_s) / self.symbol_s) - 1
        around = int(torch.maximum(-first, last).max())
        if 2 * around + 1 > MOST_SYMBOLS:
            shown = f"the panel shows {2 * around + 1} symbols during its readout, at most {MOST_SYMBOLS}"
            raise VoccError(f"scene.effects.{self.name}.symbol_s is {self.symbol_s:g}: {shown} are allowed")
        steps = torch.arange(-around, around + 2, dtype=torch.float64, device=top.device)
        edges = truth_s.unsqueeze(-1) + steps * self.symbol_s
        # A frame's own symbols end its timeline, not the batch's: so the batch cannot change a frame.
        edges = edges.masked_fill(steps <= first.unsqueeze(-1), -torch.inf)
        edges = edges.masked_fill(steps > last.unsqueeze(-1), torch.inf)
        return _Timing(edges, centre, around, generators)

    def _check(self, context: Context) -> None:
        """Refuse symbols so short that a row could see three of them."""
        exposure_s = context.camera.exposure_time_s
        if self.symbol_s < exposure_s:
            rule = f"it must be at least camera.exposure_time_s, which is {exposure_s:g}"
            raise VoccError(f"scene.effects.{self.name}.symbol_s is {self.symbol_s:g}: {rule}")


@dataclass(frozen=True, slots=True)
class _Timing:
    """When the symbols of each frame begin and end."""

    edges_s: Tensor
    """(B,K+1): where one symbol follows the other; 0 is the middle of the centre row's exposure."""
    centre_row: Tensor
    """(B,): the sensor's row that the panel's centre lies in."""
    around: int
    """Symbols before the truth, and as many after it."""
    generators: list[np.random.Generator]
    """Each frame's stream, its phase drawn."""


def _panel_rows(context: Context) -> tuple[Tensor, Tensor, Tensor]:
    """Sensor rows of a panel with a cell around it: first, centre's and last, (B,) each, on the sensor."""
    scene, leds = context.scene, led_centres_m(context.panel)
    points = torch.cat([torch.zeros_like(leds[:1]), leds]).to(scene.distance_m.device)
    y = view_of(context).points_px(points)[..., 1]
    cell = context.panel.pitch_m * context.camera.pixels_per_metre(scene.distance_m)
    rows = torch.stack([y.amin(dim=1) - cell, y[:, 0], y.amax(dim=1) + cell])
    top, centre, bottom = torch.floor(rows).clamp(0, context.camera.height_px - 1)
    return top, centre, bottom
