"""The stages of the detector in one frame: propose, judge, fit, and weigh what was seen."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector.clues import clues_of
from vocc_torch.receiver.detector.fit import fitted
from vocc_torch.receiver.detector.judge import judged, pitch_of
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.detector.scout import propose
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.types import Frames, PanelShape


@dataclass(frozen=True)
class DetectorSettings:
    """How many candidates go how far."""

    # Candidates that are left when the judge has moved their corners.
    judged: tuple[int, ...] = (8, 4, 3)
    samples: int = 4  # along a cell's side, of what is weighed
    apart: float = 0.35  # share of a side: panels whose centres are nearer overlap
    surround_px: int = 32  # of a crop's surround that is seen


SETTINGS = DetectorSettings()


@dataclass(frozen=True, slots=True)
class Fitted:
    """Fitted candidates of one frame: corners (n,4,2) float64 px, and clues (n,CLUES)."""

    quads: Tensor
    clues: Tensor


def detected(
    networks: Networks, frame: Frames, shape: PanelShape
) -> tuple[Tensor, Tensor]:
    """Detect the panels of one frame.

    Returns:
        (n,4,2) float64 corners on the sensor, and (n,) float64 log odds, the likeliest first, no two of one
        place.
    """
    grey, origin = with_surround(frame)
    found = candidates(networks, Pyramid.of(grey), shape)
    odds = networks.verdict(found.clues).double()
    rows = apart(found.quads, odds)
    return found.quads[rows] + origin, odds[rows]


def with_surround(frame: Frames) -> tuple[Tensor, Tensor]:
    """Give one frame's grey values (1,1,H,W), a crop with some of its surround, and its origin (2,), px."""
    if frame.surround is None:
        return frame.grey, frame.origin_px[0]
    beyond = SETTINGS.surround_px
    grey = functional.pad(
        frame.grey, (beyond,) * 4, value=float(frame.surround[0].round())
    )
    return grey, frame.origin_px[0] - beyond


def candidates(networks: Networks, pyramid: Pyramid, shape: PanelShape) -> Fitted:
    """Propose, judge and fit the candidates of one frame."""
    quads, proposal = propose(networks.scout, pyramid)
    logit = proposal
    for count in SETTINGS.judged:
        logit, quads = judged(networks.judge, pyramid, quads)
        order = logit.argsort(descending=True, stable=True)[:count]
        quads, proposal, logit = quads[order], proposal[order], logit[order]
    quads, share = fitted(pyramid, quads, shape)
    facts = torch.stack([proposal.double(), logit.double(), share], 1)
    return Fitted(quads, weighed(networks, pyramid, quads, shape, facts))


def weighed(
    networks: Networks,
    pyramid: Pyramid,
    quads: Tensor,
    shape: PanelShape,
    facts: Tensor,
) -> Tensor:
    """Measure the clues (n,CLUES) of candidates at their last corners.

    Args:
        networks: of which the judge looks once more.
        pyramid: of the frame.
        quads: (n,4,2) px.
        shape: rows and columns.
        facts: (n,3) the scout's score, the judge's before the fit, and the share that the fit explains.
    """
    last, _ = judged(networks.judge, pyramid, quads)
    pitch = pitch_of(quads, shape).log2()
    size = torch.full_like(pitch, math.log2(shape.leds))
    patches = pyramid.read_cells(quads, shape, SETTINGS.samples, 0)
    clues = clues_of(patches, shape, SETTINGS.samples)
    seen = torch.stack([last, pitch, size], 1)
    return torch.cat([facts.float(), seen, clues.float()], 1)


def apart(quads: Tensor, odds: Tensor) -> list[int]:
    """Give the rows of candidates, the likeliest first, without those that overlap a likelier one."""
    order = odds.argsort(descending=True, stable=True).tolist()
    centre, size = quads.mean(1), (quads[:, 0] - quads[:, 2]).norm(dim=1)
    rows: list[int] = []
    for row in order:
        near = [
            float((centre[row] - centre[other]).norm() / size[other].clamp(min=1e-6))
            for other in rows
        ]
        if all(distance >= SETTINGS.apart for distance in near):
            rows.append(row)
    return rows
