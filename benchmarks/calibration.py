"""What ``task=calibrate`` finds in simulated recordings of known scenes: coverage, effects, and receivers.

    python benchmarks/calibration.py [RECORDINGS A SCENE] [SCENE ...]
    python benchmarks/calibration.py receivers low_sun dashcam paper fog highway night tunnel
    python benchmarks/calibration.py pictures

Each recording is of a scene that ships, with values drawn at random: those of the scene, and blur, gamma,
read noise, and where the scene has them pattern noise and vignetting. The sensor is a part of 320 x 240
px, with pixels of the scene's own size. The tables in ``docs/results`` grow by a recording at a time:
``calibration.csv`` has every value beside its truth, ``calibration_effects.csv`` which effects were there,
and which were named. What is in them is not done
again; delete them where the fit changes.

The second command trains receivers on the paper's scene, on the one that was found and on the true one, and
counts their errors in fresh frames of the last: ``calibration_receivers.csv``. The third fits the photographs
of real panels that the tests have, from their known corners, and writes a page of each.
"""

import csv
import json
import math
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from receivers_by_scene import PICTURES, panel_corners

import vocc_torch as vt
from vocc_torch import Scene
from vocc_torch.api import load_scene
from vocc_torch.extras.calibrate import CalibrateConfig
from vocc_torch.extras.calibrate.reading import Footage, agreeing
from vocc_torch.extras.calibrate.report import write_page
from vocc_torch.extras.calibrate.scene import Findings, of_size
from vocc_torch.extras.calibrate.study import calibrate
from vocc_torch.hardware import Camera, LedPanel, PanelShape
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import World
from vocc_torch.receiver.locators import PaperLocator, locator_named
from vocc_torch.receiver.reader import Reader
from vocc_torch.recordings.reading import read_recording
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Distribution, SceneModel, Simulator
from vocc_torch.simulation.photometry import transmission
from vocc_torch.types import Frames

SCENES = ("paper", "highway", "fog", "low_sun", "night", "tunnel", "dashcam")
FIRST = 200
"""Number of the first recording: those below showed the faults that were mended, these had no part in it."""
FRAMES = 8
AMONG_LAMPS = 24
"""Frames recorded where the locator takes lamps for the panel in more than half of them."""
WIDTH, HEIGHT = 320, 240
ALIKE = {"airlight": "veiling_glare"}
"""Effects that a recording does not tell from others, which stand for them."""
NOISES = ("shot_noise", "prnu", "dsnu", "read_noise")
UNTOLD = {
    "attenuation": "the air: ",
    "bayer": "the sensor's colours",
    "demosaicing": "the sensor's colours",
}
UNTOLD |= {
    "read_noise": "read noise: ",
    "prnu": "(prnu",
    "dsnu": "dsnu",
    "row_noise": "row_noise",
}
UNTOLD |= dict.fromkeys(("lamps", "led_scatter"), "what else there may be")
UNTOLD |= dict.fromkeys(
    ("motion_blur", "lens_distortion"), "motion and the lens's distortion"
)
CODED = "the sensor's noise: "
"""How sentences begin, or what is in them, that say of effects that the recording does not tell them."""
COMPARED = tuple(
    f"effects.{key}"
    for key in (
        *(
            "blooming.sigma_px",
            "prnu.share",
            "dsnu.electrons",
            "read_noise.electrons",
            "jpeg.quality",
        ),
        *(
            "pose.yaw_deg",
            "pose.pitch_deg",
            "pose.roll_deg",
            "lens_distortion.k1",
            "vignetting.corner_loss",
        ),
    )
)
"""Values of effects that are compared with the truth."""
LIGHT = ("ambient_lx", "led_luminance_cd_m2")
FAR = {
    "highway": (80, 1000, 4000),
    "fog": (60, 2000, 3000),
    "night": (80, 3, 600),
    "tunnel": (60, 60, 1500),
}
FAR |= {
    "low_sun": (85, 30000, 2000),
    "dashcam": (90, 20000, 2000),
    "paper": (80, 1000, 4000),
}
"""Where a receiver of the paper's scene errs: distance (m), illuminance and luminance."""
SCENES_MADE = Path("runs/calibration")
TRAINED_ON, TESTED_ON = 1000, 2048
"""Frames."""
RESULTS = Path(__file__).parents[1] / "docs" / "results"
Row = list[Any]


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
    camera = replace(
        world.camera, width_px=WIDTH, height_px=HEIGHT, sensor_width_mm=wide
    )
    camera = replace(camera, gamma=float(draws.uniform(1.8, 2.4)))
    one, _ = world.scene.draw(BlockKey(seed, f"truth/{name}", 0), world.panel.shape)
    away, scale = (
        float(one.distance_m[0]),
        camera.focal_length_px / float(one.distance_m[0]),
    )
    across, down = (float(draws.uniform(-half, half)) / scale for half in (90, 50))
    model = SceneModel(
        constant(one.ambient_lx[0]),
        constant(one.led_luminance_cd_m2[0]),
        about(away, 0.05),
        constant(one.background_grey[0]),
        about(across, 0.02),
        about(down, 0.02),
    )
    return replace(
        world, camera=camera, scene=model, effects=effects, framing="full", device="cpu"
    )


