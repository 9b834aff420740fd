"""Rules in closed form: Fisher's, the least-squares equaliser, and rules that part each panel by itself."""

from collections.abc import Mapping
from typing import Self

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, finite_number, whole_number
from vocc_torch.receiver import discriminant, foreground
from vocc_torch.receiver.classifiers.protocol import Batches, Classifier, fitted
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.levels import two_levels

MOST_ROUNDS = 100
"""Most rounds of a fit: after a few nothing changes."""


class FldaClassifier(Classifier):
    """FLDA on the inputs as they are: features, or whole patches.

    Example:
        >>> x = torch.tensor([[[[0.0], [0.1]], [[1.0], [1.2]]]])
        >>> bits = torch.tensor([[[False, False], [True, True]]])
        >>> FldaClassifier().fit(x, bits).predict(x).tolist()
        [[[False, False], [True, True]]]
    """

    def __init__(self) -> None:
        self._rule: discriminant.Discriminant | None = None

    def fit(self, x: Tensor, bits: Tensor) -> Self:
        """Learn from panels held in memory."""
        return self.fit_stream(lambda first, count: iter([(x, bits)]), len(x))

    def fit_stream(self, batches: Batches, frames: int) -> Self:
        """Fit from a stream in one pass. Only running sums are held in memory."""
        flda: FLDA | None = None
        for x, bits in batches(0, frames):
            flda = flda or FLDA(x.shape[-1]).to(x.device)
            flda.update(x, bits)
        self._rule = None if flda is None else flda.rule
        return self

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED; Eq. 18.

        Raises:
            VoccError: not fitted.
        """
        return fitted(self._rule).scores(x)

    def state_dict(self) -> dict[str, Tensor]:
        """The learned state: direction, threshold and centre."""
        return fitted(self._rule)._asdict()

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Take up what :meth:`state_dict` gave."""
        self._rule = discriminant.Discriminant(**state)

    @property
    def parameters_count(self) -> int:
        """How many numbers decide: the direction and the threshold."""
        return fitted(self._rule).direction.numel() + 1


