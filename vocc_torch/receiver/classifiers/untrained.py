"""Receivers that learn nothing: each panel is parted by its own grey values."""

from __future__ import annotations

from typing import Self

import torch
from torch import Tensor

from vocc_torch.receiver.otsu import histogram256, otsu_threshold


class _Untrained:
    """What needs no training."""

    parameters_count = 0

    def fit(self, x: Tensor, bits: Tensor) -> Self:
        """Learn nothing."""
        return self

    def fit_stream(self, batches: object, frames: int) -> Self:
        """Learn nothing, and ask for no frames."""
        return self

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED.

        Raises:
            NotImplementedError: always: each kind has its own.
        """
        raise NotImplementedError

    def predict(self, x: Tensor) -> Tensor:
        """Decide every LED."""
        return self.decision_function(x) >= 0


class PanelOtsu(_Untrained):
    """Otsu's threshold of the panel's own pixels, against the mean of each cell.

    Its inputs are the own cell in grey, not relative to the panel (``cells=1, relative=white``).

    Example:
        >>> x = torch.tensor([0.2, 0.2, 0.6, 0.7]).view(1, 2, 2, 1)
        >>> PanelOtsu().predict(x).tolist()
        [[[False, False], [True, True]]]
    """

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED by its distance from the threshold, in grey values of 0 to 255."""
        greys = (x * 255.0).round().clamp(0, 255).to(torch.uint8)
        threshold = otsu_threshold(histogram256(greys.flatten(1).view(len(x), 1, 1, -1)))
        # Otsu's foreground begins above the threshold's whole grey value.
        return (x.to(torch.float64).mean(dim=-1) * 255.0) - (threshold.view(-1, 1, 1) + 0.5)


def two_means(values: Tensor) -> Tensor:
    """Part numbers into two clusters with the least sum of squares within: k-means in one dimension, exactly.

    Args:
        values: (B,N), N at least 1.

    Returns:
        (B,) the middle between the two clusters' means; where all values are equal, that value.

    Example:
        >>> two_means(torch.tensor([[0.0, 1.0, 9.0, 10.0], [3.0, 3.0, 3.0, 3.0]])).tolist()
        [5.0, 3.0]
    """
    ordered = values.to(torch.float64).sort(dim=1).values
    count = ordered.shape[1]
    if count == 1:
        return ordered[:, 0]
    below = torch.arange(1, count, dtype=torch.float64, device=values.device)
    # Relative to the least value, so that equal values differ by nothing at all.
    relative = ordered - ordered[:, :1]
    sums = relative.cumsum(dim=1)
    low = sums[:, :-1] / below
    high = (sums[:, -1:] - sums[:, :-1]) / (count - below)
    best = (below * (count - below) * (high - low).square()).argmax(dim=1, keepdim=True)
    return (ordered[:, :1] + (low.gather(1, best) + high.gather(1, best)) / 2)[:, 0]


class PanelKMeans(_Untrained):
    """Two clusters of the panel's cell means. Inputs as for :class:`PanelOtsu`, or one sample a cell.

    Example:
        >>> PanelKMeans().predict(torch.tensor([0.2, 0.2, 0.6, 0.7]).view(1, 2, 2, 1)).tolist()
        [[[False, False], [True, True]]]
    """

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED by its distance from the middle between the clusters."""
        means = x.to(torch.float64).mean(dim=-1)
        return means - two_means(means.flatten(1)).view(-1, 1, 1)


class TagPlanes(_Untrained):
    """The idea of AprilTag's cell reader, carried over to LEDs.

    A black and a white level that may slope over the panel, as two planes over its rows and columns, and a
    Laplacian across cells against the light of neighbours (Wang and Olson, "AprilTag 2", IROS 2016). A tag
    has a border of known black and white cells; a panel of LEDs has none, so the planes are fitted to the
    cells that two clusters take for Off and On, and again to those that the planes do.

    Its inputs are the means of 3 x 3 cells (``cells=3, samples=1``).

    Args:
        sharpening: weight of the Laplacian, at least 0.
        rounds: how often the planes are fitted, at least 1.

    Example:
        >>> grey = torch.tensor([0.2, 0.2, 0.6, 0.7]).view(1, 2, 2, 1)
        >>> TagPlanes(sharpening=0.0).predict(grey.expand(1, 2, 2, 9)).tolist()
        [[[False, False], [True, True]]]
    """

    def __init__(self, sharpening: float = 0.25, rounds: int = 2) -> None:
        self.sharpening, self.rounds = sharpening, rounds

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED by its distance from the plane between black and white."""
        cells = x.to(torch.float64)
        beside = cells[..., [1, 3, 5, 7]].mean(dim=-1)
        own = cells[..., 4]
        sharp = own + self.sharpening * 4 * (own - beside)
        scores = sharp - two_means(sharp.flatten(1)).view(-1, 1, 1)
        for _ in range(self.rounds):
            on = scores >= 0
            scores = sharp - (_plane(sharp, ~on) + _plane(sharp, on)) / 2
        return scores


def _plane(values: Tensor, chosen: Tensor) -> Tensor:
    """Fit a plane over rows and columns to the chosen cells, (B,R,C) both; few give about their mean."""
    down, across = torch.meshgrid(*(_steps(values, size) for size in values.shape[1:]), indexing="ij")
    terms = torch.stack([torch.ones_like(down), down, across], dim=-1).flatten(0, 1)
    weight = chosen.flatten(1).to(values.dtype)
    gram = torch.einsum("bn,ni,nj->bij", weight, terms, terms)
    # A slope costs as much as one cell's misfit, so that three cells in a row do not tilt it.
    gram = gram + torch.diag(values.new_tensor([1e-9, 1.0, 1.0]))
    right = torch.einsum("bn,bn,ni->bi", weight, values.flatten(1), terms)
    level = (torch.linalg.solve(gram, right) @ terms.mT).view_as(values)
    # A class without cells has no level of its own: the panel's mean stands in for it.
    lacking = (weight.sum(dim=1) == 0).view(-1, 1, 1)
    return torch.where(lacking, values.mean(dim=(1, 2), keepdim=True), level)


def _steps(values: Tensor, size: int) -> Tensor:
    """Give ``size`` places from -1 to 1; a single one lies at 0."""
    return (
        torch.linspace(-1, 1, size, dtype=values.dtype, device=values.device)
        if size > 1
        else values.new_zeros(1)
    )
