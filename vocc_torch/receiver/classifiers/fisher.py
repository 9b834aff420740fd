"""Fisher's discriminant on anything that a classifier can see, and the least-squares equaliser beside it."""

from __future__ import annotations

from typing import Self

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.receiver.classifiers.protocol import Batches
from vocc_torch.receiver.discriminant import Discriminant
from vocc_torch.receiver.flda import FLDA


class FldaClassifier:
    """FLDA on the inputs as they are: features, or whole patches.

    Example:
        >>> x = torch.tensor([[[[0.0], [0.1]], [[1.0], [1.2]]]])
        >>> bits = torch.tensor([[[False, False], [True, True]]])
        >>> FldaClassifier().fit(x, bits).predict(x).tolist()
        [[[False, False], [True, True]]]
    """

    def __init__(self) -> None:
        self._rule: Discriminant | None = None

    def fit(self, x: Tensor, bits: Tensor) -> Self:
        """Learn from panels held in memory."""
        self._rule = _solved(FLDA(x.shape[-1]).to(x.device).fit(x, bits))
        return self

    def fit_stream(self, batches: Batches, frames: int) -> Self:
        """Learn from a stream, of which nothing is kept but sums, and of those the rule alone."""
        flda: FLDA | None = None
        for x, bits in batches(0, frames):
            flda = flda or FLDA(x.shape[-1]).to(x.device)
            flda.update(x, bits)
        self._rule = None if flda is None else _solved(flda)
        return self

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED; Eq. 18.

        Raises:
            VoccError: not fitted.
        """
        return _fitted(self._rule).scores(x)

    def predict(self, x: Tensor) -> Tensor:
        """Decide every LED."""
        return self.decision_function(x) >= 0

    @property
    def parameters_count(self) -> int:
        """How many numbers decide: the direction and the threshold."""
        return _fitted(self._rule).direction.numel() + 1


def _solved(flda: FLDA) -> Discriminant:
    """Give what decides, which is to the last bit what the discriminant itself would."""
    # Asked for first: it refuses a missing class, and warns where samples do not determine it.
    device = flda.direction.device
    rule, _ = Discriminant.of(flda.statistics.to(torch.device("cpu")).checked())
    return Discriminant(*(one.detach().to(device, copy=True) for one in rule))


def _fitted(rule: Discriminant | None) -> Discriminant:
    """Refuse a discriminant without samples."""
    if rule is None:
        raise VoccError("it has seen no samples: call fit first")
    return rule


class LmmseEqualizer:
    """Linear minimum-mean-square-error estimate of each bit from the light about it, by distance.

    Where exposures add (``domain=exposure``), the light of a cell is a sum over its neighbours' bits, and the
    estimate of +1 or -1 with the least mean square error among all linear ones is the regression on the
    patch. How far light spreads, in cells, depends on the panel's size in the image; so there is one
    regression for each class of cell size, between quantiles of the training panels, and scores are
    interpolated between the two nearest classes.

    Args:
        classes: how many classes of cell size, at least 1; the last input must be the pitch where above 1.
        ridge: added to the diagonal of the correlation matrix, at least 0, for patches whose values are tied.

    Raises:
        VoccError: a value outside its range.
    """

    def __init__(self, classes: int = 8, ridge: float = 1e-8) -> None:
        if classes < 1 or ridge < 0:
            raise VoccError(
                f"classes is {classes}, ridge is {ridge:g}: they must be at least 1 and at least 0"
            )
        self.classes, self.ridge = classes, ridge
        self._centres: Tensor | None = None
        self._weights: Tensor | None = None

    def fit(self, x: Tensor, bits: Tensor) -> Self:
        """Solve the normal equations of each class in float64."""
        light, size = self._split(x)
        rows = torch.cat([light.double(), torch.ones_like(light[..., :1], dtype=torch.float64)], dim=-1)
        target = bits.double() * 2 - 1
        quantiles = torch.linspace(0, 1, 2 * self.classes + 1, dtype=torch.float64, device=x.device)
        edges = torch.quantile(size.double(), quantiles)
        weights = []
        for place in range(self.classes):
            # Each class learns from its neighbours' panels too: the scores between classes are interpolated.
            low, high = edges[max(0, 2 * place - 1)], edges[min(2 * self.classes, 2 * place + 3)]
            chosen = (size >= low) & (size <= high)
            a, b = rows[chosen].flatten(0, -2), target[chosen].flatten()
            gram = a.mT @ a
            gram = gram + self.ridge * gram.diagonal().mean() * torch.eye(len(gram), device=x.device)
            weights.append(torch.linalg.solve(gram, a.mT @ b))
        self._centres, self._weights = edges[1::2].contiguous(), torch.stack(weights)
        return self

    def decision_function(self, x: Tensor) -> Tensor:
        """Estimate every bit as a number about -1 or +1.

        Raises:
            VoccError: not fitted.
        """
        if self._weights is None or self._centres is None:
            raise VoccError("it has seen no samples: call fit first")
        light, size = self._split(x)
        rows = torch.cat([light.double(), torch.ones_like(light[..., :1], dtype=torch.float64)], dim=-1)
        upper = torch.bucketize(size.double(), self._centres).clamp(1, max(1, self.classes - 1))
        upper = upper.clamp(max=self.classes - 1)
        lower = (upper - 1).clamp(min=0)
        step = (self._centres[upper] - self._centres[lower]).clamp(min=1e-12)
        share = ((size.double() - self._centres[lower]) / step).clamp(0, 1).unsqueeze(-1)
        weights = torch.lerp(self._weights[lower], self._weights[upper], share)
        return (rows * weights[:, None, None]).sum(dim=-1)

    def predict(self, x: Tensor) -> Tensor:
        """Decide every LED."""
        return self.decision_function(x) >= 0

    @property
    def parameters_count(self) -> int:
        """How many numbers decide."""
        return 0 if self._weights is None else self._weights.numel()

    def _split(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Part the light (B,R,C,F) from the panels' cell sizes (B,)."""
        if self.classes == 1:
            return x, x.new_zeros(len(x))
        return x[..., :-1], x[:, 0, 0, -1]
