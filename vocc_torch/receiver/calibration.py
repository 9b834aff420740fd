"""Calibration of a receiver's scores, and the ranges of the panels of its training."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.receiver.reader import Readings

APPEARANCE = ("pitch_px", "level", "contrast")
"""What :func:`appearance` measures of a panel."""


@dataclass(frozen=True)
class Calibration:
    """From scores to log-likelihood ratios, log P(On) / P(Off), with the sign of the decision.

    On either side of 0 isotonic regression estimates the share of wrong decisions, which falls with the
    distance of the score from 0. It uses panels that are not in the training. Half an error is added to each
    step, so that every ratio is finite. The last step begins behind the last error, so it has no error. Its
    errors in other frames are estimated by leaving out one frame at a time: they are the errors of one frame
    that lie beyond the errors of all other frames.

    Args:
        off: scores below 0 by their distance from it, and the ratios' sizes, both ascending.
        on: likewise of scores from 0 on.

    Raises:
        VoccError: numbers that are not finite, not ascending or not as many of either.

    Source: B. Zadrozny and C. Elkan, "Transforming classifier scores into accurate multiclass probability
    estimates", KDD 2002.

    Example:
        >>> scores = torch.tensor([-2.0, -1.0, -0.5, 0.5, 1.0, 2.0])
        >>> learned = Calibration.of(scores, torch.tensor([0, 0, 1, 0, 1, 1]) == 1)
        >>> learned(torch.tensor([-3.0, 0.0, 0.25, 3.0])).round(decimals=2).tolist()
        [-0.69, 0.0, 0.0, 0.69]
    """

    off: tuple[tuple[float, ...], tuple[float, ...]]
    on: tuple[tuple[float, ...], tuple[float, ...]]

    def __post_init__(self) -> None:
        """Check what a file may have brought."""
        for distances, sizes in (self.off, self.on):
            values = np.array([distances, sizes])
            if (
                not len(distances)
                or values.dtype.kind not in "fi"
                or not np.isfinite(values).all()
                or (np.diff(values, axis=1) < 0).any()
            ):
                raise VoccError(
                    "calibration is not two rows of finite ascending numbers"
                )

    @classmethod
    def of(cls, scores: Tensor, bits: Tensor) -> Self:
        """Learn from scores and the bits that were sent, (B,...) of B frames."""
        frame = np.indices(scores.shape)[0].flatten()
        values, sent = (
            part.flatten().cpu().numpy() for part in (scores.double(), bits)
        )
        on = values >= 0
        return cls(
            _learned(-values[~on], sent[~on], frame[~on]),
            _learned(values[on], ~sent[on], frame[on]),
        )

    @classmethod
    def read(cls, settings: Mapping[str, Any] | None) -> Self | None:
        """Read back what a model file keeps of its fields; None if it keeps none."""
        if settings is None:
            return None
        sides = settings["off"], settings["on"]
        return cls(*((tuple(places), tuple(sizes)) for places, sizes in sides))

    def __call__(self, scores: Tensor) -> Tensor:
        """Turn scores into log-likelihood ratios, float64, of the scores' shape."""
        exact = scores.detach().double()
        sizes = _interpolated(exact, self.on), _interpolated(-exact, self.off)
        return torch.where(exact >= 0, sizes[0], -sizes[1])


def _interpolated(at: Tensor, points: tuple[tuple[float, ...], ...]) -> Tensor:
    """Interpolate between ascending points, as ``np.interp`` does to the last bit, on any device."""
    places, values = torch.tensor(points, dtype=torch.float64).to(at.device)
    slopes = torch.nn.functional.pad(values.diff() / places.diff(), (0, 1))
    at = at.clamp(max=places[-1])
    left = ((at[..., None] >= places).sum(-1) - 1).clamp(min=0)
    begin = places[left]
    found: Tensor = slopes[left] * (at - begin).clamp(min=0) + values[left]
    return found


