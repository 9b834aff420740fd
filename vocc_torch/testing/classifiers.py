"""The tests that every classifier passes."""

import copy
import pickle
from abc import abstractmethod
from typing import Any, ClassVar

import torch
from torch import Tensor

from vocc_torch.receiver.classifiers import Guarded, Inputs
from vocc_torch.testing.parts import Answer, PartCase


class ClassifierCase(PartCase):
    """Tests of a classifier; a subclass named ``Test...`` writes :meth:`classifier` and :meth:`panels`.

    Attributes:
        least_accuracy: share of the bits of the training panels that it decides rightly.
    """

    least_accuracy: ClassVar[float] = 0.9
    may_round: ClassVar[bool] = True

    @abstractmethod
    def classifier(self) -> Any:
        """Build the classifier, untrained."""

    @abstractmethod
    def panels(self) -> tuple[Tensor, Tensor]:
        """Give at least four panels to learn from: (B,R,C,F) float32 and the bits (B,R,C) bool."""

    def scored(self) -> tuple[Any, Tensor, Tensor]:
        """Train it on the panels, and score them."""
        classifier, (x, bits) = self.classifier(), self.panels()
        torch.manual_seed(0)
        classifier.fit(x, bits)
        return classifier, x, classifier.decision_function(x)

    def asked(self) -> tuple[Answer, Tensor]:
        """Give the scores of a trained classifier, and the panels."""
        classifier, x, _ = self.scored()
        return classifier.decision_function, x

    def assert_right(self, scores: Tensor) -> None:
        """Demand enough right bits of the training panels."""
        right = (scores >= 0) == self.panels()[1]
        assert float(right.double().mean()) >= self.least_accuracy

    def test_it_learns(self) -> None:
        """Enough bits of its training panels are right, and training writes into neither inputs nor bits."""
        panels, classifier = self.panels(), self.classifier()
        before = copy.deepcopy(panels)
        classifier.fit(*panels)
        assert all(map(torch.equal, panels, before))
        self.assert_right(classifier.decision_function(panels[0]))

    def test_every_led_has_a_score(self) -> None:
        """Scores are (B,R,C) real numbers, more than one; ``predict`` says On where they are at least 0."""
        classifier, x, scores = self.scored()
        assert scores.shape == x.shape[:-1]
        assert scores.is_floating_point()
        assert float(scores.std()) > 0
        assert torch.equal(classifier.predict(x) != 0, scores >= 0)

    def test_copies_score_alike(self) -> None:
        """Deep copies, and what another process gets."""
        classifier, x, scores = self.scored()
        sent = pickle.loads(pickle.dumps(classifier))
        for other in (copy.deepcopy(classifier), sent):
            assert torch.equal(other.decision_function(x), scores)

    def test_training_again_forgets_the_first(self) -> None:
        """Trained on other panels and then on these, it is as trained on these."""
        x, bits = self.panels()
        classifier = self.classifier()
        for part in (slice(len(x) // 2, None), slice(None)):
            torch.manual_seed(0)
            classifier.fit(x[part], bits[part])
        torch.testing.assert_close(classifier.decision_function(x), self.scored()[2])

    def test_other_panels_are_scored(self) -> None:
        """Inputs of zeros have finite scores, and a panel may have half as many rows."""
        classifier, x, _ = self.scored()
        assert classifier.decision_function(torch.zeros_like(x[:1])).isfinite().all()
        half = x[:, : x.shape[1] // 2]
        assert classifier.decision_function(half).shape == half.shape[:-1]

    def test_the_guard_takes_it(self) -> None:
        """The package's own checks pass, and scores are float64."""
        classifier, x, scores = self.scored()
        guarded = Guarded("case", classifier, Inputs())
        torch.testing.assert_close(guarded.decision_function(x), scores.double())

    def test_it_learns_from_a_stream(self) -> None:
        """Panels that come in batches train it as well."""
        x, bits = self.panels()
        halves = [(x[part::2], bits[part::2]) for part in (0, 1)]
        guarded = Guarded("case", self.classifier(), Inputs())
        guarded.fit_stream(lambda first, count: iter(halves), len(x))
        self.assert_right(guarded.decision_function(x))
