"""The detector as a locator: three small networks, with stated false alarms."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind, demand_word, finite_number
from vocc_torch.files import file_digest
from vocc_torch.receiver.detector.pipeline import detected, placed_near
from vocc_torch.receiver.detector.weights import (
    ARITHMETICS,
    FLOAT32,
    Networks,
    load_networks,
)
from vocc_torch.receiver.false_alarms import calibrated, demand_stated
from vocc_torch.receiver.locators.paper import PaperLocator, exact_frames
from vocc_torch.receiver.locators.protocol import PARTS_PER_PX, PanelLocator
from vocc_torch.types import (
    Candidates,
    Frames,
    Images,
    PanelShape,
    without_autocast,
)


@dataclass(frozen=True)
class DetectorLocator(PanelLocator):
    """Find panels by three small networks.

    - Gate: tiles of the frame with strong changes from pixel to pixel.
    - Scout: a network that proposes places in a pyramid of halvings.
    - Judge: a network that sees a candidate by its corners, scores it and moves its corners.
    - Placer: a network that sees each cell of a candidate, moves its corners and gives its log odds.

    A table converts the log odds to the expected number of false alarms in a frame without a panel
    (:mod:`vocc_torch.receiver.false_alarms`). ``Panels.score`` is the probability of a panel. Your own
    weights have no table: a candidate is accepted if its probability is at least 0.5.

    Args:
        weights: a file of ``task=train_detector``; None takes the weights that ship.
        false_alarms: accept a candidate if at most this many false alarms are expected in a frame without a
            panel; above 0. Infinity accepts every candidate.
        arithmetic: ``float32``, or ``int8`` for networks of 8 bits, which take less time on a CPU. They need
            the extra ``onnx``; the false alarms stated are those of float32.

    Raises:
        VoccError: a value that is not allowed; when called, weights that are missing or damaged.
    """

    name: ClassVar[str] = "detector"
    finds_several: ClassVar[bool] = True

    weights: str | None = None
    false_alarms: float = 1e-2
    arithmetic: str = FLOAT32

    def __post_init__(self) -> None:
        """Refuse values that are not allowed."""
        demand_word("location.arithmetic", self.arithmetic, ARITHMETICS)
        most = self.false_alarms
        if most != math.inf and finite_number("location.false_alarms", most) <= 0:
            raise VoccError.of("location.false_alarms", self.false_alarms, "above 0")
        if self.weights is not None and most not in (1e-2, math.inf):
            rule = "left out with weights of your own, whose false alarms are unknown"
            raise VoccError.of("location.false_alarms", most, rule)

    @property
    def states_false_alarms(self) -> bool:
        """Whether the weights are those that ship, the only ones with a table of false alarms."""
        return self.weights is None

    @property
    def most_false_alarms(self) -> float:
        """Most expected false alarms of an accepted candidate; NaN with weights of your own."""
        return self.false_alarms if self.weights is None else math.nan

    def networks(self, device: torch.device) -> Networks:
        """Give the networks on a device."""
        file = None if self.weights is None else Path(self.weights)
        return load_networks(file, device, self.arithmetic)

    def demand_shape(self, shape: PanelShape) -> None:
        """Refuse a panel with too few LEDs for the table of false alarms."""
        if self.weights is None and self.false_alarms != math.inf:
            demand_stated(self.name, shape)

    def at_rate(self, false_alarms: float) -> "DetectorLocator":
        """Give the same locator with another rate of false alarms."""
        return replace(self, false_alarms=false_alarms)

    def check(self) -> None:
        """Refuse weights that cannot be read."""
        self.networks(torch.device("cpu"))

    @classmethod
    def of(cls, paper: PaperLocator, false_alarms: float) -> "DetectorLocator":
        """Build it with a rate of false alarms."""
        return cls(false_alarms=false_alarms)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings for a model file; your own weights are given by path and digest."""
        values = {"name": self.name, **asdict(self)}
        if self.weights is None:
            return values
        file = str(Path(self.weights).resolve())
        return {**values, "weights": file, "digest": file_digest(file)}

    @classmethod
    def from_settings(cls, values: Mapping[str, Any]) -> "DetectorLocator":
        """Build it from its settings without the name.

        Raises:
            VoccError: weights that have changed.
        """
        values = dict(values)
        digest = values.pop("digest", "")
        if digest and file_digest(str(values["weights"])) != digest:
            rule = "holds other weights than the model was made with"
            raise VoccError(f"receiver.locator: {values['weights']} {rule}")
        return cls(**values)

    def locate(self, frames: Images, shape: PanelShape) -> Candidates:
        """Return every candidate, also likely false ones; the best of each frame first.

        Raises:
            VoccError: what :func:`~vocc_torch.receiver.locators.paper.exact_frames` refuses, damaged weights,
                or a panel so small that no false alarms are stated of it.
        """
        demand_kind("shape", shape, PanelShape)
        found = self._each(frames, shape, detected)
        own = self.weights is not None and self.false_alarms != math.inf
        return found[found.score >= (0.5 if own else 0.0)]

    def place(self, frame: Images, corners_px: Tensor, shape: PanelShape) -> Candidates:
        """Correct corners (n,4,2) px of panels that are nearly known in one frame, and score them."""
        if not len(corners_px):
            return super().place(frame, corners_px, shape)

        def look(
            networks: Networks, one: Frames, shape: PanelShape
        ) -> tuple[Tensor, Tensor]:
            return placed_near(networks, one, corners_px.double(), shape)

        return self._each(frame, shape, look)

    def _each(
        self,
        frames: Images,
        shape: PanelShape,
        look: Callable[[Networks, Frames, PanelShape], tuple[Tensor, Tensor]],
    ) -> Candidates:
        """Look at frame by frame: what is found does not depend on how many come together."""
        exact = exact_frames(frames)
        device = exact.grey.device
        self.demand_shape(shape)
        table = None if self.weights else calibrated(self.name, shape)
        networks = self.networks(device)
        none = torch.zeros(0, dtype=torch.float64, device=device)
        found = [Candidates(none.long(), none.new_zeros(0, 4, 2), none, none)]
        with torch.inference_mode(), without_autocast(device):
            for number in range(len(exact) if exact.grey.numel() else 0):
                quads, odds = look(networks, exact[number : number + 1], shape)
                alarms = torch.full_like(odds, math.nan if self.weights else math.inf)
                alarms = alarms if table is None else table.expected(odds)
                corners = (quads * PARTS_PER_PX).round() / PARTS_PER_PX
                rows = torch.full_like(odds, number, dtype=torch.int64)
                found.append(Candidates(rows, corners, odds.sigmoid(), alarms))
        return Candidates.cat(found).each(torch.clone)


def networks_of(locator: object, device: torch.device) -> Networks:
    """Give the networks of a locator that is a detector, and those that ship for any other."""
    if isinstance(locator, DetectorLocator):
        return locator.networks(device)
    return load_networks(None, device)
