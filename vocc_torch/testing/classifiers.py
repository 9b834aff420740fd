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

    def fitted(self) -> Any:
        """Train it on the panels."""
        x, bits = self.panels()
        classifier = self.classifier()
        torch.manual_seed(0)
        classifier.fit(x, bits)
        return classifier

    def scored(self) -> tuple[Any, Tensor, Tensor]:
        """Train it, and score the panels."""
        classifier, (x, _) = self.fitted(), self.panels()
        return classifier, x, classifier.decision_function(x)

    def asked(self) -> tuple[Answer, Tensor]:
        """Give the scores of a trained classifier, and the panels."""
        return self.fitted().decision_function, self.panels()[0]

    def test_it_learns(self) -> None:
        """Enough bits of its training panels are right."""
        _, _, scores = self.scored()
        assert (
            float(((scores >= 0) == self.panels()[1]).double().mean())
            >= self.least_accuracy
        )

    def test_every_led_has_a_score(self) -> None:
        """Scores are (B,R,C) real numbers."""
        _, x, scores = self.scored()
        assert scores.shape == x.shape[:-1]
        assert scores.is_floating_point()

    def test_scores_differ(self) -> None:
        """Scores are more than one number."""
        assert float(self.scored()[2].std()) > 0

    def test_decisions_are_the_signs_of_scores(self) -> None:
        """``predict`` says On where the score is at least 0."""
        classifier, x, scores = self.scored()
        assert torch.equal(classifier.predict(x) != 0, scores >= 0)

    def test_what_it_is_given_stays_as_it_is(self) -> None:
        """Neither training nor scoring writes into inputs or bits."""
        x, bits = self.panels()
        before = x.clone(), bits.clone()
        classifier = self.classifier()
        classifier.fit(x, bits)
        classifier.decision_function(x)
        assert torch.equal(x, before[0])
        assert torch.equal(bits, before[1])

    def test_it_can_be_sent_to_another_process(self) -> None:
        """Pickled and read back it scores alike."""
        classifier, x, scores = self.scored()
        assert torch.equal(
            pickle.loads(pickle.dumps(classifier)).decision_function(x), scores
        )

    def test_a_copy_scores_alike(self) -> None:
        """A deep copy is independent and equal."""
        classifier, x, scores = self.scored()
        assert torch.equal(copy.deepcopy(classifier).decision_function(x), scores)

    def test_training_again_forgets_the_first(self) -> None:
        """Trained on other panels and then on these, it is as trained on these."""
        x, bits = self.panels()
        classifier = self.classifier()
        for part in (slice(len(x) // 2, None), slice(None)):
            torch.manual_seed(0)
            classifier.fit(x[part], bits[part])
        torch.testing.assert_close(classifier.decision_function(x), self.scored()[2])

    def test_black_panels_have_finite_scores(self) -> None:
        """Inputs of zeros are scored."""
        classifier, x, _ = self.scored()
        assert classifier.decision_function(torch.zeros_like(x[:1])).isfinite().all()

    def test_one_panel_may_have_another_number_of_leds(self) -> None:
        """Half of the rows are scored too."""
        classifier, x, _ = self.scored()
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
        guarded = Guarded("case", self.classifier(), Inputs())
        guarded.fit_stream(
            lambda first, count: iter([(x[::2], bits[::2]), (x[1::2], bits[1::2])]),
            len(x),
        )
        right = (guarded.decision_function(x) >= 0) == bits
        assert float(right.double().mean()) >= self.least_accuracy
