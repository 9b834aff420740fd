"""The recipe of the learned locator: simulated worlds in, weights out; minutes on two cores.

    python benchmarks/train_locator.py --out learned.json

The network that judges placings comes after, by ``benchmarks/train_panel_net.py``.
Nothing but simulated frames is learned from: panels of 4 x 4 to 16 x 64 LEDs of 1.5 to 24 px, turned and
aslant, with boards or without, lighter and darker than what is around them, in streets, before drawn clutter.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image, ImageDraw
from torch import Tensor, nn

from vocc_torch import Camera, PanelShape, Scene, Simulator
from vocc_torch.hardware import LedPanel
from vocc_torch.receiver.learned import Nets, found_places, load_weights, save_weights
from vocc_torch.receiver.learned_nets import (
    CORNER_CELLS,
    PITCH_PX,
    CornerNet,
    Finder,
    corner_frames,
    corner_patches,
    places_px,
    pyramid,
)
from vocc_torch.receiver.panel_net import PanelNet
from vocc_torch.receiver.rectification import cell_size_px
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.effects import Backdrop

SIDE_PX, BLOCK = 256, 16
SHAPES = [(8, 8)] * 6 + [(4, 4), (4, 8), (16, 16), (16, 16), (8, 16), (16, 8), (32, 32), (16, 64)]
PITCHES_PX = (1.5, 24.0)


class World(NamedTuple):
    """Frames (B,1,H,W) of one panel's shape, its corners (B,4,2) px, zeros where there is no panel."""

    grey: Tensor
    corners_px: Tensor
    shape: PanelShape


@dataclass(frozen=True)
class Drawn(Backdrop):
    """Rectangles, discs, bars, gratings, letters and dots of light, drawn anew behind each panel."""

    def shade(self, x: Tensor, y: Tensor, context) -> Tensor:
        """Draw each frame's."""
        drawn = [
            drawing(one, context.camera.sensor_px) for one in context.generators(self.name, of_scene=True)
        ]
        planes = torch.from_numpy(np.stack(drawn))[:, None]
        rows = torch.arange(len(planes)).view(-1, 1, 1, 1)
        return planes[rows, 0, y, x]


