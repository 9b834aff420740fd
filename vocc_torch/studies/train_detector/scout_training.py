"""Training of the scout: crops of every level, half of them without a panel, mined where the scout errs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from vocc_torch.receiver.detector import scout
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.studies.train_detector.pool import Example


@dataclass(frozen=True)
class ScoutTraining:
    """Settings of the training."""

    crop_px: int = 96
    batch: int = 64
    rate: float = 3e-3  # of learning, at the beginning; it falls to nothing
    least_pitch_px: float = 1.75  # of LEDs in the level where a panel is to be found
    most_pitch_px: float = 4.4
    spare: float = 1.5  # pitches so many times beyond count as neither
    near_px: float = 6.0  # outputs so near a panel's centre are to find it
    spare_share: float = 0.45  # of a panel's side: outputs within count as neither
    mined_score: float = -2.5  # false candidates of higher scores are mined
    mined: int = 3  # of a level of a frame, at most
    mined_frames: int = 1200  # that are looked at each time
    least_mined_px: int = 32  # sides of a level
    mined_share: float = 0.35  # of a batch
    found_share: float = 0.5  # of a batch, crops with a panel
    gain: tuple[float, float] = (0.4, 1.7)
    offset: float = 40.0  # grey values, at most
    noise: float = 6.0  # grey values, at most
    noisy: float = 0.4  # share of crops with noise
    corner_weight: float = 1.5


SETTINGS = ScoutTraining()


class Place(NamedTuple):
    """A crop's frame and level, and the middle of what it is to show, px of the level."""

    example: int
    level: int
    x: float
    y: float


class Crops(NamedTuple):
    """Crops (B,1,S,S), corners (B,4,2) px in the crop, and the kind (B,): 1 a panel, 0 none, -1 neither."""

    grey: Tensor
    quads: Tensor
    kind: Tensor


