"""The recipe of the learned locator's network, which judges placings: simulated frames in, weights out.

    python benchmarks/train_panel_net.py --out learned.json

The places that are judged are those of lattices in the spectra of windows, and about true panels.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from panel_worlds import ASLANT, TRAINING, World, handmade, shaken, world
from torch import Tensor, nn

import vocc_torch as vt
from vocc_torch import PanelShape
from vocc_torch.api import Simulated
from vocc_torch.receiver.cell_model import Cells, read_cells
from vocc_torch.receiver.lattice_search import Pyramid
from vocc_torch.receiver.locators.learned import spectral_places, surrounded
from vocc_torch.receiver.panel_net import CONTEXT, SAMPLES, PanelNet, save_weights
from vocc_torch.receiver.resample import (
    cell_homography,
    cell_size_px,
    corner_cells,
    map_points,
)
from vocc_torch.types import Frames

REACH = 2
SCENES = ("street", "street_night", "dashcam")
STREET_SHAPES = [(8, 8)] * 3 + [(4, 4)] * 2 + [(4, 8), (16, 16), (8, 16)]
PLAIN = [
    ("paper", f"scene.distance_m={distance}") for distance in (30, 50, 60, 70, 80)
] + [("fog",)]
"""Scenes of which crops are seen, as receivers are given them."""
CUT, SLANTED = 0.2, 0.4
"""Share of frames with a panel that are cut close around it, and of blocks of panels seen aslant."""

RIGHT, WRONG, NEAR = 0.4, 0.75, 1.0
"""Cells that corners are off: at most where right, at least where wrong, at most where they are moved."""


class Seen(NamedTuple):
    """Placings of one shape: patches (n,H,W), how true corners are off in cells (n,4,2), and pitches (n,)."""

    patches: Tensor
    off_cells: Tensor
    pitch_px: Tensor


def in_cells(quads: Tensor, truth: Tensor, shape: PanelShape) -> Tensor:
    """Give a panel's corners (4,2) less those of quadrilaterals (n,4,2), in their cells, turned to fit best.

    Where there is no panel, with corners of zeros, all are far off.
    """
    if not truth.any():
        return torch.full_like(quads, 99.0)
    h = torch.linalg.inv_ex(cell_homography(quads, shape).double()).inverse
    seen = torch.cat([truth, torch.ones_like(truth[:, :1])], 1).double() @ h.mT
    turns = range(4) if shape.rows == shape.columns else (0, 2)
    off = torch.stack(
        [(seen[..., :2] / seen[..., 2:]).roll(k, 1) for k in turns]
    ) - corner_cells(shape)
    best = (
        (off - off.mean(2, keepdim=True))
        .norm(dim=3)
        .amax(2)
        .nan_to_num(torch.inf)
        .argmin(0)
    )
    return off[best, torch.arange(len(best))].nan_to_num(99, 99, 99).clamp(-99, 99)


def shaken_places(
    truth: Tensor, shape: PanelShape, draw: np.random.Generator
) -> Tensor:
    """Lay quadrilaterals about true panels (n,4,2): shifted by cells and halves, stretched, turned, bent."""
    count = len(truth)

    def noise(*size: int) -> Tensor:
        return torch.from_numpy(draw.standard_normal((count, *size)))

    rough = torch.from_numpy(draw.choice([0.1, 0.5, 1.0, 1.5], (count, 1, 1)))
    cells = corner_cells(shape).expand(count, 4, 2)
    middle = cells.mean(1, keepdim=True)
    stretch = 8 / max(shape.rows, shape.columns) * rough
    off = (cells - middle) * (1 + stretch * (0.05 * noise(1, 1) + 0.03 * noise(1, 2)))
    angle = 0.04 * rough * noise(1, 1)
    turned = torch.cat(
        [
            off[..., :1] * angle.cos() - off[..., 1:] * angle.sin(),
            off[..., :1] * angle.sin() + off[..., 1:] * angle.cos(),
        ],
        2,
    )
    shift = torch.from_numpy(draw.integers(-REACH, REACH + 1, (count, 1, 2)))
    halves = 0.5 * torch.from_numpy(draw.random((count, 1, 2)) < 0.15)
    places = (
        middle
        + turned
        + rough * (0.12 * noise(4, 2) + 0.15 * noise(1, 2))
        + shift
        + halves
    )
    return map_points(truth, places, shape)


def cut_close(
    grey: Tensor, truth: Tensor, shape: PanelShape, draw: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """Cut a frame (1,H,W) up to 1.5 cells around its panel, as in a close picture; not smaller than 48 px."""
    around = torch.from_numpy(draw.uniform(0.0, 1.5, (2, 2))) * float(
        torch.stack(cell_size_px(truth[None], shape)).max()
    )
    start = (truth.amin(0) - around[0]).floor().clamp(min=0).long().tolist()
    end = (truth.amax(0) + around[1]).ceil().long().tolist()
    if min(last - first for first, last in zip(start, end, strict=True)) < 48:
        return grey, truth
    return grey[:, start[1] : end[1], start[0] : end[0]], truth - truth.new_tensor(
        start
    )


def around(batch: Simulated, shape: PanelShape) -> World:
    """Give crops with what the locator lays around them."""
    seen = [surrounded(batch.frames[row : row + 1]) for row in range(len(batch.frames))]
    corners = torch.stack(
        [
            one - crop.origin_px[0]
            for one, crop in zip(batch.corners_px, seen, strict=True)
        ]
    )
    return World(
        torch.cat([crop.grey for crop in seen]).float(), corners.float(), shape
    )


def seen_in(one: World, draw: np.random.Generator, many: tuple[int, int]) -> Seen:
    """Look at up to so many places of each frame that are nearly the panel's, and at so many others."""
    parts = []
    for number, grey in enumerate(one.grey.round()):
        truth, there = (
            one.corners_px[number].double(),
            bool(one.corners_px[number].any()),
        )
        if there and draw.random() < CUT:
            grey, truth = cut_close(grey, truth, one.shape, draw)
        frame = Frames.whole(grey.to(torch.uint8))
        scales = Pyramid.of(frame.grey, 3 * min(one.shape.rows, one.shape.columns) // 2)
        quads = spectral_places(scales, one.shape)
        off = in_cells(quads, truth, one.shape)
        bent = (off - off.mean(1, keepdim=True).round()).norm(dim=2).amax(1)
        near = (bent < 0.6) & (off.mean(1).abs().amax(1) < REACH + 0.5)
        places = [
            torch.from_numpy(draw.permutation(rows.numpy()))
            for rows in (near.nonzero()[:, 0], (~near).nonzero()[:, 0])
        ]
        quads = quads[
            torch.cat([rows[:most] for rows, most in zip(places, many, strict=True)])
        ]
        if there:
            quads = torch.cat(
                [quads, shaken_places(truth.expand(3, 4, 2), one.shape, draw)]
            )
        quads = quads[quads.isfinite().flatten(1).all(1)]
        off = in_cells(quads, truth, one.shape)
        patches = read_cells(
            scales,
            Cells.at(scales, quads, one.shape),
            one.shape,
            SAMPLES,
            REACH + CONTEXT,
        )
        pitch = (
            torch.stack(cell_size_px(quads, one.shape)).prod(0).sqrt().clamp(0.3, 300)
        )
        parts.append(Seen(patches.half(), off.float(), pitch.float()))
    return Seen(*(torch.cat(part).clone() for part in zip(*parts, strict=True)))


def dataset(seed: int, blocks: int, streets: int) -> dict[PanelShape, Seen]:
    """Look at blocks of small worlds, at whole frames of half of which the panel is absent, and at crops.

    Of each of ``SCENES`` there are as many frames as ``streets``, of each of ``PLAIN`` half as many.
    """
    draw, parts = np.random.default_rng(seed), defaultdict(list)
    with torch.inference_mode():
        for block in range(blocks):
            one = world(
                seed, block, kind=ASLANT if draw.random() < SLANTED else TRAINING
            )
            one = shaken(one, draw) if draw.random() < 0.3 else one
            one = handmade(one, draw) if draw.random() < 0.2 else one
            parts[one.shape].append(seen_in(one, draw, (4, 7)))
        for scene in SCENES if streets else ():
            model = vt.load_scene(scene, "+scene.effects.panel_absent.share=0.5")
            for batch in vt.simulate(
                model, streets, seed, batch=8, point="train_locator streets"
            ):
                shape = PanelShape(*STREET_SHAPES[draw.integers(len(STREET_SHAPES))])
                known = batch.corners_px.float()
                # A panel is told to be none where another shape is looked for: these frames are left out.
                rows = (known == 0).flatten(1).all(1) | (shape == model.panel.shape)
                one = World(batch.frames.grey[rows].float(), known[rows], shape)
                if len(one.grey):
                    parts[shape].append(seen_in(one, draw, (3, 14)))
        for scene in PLAIN if streets else ():
            model = vt.load_scene(*scene)
            for batch in vt.simulate(
                model, streets // 2, seed, batch=8, point="train_locator plain"
            ):
                shape = model.panel.shape
                parts[shape].append(seen_in(around(batch, shape), draw, (3, 14)))
    return {
        shape: Seen(*(torch.cat(one) for one in zip(*part, strict=True)))
        for shape, part in parts.items()
    }


def mirrored(
    seen: Seen, square: bool, draw: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """Mirror patches and true corners, pale them, and add noise, each kind at random."""
    patches, off = seen.patches.float(), seen.off_cells
    if draw.random() < 0.5:
        patches, off = (
            patches.flip(2),
            (off * torch.tensor([-1.0, 1.0]))[:, [1, 0, 3, 2]],
        )
    if draw.random() < 0.5:
        patches, off = (
            patches.flip(1),
            (off * torch.tensor([1.0, -1.0]))[:, [3, 2, 1, 0]],
        )
    if square and draw.random() < 0.5:
        patches, off = patches.mT, off.flip(2)[:, [0, 3, 2, 1]]
    gain = torch.from_numpy(draw.uniform(0.3, 1.0, (len(patches), 1, 1))).float()
    patches = patches * gain + (1 - gain) * float(draw.uniform(0, 60))
    if draw.random() < 0.4:
        patches = patches + torch.randn(patches.shape) * float(draw.uniform(0.2, 5))
    return patches.contiguous(), off


def apart_cells(off_cells: Tensor, many: int) -> tuple[Tensor, Tensor]:
    """Give what is left of (n,4,2) in each of P x P placings, (n,P,P,4,2), and the most of it, (n,P,P)."""
    steps = torch.arange(many) - many // 2
    down, right = torch.meshgrid(steps, steps, indexing="ij")
    left = off_cells[:, None, None] - torch.stack([right, down], 2)[None, :, :, None]
    return left, left.norm(dim=4).amax(3)


def panel_loss(judged: Tensor, off_cells: Tensor) -> Tensor:
    """How wrong logits of placings (n,9,P,P) are, and the moves of those that are nearly right."""
    left, wrong = apart_cells(off_cells, judged.shape[-1])
    wanted, logit = (wrong < RIGHT).float(), judged[:, 0]
    cost = nn.functional.binary_cross_entropy_with_logits(
        logit, wanted, reduction="none"
    )
    cost = (
        cost
        * ((wrong < RIGHT) | (wrong > WRONG))
        * (0.2 + (logit.sigmoid() - wanted).abs())
        * (1 + 4 * wanted)
    )
    near = wrong < NEAR
    moves = judged[:, 1:].unflatten(1, (4, 2)).permute(0, 3, 4, 1, 2)[near]
    apart = (
        nn.functional.smooth_l1_loss(moves, left[near], beta=0.1, reduction="sum") / 8
    )
    return cost.sum() / len(logit) + apart / near.sum().clamp(min=1)


def trained(
    net: PanelNet, data: dict[PanelShape, Seen], minutes: float, rate: float, seed: int
) -> None:
    """Train for so many minutes of this process's own time, at a rate that falls to nothing."""
    draw, shapes = np.random.default_rng(seed), list(data)
    share = np.array([len(data[one].pitch_px) for one in shapes]) ** 0.7
    optimiser = torch.optim.AdamW(net.parameters(), rate, weight_decay=1e-3)
    begun, steps, mean = time.process_time(), 0, 0.0
    while (done := (time.process_time() - begun) / max(60 * minutes, 1e-9)) < 1:
        shape = shapes[draw.choice(len(shapes), p=share / share.sum())]
        seen = data[shape]
        many = max(8, min(64, 2**18 // seen.patches[0].numel()))
        rows = torch.from_numpy(draw.integers(0, len(seen.pitch_px), many))
        patches, off = mirrored(
            Seen(*(one[rows] for one in seen)), shape.rows == shape.columns, draw
        )
        for group in optimiser.param_groups:
            group["lr"] = (
                rate * min(1.0, (steps + 1) / 100) * (1 + math.cos(math.pi * done)) / 2
            )
        loss = panel_loss(net(patches, seen.pitch_px[rows], shape), off)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(net.parameters(), 5.0)
        optimiser.step()
        steps, mean = (
            steps + 1,
            0.98 * mean + 0.02 * float(loss.detach())
            if steps
            else float(loss.detach()),
        )
        if steps % 400 == 0:
            print(f"  step {steps}, {100 * done:.0f} %, loss {mean:.4f}", flush=True)


def main() -> None:
    """Look, train, and write the weights."""
    shown = argparse.ArgumentDefaultsHelpFormatter
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0], formatter_class=shown
    )
    parser.add_argument("--out", type=Path, required=True, help="file of the weights")
    parser.add_argument(
        "--blocks", type=int, default=200, help="blocks of 16 small frames, at least 1"
    )
    parser.add_argument(
        "--streets", type=int, default=120, help="whole frames a scene, 0 or at least 2"
    )
    parser.add_argument(
        "--minutes", type=float, default=9.0, help="processor time of the training"
    )
    parser.add_argument("--seed", type=int, default=11, help="of every draw")
    given = parser.parse_args()
    if (
        given.blocks < 1
        or given.streets == 1
        or given.streets < 0
        or not given.minutes > 0
    ):
        parser.error(
            "--blocks must be at least 1, --streets 0 or at least 2, --minutes above 0"
        )
    if not given.out.resolve().parent.is_dir():
        parser.error(f"--out is {given.out}: its folder must be there")
    torch.set_num_threads(1)
    torch.manual_seed(given.seed)
    data = dataset(given.seed, given.blocks, given.streets)
    print(
        {f"{one.rows}x{one.columns}": len(seen.pitch_px) for one, seen in data.items()},
        flush=True,
    )
    panel = PanelNet()
    trained(panel, data, given.minutes, 3e-3, given.seed)
    save_weights(given.out, panel)
    print(f"weights written to {given.out}")


if __name__ == "__main__":
    main()
