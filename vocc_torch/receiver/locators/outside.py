"""A locator from outside, held to the protocol."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind, shown
from vocc_torch.plugins import PlugIn, one_line
from vocc_torch.receiver.locators.protocol import PanelLocator
from vocc_torch.types import (
    Candidates,
    Frames,
    Images,
    Panels,
    PanelShape,
    holds,
    kind_of,
)

UNSTATED_LIMIT = 1e-3
"""False alarms at which a panel is found by a function that states them."""


@dataclass(frozen=True)
class OutsideLocator(PanelLocator):
    """A locator from outside: a :class:`PanelLocator`, or a function that gives ``Panels``.

    Args:
        plug_in: its class or function.
    """

    name: ClassVar[str] = "outside"

    plug_in: PlugIn

    @property
    def label(self) -> str:
        """Its name in results."""
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
        found: Candidates = self._answer(
            self._locator.locate, frames, shape, Candidates
        )
        alarms = found.false_alarms
        count = len(alarms) if isinstance(alarms, Tensor) and alarms.ndim == 1 else -1
        if count < 0 or (alarms < 0).any():
            rule = "it must be a tensor (n,) of numbers from 0 on, or NaN where nothing is stated"
            raise VoccError(
                f"locator {self.plug_in.name} gave false_alarms of {shown(alarms)}: {rule}"
            )
        sizes = {"frame": (count,), "corners_px": (count, 4, 2), "score": (count,)}
        for part, size in sizes.items():
            self._demand(part, getattr(found, part), size)
        if count and not 0 <= int(found.frame.min()) <= int(found.frame.max()) < len(
            frames
        ):
            raise VoccError(
                f"locator {self.plug_in.name} saw panels in frames that it was not given"
            )
        self._demand_area(
            found.corners_px, torch.ones(count, dtype=torch.bool, device=alarms.device)
        )
        return Candidates(
            found.frame.long(),
            found.corners_px.double(),
            found.score.double(),
            alarms.double(),
        )

    def __call__(self, frames: Images, shape: PanelShape) -> Panels:
        """Find the panel of each frame.

        Raises:
            VoccError: it fails, or gives anything else than panels, finite and one a frame, or of those that
                it found corners that are not clockwise about an area.
        """
        if self._locator is not None:
            return super().__call__(frames, shape)
        frames = Frames.of(frames)
        panels: Panels = self._answer(self.plug_in.made, frames, shape, Panels)
        kinds = {"found": torch.bool, "score": torch.float64, "candidates": torch.int64}
        for part in Panels.__slots__:
            size = (len(frames), *(() if part in kinds else (4, 2)))
            self._demand(part, getattr(panels, part), size)
        self._demand_area(panels.corners_px, panels.found.bool())
        parts = {
            name: getattr(panels, name).to(kinds.get(name, torch.float64))
            for name in Panels.__slots__
        }
        return replace(panels, **parts)

    def _answer(
        self, call: Callable[..., Any], frames: Frames, shape: PanelShape, kind: type
    ) -> Any:
        """Return its answer as a tensor of the expected type.

        Raises:
            VoccError: it fails, or answers anything else.
        """
        name = f"locator {self.plug_in.name}"
        try:
            answer = call(frames, shape)
        except VoccError:
            raise
        except (Exception, SystemExit) as error:
            raise VoccError(f"{name} failed ({one_line(error)})") from error
        demand_kind(f"{name}: its answer", answer, kind)
        return answer

    def _demand(self, part: str, value: object, size: tuple[int, ...]) -> None:
        """Refuse a part of an answer that is no finite tensor of a size."""
        if (
            not isinstance(value, Tensor)
            or value.shape != size
            or not holds(value.isfinite())
        ):
            said = f"locator {self.plug_in.name} gave {part} of {kind_of(value)}"
            raise VoccError(f"{said}: it must be a finite tensor of {size}")

    def _demand_area(self, corners_px: Tensor, found: Tensor) -> None:
        """Refuse panels that were found with corners (n,4,2) that are not clockwise about an area."""
        x, y = corners_px.double().unbind(2)
        doubled = (x * y.roll(-1, 1) - x.roll(-1, 1) * y).sum(dim=1)
        if not holds((doubled > 0) | ~found):
            rule = "clockwise from the top left, or the panel not found"
            raise VoccError(
                f"locator {self.plug_in.name} gave corners that enclose nothing: they must be {rule}"
            )
