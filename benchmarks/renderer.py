"""What each accuracy knob of the renderer costs, and how near it comes to whole frames in float64.

Each knob is turned by itself: working precision, framing, half width of the blooming kernel, margin of the
crop. LEDs are drawn by the exact area of the pixels that they cover, so there is no supersampling to set;
what it would cost and do is measured beside (``sampled``: s x s points in a pixel). Times are taken in the
same rounds. Errors are those of grey values before quantisation against frames rendered whole in float64 with
a kernel of 8 standard deviations: the worst on the sensor, the root mean square about the panel, and the
share of the pixels about the panel whose 8-bit value differs.

    python benchmarks/renderer.py --csv docs/results/renderer.csv
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from vocc_torch import Simulator
from vocc_torch.measure.link import block_keys
from vocc_torch.measure.timing import describe_machine, interleaved, median_of, threads
from vocc_torch.report.folder import write_rows
from vocc_torch.rng import FrameKey
from vocc_torch.simulation import SceneModel
from vocc_torch.simulation.framing import lay_on_sensor, led_centres_px
from vocc_torch.simulation.photometry import reflected_luminance_cd_m2
from vocc_torch.simulation.raster import add_patches
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Frames, Scene

COLUMNS = (
    *("knob", "value", "median_ms", "low_ms", "high_ms", "rounds", "frames_a_call"),
    *("worst_error_dn", "rms_error_dn", "pixels_changed", "threads", "machine"),
)
REFERENCE_SIGMAS = 8.0
"""Half width of the reference's kernel: beyond it lies 1e-15 of the light, as much as float64 rounds off."""
KERNEL_SIGMAS = (2.0, 3.0, 6.0)
"""Half widths of the blooming kernel in standard deviations; the renderer takes 4."""
MARGINS_PX = (-20, -16, 16, 64)
"""Pixels added to each side of the crop; the renderer leaves a cell and twice the reach of its effects."""
SUPERSAMPLING = (1, 2, 4, 8, 16)
GROUP_SAMPLES = 4_000_000
"""Samples in a working array."""


@dataclass(frozen=True)
class Knobs:
    """Where the knobs stand; the one that is turned, and where to."""

    knob: str = "none"
    value: str = "as set"
    framing: str = "crop"
    dtype: torch.dtype = torch.float32
    sigmas: float | None = None
    margin_px: int = 0
    samples: int = 0


def settings() -> list[Knobs]:
    """List the knobs as they are set, then each by itself."""
    return [
        Knobs(),
        Knobs("dtype", "float64", dtype=torch.float64),
        *(Knobs("framing", name, framing=name) for name in ("filled", "full")),
        *(Knobs("kernel", f"{sigmas:g} sigma", sigmas=sigmas) for sigmas in KERNEL_SIGMAS),
        *(Knobs("margin", f"{margin:+d} px", margin_px=margin) for margin in MARGINS_PX),
        *(Knobs("sampled", f"{samples} x {samples}", samples=samples) for samples in SUPERSAMPLING),
    ]