def recorded(world: World, seed: int) -> tuple[Footage, torch.Tensor, Scene]:
    """Take the recording."""
    key = BlockKey(seed, "recording", 0)
    scene, bits = world.scene.draw(key, world.panel.shape)
    taken = AMONG_LAMPS if "lamps" in world.effects else FRAMES
    scene, bits = scene[:taken], bits[:taken]
    keys = [FrameKey(key, frame) for frame in range(taken)]
    greys = (
        Simulator(world.camera, world.panel, world.effects, framing="full")
        .render(scene, bits, keys=keys)
        .grey
    )
    panels = locator_named("refined", PaperLocator())(
        Frames.whole(greys[:, 0]), world.panel.shape
    )
    rows = panels.found.nonzero()[:, 0]
    corners = panels.corners_px.double().numpy()
    rows = rows[agreeing(corners[rows])][:FRAMES]
    seen = greys[rows, 0].numpy(), rows.numpy(), corners[rows]
    footage = Footage(*seen, taken, taken, [], np.full(len(rows), math.nan))
    return footage, bits[rows], scene[rows]


def compared(study: Findings, world: World, scene: Scene) -> list[Row]:
    """Give the values whose truth is known: key, truth, estimate, and the ends of the 95 % interval.

    Without photons only ratios of light are told, so light is compared over the ambient's.
    """
    told = {one.key: one for one in study.values}
    effects, ambient = world.effects, told["ambient_lx"].middle
    lux, light = float(scene.ambient_lx[0]), float(scene.led_luminance_cd_m2[0])
    air = effects.get("attenuation", {}).get("visibility_m", np.inf)
    kept = float(transmission(scene.distance_m[:1], air)[0])
    truth = {
        "camera.gamma": world.camera.gamma,
        "distance_m": float(scene.distance_m.mean()),
        "offset_x_m": float(scene.offset_x_m.mean()),
        "offset_y_m": float(scene.offset_y_m.mean()),
        "led_luminance_cd_m2 over ambient_lx": light * kept / lux,
    }
    if world.camera.iso_limits is None:
        truth["background_grey"] = float(scene.background_grey[0])
    if "shot_noise" in effects:
        truth["ambient_lx"] = lux
    if "veiling_glare" in effects:
        glare = effects["veiling_glare"]
        veil = 10 * glare["glare_illuminance_lx"] / glare["angle_deg"] ** 2
        truth["effects.veiling_glare.luminance_cd_m2 over ambient_lx"] = veil / lux
    # It is told as a veil, and the light before it is another.
    if "airlight" in effects:
        truth = {key: value for key, value in truth.items() if "lx" not in key}
    for key in COMPARED:
        _, effect, name = key.split(".")
        if effect in effects:
            given = effects[effect][name]
            truth[key] = (
                float(np.mean(given[1:])) if isinstance(given, list) else float(given)
            )
    rows = []
    for key, value in truth.items():
        name, _, over = key.partition(" over ")
        unit = ambient if over else 1.0
        if name in told and math.isfinite(told[name].deviation):
            rows.append(
                [
                    key,
                    value,
                    *(one / unit for one in (told[name].middle, *told[name].interval)),
                ]
            )
    return rows


