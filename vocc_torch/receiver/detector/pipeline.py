"""The stages of the detector in one frame: propose, judge, place, and look again at what slipped."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector.judge import judged, pitch_of
from vocc_torch.receiver.detector.placer import asides, placed, placed_in_views, slips
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.detector.scout import firsts, propose
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.types import Frames, PanelShape


@dataclass(frozen=True)
class DetectorSettings:
    """How many candidates go how far."""

    judged: tuple[int, ...] = (6, 4)  # left after each look of the judge
    placed: tuple[int, ...] = (4, 3, 3)  # left after each look of the placer
    behind: float = 6.0  # log odds of the best, beyond which others go no further
    likely: float = 1.0  # log odds of a candidate that goes on however good others are
    perspective_leds: int = 16  # of a side, from which perspective stays
    sure_logit: float = 4.0  # a candidate placed so well has not slipped
    least_logit: float = 2.0  # of the judge, of a best candidate that may have slipped
    slipped: tuple[int, ...] = (4, 4)  # slips left after each look of the placer
    aside: float = 3.0  # log odds that a place a cell aside of a sure one may lack
    likelier: float = 1.5  # log odds by which a slip must be better than what is there
    least_pitch_px: float = 1.0  # of LEDs that can be told apart
    apart: float = 0.35  # share of a side: panels whose centres are nearer overlap
    surround_px: int = 32  # of a crop's surround that is seen
    near_looks: int = 2  # of the placer at corners that are nearly known


SETTINGS = DetectorSettings()


def detected(
    networks: Networks, frame: Frames, shape: PanelShape
) -> tuple[Tensor, Tensor]:
    """Detect the panels of one frame.

    Returns:
        (n,4,2) float64 corners on the sensor, and (n,) float64 log odds, the likeliest first, no two of one
        place.
    """
    grey, origin = with_surround(frame)
    quads, odds = candidates(networks, Pyramid.of(grey), shape)
    seen = pitch_of(quads, shape) >= SETTINGS.least_pitch_px
    quads, odds = quads[seen], odds[seen]
    rows = apart(quads, odds)
    return quads[rows] + origin, odds[rows].double()


def placed_near(
    networks: Networks, frame: Frames, corners: Tensor, shape: PanelShape
) -> tuple[Tensor, Tensor]:
    """Correct corners (n,4,2) px of panels that are off by up to a cell in one frame.

    Returns:
        (n,4,2) corners and (n,) log odds, in the order of ``corners``.
    """
    grey, origin = with_surround(frame)
    pyramid, quads = Pyramid.of(grey), corners - origin
    for _ in range(SETTINGS.near_looks):
        _, quads = placed(networks.placer, pyramid, quads, shape)
        quads = flattened(quads, shape)
    odds, quads = placed_in_views(networks.placer, pyramid, quads, shape)
    return quads + origin, odds.double()


def with_surround(frame: Frames) -> tuple[Tensor, Tensor]:
    """Give one frame's grey values (1,1,H,W), a crop with some of its surround, and its origin (2,), px."""
    if frame.surround is None:
        return frame.grey, frame.origin_px[0]
    beyond = SETTINGS.surround_px
    grey = functional.pad(
        frame.grey, (beyond,) * 4, value=float(frame.surround[0].round())
    )
    return grey, frame.origin_px[0] - beyond


class Placed(NamedTuple):
    """Candidates where the placer has put them: corners (n,4,2) px and log odds (n,)."""

    quads: Tensor
    odds: Tensor

    @property
    def best(self) -> Tensor:
        """Corners (4,2) of the likeliest."""
        return self.quads[self.odds.argmax()]

    def joined(self, others: "Placed") -> "Placed":
        """Add those of others that are clearly likelier than all of these."""
        likelier = others.odds > self.odds.amax() + SETTINGS.likelier
        parts = zip(self, others, strict=True)
        return Placed(*(torch.cat([these, those[likelier]]) for these, those in parts))


