"""The tests that parts of every kind pass: batches, order, repetition, and no side effect."""

from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar, TypeAlias

import torch
from torch import Tensor

Answer: TypeAlias = Callable[[Tensor], Tensor]
"""What a part says of a batch (B,...): a row for each of its rows."""


class PartCase:
    """Tests of any part; a case of a kind writes :meth:`asked`.

    Attributes:
        may_round: whether answers may differ by rounding with the batch.
    """

    may_round: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        """Refuse a test class that leaves a method unwritten: pytest skips abstract classes silently.

        Raises:
            TypeError: it names the methods.
        """
        left = [
            name
            for name in dir(cls)
            if getattr(getattr(cls, name), "__isabstractmethod__", False)
        ]
        if left and cls.__name__.startswith("Test"):
            raise TypeError(f"{cls.__name__} must write {' and '.join(left)}")

    @abstractmethod
    def asked(self) -> tuple[Answer, Tensor]:
        """Give a part, ready to answer, and a batch of at least three rows."""

    def assert_same(self, answer: Tensor, expected: Tensor) -> None:
        """Demand equal answers, but for rounding where that is allowed."""
        exact = None if self.may_round else 0.0
        torch.testing.assert_close(answer, expected, rtol=exact, atol=exact)

    def test_answers_are_finite(self) -> None:
        """No answer is NaN or infinite."""
        answer, batch = self.asked()
        assert answer(batch).isfinite().all()

    def test_a_row_alone_is_answered_as_in_a_batch(self) -> None:
        """The batch changes no answer."""
        answer, batch = self.asked()
        alone = [answer(batch[row : row + 1]) for row in range(len(batch))]
        self.assert_same(torch.cat(alone), answer(batch))

    def test_the_order_changes_nothing(self) -> None:
        """Rows in reverse have the answers in reverse."""
        answer, batch = self.asked()
        self.assert_same(answer(batch.flip(0)).flip(0), answer(batch))

    def test_answering_leaves_no_trace(self) -> None:
        """The batch and torch's generator stay; a second answer, and another such part, are alike."""
        answer, batch = self.asked()
        before, generator = batch.clone(), torch.get_rng_state()
        first = answer(batch)
        assert torch.equal(batch, before)
        assert torch.equal(torch.get_rng_state(), generator)
        assert torch.equal(answer(batch), first)
        assert torch.equal(self.asked()[0](batch), first)

    def test_inference_mode_changes_nothing(self) -> None:
        """Within inference mode the answers are the same."""
        answer, batch = self.asked()
        with torch.inference_mode():
            inside = answer(batch)
        self.assert_same(inside.clone(), answer(batch))

    def test_strided_batches_are_taken(self) -> None:
        """A batch need not be contiguous."""
        answer, batch = self.asked()
        strided = batch.mT.contiguous().mT
        self.assert_same(answer(strided), answer(batch))