def judged(study: Findings, world: World) -> list[Row]:
    """Say of each effect that was there or tried: was it there, named, said not to be told."""
    true = {ALIKE.get(effect, effect): effect for effect in world.effects}
    asked = {one.effect: one.asked for one in study.effects}
    coded, rows = any(one.startswith(CODED) for one in study.unknown), []
    for effect in dict.fromkeys((*true, *asked)):
        there, named, untold = effect in true, asked.get(effect, False), False
        if there and not named:
            word = (
                CODED
                if coded and effect in (*NOISES, "photoelectrons", "gain")
                else UNTOLD.get(effect)
            )
            untold = word is not None and any(word in one for one in study.unknown)
        rows.append([effect, *map(int, (there, named, untold))])
    return rows


def run(name: str, seed: int) -> tuple[list[Row], list[Row], str]:
    """Calibrate one recording: its values, its effects, and what happened."""
    began, world = time.process_time(), truth_of(name, seed)
    footage, bits, scene = recorded(world, seed)
    if len(footage) < 4:
        return [], [], f"the panel was found in {len(footage)} of {FRAMES} frames"
    camera = replace(world.camera, gamma=2.2, iso_limits=None)
    study = calibrate(footage, camera, world.panel, CalibrateConfig(frames=FRAMES))
    fitted = torch.from_numpy(
        np.isin(footage.numbers, study.footage.numbers)
    ).nonzero()[:, 0]
    bits, scene = bits[fitted], scene[fitted]
    wrong = int((study.fit.bits != bits.flatten(1).numpy()).sum())
    path = SCENES_MADE / f"{name}_{seed}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(study.text(path.stem, "a recording"))
    rows = compared(study, world, scene)
    effects = judged(study, world)
    off = ", ".join(
        f"{key} {(est - is_) / (high - low) * 3.92:+.1f}"
        for key, is_, est, low, high in rows
    )
    missed = [row for row in effects if row[1] and not row[2]]
    many = [effect for effect, there, named, *_ in effects if named and not there]
    text = f"{time.process_time() - began:.1f} s, {wrong} bits wrong, residuals {study.fit.scale**0.5:.2f}; "
    return rows, effects, text + f"{off}; missed {missed}, too many {many}"


def main() -> None:
    """Calibrate what is not in the files yet."""
    words = sys.argv[1:]
    if words == ["pictures"]:
        pictures()
        return
    if words and words[0] == "receivers":
        for one in words[1:]:
            rows = receivers(one, 0)
            print(one, rows, flush=True)
            append(
                "calibration_receivers.csv",
                "trained_on frames bits bit_errors",
                one,
                0,
                rows,
            )
        return
    count = int(words.pop(0)) if words and words[0].isdigit() else 1
    done = {
        (row["scene"], int(row["recording"]))
        for row in read(RESULTS / "calibration_effects.csv")
    }
    for seed in range(FIRST, FIRST + count):
        for name in words or SCENES:
            if (name, seed) in done:
                continue
            rows, effects, text = run(name, seed)
            print(f"{name} {seed}: {text}", flush=True)
            append("calibration.csv", "key truth estimate low high", name, seed, rows)
            columns = "effect present named untold"
            append(
                "calibration_effects.csv",
                columns,
                name,
                seed,
                effects or [["none", 0, 0, 0]],
            )


