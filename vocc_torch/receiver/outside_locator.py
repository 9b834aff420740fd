"""What a locator is, and one from outside, held to that."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind, shown
from vocc_torch.plugins import PlugIn, one_line
from vocc_torch.types import Frames, Images, Panels, PanelShape, Sightings, StatedPanels, holds

MOST_FALSE_ALARMS = 1e-3
"""A panel is found where no more are expected in a frame without one, of a locator that says no limit."""


class PanelLocator(Protocol):
    """What finds panels: any callable of frames and the panel's shape."""

    def __call__(self, frames: Frames, shape: PanelShape, /) -> Panels:
        """Find the panel of ``shape`` in each frame.

        Args:
            frames: B frames or crops of them; a crop's ``origin_px`` says where it lies on the sensor, and
                its ``surround`` is the grey of all that is not in it.
            shape: rows and columns of the panel.

        Returns:
            Corners in the sensor's coordinates, and whether each panel was found.

        A locator may have ``sightings`` of the same arguments, too, which gives
        :class:`~vocc_torch.types.Sightings`: then several panels of a frame can be read and followed.
        """

    def __hash__(self) -> int:
        """Hash it: receivers that share a locator locate once."""


def allowed_by(locator: object) -> float:
    """Give the false alarms a frame without a panel that a locator allows; NaN of one that states none.

    Example:
        >>> allowed_by(len)
        0.001
    """
    own = getattr(locator, "false_alarms", MOST_FALSE_ALARMS)
    return float(getattr(locator, "allowed_false_alarms", own))


@dataclass(frozen=True)
class OutsideLocator:
    """A locator from outside, held to the protocol under its name.

    Args:
        plug_in: its class or function.
    """

    plug_in: PlugIn

    @property
    def allowed_false_alarms(self) -> float:
        """What its class says by ``false_alarms``, of a frame without a panel; else 1e-3."""
        own = getattr(self.plug_in.made, "false_alarms", MOST_FALSE_ALARMS)
        if isinstance(own, bool) or not isinstance(own, int | float) or not own > 0:
            key = f"locator {self.plug_in.name}: its false_alarms"
            raise VoccError.of(key, shown(own), "a number above 0")
        return float(own)

    @property
    def sightings(self) -> Callable[[Images, PanelShape], Sightings]:
        """See every panel, where its class does; else there is no such attribute."""
        see = self.plug_in.made.sightings

        def sightings(frames: Images, shape: PanelShape) -> Sightings:
            frames = Frames.of(frames)
            seen: Sightings = self._answer(see, frames, shape, Sightings)
            alarms = seen.false_alarms
            many = len(alarms) if isinstance(alarms, Tensor) and alarms.ndim == 1 else -1
            if many < 0 or (alarms < 0).any():
                rule = "it must be a tensor (n,) of numbers from 0 on, or NaN where nothing is stated"
                raise VoccError(f"locator {self.plug_in.name} gave false_alarms of {shown(alarms)}: {rule}")
            sizes = {"frame": (many,), "corners_px": (many, 4, 2), "score": (many,)}
            for part, size in sizes.items():
                self._demand(part, getattr(seen, part), size)
            if many and not 0 <= int(seen.frame.min()) <= int(seen.frame.max()) < len(frames):
                raise VoccError(f"locator {self.plug_in.name} saw panels in frames that it was not given")
            self._demand_area(seen.corners_px, torch.ones(many, dtype=torch.bool, device=alarms.device))
            return Sightings(
                seen.frame.long(), seen.corners_px.double(), seen.score.double(), alarms.double()
            )

        return sightings

    def _answer(self, call: Callable[..., Any], frames: Frames, shape: PanelShape, kind: type) -> Any:
        """Give what it answers, of a kind.

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

    def _demand(self, part: str, given: object, size: tuple[int, ...]) -> None:
        """Refuse a part of an answer that is no finite tensor of a size."""
        if not isinstance(given, Tensor) or given.shape != size or not holds(given.isfinite()):
            got = tuple(given.shape) if isinstance(given, Tensor) else type(given).__name__
            rule = f"it must be a finite tensor of {size}"
            raise VoccError(f"locator {self.plug_in.name} gave {part} of {got}: {rule}")

    def _demand_area(self, corners_px: Tensor, found: Tensor) -> None:
        """Refuse panels that were found with corners (n,4,2) that are not clockwise about an area."""
        x, y = corners_px.double().unbind(2)
        doubled = (x * y.roll(-1, 1) - x.roll(-1, 1) * y).sum(dim=1)
        if not holds((doubled > 0) | ~found):
            rule = "clockwise from the top left, or the panel not found"
            raise VoccError(
                f"locator {self.plug_in.name} gave corners that enclose nothing: they must be {rule}"
            )

    def __call__(self, frames: Images, shape: PanelShape) -> Panels:
        """Find panels as :class:`PanelLocator` says.

        Raises:
            VoccError: it fails, or gives anything else than panels, finite and one a frame, or of those that
                it found corners that are not clockwise about an area.
        """
        frames = Frames.of(frames)
        panels: Panels = self._answer(self.plug_in.made, frames, shape, Panels)
        kinds = {"found": torch.bool, "score": torch.float64, "candidates": torch.int64}
        for part in Panels.__slots__:
            size = (frames.grey.shape[0], *(() if part in kinds else (4, 2)))
            self._demand(part, getattr(panels, part), size)
        self._demand_area(panels.corners_px, panels.found.bool())
        held = {part: getattr(panels, part).to(kinds.get(part, torch.float64)) for part in Panels.__slots__}
        if isinstance(panels, StatedPanels):
            return StatedPanels(**held, false_alarms=panels.false_alarms)
        return Panels(**held)
