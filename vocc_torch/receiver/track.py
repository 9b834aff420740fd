"""Following panels in a recording: the last frame says where to look, a full search comes now and then."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind
from vocc_torch.receiver import lattice_model
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.rectification import cell_size_px
from vocc_torch.types import Frames, Panels, PanelShape

Plane = NDArray[np.floating[Any]]
Corners = NDArray[np.float64]

# Samples along a cell's side of the fit; along the window that is compared with the last frame's, and the
# window's side in panels.
_SAMPLES, _WINDOW, _PANELS = 4, 64, 2.0
# Steps of the fit, and from where a search found the panel; most cells of one step and of all; and a spot's
# standard deviations that are tried, cells.
_STEPS, _STEPS_AT_FIRST, _MOST_CELLS, _MOST_OFF, _BLURS = 3, 8, 0.35, 0.5, (0.2, 0.4)
# A panel is followed where a lattice explains this share of what it did when it was found.
_LEAST_SHARE = 0.6
# A panel that a full search claims is begun with where a lattice explains this share; of noise it does not.
_LEAST_TO_BEGIN = 0.5
# A sighting begins a track where no more false alarms a frame are expected, of a locator that says no limit.
_MOST_FALSE_ALARMS = 1e-3
# Of less likely sightings so many are watched at a time. A frame tells by how many LEDs change whether they
# are a panel's, half of which change, or clutter's, one in twenty, but no more than so much either way; from
# so much on it is a panel, and clutter up to so little, all in logarithms of odds.
_WATCHED, _CHANGE, _STAYS, _MOST_TOLD = 3, 0.5, 0.05, (-3.0, 10.0)
_FLICKERS, _STANDS = 25.0, -8.0
# How much more must have changed inside a panel that is moved by a line than where it is.
_LINE_MORE = 1.1
# A panel that so many full searches pass over for others is none.
_MOST_DOUBTS = 2
# A panel that is known to stand still is there where this share of it is explained.
_GOOD_SHARE = 0.95
# Cells by which a panel is looked for to the sides; log likelihood of a cell below which it is looked for
# farther off; how far cells are believed, which are not independent; what changes around LEDs at first, of
# their light; and how much of a cell's light and variance is learned anew.
_REACH, _POOR, _TRUST, _STILL, _KEPT = 3, -0.25, 0.3, 0.15, 0.1
# The corners' signs in the fields 1, u, v and uv.
_SIGNS = np.array([[1, -1, -1, 1], [1, 1, -1, -1], [1, 1, 1, 1], [1, -1, 1, -1]])
# How much of a new motion is believed: of the panel's place, and of its size, turn and bend, which change
# slowly, and which a picture of few pixels shows badly; and how much of a new size, and of a turn and bend.
_GAIN, _SIZE_GAIN, _SHAPE_GAIN = 0.5, 0.1, 0.05
_SIZE_KEPT, _SHAPE_KEPT = 0.25, 0.1
# What fields 1, u, v and uv of a step, and blur, cost, per square cell, in the picture's own variance; of a
# panel that is followed, whose shape is known.
_FREE, _KNOWN = (4.0, 16.0, 16.0, 400.0, 16.0), (4.0, 400.0, 400.0, 1600.0, 1600.0)
# Squared cells that a panel is off from where it was expected: at first, at least; and how much is learned
# anew.
_SPREAD, _LEAST_SPREAD, _LEARNED = 0.25, 0.02, 0.2
# How much of a window is remembered anew: over many frames bits become a grey mean; all else stays.
_MEMORY = 0.1
# Light of a grey value, of which 255 is white: spots of light add, grey values do not.
_LIGHT = (255 * (np.arange(256, dtype=np.float32) / 255) ** np.float32(lattice_model.GAMMA)).astype(
    np.float32
)


@lru_cache(maxsize=32)
def _grid(rows: int, columns: int, margin: int = 1) -> tuple[Plane, Plane, Plane]:
    """Samples of a panel with cells of margin: weights (4,P) of the corners, cells (N,) down and across."""
    down, across = (
        (np.arange((n + 2 * margin) * _SAMPLES, dtype=np.float32) + 0.5) / _SAMPLES - margin
        for n in (rows, columns)
    )
    return _weights(across / columns, down / rows), down, across


def _weights(u: Plane, v: Plane) -> Plane:
    """Weights (4,P) of corners, clockwise from the top left, at u (w,) by v (h,), 0 to 1 inside."""
    u, v = u[None, :], v[:, None]
    parts = [(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v]
    return np.stack([part.ravel() for part in parts])


def _spots(leds: int, blur: float) -> tuple[Plane, Plane, Plane, Plane]:
    """Profiles (N,n) of spots along an axis, their slopes by place and by blur, and their inverse (n,N)."""
    place = (np.arange((leds + 2) * _SAMPLES, dtype=np.float32) + 0.5) / _SAMPLES - 1
    apart = (place[:, None] - np.arange(leds, dtype=np.float32) - 0.5) / np.float32(blur)
    value = np.exp(-(apart**2) / 2)
    slope = value * apart / np.float32(blur)
    inverse = np.linalg.solve(value.T @ value + np.float32(2e-2) * np.eye(leds, dtype=np.float32), value.T)
    return value, slope, slope * apart, inverse


def _read(grey: NDArray[np.uint8], corners: Corners, weights: Plane) -> Plane:
    """Read (H,W) bilinearly where weights (4,P) of corners (4,2) say; borders go on."""
    x, y = (corners.T @ weights) - 0.5
    x, y = x.clip(0, grey.shape[1] - 1.001), y.clip(0, grey.shape[0] - 1.001)
    left, top = x.astype(np.int64), y.astype(np.int64)
    x, y = x - left, y - top
    flat, first = grey.reshape(-1), top * grey.shape[1] + left
    below = first + grey.shape[1]
    flat = _LIGHT[flat[np.stack([first, first + 1, below, below + 1])]]
    upper = flat[0] * (1 - x) + flat[1] * x
    lower = flat[2] * (1 - x) + flat[3] * x
    read: Plane = (upper * (1 - y) + lower * y).astype(np.float32)
    return read


def _two_levels(lit: Plane) -> Plane:
    """Replace the spots' amplitudes by the means of the dark and of the bright ones."""
    limit = (float(lit.min()) + float(lit.max())) / 2
    for _ in range(3):
        on = lit > limit
        if on.all() or not on.any():
            return lit
        low, high = float(lit[~on].mean()), float(lit[on].mean())
        limit = (low + high) / 2
    return np.where(on, np.float32(high), np.float32(low))