def receivers(name: str, seed: int) -> list[Row]:
    """Calibrate a recording from afar; train on the paper's scene, on the one found and on the true one.

    Errors are counted in fresh frames of the true one. All read at the panel's true corners: what differs is
    what the scene taught.
    """
    true = truth_of(name, seed)
    far = {
        key: constant(value) for key, value in zip(LIGHT, FAR[name][1:], strict=True)
    }
    true = replace(
        true, scene=replace(true.scene, distance_m=about(FAR[name][0], 0.5), **far)
    )
    footage, bits, _ = recorded(true, seed)
    known = replace(true.camera, gamma=2.2, iso_limits=None)
    study = calibrate(footage, known, true.panel, CalibrateConfig(frames=FRAMES))
    bits = bits[torch.from_numpy(np.isin(footage.numbers, study.footage.numbers))]
    wrong_leds = int((study.fit.bits != bits.flatten(1).numpy()).sum())
    print(
        f"{name}: {wrong_leds} of {bits.numel()} bits of the recording wrong",
        flush=True,
    )
    path = SCENES_MADE / f"{name}_far_{seed}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(study.text(path.stem, "a recording"))
    worlds = {
        "paper": load_scene("paper"),
        "calibrated": load_scene(path),
        "true": true,
    }
    made = {
        one: vt.train(world, locator="truth", frames=TRAINED_ON)
        for one, world in worlds.items()
    }
    link = Link(true.simulator(), None, Reader(true.panel.shape))
    wrong: dict[str, list[torch.Tensor]] = {one: [] for one in made}
    keys = block_keys(0, f"calibrated {name}", TESTED_ON)
    with torch.inference_mode():
        for seen in link.observe_each(
            {"truth": None}, true.scene, keys, preambles=False, frames=TESTED_ON
        ):
            one = seen["truth"]
            for trained, receiver in made.items():
                read_ = receiver.score(one.readings) >= 0
                wrong[trained].append((read_ != one.bits).flatten(1).sum(1))
    return [
        [
            trained,
            TESTED_ON,
            TESTED_ON * true.panel.shape.leds,
            int(torch.cat(parts).sum()),
        ]
        for trained, parts in wrong.items()
    ]


def pictures() -> None:
    """Fit the photographs of real panels from their known corners, and write a page of each."""
    told = json.loads((PICTURES / "pictures.json").read_text(encoding="utf-8"))
    for name, one in told.items():
        (picture,) = read_recording(PICTURES / name, "max")
        corners = panel_corners(
            one["corner_led_centres_px"], PanelShape(one["rows"], one["columns"])
        )
        footage = Footage(
            picture.grey[None],
            np.zeros(1, np.int64),
            corners.double().numpy(),
            1,
            1,
            [],
            np.full(1, math.nan),
        )
        panel = replace(LedPanel(), shape=PanelShape(one["rows"], one["columns"]))
        camera, _ = of_size(Camera(), *picture.grey.shape)
        began, bits = (
            time.process_time(),
            np.array([[bit == "1" for bit in row] for row in one["bits"]]),
        )
        study = calibrate(footage, camera, panel, CalibrateConfig(frames=2))
        wrong = int((study.fit.bits != bits.reshape(1, -1)).sum())
        folder = SCENES_MADE / Path(name).stem
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "scene.yaml").write_text(study.text(folder.name, name))
        write_page(study, name, "vocc-torch task=train", folder)
        print(
            f"{name}: {time.process_time() - began:.0f} s, {wrong} of {bits.size} bits wrong",
            flush=True,
        )
        print(
            "\n".join(f"  {line}" for line in (*study.doubts, f"{folder}/page.html")),
            flush=True,
        )


def read(path: Path) -> list[dict[str, str]]:
    """Read a table, empty where there is none."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def append(file: str, columns: str, name: str, seed: int, rows: list[Row]) -> None:
    """Add a recording's rows to a table."""
    path = RESULTS / file
    fresh = not path.exists()
    with path.open("a", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        if fresh:
            writer.writerow(["scene", "recording", *columns.split()])
        for row in rows:
            shown = [f"{one:.7g}" if isinstance(one, float) else one for one in row]
            writer.writerow([name, seed, *shown])


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
