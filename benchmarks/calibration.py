"""What ``task=calibrate`` finds in simulated recordings of known scenes: coverage, effects, and receivers.

    python benchmarks/calibration.py [RECORDINGS A SCENE] [SCENE ...]

Each recording is of a scene that ships, with values drawn at random: those of the scene, and blur, gamma,
read noise, and where the scene has them pattern noise and vignetting. The sensor is a part of 320 x 240
px, with pixels of the scene's own size. Two tables: how often the truth lies in the stated 95 % interval, and
by how many standard deviations it is off in the middle; and which effects were there and which were named.
"""

import sys
import time
from collections import defaultdict
from dataclasses import replace
from statistics import median

import numpy as np
import torch

from vocc_torch.api import load_scene
from vocc_torch.hardware import LedPanel
from vocc_torch.measure.plan import World
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.locators import locator_named
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Distribution, SceneModel, Simulator
from vocc_torch.simulation.photometry import transmission
from vocc_torch.studies.calibrate.reading import Footage
from vocc_torch.studies.calibrate.study import CalibratedScene, calibrate
from vocc_torch.types import Frames

SCENES = ("paper", "highway", "fog", "low_sun", "night", "tunnel", "dashcam")
FRAMES = 16
WIDTH, HEIGHT = 320, 240
ALIKE = {"airlight": "veiling_glare", "bayer": "demosaicing"}
"""Effects that a recording does not tell from others, which stand for them."""
UNSEEN = ("attenuation", "full_well")
"""Effects that leave no trace of their own in these recordings."""


def constant(value: float) -> Distribution:
    """A value that stays."""
    return Distribution("constant", (float(value),))


def about(value: float, half: float) -> Distribution:
    """A value that moves a little."""
    return Distribution("uniform", (float(value) - half, float(value) + half))


def truth_of(name: str, seed: int) -> World:
    """Draw a recording's world: one place, one light, one sensor."""
    world, draws = load_scene(name), np.random.default_rng([seed, len(name)])
    effects = {effect: dict(given) for effect, given in world.effects.items()}
    effects["blooming"]["sigma_px"] = float(draws.uniform(1.0, 2.0))
    for effect, key, low, high in (
        ("read_noise", "electrons", 2.0, 8.0),
        ("prnu", "share", 0.005, 0.02),
        ("dsnu", "electrons", 0.7, 2.0),
        ("vignetting", "corner_loss", 0.1, 0.3),
        ("jpeg", "quality", 75, 92),
    ):
        if effect in effects:
            effects[effect][key] = type(effects[effect][key])(draws.uniform(low, high))
    if "pose" in effects:
        for key, angle in effects["pose"].items():
            middle = draws.uniform(float(angle[1]), float(angle[2]))
            effects["pose"][key] = ["uniform", middle - 0.5, middle + 0.5]
    wide = world.camera.sensor_width_mm * WIDTH / world.camera.width_px
    camera = replace(world.camera, width_px=WIDTH, height_px=HEIGHT, sensor_width_mm=wide)
    camera = replace(camera, gamma=float(draws.uniform(1.8, 2.4)))
    one, _ = world.scene.draw(BlockKey(seed, f"truth/{name}", 0), world.panel.shape)
    away, scale = float(one.distance_m[0]), camera.focal_length_px / float(one.distance_m[0])
    across, down = (float(draws.uniform(-half, half)) / scale for half in (90, 50))
    model = SceneModel(
        constant(one.ambient_lx[0]),
        constant(one.led_luminance_cd_m2[0]),
        about(away, 0.05),
        constant(one.background_grey[0]),
        about(across, 0.02),
        about(down, 0.02),
    )
    return replace(world, camera=camera, scene=model, effects=effects, framing="full", device="cpu")


def recorded(world: World, seed: int) -> tuple[Footage, torch.Tensor, object]:
    """Take the recording."""
    key = BlockKey(seed, "recording", 0)
    scene, bits = world.scene.draw(key, world.panel.shape)
    scene, bits = scene[:FRAMES], bits[:FRAMES]
    keys = [FrameKey(key, frame) for frame in range(FRAMES)]
    greys = (
        Simulator(world.camera, world.panel, world.effects, framing="full")
        .render(scene, bits, keys=keys)
        .grey
    )
    panels = locator_named("refined", PaperLocator())(Frames.whole(greys[:, 0]), world.panel.shape)
    rows = panels.found.nonzero()[:, 0]
    none = np.full(len(rows), np.nan)
    footage = Footage(
        greys[rows, 0].numpy(), rows.numpy(), none, panels.corners_px[rows].double(), FRAMES, FRAMES, []
    )
    return footage, bits[rows], scene[rows]


