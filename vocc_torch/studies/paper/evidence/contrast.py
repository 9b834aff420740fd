"""Fig. 20: panels at a contrast of 6, 30 and 50 %: the paper's scenes, and scenes that truly have it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vocc_torch.measure.plan import Plan
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Simulator
from vocc_torch.studies.paper.evidence.data import Cell, FigureData, Floats, Picture, pixel_rows
from vocc_torch.studies.paper.evidence.overlap import conditions
from vocc_torch.studies.paper.evidence.sample import cut_out, paper_scene
from vocc_torch.types import Scene

PAPER_SCENES = ((0.06, 32000.0, 500.0), (0.30, 4000.0, 3500.0), (0.50, 1000.0, 4000.0))
"""Section IV-D-1: the contrast that the text states, its ambient light (lx) and LED luminance (cd/m2)."""

BRIGHTEST_CD_M2 = 1e6
"""No LED is looked for beyond this luminance."""


@dataclass(frozen=True)
class ContrastPanels(FigureData):
    """Six panels with the same bits: the paper's three scenes, then three with the contrast asked for.

    Args:
        pictures: six panels.
        contrasts: (6,) contrast by Eqs 1 to 3 of the LEDs before any blur.
        seen: (6,) the same in the pictures: mean grey of the centre pixels of On LEDs less that of Off LEDs.
        conditions: (6,4) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        wanted: (6,) contrast that the paper states.
    """

    pictures: tuple[Picture, ...]
    contrasts: Floats
    seen: Floats
    conditions: Floats
    wanted: Floats

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line a pixel of each picture."""
        return pixel_rows(dict(zip(self._names(), self.pictures, strict=True)))

    def findings(self) -> dict[str, float]:
        """Give the contrast that comes out in each picture."""
        found = {}
        for index, name in enumerate(self._names()):
            found[f"contrast_{name}"] = float(self.contrasts[index])
            found[f"contrast_in_picture_{name}"] = float(self.seen[index])
            found[f"led_luminance_cd_m2_{name}"] = float(self.conditions[index, 1])
            found[f"background_grey_{name}"] = float(self.conditions[index, 3])
        return found

    def _names(self) -> list[str]:
        """Name the pictures."""
        kinds = ("paper_scene", "true")
        return [
            f"{kinds[index // 3]}_{round(100 * value)}" for index, value in enumerate(self.wanted.tolist())
        ]


def contrast_panels(plan: Plan) -> ContrastPanels:
    """Render the paper's scenes, and the same with the LED luminance that the stated contrast needs."""
    simulator, shape = plan.world.simulator(), plan.world.panel.shape
    scenes = [paper_scene(ambient, light) for _, ambient, light in PAPER_SCENES]
    darkest = plan.world.scene.background_grey.bounds[0]
    scenes += [
        scene_of_contrast(simulator, scene, wanted, darkest)
        for scene, (wanted, _, _) in zip(scenes, PAPER_SCENES, strict=True)
    ]
    _, bits = plan.world.scene.draw(BlockKey(plan.seed, "figures/contrast", 0), shape)
    both = Scene.cat(scenes)
    frames, panels = simulator.render(both, bits[:1].repeat(len(both), 1, 1)), simulator.true_panels(both)
    centres = plan.receiver.reader.read_greys(frames, panels).centre.double().cpu()
    seen = centres[:, bits[0]].mean(dim=1) - centres[:, ~bits[0]].mean(dim=1)
    return ContrastPanels(
        pictures=tuple(cut_out(frames[i : i + 1], panels.corners_px[i], shape) for i in range(len(both))),
        contrasts=simulator.contrast(both).double().cpu().numpy(),
        seen=seen.numpy() / 255.0,
        conditions=np.stack([conditions(both, index) for index in range(len(both))]),
        wanted=np.array([wanted for wanted, _, _ in PAPER_SCENES] * 2),
    )


def scene_of_contrast(simulator: Simulator, scene: Scene, wanted: float, darkest: float) -> Scene:
    """Change a scene's LED luminance until its contrast is the one wanted.

    White limits the contrast: where the scene cannot reach it, the background becomes ``darkest``, the lowest
    grey value that auto-ISO may give it; where that does not do either, the highest contrast is given.

    Args:
        simulator: knows the contrast of a scene.
        scene: one scene.
        wanted: above 0 and below 1.
        darkest: grey value, at most that of the scene.

    Example:
        >>> simulator = Simulator()
        >>> float(simulator.contrast(scene_of_contrast(simulator, Scene.of(), 0.3, 86.0)).round(decimals=6))
        0.3
    """

    def at(luminance: float, background: float) -> Scene:
        return Scene.of(
            ambient_lx=float(scene.ambient_lx[0]),
            led_luminance_cd_m2=luminance,
            distance_m=float(scene.distance_m[0]),
            background_grey=background,
        )

    background = float(scene.background_grey[0])
    if float(simulator.contrast(at(BRIGHTEST_CD_M2, background))) < wanted:
        background = min(background, darkest)
    low, high = 0.0, BRIGHTEST_CD_M2
    # 60 halvings bring the luminance to the last bit; contrast rises with it until white.
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (
            (low, middle) if float(simulator.contrast(at(middle, background))) >= wanted else (middle, high)
        )
    return at(high, background)