def drawing(draw: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    """Draw a street's worth of shapes: light over the background's, (H,W)."""
    high, wide = size
    light = np.full(size, draw.uniform(0.3, 1.5))
    plane = Image.new("L", (wide, high), int(draw.integers(10, 120)))
    pen = ImageDraw.Draw(plane)
    for _ in range(draw.integers(0, 25)):
        x, y = draw.uniform(0, wide), draw.uniform(0, high)
        w, h = np.exp(draw.uniform(math.log(4), math.log(wide), 2))
        shade, kind = int(255 * draw.random() ** 2), draw.integers(8)
        box = [x - w / 2, y - h / 2, x + w / 2, y + h / 2]
        if kind < 2:
            pen.rectangle(box, fill=shade, outline=int(draw.integers(256)))
        elif kind == 2:
            pen.ellipse(box, fill=shade)
        elif kind == 3:
            pen.line(box, fill=shade, width=int(draw.integers(1, 8)))
        elif kind == 4:
            letters = "".join(chr(draw.integers(48, 91)) for _ in range(draw.integers(2, 10)))
            pen.text((x, y), letters, fill=shade, font_size=float(np.clip(h, 6, 80)))
        else:
            # A grating or a regular lattice: equal cells, which carry no bits.
            step = draw.uniform(2, 20)
            count = draw.integers(3, 20, 2)
            across = count[0] if kind != 5 else 1
            for i in range(int(across)):
                for j in range(int(count[1])):
                    left, top = x + i * step, y + j * step
                    right = left + step * (0.6 if kind != 5 else 8)
                    if kind == 7 and draw.random() < 0.15:
                        continue
                    (pen.ellipse if kind == 6 else pen.rectangle)(
                        [left, top, right, top + 0.5 * step], fill=shade
                    )
    light = light * (0.05 + np.asarray(plane, np.float64) / 128)
    return light.astype(np.float32)


def world(seed: int, block: int, *, cluttered: bool = True) -> World:
    """Render a block of frames of one shape, camera, board and set of effects."""
    key = BlockKey(seed, "train_locator", block)
    draw = key.generator("world")
    shape = PanelShape(*SHAPES[draw.integers(len(SHAPES))])
    diameter = 0.06 * draw.uniform(0.35, 0.95)
    board = [None, None, 0.02, 0.05, 0.1, 0.3, 0.8][draw.integers(7)]
    surfaces = {"led_reflectance": draw.uniform(0.03, 0.8), "background_reflectance": draw.uniform(0.1, 0.6)}
    panel = LedPanel(shape, diameter, 0.06 - diameter, board_reflectance=board, **surfaces)
    focal_mm = float(draw.uniform(10, 25))
    camera = Camera(focal_mm, width_px=SIDE_PX, height_px=SIDE_PX, sensor_width_mm=SIDE_PX * 13.2 / 1920)
    most = min(PITCHES_PX[1], 0.8 * SIDE_PX / max(shape.rows, shape.columns))
    pitch = np.exp(draw.uniform(math.log(PITCHES_PX[0]), math.log(most), BLOCK))
    distance = camera.focal_length_px * 0.06 / pitch
    ambient = np.exp(draw.uniform(math.log(100), math.log(32000), BLOCK))
    turn = draw.choice([5.0, 20.0, 44.0])
    reach = (
        np.clip(1.0 - pitch * max(shape.rows, shape.columns) / SIDE_PX, 0.05, 0.9)
        * SIDE_PX
        / 2
        / pitch
        * 0.06
    )
    scene = Scene(
        *(
            torch.from_numpy(np.asarray(values, np.float64).repeat(BLOCK) if np.ndim(values) == 0 else values)
            for values in (
                ambient,
                ambient
                * surfaces["background_reflectance"]
                / math.pi
                * np.exp(draw.uniform(-1.2, 2.5, BLOCK)),
                distance,
                draw.uniform(30, 160, BLOCK),
                draw.uniform(-1, 1, BLOCK) * reach,
                draw.uniform(-1, 1, BLOCK) * reach,
            )
        )
    )
    bits = torch.from_numpy(
        draw.random((BLOCK, shape.rows, shape.columns)) < draw.uniform(0.3, 0.7, (BLOCK, 1, 1))
    )
    effects: dict[str, object] = {
        "pose": {
            "yaw_deg": ["uniform", -30, 30],
            "pitch_deg": ["uniform", -12, 12],
            "roll_deg": ["uniform", -turn, turn],
        },
        "blooming": {"sigma_px": float(draw.uniform(0.3, 2.0))},
        "photoelectrons": {"quantum_efficiency": 0.6},
        "shot_noise": {},
        "read_noise": {"electrons": float(draw.uniform(1, 5))},
        "gain": {},
        "saturation": {},
        "quantization": {"bits": 8},
    }
    if cluttered and draw.random() < 0.7:
        effects |= {"led_look": {}, "housing": {}}
        panel = replace(panel, board_reflectance=None)
    kind = draw.random() if cluttered else 1.0
    if kind < 0.6:
        effects |= {
            "scenery": {},
            "clutter": {"lit": float(draw.random()), "wet": 0.3},
            "panel_absent": {"share": 0.2},
        }
    elif kind < 0.9:
        effects["background_texture"] = {
            "contrast": float(draw.uniform(0.1, 0.8)),
            "beta": float(draw.uniform(1, 3)),
        }
    if draw.random() < 0.4:
        effects["jpeg"] = {"quality": int(draw.integers(40, 96))}
    keys = [FrameKey(key, one) for one in range(BLOCK)]
    built = list(Simulator(camera, panel, effects).effects)
    if cluttered and draw.random() < 0.5:
        built.append(Drawn())
    simulator = Simulator(camera, panel, built)
    grey, truth = simulator.render(scene, bits, keys=keys).grey, simulator.true_panels(scene, keys)
    return World(grey, truth.corners_px.float() * truth.found.view(-1, 1, 1), shape)


def shaken(one: World, draw: np.random.Generator) -> World:
    """Mirror, invert and pale a block of frames, each kind at random: light's sign must not matter."""
    grey, corners = one.grey.float(), one.corners_px
    for axis in (0, 1):
        if draw.random() < 0.5:
            grey, there = grey.flip(3 - axis), (corners != 0).any(2, keepdim=True).any(1, keepdim=True)
            corners = corners.clone()
            corners[..., axis] = grey.shape[3 - axis] - corners[..., axis]
            corners = corners[:, [[1, 0, 3, 2], [3, 2, 1, 0]][axis]] * there
    gain = torch.from_numpy(draw.uniform(0.25, 1.0, len(grey)) * draw.choice([1, -1], len(grey))).float()
    gain = gain.view(-1, 1, 1, 1)
    grey = torch.where(gain < 0, 255 + grey * gain, grey * gain + (1 - gain) * float(draw.uniform(0, 200)))
    return World(grey.clamp(0, 255), corners, one.shape)


def finder_loss(finder: Finder, one: World) -> Tensor:
    """Focal loss of the places, and how far off the panel is said to be where there is one."""
    total = torch.zeros(())
    centre = one.corners_px.mean(1)
    pitch = torch.stack(cell_size_px(one.corners_px, one.shape)).prod(0).sqrt()
    along = one.corners_px[:, 1] - one.corners_px[:, 0] + one.corners_px[:, 2] - one.corners_px[:, 3]
    turn = torch.atan2(along[:, 1], along[:, 0])
    if one.shape.rows == one.shape.columns:
        turn = turn - (turn / (math.pi / 2)).round() * (math.pi / 2)
    half, every = math.sqrt(one.shape.leds) * PITCH_PX / 2, torch.arange(len(one.grey))
    for level, picture in enumerate(pyramid(one.grey)):
        # The finest scale costs most, and few panels are as small: a third of the frames, small panels first.
        rows = every if level else pitch.argsort()[: -(-len(every) // 3)]
        judged = finder(picture[rows], one.shape)
        logit = judged[:, 0]
        off = (centre[rows, :, None, None] / 2**level - places_px(logit.shape[1:])) / half
        ratio, near = (pitch[rows] / 2**level / PITCH_PX).log(), off.norm(dim=1)
        fits, maybe = ((ratio.abs() < most)[:, None, None] for most in (0.40, 0.75))
        target = ((near < max(0.35, 6 / half)) & fits).float()
        weight = 1.0 - ((near < max(0.9, 12 / half)) & maybe & (target == 0)).float()
        there = target > 0
        if there.any():
            wanted = [off[:, 0], off[:, 1], *(v[:, None, None].expand_as(near) for v in (ratio, turn[rows]))]
            given = judged[:, 1:].movedim(1, 0)[:, there]
            apart = (given - torch.stack(wanted)[:, there]) * torch.tensor([2.0, 2.0, 3.0, 2.0])[:, None]
            total = total + nn.functional.smooth_l1_loss(apart, torch.zeros_like(apart), reduction="sum") / 8
        cost = nn.functional.binary_cross_entropy_with_logits(logit, target, reduction="none")
        wrong = (logit.sigmoid() - target).abs()
        total = total + (cost * wrong**2 * weight * (1 + 3 * target)).sum()
    return total / len(one.grey)


def corner_loss(net: CornerNet, one: World, draw: np.random.Generator, wrong: Tensor | None) -> Tensor:
    """How far off corners are said to be about guesses of true panels, and whether they are corners at all.

    Args:
        net: the network.
        one: frames with panels.
        draw: of the guesses.
        wrong: (n,5,2) quadrilaterals of the finder that are no panels, after their frame's number; or None.
    """
    present = (one.corners_px != 0).flatten(1).any(1).nonzero()[:, 0]
    truth, count = one.corners_px[present], len(present)
    size = torch.stack(cell_size_px(truth, one.shape)).prod(0).sqrt()
    zooms = [2**n for n in range(1 + int(math.log2(max(1, max(one.shape.rows, one.shape.columns) / 8))))]
    zoom = torch.from_numpy(draw.choice(zooms, count)).float()
    middle = truth.mean(1, keepdim=True)
    # A guess of the finder's, and later ones: scale, turn, place, and each corner by itself.
    rough = torch.from_numpy(draw.choice([0.08, 0.5, 1.0], count)).float().view(-1, 1, 1)

    def noise(*shape: int) -> Tensor:
        return torch.from_numpy(draw.standard_normal(shape)).float()

    scale, angle = (0.12 * rough * noise(count, 1, 1)).exp(), 0.1 * rough * noise(count, 1, 1)
    turned = (truth - middle) * scale
    turned = turned * angle.cos() + torch.stack([-turned[..., 1], turned[..., 0]], 2) * angle.sin()
    unit = size.view(-1, 1, 1) * zoom.view(-1, 1, 1)
    guess = middle + turned + unit * rough * (0.8 * noise(count, 1, 2) + 0.4 * noise(count, 4, 2))
    scales = pyramid(one.grey)
    level = ((size * zoom / PITCH_PX).log2().round() - 1).clamp(0, len(scales) - 1).long()
    told = torch.tensor([math.log2(one.shape.rows), math.log2(one.shape.columns)])
    told = torch.cat([told.expand(count, 2), zoom.log2()[:, None]], 1).repeat_interleave(4, 0)
    judged = net(corner_patches(scales, present, level, guess, one.shape, zoom), told)
    # The truth in the guess's own axes, in half patches.
    axes = corner_frames(guess, one.shape) * zoom.view(-1, 1, 1, 1) * CORNER_CELLS
    wanted = torch.linalg.solve(axes.mT.flatten(0, 1), (truth - guess).flatten(0, 1)[..., None])[..., 0]
    distance = wanted.norm(dim=1) * CORNER_CELLS
    near = (distance < 3.5).float()
    apart = (judged[:, :2] - wanted) * CORNER_CELLS
    place = (
        nn.functional.smooth_l1_loss(apart, torch.zeros_like(apart), reduction="none", beta=0.2).sum(1) * near
    ).mean()
    hit = (distance < 0.4).float()
    sure = ((distance < 0.4) | (distance > 0.8)).float()
    cost = nn.functional.binary_cross_entropy_with_logits(judged[:, 2], hit, reduction="none")
    loss = place + (cost * sure).mean()
    if wrong is not None and len(wrong):
        frame, quads = wrong[:, 0, 0].long(), wrong[:, 1:]
        pitch = torch.stack(cell_size_px(quads, one.shape)).prod(0).sqrt()
        level = ((pitch / PITCH_PX).log2().round() - 1).clamp(0, len(scales) - 1).long()
        ones = torch.ones(len(frame))
        patches = corner_patches(scales, frame, level, quads, one.shape, ones)
        none = net(patches, (told[:1] * torch.tensor([1, 1, 0.0])).expand(len(patches), 3))
        loss = loss + nn.functional.softplus(none[:, 2]).mean()
    return loss


def wrong_claims(finder: Finder, one: World, many: int = 3) -> Tensor:
    """Give the finder's best claims that are no panels, (n,5,2): the frame's number, and the corners."""
    claims = []
    with torch.inference_mode():
        for i in range(0, len(one.grey), 3):
            quads, _, _ = found_places(finder, pyramid(one.grey[i : i + 1]), one.shape, many + 1)
            centre, across = one.corners_px[i].mean(0), (one.corners_px[i, 0] - one.corners_px[i, 2]).norm()
            quads = quads[(quads.mean(1) - centre).norm(dim=1) > 0.35 * across]
            claims.append(torch.cat([torch.full((len(quads), 1, 2), float(i)), quads.float()], 1)[:many])
    return torch.cat(claims).clone()


def trained(net: nn.Module, minutes: float, losses: Iterator, rate: float = 3e-3) -> None:
    """Train for so many minutes of this process's own time, at a rate that falls to nothing."""
    optimiser = torch.optim.AdamW(net.parameters(), rate, weight_decay=1e-3)
    begun, steps, mean = time.process_time(), 0, 0.0
    while (done := (time.process_time() - begun) / max(60 * minutes, 1e-9)) < 1:
        for group in optimiser.param_groups:
            group["lr"] = rate * min(1.0, (steps + 1) / 100) * (1 + math.cos(math.pi * done)) / 2
        loss = next(losses)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(net.parameters(), 5.0)
        optimiser.step()
        steps, mean = steps + 1, 0.98 * mean + 0.02 * float(loss.detach()) if steps else float(loss.detach())
        if steps % 100 == 0:
            print(f"  {type(net).__name__} step {steps}, {100 * done:.0f} %, loss {mean:.4f}", flush=True)


def main() -> None:
    """Render, train both networks, and write their weights."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--blocks", type=int, default=240, help=f"blocks of {BLOCK} frames with panels")
    parser.add_argument(
        "--minutes", type=float, nargs=2, default=(6.0, 6.0), help="processor time of finder and corners"
    )
    parser.add_argument("--start", type=Path, help="weights to go on from")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--plain", action="store_true", help="no clutter: what robustness costs")
    given = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(given.seed)
    begun = time.process_time()
    worlds = [world(given.seed, block, cluttered=not given.plain) for block in range(given.blocks)]
    print(f"{len(worlds) * BLOCK} frames in {time.process_time() - begun:.0f} s", flush=True)
    draw = np.random.default_rng(given.seed)

    def any_world() -> World:
        return shaken(worlds[draw.integers(len(worlds))], draw)

    finder, corners, _ = nets = Nets(Finder(), CornerNet(), PanelNet())
    if given.start:
        for net, before in zip(nets, load_weights(given.start, torch.device("cpu")), strict=True):
            net.load_state_dict(before.state_dict())
    trained(finder, given.minutes[0], (finder_loss(finder, any_world()) for _ in iter(int, 1)))
    finder.eval()

    def corner_losses() -> Iterator[Tensor]:
        while True:
            one = any_world()
            wrong = wrong_claims(finder, one) if draw.random() < 0.4 else None
            yield corner_loss(corners, one, draw, wrong)

    trained(corners, given.minutes[1], corner_losses(), 2e-3)
    save_weights(given.out, nets)
    weights = sum(one.numel() for net in nets for one in net.parameters())
    print(f"{given.out}: {given.out.stat().st_size / 1e6:.2f} MB, {weights} weights")


if __name__ == "__main__":
    main()