def _levels(grey: NDArray[np.uint8], corners: Corners, shape: PanelShape, reach: int = 0) -> Plane:
    """Read the mean light of cells with a line of cells around, moved by quarters up to ``reach`` cells.

    Returns:
        (P,P,R+2,C+2) for P = 8 reach + 1 places down and along.
    """
    rows, columns = (n + 2 + 2 * reach for n in (shape.rows, shape.columns))
    light = _read(grey, corners, _grid(shape.rows, shape.columns, 1 + reach)[0])
    light = light.reshape(rows * _SAMPLES, columns * _SAMPLES)
    for axis in (0, 1):
        light = sliding_window_view(light, _SAMPLES, axis).mean(-1)
    size = tuple(_SAMPLES * (n + 1) + 1 for n in (shape.rows, shape.columns))
    return sliding_window_view(light, size)[..., ::_SAMPLES, ::_SAMPLES]


def fit(
    grey: NDArray[np.uint8],
    corners: Corners,
    shape: PanelShape,
    blur: float,
    steps: int = _STEPS,
    costs: tuple[float, ...] = _FREE,
    dark: Plane | None = None,
) -> tuple[Corners, float, float]:
    """Move corners by a few Gauss-Newton steps to where a lattice of two levels explains a picture best.

    One frame at a time: NumPy's calls cost a few microseconds, so that all of it takes about a millisecond.

    Args:
        grey: (H,W) grey values.
        corners: (4,2) px, within a third of a cell of the truth.
        shape: rows and columns.
        blur: a spot's standard deviation, cells.
        steps: how many.
        costs: of moving by the fields 1, u, v and uv from these corners, per square cell, and of blur, in
            variances.
        dark: (R+2,C+2) light of the cells and of a line of cells around where no LED shines; the median of
            that line by default.

    Returns:
        The corners, the spots' standard deviation, and the share of the picture's variation explained.
    """
    weights, down, across = _grid(shape.rows, shape.columns)
    size = len(down), len(across)
    u, v = 2 * across / shape.columns - 1, 2 * down / shape.rows - 1
    fields: list[Plane] = [
        np.ones(size, np.float32),
        np.broadcast_to(u, size),
        np.broadcast_to(v[:, None], size),
        np.outer(v, u),
    ]
    share, moved = 0.0, np.zeros(8)
    for step in range(steps + 1):
        rows, row_slope, row_blur, from_rows = _spots(shape.rows, blur)
        columns, column_slope, column_blur, from_columns = _spots(shape.columns, blur)
        patch = _read(grey, corners, weights).reshape(size)
        if dark is None:
            patch = patch - np.median(np.concatenate([patch[0], patch[-1], patch[:, 0], patch[:, -1]]))
        else:
            patch = patch - dark.repeat(_SAMPLES, 0).repeat(_SAMPLES, 1)
        lit = _two_levels(from_rows @ patch @ from_columns.T)
        half = rows @ lit
        rest = patch - half @ columns.T
        all_of_it = float((patch**2).sum())
        share = 1 - float((rest**2).sum()) / all_of_it if all_of_it > 1e-6 else 0.0
        if step == steps:
            break
        by_x, by_y = half @ column_slope.T, row_slope @ lit @ columns.T
        wider = half @ column_blur.T + row_blur @ lit @ columns.T
        jacobian = np.stack([f * one for one in (by_x, by_y) for f in fields] + [wider]).reshape(9, -1)
        damping = np.array([*costs[:4] * 2, costs[4]]) * max(float((rest**2).mean()), 1e-2)
        pull = jacobian @ rest.ravel() - damping * np.append(moved, 0.0)
        moves = np.linalg.solve(jacobian @ jacobian.T + np.diag(damping), pull)
        moves *= min(1.0, _MOST_CELLS / max(float(np.abs(moves).max()), 1e-9))
        moved = moved + moves[:8]
        cells, blur = _SIGNS @ moves[:8].reshape(2, 4).T, min(max(blur + float(moves[8]), 0.12), 0.7)
        # From cells to px along the panel's own sides.
        along = (corners[1] - corners[0] + corners[2] - corners[3]) / (2 * shape.columns)
        beside = (corners[3] - corners[0] + corners[2] - corners[1]) / (2 * shape.rows)
        corners = corners + cells[:, :1] * along + cells[:, 1:] * beside
    return corners, blur, share


