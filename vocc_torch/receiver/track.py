"""Following panels in a recording: the last frame says where to look, a full search comes now and then."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import torch
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
# A panel that so many full searches pass over for others is none.
_MOST_DOUBTS = 2
# Below this share of it neighbouring lattices are tried.
_GOOD_SHARE = 0.95
_NEIGHBOURS = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]
# The corners' signs in the fields 1, u, v and uv.
_SIGNS = np.array([[1, -1, -1, 1], [1, 1, -1, -1], [1, 1, 1, 1], [1, -1, 1, -1]])
# How much of a new motion is believed: of the panel's place, and of its size, turn and bend, which change
# slowly, and which a picture of few pixels shows badly.
_GAIN, _SHAPE_GAIN = 0.5, 0.1
# What fields 1, u, v and uv of a step cost, per square cell, in the picture's own variance; of a panel that
# is followed, whose shape is known.
_FREE, _KNOWN = (4.0, 16.0, 16.0, 400.0), (4.0, 400.0, 400.0, 1600.0)
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
def _grid(rows: int, columns: int) -> tuple[Plane, Plane, Plane]:
    """Samples of a panel with a cell of margin: weights (4,P) of the corners, cells (N,) down and across."""
    down, across = (
        (np.arange((n + 2) * _SAMPLES, dtype=np.float32) + 0.5) / _SAMPLES - 1 for n in (rows, columns)
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


def fit(
    grey: NDArray[np.uint8],
    corners: Corners,
    shape: PanelShape,
    blur: float,
    steps: int = _STEPS,
    costs: tuple[float, float, float, float] = _FREE,
) -> tuple[Corners, float, float]:
    """Move corners by a few Gauss-Newton steps to where a lattice of two levels explains a picture best.

    One frame at a time: NumPy's calls cost a few microseconds, so that all of it takes about a millisecond.

    Args:
        grey: (H,W) grey values.
        corners: (4,2) px, within a third of a cell of the truth.
        shape: rows and columns.
        blur: a spot's standard deviation, cells.
        steps: how many.
        costs: of moving by the fields 1, u, v and uv from these corners, per square cell, in variances.

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
        patch = patch - np.median(np.concatenate([patch[0], patch[-1], patch[:, 0], patch[:, -1]]))
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
        damping = np.array([*costs * 2, 16.0]) * max(float((rest**2).mean()), 1e-2)
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


@dataclass
class Track:
    """A panel that is followed.

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

    def follow(self, grey: NDArray[np.uint8], shape: PanelShape) -> bool:
        """Look where the motion leads, and say whether the panel is there."""
        expected = self.corners + self.motion * (1 + self.misses)
        before = math.sqrt(abs(_area(self.corners)) / shape.leds)

        def likely(start: Corners, steps: int = _STEPS) -> tuple[float, Corners, float, float]:
            """Fit from a start: how likely that is, for what a lattice explains and how far off it lies."""
            corners, blur, share = fit(grey, start, shape, self.blur, steps, _KNOWN)
            apart = float(((corners - expected).mean(0) ** 2).sum()) / before**2
            told = -shape.leds / 4 * math.log(max(1 - share, 1e-3))
            return told - apart / 2 / (self.spread * (1 + self.misses)), corners, blur, share

        there = shift(grey, expected, self.seen)
        # Bits change, so that a shift may be off by a line of LEDs, and so may what is expected.
        starts = [expected, there] if np.abs(there - expected).max() > before / 4 else [expected]
        best = max((likely(start) for start in starts), key=lambda one: one[0])
        if best[3] < _GOOD_SHARE * self.share:
            sides = (best[1][1] - best[1][0]) / shape.columns, (best[1][3] - best[1][0]) / shape.rows
            lines = [likely(best[1] + x * sides[0] + y * sides[1], 1) for x, y in _NEIGHBOURS]
            best = max(best, likely(max(lines, key=lambda one: one[0])[1]), key=lambda one: one[0])
        _, corners, blur, share = best
        cell = math.sqrt(abs(_area(corners)) / shape.leds)
        sane = bool(np.isfinite(corners).all()) and 0.8 < cell / before < 1.25
        if not sane or share < _LEAST_SHARE * self.share:
            self.misses += 1
            return False
        off = (corners - expected) / (1 + self.misses)
        place = off.mean(0)
        self.motion = self.motion + _GAIN * place + _SHAPE_GAIN * (off - place)
        self.spread += _LEARNED * (float((place**2).mean()) / before**2 - self.spread)
        self.spread = max(self.spread, _LEAST_SPREAD)
        self.corners, self.blur, self.misses = corners, blur, 0
        self.share += _MEMORY * (share - self.share)
        self.seen += _MEMORY * (_spectrum(grey, corners) - self.seen)
        return True


def _area(corners: Corners) -> float:
    """Area of a quadrilateral, px^2."""
    x, y = corners.T
    return float(((x[2] - x[0]) * (y[3] - y[1]) - (x[3] - x[1]) * (y[2] - y[0])) / 2)


@dataclass
class Tracker:
    """Follow panels from frame to frame of one recording.

    A full search begins, goes on while nothing is seen, and comes again every ``every`` frames: it finds new
    panels and corrects the followed ones. A panel that is not seen in ``patience`` frames is lost.

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
        self.tracks = [track for track in self.tracks if track.misses <= self.patience]
        self._since += 1
        # All the time while nothing is followed, and soon where something is missed.
        missed = len(seen) < len(self.tracks)
        if not seen or self._since >= self.every or (missed and self._since >= 3):
            self._since, self.searches = 0, self.searches + 1
            met = [self._anchored(plane, *one) for one in self._found(plane)]
            for track in self.tracks:
                track.doubts = 0 if not any(met) or any(track is one for one in met) else track.doubts + 1
            self.tracks = [track for track in self.tracks if track.doubts <= _MOST_DOUBTS]
            seen = [one for one in self.tracks if any(one is other for other in (*seen, *met))]
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

    def _found(self, plane: NDArray[np.uint8]) -> Iterator[tuple[Corners, float]]:
        """Search the whole frame."""
        frames = Frames.whole(torch.from_numpy(plane))
        sightings = getattr(self.locator, "sightings", None)
        found = self.locator(frames, self.shape) if sightings is None else sightings(frames, self.shape)
        most = getattr(self.locator, "false_alarms", _MOST_FALSE_ALARMS)
        kept = found.found if isinstance(found, Panels) else ~(found.false_alarms > most)
        for corners, score, good in zip(
            found.corners_px.cpu().numpy(), found.score.tolist(), kept.tolist(), strict=True
        ):
            cell = min(float(one) for one in cell_size_px(torch.from_numpy(corners)[None], self.shape))
            if good and cell >= 1:
                yield corners, score

    def _anchored(self, plane: NDArray[np.uint8], corners: Corners, score: float) -> Track | None:
        """Correct the track that a full search met, or begin one, where a lattice explains what is there."""
        share, blur = max(fit(plane, corners, self.shape, blur)[:0:-1] for blur in _BLURS)
        middle, reach = corners.mean(0), math.sqrt(abs(_area(corners))) / 2
        if share < _LEAST_TO_BEGIN:
            return None
        for track in self.tracks:
            there = track.corners + track.motion * track.misses
            if float(np.linalg.norm(there.mean(0) - middle)) < reach:
                track.corners, track.score, track.misses = corners, score, 0
                break
        else:
            track = Track(self._number, corners, score, blur, share, _spectrum(plane, corners, True))
            self._number += 1
            self.tracks.append(track)
        track.blur, track.share = blur, share
        return track
