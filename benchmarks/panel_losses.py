"""Which step of the learned locator loses panels, in small and photo-like pictures of panels of any shape.

    python benchmarks/panel_losses.py --small 56 --photo 60
    python benchmarks/panel_losses.py --small 28 --photo 30 --yaw 30 50

Photo-like: of 8 to 40 px an LED, cut so that the panel fills 40 to 100 % of either side, every second one
shrunk to 2.2 to 4.5 px an LED. Counted are panels that can be read: of 2 px an LED and more, whole in the
picture, and at the true corners two patterns of cells give their bits, but for one of 128. Located: within
0.25 pitches and at most 1e-3 false alarms. Lost by place: no lattice comes near the truth; by placing: none
of those that are judged twice; by fit: none of the candidates is right; by score: one is, and states more
false alarms. Prints a table.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import torch
from panel_worlds import Kind, world
from streets import MOST_FALSE_ALARMS, NEAR, pitch_of
from torch import Tensor
from train_panel_net import in_cells

from vocc_torch import PanelShape
from vocc_torch.receiver.cell_model import Cells, best_places, fit_cells
from vocc_torch.receiver.false_alarms import demand_stated
from vocc_torch.receiver.lattice_search import Pyramid
from vocc_torch.receiver.locators import learned
from vocc_torch.types import Frames

SHAPES = ((4, 4), (8, 8), (8, 8), (8, 16), (16, 16), (32, 32), (16, 64), (4, 8))
PHOTO_SHAPES = ((4, 4), (8, 8), (8, 8), (8, 16), (16, 16), (16, 64))
LOSSES = ("place", "placing", "fit", "score")
STEPS_PX, TURNED_DEG = (2, 3, 5, 12, 99), 20.0


def small_or_photo(
    photo: bool, blocks: int, seed: int, **seen_from: tuple[float, float]
) -> Iterator[tuple[str, Tensor, Tensor, Tensor]]:
    """Draw pictures (1,H,W) of a panel each: the kind, the picture, its corners (4,2) px, and its bits."""
    draw, shapes = np.random.default_rng(seed), PHOTO_SHAPES if photo else SHAPES
    for block in range(blocks):
        own = (shapes[block % len(shapes)],)
        kind = Kind(own, 800, 4, (8.0, 40.0)) if photo else Kind(own, frames=8)
        drawn = world(seed, block, kind=replace(kind, **seen_from))
        for picture, corners, bits in zip(drawn.grey, drawn.corners_px.double(), drawn.bits, strict=True):
            grey, truth, name = picture.round().to(torch.uint8), corners, "small"
            if truth.any() and photo:
                low, high = truth.amin(0), truth.amax(0)
                around = (high - low) * (1 / draw.uniform(0.4, 1.0) - 1)
                share = torch.from_numpy(draw.random(2))
                start = (low - around * share).floor().clamp(min=0)
                end = (high + around * (1 - share)).ceil().clamp(max=grey.shape[1])
                start = torch.minimum(start, end - 48).clamp(min=0)
                (left, top), (right, bottom) = start.long().tolist(), end.long().tolist()
                grey, truth, name = grey[:, top:bottom, left:right], truth - start, "photo"
                across, down = (truth[1] - truth[0]).norm(), (truth[3] - truth[0]).norm()
                pitch = float(across / own[0][1] + down / own[0][0]) / 2
                if draw.random() < 0.5:
                    size = torch.tensor(grey.shape[:0:-1])
                    small = (size * (draw.uniform(2.2, 4.5) / pitch)).round().clamp(min=8).long()
                    shrunk = cv2.resize(grey[0].numpy(), small.tolist(), interpolation=cv2.INTER_AREA)
                    grey, truth, name = (
                        torch.from_numpy(shrunk)[None],
                        truth * (small / size),
                        "photo, shrunk",
                    )
            if truth.any():
                yield name, grey, truth, bits


def readable(scales: Pyramid, truth: Tensor, bits: Tensor, shape: PanelShape) -> bool:
    """Whether a panel is whole in its picture and two patterns of cells at its corners give its bits."""
    size = truth.new_tensor(scales.levels[0].shape[::-1])
    if (
        not ((truth >= -0.01) & (truth <= size + 0.01)).all()
        or pitch_of(truth[None], shape.leds) < STEPS_PX[0]
    ):
        return False
    start = best_places(scales, Cells.at(scales, truth[None], shape), shape, 0)
    wrong = int((fit_cells(scales, start, shape, 0, most_random=0.0).bits[0] != bits).sum())
    return min(wrong, shape.leds - wrong) <= shape.leds // 128


def loss(net: learned.PanelNet, grey: Tensor, scales: Pyramid, truth: Tensor, shape: PanelShape) -> str:
    """Look for a panel, and name the step that lost it; nothing where it is located."""
    quads, score = learned.sighted(net, Frames.whole(grey[None]), shape)
    turned = torch.stack([truth.roll(k, 0) for k in (range(4) if shape.rows == shape.columns else (0, 2))])
    apart = (turned[:, None] - quads).abs().amax((2, 3)).amin(0) / pitch_of(truth[None], shape.leds)
    if len(apart) and apart[0] < NEAR:
        least = demand_stated("learned", shape).score_at(MOST_FALSE_ALARMS)
        return "" if score[0] >= least else "score"
    if (apart < NEAR).any():
        return "score"
    places = learned.spectral_places(scales, shape)
    off = in_cells(places, truth, shape)
    bent = (off - off.mean(1, keepdim=True).round()).norm(dim=2).amax(1)
    far = off.new_tensor([max(3.5, leds / 3 + 0.5) for leds in (shape.columns, shape.rows)])
    if not ((bent < 0.8) & (off.mean(1).abs() < far).all(1)).any():
        return "place"
    reach = learned.reach(shape)
    first = learned.distinct(*learned.placings(net, scales, places, shape, reach), shape, learned._KEPT)
    both = zip(first, learned.placings(net, scales, first[0], shape, 1, moved=True), strict=True)
    quads, logit = (torch.cat(one) for one in both)
    quads, _ = learned.distinct(quads, logit, shape, learned._FITTED, same_cells=learned._FITTED_CELLS)
    return "fit" if (in_cells(quads, truth, shape).norm(dim=2).amax(1) < 0.5).any() else "placing"


def main() -> None:
    """Look, count and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--small", type=int, default=56, help="blocks of eight small pictures")
    parser.add_argument("--photo", type=int, default=60, help="blocks of four photo-like ones")
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--yaw", type=float, nargs=2, default=Kind.yaw_deg, help="degrees, from and to")
    parser.add_argument("--pitch", type=float, nargs=2, default=Kind.pitch_deg)
    given = parser.parse_args()
    seen_from = {"yaw_deg": tuple(given.yaw), "pitch_deg": tuple(given.pitch)}
    torch.set_num_threads(1)
    net, tally = learned.LearnedLocator().net(torch.device("cpu")), Counter[tuple[str, str]]()
    with torch.inference_mode():
        for photo, blocks in ((False, given.small), (True, given.photo)):
            for name, grey, truth, bits in small_or_photo(photo, blocks, given.seed, **seen_from):
                shape = PanelShape(*bits.shape)
                scales = Pyramid.of(grey[None], 3 * min(shape.rows, shape.columns) // 2)
                if not readable(scales, truth, bits, shape):
                    continue
                lost, pitch = loss(net, grey, scales, truth, shape), float(pitch_of(truth[None], shape.leds))
                sides = truth[1] - truth[0], (truth[3] - truth[0]).flip(0)
                turn = max(abs(math.degrees(math.atan2(float(y), float(x)))) for x, y in sides)
                bins = ["all", name, f"{shape.rows} x {shape.columns}"]
                bins += [f"{a} to {b} px" for a, b in pairwise(STEPS_PX) if a <= pitch < b]
                bins += [f"turned by {TURNED_DEG:g} degrees and more"] * (turn >= TURNED_DEG)
                for one in bins:
                    tally[one, lost] += 1
    print(f"| pictures | readable | located | {' | '.join(LOSSES)} |\n{'|---' * (3 + len(LOSSES))}|")
    for one in dict.fromkeys(name for name, _ in tally):
        count = sum(tally[one, lost] for lost in ("", *LOSSES))
        print(
            f"| {one} | {count} | {tally[one, '']} | {' | '.join(str(tally[one, lost]) for lost in LOSSES)} |"
        )


if __name__ == "__main__":
    main()
