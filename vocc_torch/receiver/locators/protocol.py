"""The protocol of locators: frames and the panel's shape in, candidates with scores out."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, ClassVar, Self

from torch import Tensor

from vocc_torch.types import Candidates, Frames, Images, Panels, PanelShape

if TYPE_CHECKING:
    from vocc_torch.receiver.locators.paper import PaperLocator


PARTS_PER_PX = 1024.0
"""Corners are rounded to such parts of a pixel, for the same numbers on every machine."""


class PanelLocator(ABC):
    """Find panels in frames; a subclass is a frozen dataclass of its settings and has :meth:`locate`.

    Receivers that share a locator locate once, so it must be hashable, as a frozen dataclass is.

    Attributes:
        name: in configurations and results.
        finds_several: whether a frame's candidates may all be panels, to be read and followed.
        exportable: whether it can be drawn as an ONNX graph.

    Example:
        >>> from dataclasses import dataclass
        >>> @dataclass(frozen=True)
        ... class Middle(PanelLocator):
        ...     name = "middle"
        ...     side_px: float = 8.0
        ...
        ...     def locate(self, frames, shape):
        ...         height, width = frames.grey.shape[-2:]
        ...         corners = torch.tensor([[0, 0], [1, 0], [1, 1], [0, 1]]).double() * self.side_px
        ...         corners = corners + (torch.tensor([width, height]) - self.side_px) / 2
        ...         return Candidates.of(corners.expand(len(frames), 4, 2), torch.ones(len(frames)).double())
        >>> import torch
        >>> Middle()(Frames.whole(torch.zeros(1, 20, 20)), PanelShape(8, 8)).corners_px[0, 0].tolist()
        [6.0, 6.0]
    """

    name: ClassVar[str]
    finds_several: ClassVar[bool] = False
    exportable: ClassVar[bool] = False

    @abstractmethod
    def locate(self, frames: Images, shape: PanelShape) -> Candidates:
        """Give every candidate for a panel of ``shape``, the best of each frame first.

        Args:
            frames: B frames or crops of them; a crop's ``origin_px`` says where it lies on the sensor, and
                its ``surround`` is the grey of all that is not in it.
            shape: rows and columns of the panel.
        """

    def place(self, frame: Images, corners_px: Tensor, shape: PanelShape) -> Candidates:
        """Correct corners (n,4,2) px of panels that are nearly known in one frame; only some locators can.

        Returns:
            A candidate for each, in their order; by default none.
        """
        return Candidates.of(corners_px[:0], corners_px[:0, 0, 0])

    def __call__(self, frames: Images, shape: PanelShape) -> Panels:
        """Take the best candidate of each frame; zero corners and score where there is none."""
        frames = Frames.of(frames)
        return self.locate(frames, shape).panels(len(frames), self.most_false_alarms)[1]

    @property
    def states_false_alarms(self) -> bool:
        """Whether it says how many false alarms to expect in a frame without a panel."""
        return False

    @property
    def most_false_alarms(self) -> float:
        """Most expected false alarms of an accepted candidate; NaN if all candidates are accepted."""
        return math.nan

    def demand_shape(self, shape: PanelShape) -> None:  # noqa: B027  # few locators have a limit
        """Refuse a panel shape for which the locator has no false-alarm rates."""

    def at_rate(self, false_alarms: float) -> Self:
        """Give the same locator with another rate of false alarms.

        Raises:
            NotImplementedError: it states none.
        """
        raise NotImplementedError

    def check(self) -> None:  # noqa: B027  # few locators have files
        """Refuse files of its own that cannot be read."""

    @classmethod
    def of(cls, paper: "PaperLocator", false_alarms: float) -> Self:
        """Build the locator from the keys of all locators: limits of blobs, and a false-alarm rate."""
        return cls()

    @property
    def settings(self) -> dict[str, Any]:
        """What a model file keeps of it; :meth:`from_settings` reads it back."""
        return {"name": self.name, **asdict(self)}  # type: ignore[call-overload]  # subclasses are dataclasses

    @classmethod
    def from_settings(cls, values: Mapping[str, Any]) -> Self:
        """Build it from its settings without the name."""
        return cls(**values)