class LmmseEqualizer(Classifier):
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
                f"classes is {classes}, ridge is {ridge:g}: at least 1 and 0 are allowed"
            )
        self.classes, self.ridge = classes, ridge
        self._centres: Tensor | None = None
        self._weights: Tensor | None = None

    def fit(self, x: Tensor, bits: Tensor) -> Self:
        """Solve the normal equations of each class in float64."""
        rows, size = self._split(x)
        target = bits.double() * 2 - 1
        quantiles = torch.linspace(
            0, 1, 2 * self.classes + 1, dtype=torch.float64, device=x.device
        )
        edges = torch.quantile(size.double(), quantiles)
        weights = []
        for place in range(self.classes):
            # Each class learns from its neighbours' panels too: the scores between classes are interpolated.
            low, high = (
                edges[max(0, 2 * place - 1)],
                edges[min(2 * self.classes, 2 * place + 3)],
            )
            chosen = (size >= low) & (size <= high)
            a, b = rows[chosen].flatten(0, -2), target[chosen].flatten()
            gram = a.mT @ a
            gram = gram + self.ridge * gram.diagonal().mean() * torch.eye(
                len(gram), device=x.device
            )
            weights.append(torch.linalg.solve(gram, a.mT @ b))
        self._centres, self._weights = edges[1::2].contiguous(), torch.stack(weights)
        return self

    def decision_function(self, x: Tensor) -> Tensor:
        """Estimate every bit as a number about -1 or +1.

        Raises:
            VoccError: not fitted.
        """
        weights, centres = fitted(self._weights), fitted(self._centres)
        rows, size = self._split(x)
        # With a single class the upper limit is below the lower one, and clamp takes the upper.
        upper = (size.double()[:, None] > centres).sum(1).clamp(1, self.classes - 1)
        lower = (upper - 1).clamp(min=0)
        step = (centres[upper] - centres[lower]).clamp(min=1e-12)
        share = ((size.double() - centres[lower]) / step).clamp(0, 1).unsqueeze(-1)
        weights = torch.lerp(weights[lower], weights[upper], share)
        return (rows * weights[:, None, None]).sum(dim=-1)

    @property
    def parameters_count(self) -> int:
        """How many numbers decide."""
        return 0 if self._weights is None else self._weights.numel()

    def _split(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Split inputs into light and a constant 1, (B,R,C,F) float64, and the panels' cell sizes (B,)."""
        light, size = (
            (x[..., :-1], x[:, 0, 0, -1])
            if self.classes > 1
            else (x, x.new_zeros(x.shape[0]))
        )
        return torch.nn.functional.pad(light, (0, 1), value=1.0).double(), size


class _Untrained(Classifier):
    """What needs no training."""

    parameters_count = 0

    def fit(self, x: Tensor, bits: Tensor) -> Self:
        """Learn nothing."""
        return self

    def fit_stream(self, batches: object, frames: int) -> Self:
        """Learn nothing, and ask for no frames."""
        return self


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
        threshold = foreground.otsu_threshold(foreground.histogram256(greys))
        # Otsu's foreground begins above the threshold's whole grey value.
        return (x.double().mean(dim=-1) * 255.0) - (threshold.view(-1, 1, 1) + 0.5)


class PanelKMeans(_Untrained):
    """Two clusters of the panel's cell means. Inputs as for :class:`PanelOtsu`, or one sample a cell.

    Example:
        >>> PanelKMeans().predict(torch.tensor([0.2, 0.2, 0.6, 0.7]).view(1, 2, 2, 1)).tolist()
        [[[False, False], [True, True]]]
    """

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED by its distance from the middle between the clusters."""
        means = x.double().mean(dim=-1)
        return means - two_levels(means.flatten(1))[0].view(-1, 1, 1)


class TagPlanes(_Untrained):
    """The idea of AprilTag's cell reader, carried over to LEDs.

    A black and a white level that may slope over the panel, as two planes over its rows and columns, and a
    Laplacian across cells against the light of neighbours (Wang and Olson, "AprilTag 2", IROS 2016). A tag
    has a border of known black and white cells; a panel of LEDs has none, so the planes are fitted to the
    cells that two clusters take for Off and On, and again to those that the planes do.

    Its inputs are the means of 3 x 3 cells (``cells=3, samples=1``).

    Args:
        sharpening: weight of the Laplacian, at least 0.
        rounds: how often the planes are fitted, 1 to 100.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> grey = torch.tensor([0.2, 0.2, 0.6, 0.7]).view(1, 2, 2, 1)
        >>> TagPlanes(sharpening=0.0).predict(grey.expand(1, 2, 2, 9)).tolist()
        [[[False, False], [True, True]]]
    """

    def __init__(self, sharpening: float = 0.25, rounds: int = 2) -> None:
        finite_number("sharpening", sharpening)
        whole_number("rounds", rounds, 1, MOST_ROUNDS)
        self.sharpening, self.rounds = sharpening, rounds

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED by its distance from the plane between black and white."""
        cells = x.double()
        beside = cells[..., [1, 3, 5, 7]].mean(dim=-1)
        centre = cells[..., 4]
        sharp = centre + self.sharpening * 4 * (centre - beside)
        scores = sharp - two_levels(sharp.flatten(1))[0].view(-1, 1, 1)
        for _ in range(self.rounds):
            on = scores >= 0
            scores = sharp - (_plane(sharp, ~on) + _plane(sharp, on)) / 2
        return scores


def _plane(values: Tensor, chosen: Tensor) -> Tensor:
    """Fit a plane over rows and columns to the chosen cells, (B,R,C) both; few give about their mean."""
    down, across = torch.meshgrid(
        *(_steps(values, size) for size in values.shape[1:]), indexing="ij"
    )
    terms = torch.stack([torch.ones_like(down), down, across], dim=-1).flatten(0, 1)
    weight = chosen.flatten(1).to(values.dtype)
    gram = torch.einsum("bn,ni,nj->bij", weight, terms, terms)
    # A slope costs as much as one cell's misfit, so that three cells in a row do not tilt it.
    gram = gram + torch.diag(values.new_tensor([1e-9, 1.0, 1.0]))
    right = torch.einsum("bn,bn,ni->bi", weight, values.flatten(1), terms)
    # By Cramer's rule, in closed form.
    first, second, third = gram.unbind(1)
    cofactors = [
        torch.linalg.cross(*pair)
        for pair in ((second, third), (third, first), (first, second))
    ]
    slopes = torch.einsum("bi,bij->bj", right, torch.stack(cofactors, 1))
    determinant = (first * cofactors[0]).sum(1, keepdim=True)
    level = (slopes / determinant @ terms.mT).view_as(values)
    # A class without cells has no level of its own: the panel's mean stands in for it.
    lacking = (weight.sum(dim=1) == 0).view(-1, 1, 1)
    return torch.where(lacking, values.mean(dim=(1, 2), keepdim=True), level)


def _steps(values: Tensor, size: int) -> Tensor:
    """Return ``size`` places from -1 to 1; a single one lies at 0."""
    ends = (-1, 1) if size > 1 else (0, 0)
    return torch.linspace(*ends, size, dtype=values.dtype, device=values.device)