def settled(
    grey: NDArray[np.uint8],
    corners: Corners,
    shape: PanelShape,
    known: tuple[float, float] | None = None,
) -> tuple[Corners, float, float] | None:
    """Fit a lattice to a panel that is near some corners, or say that it is not there.

    Args:
        grey: (H,W) grey values.
        corners: (4,2) px, within half a cell of the truth.
        shape: rows and columns.
        known: of a panel that was seen there, its spots' standard deviation, cells, and the share of the
            picture's variation that a lattice explained.

    Returns:
        Its corners (4,2), and the two numbers for the next time; None where a lattice explains too little,
        or lies elsewhere.
    """
    if known is None:
        moved, blur, share = max(
            (fit(grey, corners, shape, one, _STEPS_AT_FIRST) for one in _BLURS), key=lambda one: one[2]
        )
        least = _LEAST_TO_BEGIN
    else:
        moved, blur, share = fit(grey, corners, shape, known[0])
        least = max(_LEAST_TO_BEGIN, _GOOD_SHARE * known[1])
    off = float(np.abs(moved - corners).max()) / math.sqrt(abs(_area(corners)) / shape.leds)
    return (moved, blur, share) if share >= least and off < _MOST_OFF else None


_U = ((np.arange(_WINDOW, dtype=np.float32) + 0.5) / _WINDOW - 0.5) * _PANELS + 0.5
_WIDE = _weights(_U, _U)
_INSIDE = (slice(_WINDOW // 4, -_WINDOW // 4), slice(_WINDOW // 4, -_WINDOW // 4))
_TAPER = np.outer(np.hanning(_WINDOW), np.hanning(_WINDOW)).astype(np.float32)


def _spectrum(grey: NDArray[np.uint8], corners: Corners, plain: bool = False) -> NDArray[np.complex64]:
    """Fourier transform of a window twice the panel's size; ``plain`` with the panel's mean inside."""
    patch = _read(grey, corners, _WIDE).reshape(_WINDOW, _WINDOW)
    if plain:
        patch[_INSIDE] = patch[_INSIDE].mean()
    patch = (patch - patch.mean()) * _TAPER
    return np.fft.rfft2(patch).astype(np.complex64)


def shift(grey: NDArray[np.uint8], corners: Corners, before: NDArray[np.complex64]) -> Corners:
    """Move corners by how far the window's content lies from what is remembered of it, ``before``.

    The bits change; the lattice, the board, its edges and the vehicle around it stay.
    """
    both = np.fft.irfft2(_spectrum(grey, corners) * before.conj(), s=(_WINDOW, _WINDOW))
    y, x = divmod(int(both.argmax()), _WINDOW)
    cells = np.array([(n + _WINDOW // 2) % _WINDOW - _WINDOW // 2 for n in (x, y)]) * (_PANELS / _WINDOW)
    along, beside = corners[1] - corners[0], corners[3] - corners[0]
    moved: Corners = corners + cells[0] * along + cells[1] * beside
    return moved


@dataclass(eq=False)
class Track:
    """A panel that is followed, or what may be one and is watched until its LEDs change.

    Args:
        number: its own, from 0.
        corners: (4,2) px where it was seen last.
        score: of the full search that found it.
        blur: its spots' standard deviation, cells.
        share: what a lattice explained there.
        seen: the window's spectrum when it was seen last.
        motion: (4,2) px a frame.
        spread: squared cells by which it is off from where it is expected, along an axis.
        misses: frames since it was seen.
        doubts: full searches since one met it that found others.
        flicker: log odds of a panel by how its LEDs change; infinity where the search was sure.
        lights: (2,R+2,C+2), the cells' light and its variance, with a line of cells around.
        on: (R+2,C+2) bool, cells that were bright when it was seen last.
        changes: (R+2,C+2), how often they changed since it was begun.
    """

    number: int
    corners: Corners
    score: float
    blur: float
    share: float
    seen: NDArray[np.complex64]
    motion: Corners = field(default_factory=lambda: np.zeros((4, 2)))
    spread: float = _SPREAD
    misses: int = 0
    doubts: int = 0
    flicker: float = math.inf
    lights: Plane = field(default_factory=lambda: np.zeros((2, 0, 0)))
    on: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), bool))
    changes: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 0), np.int64))

    @property
    def sure(self) -> bool:
        """Whether it is a panel: nothing else changes half of its lights from frame to frame."""
        return self.flicker >= _FLICKERS

    def watch(self, grey: NDArray[np.uint8], shape: PanelShape) -> bool:
        """Compare the LEDs with those of the frame before, and say whether it is surely a panel."""
        levels = _levels(grey, self.corners, shape)[0, 0].copy()
        inside = levels[1:-1, 1:-1]
        low, high = float(inside.min()), float(inside.max())
        on = levels > (low + high) / 2
        if self.on.size:
            self.changes = self.changes + (on != self.on)
            # The least of all shifts by a line: where the corners slip, what stands still changes as well.
            before = sliding_window_view(self.on, inside.shape)
            changed = float((before != on[1:-1, 1:-1]).mean((2, 3)).min())
            told = changed * math.log(_CHANGE / _STAYS) + (1 - changed) * math.log(
                (1 - _CHANGE) / (1 - _STAYS)
            )
            self.flicker += min(max(shape.leds * told, _MOST_TOLD[0]), _MOST_TOLD[1])
            self.flicker = max(self.flicker, _STANDS)
            off = levels - self.lights[0]
            self.lights = self.lights + _KEPT * np.stack([off, off**2 - self.lights[1]])
        else:  # LEDs may change by all their light, and what is around them by little
            varied = np.full_like(levels, (_STILL * (high - low)) ** 2)
            varied[1:-1, 1:-1], levels[1:-1, 1:-1] = ((high - low) / 2) ** 2, (low + high) / 2
            self.lights, self.changes = np.stack([levels, varied]), np.zeros(on.shape, np.int64)
        self.on = on
        self.lights[1] = np.maximum(self.lights[1], (_STILL * (high - low) / 2) ** 2 + 1)
        return self.sure

    def known(self, grey: NDArray[np.uint8], corners: Corners, shape: PanelShape, reach: int = 0) -> Plane:
        """How likely what is seen is, for what stands still and for LEDs that have changed before.

        Returns:
            (P,P) log likelihoods at places by quarters of cells up to ``reach`` cells down and along.
        """
        seen = _levels(grey, corners, shape, reach)
        worth: Plane = -_TRUST / 2 * ((seen - self.lights[0]) ** 2 / self.lights[1]).sum((2, 3))
        return worth

    def starts(self, grey: NDArray[np.uint8], expected: Corners, shape: PanelShape) -> list[Corners]:
        """Give where a panel may be: where it is expected, and where more is as it was."""
        if not self.on.size:
            return [expected, shift(grey, expected, self.seen)]
        worth = self.known(grey, expected, shape, _REACH)
        apart = (np.arange(len(worth)) / _SAMPLES - _REACH) ** 2 / 2 / (self.spread * (1 + self.misses))
        places = {divmod(int(told.argmax()), len(worth)) for told in (worth - apart - apart[:, None], worth)}
        cells = [(x / _SAMPLES - _REACH, y / _SAMPLES - _REACH) for y, x in sorted(places)]
        found = [_by_cells(expected, x, y, shape) for x, y in cells if max(abs(x), abs(y)) > 1 / _SAMPLES]
        if worth.max() < _POOR * self.on.size:
            found.append(shift(grey, expected, self.seen))
        return [expected, *found]

    def place(self, shape: PanelShape) -> None:
        """Move by a line of LEDs where most that changed is inside then."""
        inside = sliding_window_view(self.changes, (shape.rows, shape.columns)).sum((2, 3))
        y, x = divmod(int(inside.argmax()), 3)
        if inside[y, x] > _LINE_MORE * inside[1, 1]:
            self.corners = _by_cells(self.corners, x - 1, y - 1, shape)
            self.on = self.on[:0]

    def follow(self, grey: NDArray[np.uint8], shape: PanelShape) -> bool:
        """Look where the motion leads, and say whether the panel is there."""
        expected = self.corners + self.motion * (1 + self.misses)
        before = math.sqrt(abs(_area(self.corners)) / shape.leds)

        def likely(start: Corners) -> tuple[float, Corners, float, float]:
            """Fit from a start: how likely that is, for what a lattice explains and how far off it lies."""
            corners, blur, share = fit(grey, start, shape, self.blur, _STEPS, _KNOWN, dark)
            place, size, bend = _parts(corners - expected, expected)
            corners = expected + place + _SIZE_KEPT * size + _SHAPE_KEPT * bend
            told = -shape.leds / 4 * math.log(max(1 - share, 1e-3))
            if self.on.size:
                told += float(self.known(grey, corners, shape)[0, 0])
            apart = float(((corners - expected).mean(0) ** 2).sum()) / before**2
            return told - apart / 2 / (self.spread * (1 + self.misses)), corners, blur, share

        dark = None
        if self.on.size:
            dark = self.lights[0].copy()
            dark[1:-1, 1:-1] -= np.sqrt(self.lights[1, 1:-1, 1:-1])
        # Bits change, so that what is expected may be off by a line of LEDs.
        starts = self.starts(grey, expected, shape)
        _, corners, blur, share = max((likely(start) for start in starts), key=lambda one: one[0])
        if dark is not None:  # which a frame without the panel has, too
            share = fit(grey, corners, shape, blur, 0)[2]
        cell = math.sqrt(abs(_area(corners)) / shape.leds)
        sane = bool(np.isfinite(corners).all()) and 0.8 < cell / before < 1.25
        inside = sane and bool((abs(corners.mean(0) * 2 - grey.shape[::-1]) <= grey.shape[::-1]).all())
        if not inside or share < _LEAST_SHARE * max(self.share, _LEAST_TO_BEGIN):
            self.misses += 1
            return False
        place, size, bend = (part / (1 + self.misses) for part in _parts(corners - expected, expected))
        self.motion = self.motion + _GAIN * place + _SIZE_GAIN * size + _SHAPE_GAIN * bend
        self.spread += _LEARNED * (float((place**2).mean()) / before**2 - self.spread)
        self.spread = max(self.spread, _LEAST_SPREAD)
        self.corners, self.misses = corners, 0
        self.blur += _SIZE_GAIN * (blur - self.blur)
        self.share += _MEMORY * (share - self.share)
        self.seen += _MEMORY * (_spectrum(grey, corners) - self.seen)
        return True