def candidates(networks: Networks, pyramid: Pyramid, shape: PanelShape) -> Placed:
    """Propose, judge and place the candidates of one frame."""
    options = SETTINGS
    quads, logit, _ = propose(networks.scout, pyramid, shape)
    for count in options.judged:
        logit, quads = judged(networks.judge, pyramid, quads, shape)
        order = likeliest(logit, count)
        quads, logit = flattened(quads[order], shape), logit[order]
    start, likely = quads[0], logit[0]
    found = placed_well(networks, pyramid, quads, shape, options.placed)
    if likely >= options.least_logit and found.odds.amax() < options.sure_logit:
        quads = torch.cat([slips(start, shape), asides(found.best, shape)])
        least, left = float(found.odds.amax()), options.slipped
        found = found.joined(placed_well(networks, pyramid, quads, shape, left, least))
    if found.odds.amax() >= options.sure_logit:
        quads = asides(found.best, shape)
        least = float(found.odds.amax()) - options.aside
        found = found.joined(placed_well(networks, pyramid, quads, shape, (1,), least))
    return found


def placed_well(
    networks: Networks,
    pyramid: Pyramid,
    quads: Tensor,
    shape: PanelShape,
    left: Sequence[int],
    least: float = -math.inf,
) -> Placed:
    """Place candidates (n,4,2) px several times, at last in all views, which score them.

    Args:
        networks: of the detector.
        pyramid: of the frame.
        quads: corners.
        shape: rows and columns.
        left: how many of the best go on after each look.
        least: log odds at the last look; only candidates above it are seen in all views.
    """
    for count in left:
        odds, moved = placed(networks.placer, pyramid, quads, shape)
        order = likeliest(odds, count)
        quads, odds = flattened(moved[order], shape), odds[order]
    quads = quads[odds > least]
    if len(quads):
        odds, quads = placed_in_views(networks.placer, pyramid, quads, shape)
    return Placed(quads, odds[: len(quads)])


def likeliest(odds: Tensor, most: int) -> Tensor:
    """Return the rows of candidates whose log odds (n,) are near the best or high.

    Example:
        >>> likeliest(torch.tensor([-5.0, 9.0, 3.0, 8.0]), 3).tolist()
        [1, 3, 2]
    """
    order = odds.argsort(descending=True, stable=True)[:most]
    odds = odds[order]
    enough = torch.minimum(odds[:1] - SETTINGS.behind, odds.new_tensor(SETTINGS.likely))
    return order[odds >= enough]


def flattened(quads: Tensor, shape: PanelShape) -> Tensor:
    """Reduce the perspective of candidates (n,4,2) of small panels.

    In a small panel the errors of the corners are larger than the perspective, which in cells grows with the
    square of the panel's side.

    Example:
        >>> quads = torch.tensor([[[0.0, 0.0], [4.0, 0.0], [8.0, 4.0], [0.0, 4.0]]])
        >>> flattened(quads, PanelShape(8, 8)).tolist()
        [[[-0.75, 0.0], [4.75, 0.0], [7.25, 4.0], [0.75, 4.0]]]
    """
    side = max(shape.rows, shape.columns) / SETTINGS.perspective_leds
    signs = quads.new_tensor([[1.0], [-1.0], [1.0], [-1.0]])
    perspective = (quads * signs).mean(1, keepdim=True) * signs
    return quads - (1 - min(1.0, side) ** 2) * perspective


def apart(quads: Tensor, odds: Tensor) -> Tensor:
    """Return the rows of candidates, best first, without candidates that overlap a better one."""
    order = odds.argsort(descending=True, stable=True)
    quads = quads[order]
    centre, size = quads.mean(1), (quads[:, 0] - quads[:, 2]).norm(dim=1)
    away = (centre[:, None] - centre).norm(dim=2) / size.clamp(min=1e-6)[:, None]
    return order[firsts(away < SETTINGS.apart, len(order))]
