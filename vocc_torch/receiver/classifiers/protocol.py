"""The protocol of classifiers, and a guard that turns their errors into one line with their name."""

import io
import pickle
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.plugins import PlugIn, blamed
from vocc_torch.receiver.classifiers.inputs import Inputs
from vocc_torch.receiver.reader import Readings
from vocc_torch.types import holds, kind_of

R = TypeVar("R")

AGREEING_PANELS = 4
"""Panels on which ``predict`` is held against the scores, once in each process."""


class Classifier(Protocol):
    """What a classifier has to offer; ``x`` is (B,R,C,F) float32, of B whole panels."""

    def fit(self, x: Tensor, bits: Tensor) -> object:
        """Learn from panels ``x`` with their bits (B,R,C) bool; one that needs no training does nothing."""

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED, (B,R,C); at least 0 is On."""

    def predict(self, x: Tensor) -> Tensor:
        """Decide every LED, (B,R,C) bool; as good as ``decision_function(x) >= 0``."""
        return self.decision_function(x) >= 0


Batches = Callable[[int, int], Iterator[tuple[Tensor, Tensor]]]
"""Training panels, the same ones each time.

Of ``first`` and ``count`` it gives panels ``first`` to ``first + count`` as batches of ``x`` (B,R,C,F) and bits
(B,R,C).
"""


class Guarded:
    """A classifier under its name, held to the protocol.

    Args:
        name: its name in results and refusals.
        classifier: follows :class:`Classifier`.
        inputs: what it sees of each LED.
        plug_in: what it was built from, or None; another process reads its file first.

    Raises:
        VoccError: it lacks ``fit`` or ``decision_function``.

    Example:
        >>> Guarded("mine", object(), Inputs())
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: classifier mine is of type object without fit, which it must have
    """

    def __init__(
        self,
        name: str,
        classifier: object,
        inputs: Inputs,
        plug_in: PlugIn | None = None,
    ) -> None:
        kind = type(classifier).__name__
        for method in ("fit", "decision_function"):
            if not callable(getattr(classifier, method, None)):
                raise VoccError(
                    f"classifier {name} is of type {kind} without {method}, which it must have"
                )
        self.name = name
        self.inputs = inputs
        self.plug_in = plug_in
        self.classifier: Classifier = classifier  # type: ignore[assignment]  # checked just above
        self._agreed = False

    @property
    def features(self) -> tuple[str, ...]:
        """Measurements that it needs."""
        return self.inputs.features

    def score(self, readings: Readings, preambles: object = None) -> Tensor:
        """Score every LED of located panels, (B,R,C) float64; at least 0 is On."""
        return self.decision_function(self.inputs.of(readings))

    def fit(self, x: Tensor, bits: Tensor) -> None:
        """Train on panels held in memory.

        Raises:
            VoccError: the classifier raised an error, which is named.
        """
        self._guarded("fit", lambda: self.classifier.fit(x, bits))

    def fit_stream(self, batches: Batches, frames: int) -> None:
        """Train from a stream; a classifier without ``fit_stream`` gets ``frames`` panels at once.

        Raises:
            VoccError: as :meth:`fit`.
        """
        if fit_stream := getattr(self.classifier, "fit_stream", None):
            self._guarded("fit_stream", lambda: fit_stream(batches, frames))
        else:
            self.fit(*joined(batches(0, frames)))

    def decision_function(self, x: Tensor) -> Tensor:
        """Score every LED, (B,R,C) float64.

        Raises:
            VoccError: the classifier raised an error, gave another shape or scores that are not finite, or
                ``predict`` says otherwise than its scores.
        """
        scores, predict = self._scores(x), getattr(self.classifier, "predict", None)
        if not self._agreed and callable(predict):
            some = x[:AGREEING_PANELS]
            decided, own_scores = (
                self._answer("predict", predict, some),
                self._scores(some),
            )
            # A score of 0 may be both.
            if apart := int(
                (((decided != 0) != (own_scores >= 0)) & (own_scores != 0)).sum()
            ):
                refusal = f"classifier {self.name}: predict says otherwise at {apart} of {own_scores.numel()} LEDs"
                raise VoccError(
                    f"{refusal}: it must be On where decision_function is at least 0, else Off"
                )
        self._agreed = True
        return scores

    def _scores(self, x: Tensor) -> Tensor:
        """Score, and check what came."""
        scores = self._answer("decision_function", self.classifier.decision_function, x)
        refusal = f"classifier {self.name}: decision_function gave"
        # Bits for scores would all be On: none is below 0.
        if (
            scores.layout != torch.strided
            or scores.dtype == torch.bool
            or scores.is_complex()
        ):
            raise VoccError(
                f"{refusal} {scores.dtype}, {scores.layout}, it must give dense real numbers"
            )
        if not holds(torch.isfinite(scores)):
            raise VoccError(f"{refusal} scores that are not finite")
        return scores.detach().double()

    def _answer(self, what: str, call: Callable[[Tensor], Tensor], x: Tensor) -> Tensor:
        """Call a method on ``x``; refuse a result that is not one number per LED."""
        answer: object = self._guarded(what, lambda: call(x))
        expected = tuple(x.shape[:-1])
        if not isinstance(answer, Tensor) or answer.shape != expected:
            raise VoccError(
                f"classifier {self.name}: {what} gave {kind_of(answer)}, not a tensor of shape {expected}"
            )
        return answer

    def to(self, device: torch.device) -> "Guarded":
        """Copy it to a device, with every tensor that the classifier holds."""
        packed = io.BytesIO()
        torch.save(self.classifier, packed)
        packed.seek(0)
        # Packed two lines above, so there is nothing in it that was not here.
        classifier = torch.load(packed, map_location=device, weights_only=False)
        return Guarded(self.name, classifier, self.inputs, self.plug_in)

    def __reduce__(self) -> tuple[Callable[..., "Guarded"], tuple[object, ...]]:
        """Pickle it with the file that its class comes from."""
        return _unpacked, (
            self.name,
            pickle.dumps(self.classifier),
            self.inputs,
            self.plug_in,
        )

    def _guarded(self, what: str, call: Callable[[], R]) -> R:
        """Call the classifier; its errors become one line that begins with its name."""
        try:
            with blamed(what):
                return call()
        except VoccError as error:
            raise VoccError(f"classifier {self.name}: {error}") from error


def fitted(learned: R | None) -> R:
    """Give what a classifier learned, or refuse one that has not."""
    if learned is None:
        raise VoccError("it has seen no samples: call fit first")
    return learned


def joined(batches: Iterable[tuple[Tensor, Tensor]]) -> tuple[Tensor, Tensor]:
    """Join batches of panels and their bits in memory."""
    x, bits = map(torch.cat, zip(*batches, strict=True))
    return x, bits


def leds(x: Tensor) -> Tensor:
    """Flatten the LEDs of all panels to rows, (N,F) float32."""
    return x.reshape(-1, x.shape[-1]).float()


def _unpacked(
    name: str, packed: bytes, inputs: Inputs, plug_in: PlugIn | None
) -> Guarded:
    """Unpickle a guarded classifier; the file that defines its class is read first."""
    if plug_in is not None and plug_in.file is not None:
        plug_in.file.module()
    return Guarded(name, pickle.loads(packed), inputs, plug_in)