def _parts(off: Corners, corners: Corners) -> tuple[Corners, Corners, Corners]:
    """Part how corners are off: by place, by size, and by turn and bend."""
    place, arms = off.mean(0, keepdims=True), corners - corners.mean(0)
    size = arms * ((off * arms).sum() / max(float((arms**2).sum()), 1e-9))
    return place, size, off - place - size


def _apart(tracks: list[Track]) -> list[Track]:
    """Leave of tracks that lie on one panel the one of the lowest number."""
    kept: list[Track] = []
    for track in sorted(tracks, key=lambda one: one.number):
        middle, reach = track.corners.mean(0), math.sqrt(abs(_area(track.corners))) / 2
        if all(np.linalg.norm(one.corners.mean(0) - middle) >= reach for one in kept):
            kept.append(track)
    return kept


def _by_cells(corners: Corners, across: float, down: float, shape: PanelShape) -> Corners:
    """Move corners along the panel's own lines."""
    along, beside = (corners[1] - corners[0]) / shape.columns, (corners[3] - corners[0]) / shape.rows
    moved: Corners = corners + across * along + down * beside
    return moved


def _area(corners: Corners) -> float:
    """Area of a quadrilateral, px^2."""
    x, y = corners.T
    return float(((x[2] - x[0]) * (y[3] - y[1]) - (x[3] - x[1]) * (y[2] - y[0])) / 2)