class Sampler:
    """Draws crops from a pool of frames.

    Args:
        examples: the pool.
    """

    def __init__(self, examples: Sequence[Example]) -> None:
        self.examples = examples
        self.levels = [
            [
                level.round().to(torch.uint8).numpy()
                for level in Pyramid.of(one.grey).levels
            ]
            for one in examples
        ]
        self.panels: list[Place] = []
        for number, one in enumerate(examples):
            if not one.readable:
                continue
            for level in range(len(self.levels[number])):
                pitch = one.pitch_px / 2**level
                if SETTINGS.least_pitch_px <= pitch <= SETTINGS.most_pitch_px:
                    centre = one.corners_px.mean(0) / 2**level
                    self.panels.append(
                        Place(number, level, float(centre[0]), float(centre[1]))
                    )
        self.mined: list[Place] = []

    def batch(self, draw: np.random.Generator) -> Crops:
        """Draw a batch of augmented crops."""
        crops = []
        for _ in range(SETTINGS.batch):
            luck = draw.random()
            if luck < SETTINGS.found_share:
                place = self.panels[draw.integers(len(self.panels))]
            elif luck < SETTINGS.found_share + SETTINGS.mined_share and self.mined:
                place = self.mined[draw.integers(len(self.mined))]
            else:
                number = int(draw.integers(len(self.examples)))
                level = min(int(draw.geometric(0.5)) - 1, len(self.levels[number]) - 1)
                high, wide = self.levels[number][level].shape
                place = Place(
                    number, level, draw.uniform(0, wide), draw.uniform(0, high)
                )
            crops.append(self.crop(place, draw))
        return Crops(*(torch.stack(part) for part in zip(*crops, strict=True)))

    def crop(self, place: Place, draw: np.random.Generator) -> Crops:
        """Cut one crop and augment it."""
        side, plane = SETTINGS.crop_px, self.levels[place.example][place.level]
        corner = []
        for middle, length in ((place.x, plane.shape[1]), (place.y, plane.shape[0])):
            start = round(middle - side / 2 + draw.uniform(-0.4, 0.4) * side)
            corner.append(
                min(max(start, 0), length - side)
                if length >= side
                else (length - side) // 2
            )
        left, top = corner
        cut = plane[
            max(top, 0) : max(top + side, 0), max(left, 0) : max(left + side, 0)
        ]
        grey = np.full((side, side), cut.mean(), np.float32)
        row, column = max(-top, 0), max(-left, 0)
        grey[row : row + cut.shape[0], column : column + cut.shape[1]] = cut
        low, high = SETTINGS.gain
        gain = math.exp(draw.uniform(math.log(low), math.log(high)))
        noise = draw.uniform(0, SETTINGS.noise) * (draw.random() < SETTINGS.noisy)
        light = (
            grey * gain
            + draw.uniform(-1, 1) * SETTINGS.offset
            + noise * draw.standard_normal(grey.shape)
        )
        one = self.examples[place.example]
        quad = one.corners_px.float() / 2**place.level - torch.tensor(
            [float(left), float(top)]
        )
        kind = kind_of(one, place.level)
        plane_out = torch.from_numpy(light.clip(0, 255).astype(np.float32))
        if draw.random() < 0.5:
            plane_out, quad = (
                plane_out.flip(1),
                (quad * torch.tensor([-1.0, 1.0]) + torch.tensor([side, 0.0]))[
                    [1, 0, 3, 2]
                ],
            )
        if draw.random() < 0.5:
            plane_out, quad = (
                plane_out.flip(0),
                (quad * torch.tensor([1.0, -1.0]) + torch.tensor([0.0, side]))[
                    [3, 2, 1, 0]
                ],
            )
        if draw.random() < 0.5:
            plane_out, quad = plane_out.mT, quad.flip(1)[[0, 3, 2, 1]]
        return Crops(plane_out[None].contiguous(), quad, torch.tensor(kind))

    def mine(self, net: scout.Scout, draw: np.random.Generator) -> None:
        """Find places without a panel that the scout takes for one."""
        self.mined = []
        for number in draw.permutation(len(self.examples))[
            : SETTINGS.mined_frames
        ].tolist():
            one = self.examples[number]
            for level, plane in enumerate(self.levels[number]):
                if min(plane.shape) < SETTINGS.least_mined_px:
                    continue
                high, wide = (side // 16 * 16 for side in plane.shape)
                out = net(torch.from_numpy(plane[:high, :wide]).float()[None, None])
                _, quads, score = scout.peaks(out, SETTINGS.mined)
                centre = quads.mean(1)
                good = score > SETTINGS.mined_score
                if not one.empty:
                    truth = one.corners_px.float() / 2**level
                    size = float((truth[0] - truth[2]).norm())
                    good &= (centre - truth.mean(0)).norm(dim=1) > 0.7 * size
                self.mined += [
                    Place(number, level, *map(float, at))
                    for at in centre[good].tolist()
                ]


def kind_of(example: Example, level: int) -> int:
    """Say whether a panel is to be found in a level: 1, 0 or -1 for neither."""
    if example.empty:
        return 0
    pitch = example.pitch_px / 2**level
    least, most = SETTINGS.least_pitch_px, SETTINGS.most_pitch_px
    if least <= pitch <= most:
        return 1 if example.readable else -1
    return 0 if pitch < least / SETTINGS.spare or pitch > most * SETTINGS.spare else -1


def scout_loss(outputs: Tensor, crops: Crops) -> Tensor:
    """Give the focal loss of scores and the distance of corners where a panel is."""
    high, wide = outputs.shape[2:]
    stride = scout.SETTINGS.stride_px
    row, column = torch.meshgrid(torch.arange(high), torch.arange(wide), indexing="ij")
    places = torch.stack([column, row], -1)
    centre = crops.quads.mean(1)[:, None, None]
    apart = ((places + 0.5) * stride - centre).norm(dim=3)
    size = (crops.quads[:, 0] - crops.quads[:, 2]).norm(dim=1)[:, None, None]
    kind = crops.kind[:, None, None]
    spare = (apart < SETTINGS.spare_share * size) & (kind != 0)
    nearest = apart <= apart.flatten(1).amin(1)[:, None, None].clamp(min=1e-3)
    inside = ((centre > 0) & (centre < high * stride)).all(3)
    there = (
        (kind == 1)
        & inside
        & ((apart < SETTINGS.near_px) | (nearest & (apart < stride)))
    )
    logit = outputs[:, 0]
    found = logit.sigmoid()
    missed = (1 - found).square() * functional.logsigmoid(logit)
    false = found.square() * functional.logsigmoid(-logit)
    cost = -torch.where(
        there, missed, torch.where(spare, 0.0, false)
    ).sum() / there.sum().clamp(min=1)
    picture, y, x = there.nonzero(as_tuple=True)
    quads = scout.quads_of(outputs[picture, :, y, x], torch.stack([x, y], 1))
    # Of small panels a pixel is more of a cell.
    unit = scout.SETTINGS.unit_px * (size[picture, 0, 0] / 30)[:, None, None]
    off = functional.smooth_l1_loss(
        quads / unit, crops.quads[picture] / unit, beta=0.05
    )
    loss: Tensor = cost + SETTINGS.corner_weight * off * 8
    return loss


def train_steps(
    net: scout.Scout,
    optimiser: torch.optim.Optimizer,
    sampler: Sampler,
    seed: int,
    steps: range,
    whole: int,
) -> float:
    """Take some steps of a training of ``whole`` steps, and give their mean loss."""
    total = 0.0
    net.train()
    for step in steps:
        draw = np.random.default_rng((seed, step))
        crops = sampler.batch(draw)
        for group in optimiser.param_groups:
            group["lr"] = (
                SETTINGS.rate
                * min(1.0, (step + 1) / 100)
                * (1 + math.cos(math.pi * step / whole))
                / 2
            )
        loss = scout_loss(net(crops.grey), crops)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(net.parameters(), 5.0)
        optimiser.step()
        total += float(loss.detach())
    return total / max(len(steps), 1)
