"""What others wrote as a classifier of LEDs: a torch module, or a scikit-learn estimator."""

import sys
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.plugins import blamed
from vocc_torch.receiver.classifiers.protocol import Batches, Scored, fitted, joined
from vocc_torch.receiver.classifiers.training import (
    Checkpoint,
    TrainingRecipe,
    train_module,
)
from vocc_torch.types import kind_of


class TorchClassifier(Scored):
    """Train a module to score LEDs, with inputs brought to mean 0 and spread 1.

    The module gets (N,F) float32 and gives (N,) or (N,1), trained with the logistic loss, so that a score is
    the logarithm of the odds of On. Everything random comes from the recipe's seed; torch's own generator is
    left as it was.
    Where the recipe names a folder of checkpoints, an interrupted training goes on from its last pass and
    ends with the very weights of one that nobody disturbed; ``earlier_s`` says how long it had taken.

    Args:
        module: an ``torch.nn.Module``.
        recipe: how it is trained.

    Example:
        >>> x = torch.linspace(0, 1, 64).view(16, 4).T.reshape(4, 4, 4, 1)
        >>> recipe = TrainingRecipe(frames=4, epochs=200, patience=200, validation=0.25, learning_rate=0.5)
        >>> net = TorchClassifier(torch.nn.Linear(1, 1), recipe).fit(x, x[..., 0] > 0.5)
        >>> net.predict(torch.tensor([0.1, 0.9]).view(1, 1, 2, 1)).tolist()
        [[[False, True]]]
    """

    def __init__(
        self, module: torch.nn.Module, recipe: TrainingRecipe | None = None
    ) -> None:
        self.module = module
        self.recipe = recipe or TrainingRecipe()
        self.losses: list[float] = []
        self.earlier_s = 0.0
        self._scale: tuple[Tensor, Tensor] | None = None

    def fit_stream(self, batches: Batches, frames: int) -> Self:
        """Train on ``recipe.frames`` panels of the stream, independently of the study's budget."""
        return self.fit(*joined(batches(0, self.recipe.frames)))

    def fit(self, x: Tensor, bits: Tensor) -> Self:
        """Learn from panels (B,R,C,F); the last of them are held back for validation.

        Raises:
            VoccError: fewer than two panels, a module with nothing to learn or whose ``forward`` fails, or a
                loss that is not finite.
        """
        if not any(parameter.requires_grad for parameter in self.module.parameters()):
            raise VoccError(
                "the module has nothing that learns: use a class with fit and decision_function"
            )
        held_out = max(1, round(self.recipe.validation * len(x)))
        if len(x) <= held_out:
            raise VoccError(
                f"{len(x)} training panels are too few to hold {held_out} back for validation"
            )
        begin = bits[:-held_out].numel()
        rows, held_rows = _leds(x).tensor_split([begin])
        target, held_target = bits.reshape(-1).float().tensor_split([begin])
        spread = rows.std(dim=0)
        self._scale = rows.mean(dim=0), torch.where(spread > 0, spread, 1.0)
        self.module.to(x.device)
        recipe, checkpoint = self.recipe, None
        if recipe.checkpoints is not None:
            checkpoint = Checkpoint(recipe.checkpoints, self.module, recipe, [x, bits])
        with torch.random.fork_rng(
            devices=[x.device] if x.device.type == "cuda" else []
        ):
            torch.manual_seed(recipe.seed)
            self.losses, self.earlier_s = train_module(
                self.module,
                self._score,
                [rows, target, held_rows, held_target],
                recipe,
                checkpoint,
            )
        return self

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED by the logarithm of the odds of On.

        Raises:
            VoccError: not fitted, or the module fails or gives another number of scores.
        """
        self.module.eval()
        with torch.inference_mode():
            scores = self._score(_leds(x))
        return scores.reshape(x.shape[:-1]).double()

    @property
    def parameters_count(self) -> int:
        """How many numbers decide."""
        return sum(parameter.numel() for parameter in self.module.parameters())

    def state_dict(self) -> dict[str, Tensor]:
        """The learned state: the module's parameters and the scale of the inputs.

        Raises:
            VoccError: not fitted.
        """
        mean, spread = fitted(self._scale)
        learned = self.module.state_dict(prefix="module.")
        return {**learned, "mean": mean, "spread": spread}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Take up what :meth:`state_dict` gave."""
        module_state = {
            name.partition(".")[2]: value
            for name, value in state.items()
            if "." in name
        }
        self.module.load_state_dict(module_state)
        self._scale = state["mean"], state["spread"]

    def _score(self, rows: Tensor) -> Tensor:
        """Return the module's score of each row, (N,), or refuse another number of them."""
        mean, spread = fitted(self._scale)
        with blamed(f"forward on {tuple(rows.shape)}"):
            scores = self.module((rows - mean) / spread)
        if not isinstance(scores, Tensor) or scores.numel() != rows.shape[0]:
            raise VoccError(
                f"the module gave {kind_of(scores)} for {len(rows)} LEDs: it must give one score each"
            )
        return scores.reshape(-1)