@dataclass
class Tracker:
    """Follow panels from frame to frame of one recording.

    A full search begins, goes on while nothing is seen, and comes again every ``every`` frames: it finds new
    panels and corrects the followed ones. A panel that is not seen in ``patience`` frames is lost. While
    there is none, sightings that a search is not sure of are watched: panels once their LEDs change.

    Args:
        locator: does the full search; of one with ``sightings`` every panel is followed, else the best.
        shape: rows and columns.
        every: frames between full searches, at least 1.
        patience: frames that a panel may be out of sight.

    Raises:
        VoccError: a number below 1.
    """

    locator: PanelLocator
    shape: PanelShape
    every: int = 30
    patience: int = 8
    tracks: list[Track] = field(default_factory=list)
    searches: int = 0
    _number: int = 0
    _since: int = 0

    def __post_init__(self) -> None:
        """Check the numbers."""
        demand_kind("shape", self.shape, PanelShape)
        for name in ("every", "patience"):
            if type(value := getattr(self, name)) is not int or value < 1:
                raise VoccError.of(f"follow.{name}", value, "a whole number of at least 1")

    def __call__(self, plane: NDArray[np.uint8]) -> list[Track]:
        """Take the recording's next frame (H,W), and give the panels that are seen in it."""
        seen = [track for track in self.tracks if track.follow(plane, self.shape)]
        for track in seen:
            watched = not track.sure
            if track.watch(plane, self.shape) and watched:
                track.place(self.shape)
                self._admit(track)
        seen = _apart([track for track in seen if track.sure])
        # What is watched stays while it is followed and there is no panel; panels while not missed for long.
        self.tracks = [
            one
            for one in self.tracks
            if one in seen or (0 < one.misses <= self.patience if one.sure else not (seen or one.misses))
        ]
        self._since += 1
        # All the time while nothing is followed, and soon where something is missed.
        missed = len(seen) < sum(track.sure for track in self.tracks)
        if not seen or self._since >= self.every or (missed and self._since >= 3):
            self._since, self.searches = 0, self.searches + 1
            met = [self._anchored(plane, *one) for one in self._found(plane)]
            for track in self.tracks:
                track.doubts = 0 if not any(met) or track in met else track.doubts + 1
            self.tracks = [track for track in self.tracks if track.doubts <= _MOST_DOUBTS]
            seen = [one for one in self.tracks if one.sure and (one in seen or one in met)]
        return sorted(seen, key=lambda track: track.number)

    def panels(self, greys: Tensor) -> Panels:
        """Take the next frames (B,H,W) uint8 in order, and give the panel followed longest in each."""
        panels = Panels.known(torch.zeros(len(greys), 4, 2))
        for i, plane in enumerate(greys.cpu().numpy()):
            seen = self(plane)
            panels.found[i], panels.candidates[i] = bool(seen), len(seen)
            panels.score[i] = seen[0].score if seen else 0.0
            if seen:
                panels.corners_px[i] = torch.from_numpy(seen[0].corners)
        return panels

    def _admit(self, track: Track) -> None:
        """Take for a panel what was watched, or is begun."""
        track.flicker, track.number = math.inf, self._number
        self._number += 1

    def _found(self, plane: NDArray[np.uint8]) -> Iterator[tuple[Corners, float, bool]]:
        """Search the whole frame: corners, score, and whether it is surely a panel, these first."""
        frames = Frames.whole(torch.from_numpy(plane))
        sightings = getattr(self.locator, "sightings", None)
        found = self.locator(frames, self.shape) if sightings is None else sightings(frames, self.shape)
        most = getattr(self.locator, "false_alarms", _MOST_FALSE_ALARMS)
        kept = found.found if isinstance(found, Panels) else ~(found.false_alarms > most)
        rows = zip(found.corners_px.cpu().numpy(), found.score.tolist(), kept.tolist(), strict=True)
        for corners, score, good in sorted(rows, key=lambda row: not row[2]):
            cell = min(float(one) for one in cell_size_px(torch.from_numpy(corners)[None], self.shape))
            if (good or sightings) and cell >= 1:
                yield corners, score, good

    def _anchored(self, plane: NDArray[np.uint8], corners: Corners, score: float, good: bool) -> Track | None:
        """Correct the track that a search met, or begin one, where a lattice explains what is there.

        What is not ``good`` corrects nothing, and is watched while there is no panel.
        """
        watched = sum(track.flicker > _STANDS for track in self.tracks)
        if not good and any(track.sure for track in self.tracks):
            return None
        share, blur = max(fit(plane, corners, self.shape, blur)[:0:-1] for blur in _BLURS)
        middle, reach = corners.mean(0), math.sqrt(abs(_area(corners))) / 2
        if share < _LEAST_TO_BEGIN:
            return None
        for track in self.tracks:
            there = track.corners + track.motion * track.misses
            if float(np.linalg.norm(there.mean(0) - middle)) < reach:
                if not good:
                    return track
                track.corners, track.score, track.misses = corners, score, 0
                track.on = track.on[:0]
                break
        else:
            if not good and watched >= _WATCHED:
                return None
            track = Track(-1, corners, score, blur, share, _spectrum(plane, corners, True), flicker=0.0)
            self.tracks.append(track)
        if good and track.number < 0:
            self._admit(track)
        track.watch(plane, self.shape)
        track.blur, track.share = blur, share
        return track
