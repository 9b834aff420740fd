"""A locator from outside, held to the protocol."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind, shown
from vocc_torch.plugins import PlugIn, blamed
from vocc_torch.receiver.locators.protocol import PanelLocator
from vocc_torch.types import (
    Candidates,
    Frames,
    Images,
    Panels,
    PanelShape,
    finite_tensor,
    holds,
)

UNSTATED_LIMIT = 1e-3
"""False alarms at which a panel is found by a function that states them."""


KINDS = {
    "frame": torch.int64,
    "corners_px": torch.float64,
    "found": torch.bool,
    "score": torch.float64,
    "candidates": torch.int64,
}
"""Types of what panels and candidates hold."""

Answer = TypeVar("Answer", Panels, Candidates)


@dataclass(frozen=True)
class OutsideLocator(PanelLocator):
    """A locator from outside: a :class:`PanelLocator`, or a function that gives ``Panels``.

    Args:
        plug_in: its class or function.
    """

    plug_in: PlugIn

    @property
    def name(self) -> str:  # type: ignore[override]  # each plug-in has its own
        """Its name in configurations and results."""
        return self.plug_in.name

    @property
    def _locator(self) -> PanelLocator | None:
        """The object where it follows the protocol itself."""
        return (
            self.plug_in.made if isinstance(self.plug_in.made, PanelLocator) else None
        )

    @property
    def finds_several(self) -> bool:  # type: ignore[override]  # it is asked of the object
        """Whether a frame's candidates may all be panels."""
        return self._locator is not None and self._locator.finds_several

    @property
    def exportable(self) -> bool:  # type: ignore[override]  # it is asked of the object
        """Whether it says of itself, by ``exportable = True``, that it can be in a graph."""
        return getattr(self.plug_in.made, "exportable", False) is True

    @property
    def states_false_alarms(self) -> bool:
        """Whether it says how many false alarms to expect."""
        return self._locator is not None and self._locator.states_false_alarms

    @property
    def most_false_alarms(self) -> float:
        """The most at which a candidate is a panel.

        Raises:
            VoccError: a locator whose own limit is no number above 0.
        """
        limit: Any = (
            UNSTATED_LIMIT if self._locator is None else self._locator.most_false_alarms
        )
        if isinstance(limit, bool) or not isinstance(limit, int | float) or limit <= 0:
            key = f"locator {self.plug_in.name}: its most_false_alarms"
            raise VoccError.of(key, shown(limit), "a number above 0, or NaN")
        return float(limit)

    @property
    def settings(self) -> dict[str, Any]:
        """What a model file keeps of it."""
        return self.plug_in.settings

    def locate(self, frames: Images, shape: PanelShape) -> Candidates:
        """Give every candidate.

        Raises:
            VoccError: it fails, or gives what is no candidate of these frames.
        """
        frames = Frames.of(frames)
        if self._locator is None:
            return Candidates.of_panels(self(frames, shape))
        found = self._answer(self._locator.locate, frames, shape, Candidates)
        if not holds((found.frame >= 0) & (found.frame < len(frames))):
            raise VoccError(
                f"locator {self.plug_in.name} saw panels in frames that it was not given"
            )
        return found

    def __call__(self, frames: Images, shape: PanelShape) -> Panels:
        """Find the panel of each frame.

        Raises:
            VoccError: it fails, or gives anything else than panels, finite and one a frame, or of those that
                it found corners that are not clockwise about an area.
        """
        if self._locator is not None:
            return super().__call__(frames, shape)
        return self._answer(self.plug_in.made, Frames.of(frames), shape, Panels)

    def _answer(
        self,
        call: Callable[..., Any],
        frames: Frames,
        shape: PanelShape,
        kind: type[Answer],
    ) -> Answer:
        """Return its answer with every part in its type.

        Raises:
            VoccError: it fails, or answers anything else, a part is no finite tensor of its size, or panels
                were found with corners that are not clockwise about an area.
        """
        name = f"locator {self.plug_in.name}"
        said, parts = f"{name} gave", dict[str, Tensor]()
        with blamed(name):
            answer = call(frames, shape)
        demand_kind(f"{name}: its answer", answer, kind)
        count = frames.grey.shape[0]
        if isinstance(answer, Candidates):
            alarms = answer.false_alarms
            is_column = isinstance(alarms, Tensor) and alarms.ndim == 1
            if not is_column or (alarms < 0).any():
                rule = (
                    "a tensor (n,) of numbers from 0 on, or NaN where nothing is stated"
                )
                raise VoccError(
                    f"{said} false_alarms of {shown(alarms)}: it must be {rule}"
                )
            count, parts["false_alarms"] = len(alarms), alarms.double()
        for part in filter(kind.__dataclass_fields__.__contains__, KINDS):
            size = (count, 4, 2) if part == "corners_px" else (count,)
            value = finite_tensor(f"{said} {part} of", getattr(answer, part), size)
            parts[part] = value.to(KINDS[part])
        x, y = parts["corners_px"].unbind(2)
        doubled = (x * y.roll(-1, 1) - x.roll(-1, 1) * y).sum(dim=1)
        if not holds((doubled > 0) | ~parts.get("found", doubled < math.inf)):
            rule = "clockwise from the top left, or the panel not found"
            raise VoccError(f"{said} corners that enclose nothing: they must be {rule}")
        checked: Answer = replace(answer, **parts)
        return checked