def off_by(study: CalibratedScene, world: World, scene: object) -> dict[str, list[float]]:
    """Say by how many of its standard deviations each value is off."""
    fit, told = study.fit, {one.key: one for one in study.scene.values}
    camera, panel = world.camera, LedPanel()
    off: dict[str, list[float]] = defaultdict(list)
    away = fit.derived(
        lambda own, _: camera.focal_length_px * panel.pitch_m * torch.exp(-own["log_pitch_px"])
    )
    off["distance_m (a frame)"] = (
        (away[0] - scene.distance_m) / away[1].hypot(torch.tensor(away[2]))
    ).tolist()
    off["gamma"] = [(float(fit.of_all[0]) - camera.gamma) / fit.deviation("gamma")]
    lux, lum = float(scene.ambient_lx[0]), float(scene.led_luminance_cd_m2[0])
    effects = world.effects
    air = effects.get("attenuation", {}).get("visibility_m", np.inf)
    kept = float(transmission(scene.distance_m[:1], air)[0])
    truth = {
        "background_grey": float(scene.background_grey[0]),
        "effects.blooming.sigma_px": effects["blooming"]["sigma_px"],
    }
    iso = camera.iso_limits
    if iso:
        del truth["background_grey"]
    for effect, key in (
        ("prnu", "share"),
        ("dsnu", "electrons"),
        ("vignetting", "corner_loss"),
        ("read_noise", "electrons"),
    ):
        if effect in effects:
            truth[f"effects.{effect}.{key}"] = effects[effect][key]
    if "airlight" not in effects and "shot_noise" in effects and "ambient_lx" in told:
        truth["ambient_lx"] = lux
    for key, value in truth.items():
        if key in told and told[key].deviation > 0:
            off[key].append((told[key].middle - value) / told[key].deviation)
    if "led_luminance_cd_m2" in told and told["led_luminance_cd_m2"].deviation > 0:
        one, ambient = told["led_luminance_cd_m2"], told["ambient_lx"].middle
        if "airlight" not in effects:
            off["luminance over ambient"].append(
                (one.middle / ambient - lum * kept / lux) / (one.deviation / ambient)
            )
    if "veiling_glare" in effects and "effects.veiling_glare.luminance_cd_m2" in told:
        one, ambient = told["effects.veiling_glare.luminance_cd_m2"], told["ambient_lx"].middle
        veil = (
            10 * effects["veiling_glare"]["glare_illuminance_lx"] / effects["veiling_glare"]["angle_deg"] ** 2
        )
        off["veil over ambient"].append((one.middle / ambient - veil / lux) / (one.deviation / ambient))
    return off


def main() -> None:
    """Print the three tables."""
    words = sys.argv[1:]
    count = int(words.pop(0)) if words and words[0].isdigit() else 2
    off: dict[str, list[float]] = defaultdict(list)
    there: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    lost = wrong = leds = 0
    for name in words or SCENES:
        for seed in range(count):
            began, world = time.process_time(), truth_of(name, seed)
            footage, bits, scene = recorded(world, seed)
            if len(footage) < 4:
                lost += 1
                print(f"{name} {seed}: the panel was found in {len(footage)} of {FRAMES} frames", flush=True)
                continue
            configured = replace(world.camera, gamma=2.2, iso_limits=None)
            study = calibrate(footage, configured, world.panel, most=FRAMES)
            missed = int((study.fit.bits != bits.flatten(1)).sum())
            wrong, leds = wrong + missed, leds + bits.numel()
            mine = off_by(study, world, scene)
            for key, values in mine.items():
                off[key] += values
            true = {ALIKE.get(effect, effect) for effect in world.effects if effect not in UNSEEN}
            for one in study.scene.effects:
                there[one.effect][2 * (one.effect not in true) + (not one.asked)] += 1
            named = [one.effect for one in study.scene.effects if one.asked]
            shown = ", ".join(f"{key} {median(values):+.1f}" for key, values in mine.items())
            print(
                f"{name} {seed}: {time.process_time() - began:.0f} s, {missed} bits wrong, residuals "
                f"{study.fit.scale**0.5:.2f}; off by (standard deviations) {shown}; "
                f"missed {sorted(true - set(named))}, too many {sorted(set(named) - true)}",
                flush=True,
            )
    print(f"\n{lost} recordings without a panel; {wrong} of {leds} bits wrong\n")
    print("| value | compared | within its 95 % interval | median deviation |\n|---|---|---|---|")
    for key, values in off.items():
        inside = np.mean(np.abs(values) < 1.96)
        print(f"| {key} | {len(values)} | {inside:.0%} | {median(np.abs(values)):.2f} |")
    print("\n| effect | there, named | there, not named | not there, named | not there, not named |")
    print("|---|---|---|---|---|")
    for effect, row in sorted(there.items()):
        print(f"| {effect} | {row[0]} | {row[1]} | {row[2]} | {row[3]} |")


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