def _leds(x: Tensor) -> Tensor:
    """Flatten the LEDs of all panels to rows, (N,F) float32."""
    return x.reshape(-1, x.shape[-1]).float()


def is_estimator(value: object) -> bool:
    """Whether an object is a scikit-learn estimator, by its methods; scikit-learn is not imported.

    Example:
        >>> is_estimator(torch.nn.Linear(1, 1))
        False
    """
    return callable(getattr(value, "get_params", None)) and callable(
        getattr(value, "fit", None)
    )


class SklearnClassifier:
    """A scikit-learn estimator, a pipeline too; the LEDs of all panels are its samples.

    Args:
        estimator: has ``fit`` and one of ``decision_function``, ``predict_proba`` and ``predict``, taken in
            that order.

    Raises:
        VoccError: it has none of the three, or finds clusters or outliers and no classes.

    Example:
        >>> from sklearn.naive_bayes import GaussianNB
        >>> x = torch.tensor([[[[0.0], [0.1]], [[1.0], [1.2]]]])
        >>> bits = torch.tensor([[[False, False], [True, True]]])
        >>> SklearnClassifier(GaussianNB()).fit(x, bits).predict(x).tolist()
        [[[False, False], [True, True]]]
    """

    # Any class that follows scikit-learn's conventions.
    def __init__(self, estimator: Any) -> None:
        ways = ("decision_function", "predict_proba", "predict")
        if not any(hasattr(estimator, way) for way in ways):
            raise VoccError(
                f"{type(estimator).__name__} must have {', '.join(ways[:2])} or {ways[2]}"
            )
        if _is_no_classifier(estimator):
            raise VoccError(
                f"{type(estimator).__name__} finds clusters or outliers: it must be a classifier"
            )
        self.estimator = estimator

    def fit(self, x: Tensor, bits: Tensor) -> Self:
        """Fit the estimator on all LEDs."""
        self.estimator.fit(
            _leds(x).cpu().numpy(), bits.reshape(-1).cpu().numpy().astype(np.int64)
        )
        return self

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED: the estimator's score, or its probability of On or its prediction less a half.

        Raises:
            VoccError: probabilities that are not those of Off and On.
        """
        rows = _leds(x).cpu().numpy()
        if hasattr(self.estimator, "decision_function"):
            scores = self.estimator.decision_function(rows)
        elif hasattr(self.estimator, "predict_proba"):
            shares = np.asarray(self.estimator.predict_proba(rows))
            if shares.shape != (len(rows), 2):
                raise VoccError(
                    f"predict_proba gave {shares.shape}, it must give {(len(rows), 2)}"
                )
            scores = shares[:, 1] - 0.5
        else:
            scores = np.asarray(self.estimator.predict(rows)) - 0.5
        return _as_leds(np.asarray(scores, dtype=np.float64), x)

    def predict(self, x: Tensor) -> Tensor:
        """Decide every LED, as the estimator itself does."""
        if not hasattr(self.estimator, "predict"):
            return self.decision_function(x) >= 0
        return _as_leds(
            np.asarray(self.estimator.predict(_leds(x).cpu().numpy())) > 0.5, x
        )

    @property
    def parameters_count(self) -> int | None:
        """How many numbers decide: a linear estimator's weights and intercepts; None of another."""
        # A pipeline decides by its last step; a scaler before it makes no more decisions.
        last = getattr(self.estimator, "steps", [(None, self.estimator)])[-1][1]
        if not hasattr(last, "coef_"):
            return None
        return int(np.size(last.coef_) + np.size(last.intercept_))


def _as_leds(given: NDArray[Any], x: Tensor) -> Tensor:
    """Return an estimator's answers as (B,R,C); the guard refuses another number of them, by name."""
    answers = torch.as_tensor(given)
    fits = answers.numel() == x.shape[:-1].numel()
    return answers.reshape(x.shape[:-1]).to(x.device) if fits else answers


def _is_no_classifier(estimator: Any) -> bool:
    """Whether scikit-learn knows an estimator to be something else; it is not imported for that."""
    base = sys.modules.get("sklearn.base")
    if base is None or not isinstance(estimator, base.BaseEstimator):
        return False
    return bool(base.is_clusterer(estimator) or base.is_outlier_detector(estimator))


def scaled(estimator: Any) -> Any:
    """Put a scikit-learn estimator behind a scaler to mean 0 and spread 1, in one pipeline.

    Example:
        >>> from sklearn.svm import LinearSVC
        >>> [name for name, _ in scaled(LinearSVC()).steps]
        ['standardscaler', 'linearsvc']
    """
    # Imported here, because scikit-learn is an extra.
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    return make_pipeline(StandardScaler(), estimator)