class Turned(Simulator):
    """The paper's simulator with its knobs turned, and with another way to draw LEDs where they are sampled.

    Args:
        knobs: where they stand.
        device: where it works.
        quantised: False for grey values before quantisation.
    """

    def __init__(self, knobs: Knobs, device: str, *, quantised: bool = True) -> None:
        effects = {name: own for name, own in PAPER_EFFECTS.items() if quantised or name != "quantization"}
        super().__init__(effects=effects, framing=knobs.framing, device=device, dtype=knobs.dtype)
        self.knobs = knobs
        if knobs.sigmas is not None:
            self.effects = tuple(
                truncated(effect, knobs.sigmas) if effect.name == "blooming" else effect
                for effect in self.effects
            )

    def crop_px(self, nearest_m: float) -> tuple[int, int]:
        """Height and width of the crop, at least 8 px."""
        sides = zip(super().crop_px(nearest_m), self.camera.sensor_px, strict=True)
        height, width = (max(8, min(side + 2 * self.knobs.margin_px, full)) for side, full in sides)
        return height, width

    def paint(self, batch: Any) -> Tensor:
        """Draw the picture that the lens sees, (B,1,H,W) cd/m2: squarely faced panels without a board."""
        if not self.knobs.samples:
            return super().paint(batch)
        scene, panel, samples = batch.context.scene, self.panel, self.knobs.samples
        light = batch.bits * scene.led_luminance_cd_m2.view(-1, 1, 1)
        for effect in self.effects:
            light = effect(light, batch.context) if effect.name == "attenuation" else light
        background = reflected_luminance_cd_m2(scene.ambient_lx, panel.background_reflectance)
        reflected = reflected_luminance_cd_m2(scene.ambient_lx, panel.led_reflectance)
        excess = (light + (reflected - background).view(-1, 1, 1)).reshape(-1)
        canvas = background.view(-1, 1, 1).expand(len(scene), *batch.size).contiguous()
        x, y = led_centres_px(scene, self.camera, panel)
        origin, each = batch.context.origin_px, (len(scene), panel.shape.rows, panel.shape.columns)
        x = (x - origin[:, :1]).unsqueeze(-2).expand(each).reshape(-1)
        y = (y - origin[:, 1:]).unsqueeze(-1).expand(each).reshape(-1)
        radius = panel.led_diameter_m / 2 * self.camera.pixels_per_metre(scene.distance_m)
        radius = radius.repeat_interleave(panel.shape.leds)
        frame = torch.arange(len(scene), device=x.device).repeat_interleave(panel.shape.leds)
        side = int((2 * radius.max()).ceil()) + 1
        group = max(1, GROUP_SAMPLES // (side * samples) ** 2)
        for start in range(0, len(x), group):
            rows = slice(start, start + group)
            cover, left, top = sampled_cover(x[rows], y[rows], radius[rows], side, samples)
            add_patches(canvas, cover * excess[rows].view(-1, 1, 1), frame[rows], left, top)
        return canvas.clamp_(min=0).unsqueeze(1).to(self.dtype)


def truncated(blooming: Any, sigmas: float) -> Any:
    """Give blooming whose kernel ends at that many standard deviations."""

    def reach(own: Any, camera: Any, nearest_m: float) -> int:
        return max(1, math.ceil(sigmas * own.sigma_px))

    return type("Truncated", (type(blooming),), {"reach_in_px": reach})(blooming.sigma_px)


def sampled_cover(
    x: Tensor, y: Tensor, radius: Tensor, side: int, samples: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Estimate the share of each pixel that a disc covers by the points of a grid that lie in it.

    Args:
        x: (N,) centres, px.
        y: (N,) likewise.
        radius: (N,) px.
        side: of the patch, px, at least ``ceil(2 radius) + 1``.
        samples: points along the side of a pixel, in the middle of its parts.

    Returns:
        cover (N,side,side), and the patches' left columns and top rows (N,), int64.
    """
    left, top = torch.floor(x - radius), torch.floor(y - radius)
    at = (torch.arange(side * samples, dtype=x.dtype, device=x.device) + 0.5) / samples
    across, down = (left - x).unsqueeze(-1) + at, (top - y).unsqueeze(-1) + at
    inside = (across.square().unsqueeze(-2) + down.square().unsqueeze(-1)) < radius.square().view(-1, 1, 1)
    parts = inside.view(len(x), side, samples, side, samples)
    return parts.sum(dim=(2, 4)).to(x.dtype) / samples**2, left.long(), top.long()


@dataclass(frozen=True)
class Drawn:
    """Scenes to render.

    Args:
        scene: B scenes.
        bits: (B,R,C) bool.
        keys: a key a frame.
    """

    scene: Scene
    bits: Tensor
    keys: list[FrameKey]

    @classmethod
    def of(cls, frames: int) -> Drawn:
        """Draw the first scenes of the paper's; one is as near as scenes come, where narrow margins cut."""
        (key,) = block_keys(0, "tradeoff/mixture", frames)
        scene, bits = SceneModel().draw(key, Simulator().panel.shape)
        near = scene.distance_m.clone()
        near[0] = SceneModel().nearest_m
        keys = [FrameKey(key, frame) for frame in range(frames)]
        return cls(replace(scene, distance_m=near)[:frames], bits[:frames], keys)

    def rendered(self, simulator: Simulator, rows: slice = slice(None)) -> Frames:
        """Render some of them."""
        return simulator.render(
            self.scene[rows], self.bits[rows], nearest_m=SceneModel().nearest_m, keys=self.keys[rows]
        )


def errors(knobs: Knobs, drawn: Drawn, device: str) -> tuple[float, float, float]:
    """Compare grey values with the reference: worst, root mean square, share of pixels changed."""
    exact = Knobs(framing="full", dtype=torch.float64, sigmas=REFERENCE_SIGMAS)
    reference, simulator = (Turned(one, device, quantised=False) for one in (exact, knobs))
    sides = Simulator().crop_px(SceneModel().nearest_m)
    worst = squares = changed = pixels = 0.0
    for frame in range(len(drawn.scene)):
        rows = slice(frame, frame + 1)
        truth, seen = drawn.rendered(reference, rows).grey, drawn.rendered(simulator, rows)
        grey = seen.grey.double()
        if seen.surround is not None:
            grey = lay_on_sensor(grey, seen.surround.double(), seen.origin_px, seen.sensor_px)
        corners = reference.true_panels(drawn.scene[rows], drawn.keys[rows]).corners_px[0]
        middle = corners.mean(dim=0).round().long().tolist()[::-1]
        near = tuple(
            slice(max(0, at - side // 2), at + side // 2) for at, side in zip(middle, sides, strict=True)
        )
        apart = (grey - truth).abs()
        worst = max(worst, float(apart.max()))
        squares += float(apart[..., *near].square().sum())
        changed += int((grey[..., *near].round() != truth[..., *near].round()).sum())
        pixels += truth[..., *near].numel()
    return worst, math.sqrt(squares / pixels), changed / pixels


def main() -> None:
    """Measure, print, and write a table if asked to."""
    parser = argparse.ArgumentParser(description="Price the renderer's knobs.")
    parser.add_argument(
        "--frames", type=int, default=8, help="frames to render; whole ones are timed one by one"
    )
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--csv", type=Path, help="write a line for each setting here")
    given = parser.parse_args()
    drawn, every, device = Drawn.of(given.frames), settings(), torch.device(given.device)
    counts = [1 if one.framing == "full" else given.frames for one in every]

    def call(one: Knobs, frames: int) -> Any:
        simulator = Turned(one, given.device)
        return lambda: drawn.rendered(simulator, slice(frames))

    with threads(1):
        calls = {f"{one.knob} {one.value}": call(one, n) for one, n in zip(every, counts, strict=True)}
        times = interleaved(calls, given.rounds, device, warm_up=1)
        rows: list[list[str | int | float]] = []
        for one, (name, timing), frames in zip(every, times.items(), counts, strict=True):
            found = errors(one, drawn, given.device)
            spent = median_of(timing.seconds)
            ms = [1e3 * s / frames for s in (spent.value, spent.low, spent.high)]
            print(f"{name:<16} {ms[0]:8.3f} ms, worst error {found[0]:.2g}, {100 * found[2]:.2g} % changed")
            numbers = [float(f"{value:.5g}") for value in (*ms, *found)]
            rows.append([one.knob, one.value, *numbers[:3], given.rounds, frames, *numbers[3:], 1])
        machine = describe_machine(device)
    if given.csv:
        write_rows(given.csv, [COLUMNS, *([*row, machine] for row in rows)])


if __name__ == "__main__":
    main()