def _learned(
    distances: NDArray[np.float64], wrong: NDArray[np.bool_], frame: NDArray[np.int64]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Give distances from 0, both ends of each step of the regression, and log of right over wrong there."""
    order = np.argsort(distances, kind="stable")
    distances, wrong, frame = distances[order], wrong[order], frame[order]
    places, sizes = [0.0], [0.0]
    if len(wrong):
        # Loaded here because reading a picture needs no SciPy.
        from scipy.optimize import isotonic_regression

        ends = isotonic_regression(
            wrong.astype(np.float64), increasing=False
        ).blocks.tolist()
        counts = (np.add.reduceat(wrong, ends[:-1], dtype=np.float64) + 0.5).tolist()
        counts[-1] = max(counts[-1], float(beyond_others(frame[wrong])))
        # Steps that are no longer less often wrong than the one before are one with it.
        while len(counts) > 1 and counts[-1] * (ends[-2] - ends[-3]) > counts[-2] * (
            ends[-1] - ends[-2]
        ):
            counts[-2:], ends[-2:] = [counts[-2] + counts[-1] - 0.5], ends[-1:]
        for (first, last), errors in zip(itertools.pairwise(ends), counts, strict=True):
            places += [float(distances[first]), float(distances[last - 1])]
            sizes += [
                max(
                    sizes[-1],
                    float(np.log(max(last - first + 1.0 - errors, 0.5) / errors)),
                )
            ] * 2
    return tuple(places), tuple(sizes)


def beyond_others(frames: NDArray[np.int64]) -> int:
    """Count the errors at the end of a list that are of one frame.

    Args:
        frames: of each error its frame, in the order of the errors' distances from 0.

    Example:
        >>> beyond_others(np.array([3, 1, 2, 2])), beyond_others(np.array([], dtype=int))
        (2, 0)
    """
    others = np.flatnonzero(frames != frames[-1:])
    return len(frames) - (int(others[-1]) + 1 if len(others) else 0)


def appearance(readings: Readings) -> Tensor:
    """Measure how panels look, (B,3) float64, in the order of ``APPEARANCE``.

    The pitch is a cell's mean side in the image, the level the mean grey value of the panel, and the contrast
    the difference of its brightest and its darkest cell, in digital numbers both.
    """
    cells = readings.greys.average.double().flatten(1)
    darkest, brightest = cells.aminmax(dim=1)
    measured = [
        readings.cell_px.double().mean(dim=1),
        cells.mean(dim=1),
        brightest - darkest,
    ]
    return torch.stack(measured, dim=1)


Ranges = dict[str, tuple[float, float]]
"""Least and greatest of each of ``APPEARANCE``."""


def ranges_of(seen: Tensor) -> Ranges:
    """Give the ranges of what :func:`appearance` measured of at least one panel.

    They reach a twentieth further at either end: the scenes' own ends are hardly ever drawn.
    """
    low, high = seen.aminmax(dim=0)
    further = (high - low) / 20
    ends = zip((low - further).tolist(), (high + further).tolist(), strict=True)
    return dict(zip(APPEARANCE, ends, strict=True))


HARDER_BELOW = ("pitch_px", "contrast")
"""What makes a panel harder to read where it is less: larger LEDs and more contrast are read more easily."""


def harder(looks: Tensor, ranges: Ranges) -> dict[str, Tensor]:
    """Say which panels (B,) have smaller LEDs or less contrast than the ranges, where any has.

    Example:
        >>> harder(torch.tensor([[2.0, 90.0, 200.0]]), {"pitch_px": (3.0, 7.0), "contrast": (8.0, 127.0)})
        {'pitch_px': tensor([True])}
    """
    found = {}
    for name in HARDER_BELOW if ranges else ():
        below = looks[:, APPEARANCE.index(name)] < ranges[name][0]
        if bool(below.any()):
            found[name] = below
    return found
