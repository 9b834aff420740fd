"""A panel that is followed from frame to frame: where it is expected, how it looks, whether it is there."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from vocc_torch.receiver.frame_fit import (
    SAMPLES,
    Corners,
    Plane,
    area,
    cell_levels,
    fit,
    read_cells,
    spot_energy,
)
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class TrackSettings:
    """When a panel is followed, and how much is learned anew from each frame."""

    least_share: float = 0.6  # of what a lattice explained before
    least_explained: float = 0.3  # of the picture that a lattice explains
    worse_share: float = (
        0.12  # less than before: half a cell off a lattice fits as well, though badly
    )
    change_share: float = 0.5  # of a panel's LEDs that change from frame to frame
    clutter_change_share: float = 0.05  # of clutter's lights that change
    # The least and the most that one frame says.
    frame_log_odds: tuple[float, float] = (
        -3.0,
        10.0,
    )
    panel_log_odds: float = 25.0  # from which on it is a panel
    line_more: float = (
        3.0  # energy by which a panel moved by a line must stand out more
    )
    energy_learned: float = 0.2  # share of the energy that is learned anew
    least_energy: float = 1.2  # of a cell on the average; below, no panel is left
    level_spread: float = (
        0.8  # of an LED's light about bright or dark, of half the way between
    )
    most_deviation2: float = 25.0  # squared deviations of the least likely cell
    reach_cells: int = 3  # by which a panel is looked for to the sides
    trust: float = 0.15  # in a cell, for cells are not independent
    still_share: float = 0.15  # of the LEDs' light that changes around them at first
    light_learned: float = (
        0.1  # share of a cell's light and variance that is learned anew
    )
    place_gain: float = 0.5  # of a new motion of the place that is believed
    size_gain: float = 0.1  # of a new motion of the size: it changes slowly
    shape_gain: float = 0.05  # of a new turn and bend, which few pixels show badly
    size_kept: float = 0.5  # of a new size that is believed
    shape_kept: float = 0.2  # of a new turn and bend that is believed
    beyond_share: float = (
        0.6  # of the LEDs' variance: lights beyond a side that vary so are LEDs
    )
    steps: int = 2  # of the fit
    # Of moves of a known shape.
    known_costs: tuple[float, ...] = (
        4.0,
        400.0,
        400.0,
        1600.0,
        1600.0,
    )
    spread_cells2: float = 0.25  # squared cells off the expected place at first
    least_spread_cells2: float = 0.02  # at least
    most_spread_cells2: float = 1.0  # at most
    spread_learned: float = 0.2  # share of it that is learned anew
    share_learned: float = 0.1  # share of what a lattice explains that is learned anew


TRACK = TrackSettings()

STANDS = -8.0
"""Logarithm of the odds of a panel up to which it is clutter."""


@dataclass(eq=False)
class Track:
    """A panel that is followed, or what may be one and is watched until its LEDs change.

    Args:
        number: its own, from 0.
        corners: (4,2) px where it was seen last.
        score: of the last full search that was sure of it.
        false_alarms: stated by that search, for a frame without a panel; NaN where none was.
        blur: its spots' standard deviation, cells.
        share: what a lattice explained there.
        motion: (4,2) px a frame.
        spread: squared cells by which it is off from where it is expected, along an axis.
        misses: frames since it was seen.
        doubts: full searches since one met it that found others.
        flicker: log odds of a panel by how its LEDs change; infinity where the search was sure.
        lights: (2,R+2,C+2), the cells' light and its variance, with a line of cells around.
        on: (R+2,C+2) bool, cells that were bright when it was seen last.
        energy: (R+2,C+2), how much a spot stood out of each cell, over some frames.
    """

    number: int
    corners: Corners
    score: float
    blur: float
    share: float
    motion: Corners = field(default_factory=lambda: np.zeros((4, 2)))
    false_alarms: float = math.nan
    spread: float = TRACK.spread_cells2
    misses: int = 0
    doubts: int = 0
    flicker: float = math.inf
    lights: Plane = field(default_factory=lambda: np.zeros((2, 0, 0)))
    on: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), bool))
    energy: Plane = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def sure(self) -> bool:
        """Whether it is a panel: nothing else changes half of its lights from frame to frame."""
        return self.flicker >= TRACK.panel_log_odds

    def watch(self, levels: Plane) -> None:
        """Compare the LEDs' light (R+2,C+2) with that of the frame before, and remember it."""
        levels = levels.copy()
        inside = levels[1:-1, 1:-1]
        low, high = float(inside.min()), float(inside.max())
        on = levels > (low + high) / 2
        if self.on.size:
            # The least of all shifts by a line: where the corners slip, what stands still changes as well.
            before = sliding_window_view(self.on, inside.shape)
            changed = float((before != on[1:-1, 1:-1]).mean((2, 3)).min())
            evidence = changed * math.log(
                TRACK.change_share / TRACK.clutter_change_share
            ) + (1 - changed) * math.log(
                (1 - TRACK.change_share) / (1 - TRACK.clutter_change_share)
            )
            self.flicker += min(
                max(inside.size * evidence, TRACK.frame_log_odds[0]),
                TRACK.frame_log_odds[1],
            )
            self.flicker = max(self.flicker, STANDS)
            off = levels - self.lights[0]
            self.lights = self.lights + TRACK.light_learned * np.stack(
                [off, off**2 - self.lights[1]]
            )
        else:  # LEDs may change by all their light, and what is around them by little
            varied = np.full_like(levels, (TRACK.still_share * (high - low)) ** 2)
            varied[1:-1, 1:-1], levels[1:-1, 1:-1] = (
                ((high - low) / 2) ** 2,
                (low + high) / 2,
            )
            self.lights = np.stack([levels, varied])
        self.on = on
        self.lights[1] = np.maximum(
            self.lights[1], (TRACK.still_share * (high - low) / 2) ** 2 + 1
        )

    def likely(self, levels: Plane, apart: Corners, step: float) -> Plane:
        """How likely what is seen (R+2,C+2,P,P) is at places by a ``step`` of cells: (P,P), logarithms.

        What stands still is as it was, and LEDs are bright or dark. ``apart`` (2,) is how far the middle
        place is from where the panel is expected, cells.
        """
        light, variance = self.lights[..., None, None]
        off = np.subtract(levels, light, order="C")
        off /= np.sqrt(variance)
        leds = off[1:-1, 1:-1]
        np.abs(leds, out=leds)
        leds -= 1
        leds /= TRACK.level_spread
        off *= off
        np.minimum(off, TRACK.most_deviation2, out=off)
        likelihood: Plane = -TRACK.trust / 2 * off.sum((0, 1))
        places = (np.arange(len(likelihood)) - len(likelihood) // 2) * step
        across, down = (
            (places + distance) ** 2 / 2 / (self.spread * self.misses)
            for distance in apart
        )
        likelihood -= down[:, None] + across
        return likelihood

    def place(self, shape: PanelShape) -> None:
        """Move by a line of LEDs where spots have stood out; what is around stands still at first."""
        inside = _inside(self.energy, shape)
        y, x = divmod(int(inside.argmax()), 3)
        if inside[y, x] > inside[1, 1] + TRACK.line_more:
            self.corners = _by_cells(self.corners, x - 1, y - 1, shape)
            for name in ("on", "energy", "lights"):
                setattr(
                    self, name, np.roll(getattr(self, name), (1 - y, 1 - x), (-2, -1))
                )
            variance = self.lights[1]
            variance[[0, -1]] = variance[:, [0, -1]] = variance.min()

    def ends(self) -> bool:
        """Whether lights beyond each side change less than LEDs do, so that the panel ends there."""
        variance = self.lights[1]
        beyond = max(
            variance[[0, -1], 1:-1].mean(1).max(), variance[1:-1, [0, -1]].mean(0).max()
        )
        return bool(beyond <= TRACK.beyond_share * variance[1:-1, 1:-1].mean())

    def follow(self, grey: NDArray[np.uint8], shape: PanelShape) -> bool:
        """Look where the motion leads, and say whether the panel is there."""
        self.misses += 1
        expected = self.corners + self.motion * self.misses
        before = math.sqrt(abs(area(self.corners)) / shape.leds)
        levels = cell_levels(
            read_cells(grey, expected, shape, 1 + TRACK.reach_cells), shape
        )
        y, x = divmod(
            int(self.likely(levels, np.zeros(2), 1 / SAMPLES).argmax()),
            levels.shape[-1],
        )
        start = _by_cells(
            expected,
            x / SAMPLES - TRACK.reach_cells,
            y / SAMPLES - TRACK.reach_cells,
            shape,
        )
        corners, blur, share = fit(
            grey, start, shape, self.blur, TRACK.steps, TRACK.known_costs
        )
        # Half a cell off a lattice fits as well, though badly.
        if share < self.share - TRACK.worse_share:
            halves = (
                _by_cells(start, x / 2, y / 2, shape)
                for y, x in ((0, 1), (1, 0), (1, 1))
            )
            others = (
                fit(grey, half, shape, self.blur, TRACK.steps, TRACK.known_costs)
                for half in halves
            )
            other = max(others, key=lambda one: one[2])
            corners, blur, share = (
                other
                if other[2] > share + TRACK.worse_share
                else (corners, blur, share)
            )
        place, size, bend = _parts(corners - expected, expected)
        corners = expected + place + TRACK.size_kept * size + TRACK.shape_kept * bend
        within = bool(
            (abs(corners.mean(0) * 2 - grey.shape[::-1]) <= grey.shape[::-1]).all()
        )
        grown = math.sqrt(abs(area(corners)) / shape.leds) / before
        if (
            not within
            or not 0.8 < grown < 1.25
            or share < max(TRACK.least_share * self.share, TRACK.least_explained)
        ):
            return False
        # A lattice looks the same from line to line; what stands out of it does not.
        light = read_cells(grey, corners, shape, 2)
        levels, energy = (
            cell_levels(light, shape)[..., ::SAMPLES, ::SAMPLES],
            spot_energy(light),
        )
        likelihood = self.likely(
            levels, (corners - expected).mean(0) / before, 1.0
        ) + _inside(energy, shape)
        y, x = divmod(int(likelihood.argmax()), 3)
        corners = _by_cells(corners, x - 1, y - 1, shape)
        self.energy = self.energy + TRACK.energy_learned * (
            np.roll(energy, (1 - y, 1 - x), (0, 1)) - self.energy
        )
        if self.energy[1:-1, 1:-1].mean() < TRACK.least_energy:
            return False
        place, size, bend = (
            part / self.misses for part in _parts(corners - expected, expected)
        )
        self.motion = (
            self.motion
            + TRACK.place_gain * place
            + TRACK.size_gain * size
            + TRACK.shape_gain * bend
        )
        self.spread += TRACK.spread_learned * (
            float((place**2).mean()) / before**2 - self.spread
        )
        self.spread = min(
            max(self.spread, TRACK.least_spread_cells2), TRACK.most_spread_cells2
        )
        self.corners, self.misses = corners, 0
        self.blur += TRACK.size_gain * (blur - self.blur)
        self.share += TRACK.share_learned * (share - self.share)
        self.watch(levels[..., y, x])
        self.place(shape)
        return self.ends()


def _inside(energy: Plane, shape: PanelShape) -> Plane:
    """Sum what stands out (R+2,C+2) in a panel that is moved by up to a line: (3,3)."""
    inside: Plane = sliding_window_view(energy, (shape.rows, shape.columns)).sum((2, 3))
    return inside


def _parts(off: Corners, corners: Corners) -> tuple[Corners, Corners, Corners]:
    """Part how corners are off: by place, by size, and by turn and bend."""
    place, arms = off.mean(0, keepdims=True), corners - corners.mean(0)
    size = arms * ((off * arms).sum() / max(float((arms**2).sum()), 1e-9))
    return place, size, off - place - size


def _by_cells(
    corners: Corners, across: float, down: float, shape: PanelShape
) -> Corners:
    """Move corners along the panel's own lines."""
    along, beside = (
        (corners[1] - corners[0]) / shape.columns,
        (corners[3] - corners[0]) / shape.rows,
    )
    moved: Corners = corners + across * along + down * beside
    return moved
