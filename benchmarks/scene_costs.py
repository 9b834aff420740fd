"""Does a shipped scene cost what its effects cost one at a time?

For each scene: the time of a frame with all its effects, against the time without any plus what each effect
adds to a chain of nothing but itself and what it needs. Whole frames are rendered whole from the start, where
every effect has the same pixels to do; near the panel an effect that makes the image larger makes the others
dearer. All chains of a scene take turns; medians over the rounds.

    python benchmarks/scene_costs.py --rounds 9
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import torch
import yaml

from vocc_torch import PanelShape, Simulator
from vocc_torch.measure.timing import describe_machine, interleaved, median_of
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Camera, Distribution, SceneModel
from vocc_torch.simulation.effects import PHYSICAL_ORDER, Parameters, Quantity

Chain = dict[str, Parameters]
SCENES = Path(__file__).resolve().parents[1] / "conf" / "scene"
ELECTRONS = {kind.name for kind in PHYSICAL_ORDER if Quantity.ELECTRONS in (kind.takes, kind.gives)}


def chains(effects: Mapping[str, Parameters]) -> dict[str, tuple[Chain, Chain]]:
    """Give each effect with what it needs, and what it needs alone."""
    pairs: dict[str, tuple[Chain, Chain]] = {}
    sensor = {name: effects[name] for name in ("photoelectrons", "gain") if name in effects}
    needs = {
        "quantization": ("saturation",),
        "jpeg": ("saturation", "quantization"),
        "airlight": ("attenuation",),
    }
    for name, parameters in effects.items():
        if name == "gain":
            continue
        rest: Chain = {other: effects[other] for other in needs.get(name, ())}
        if name in ELECTRONS and name != "photoelectrons":
            rest = dict(sensor)
        own: Chain = sensor if name == "photoelectrons" else {name: parameters}
        pairs[name] = ({**rest, **own}, rest)
    return pairs


def measured(path: Path, rounds: int, whole: bool, frames: int) -> tuple[float, float, float]:
    """Give the time of the scene's frame, of a frame without effects, and the sum of its effects', ms."""
    given = yaml.safe_load(path.read_text(encoding="utf-8"))
    camera = given.get("camera", {})
    if "iso_limits" in camera:
        camera["iso_limits"] = tuple(camera["iso_limits"])
    fields = (
        "ambient_lx",
        "led_luminance_cd_m2",
        "distance_m",
        "background_grey",
        "offset_x_m",
        "offset_y_m",
    )
    model = SceneModel(**{name: Distribution.parse(given[name], name) for name in fields})
    key = BlockKey(0, "scene_costs", 0)
    scene, bits = model.draw(key, PanelShape())
    keys = [FrameKey(key, frame) for frame in range(frames)]
    pairs = chains(given["effects"])
    wanted: dict[str, Chain] = {"scene": given["effects"], "none": {}}
    for name, (present, absent) in pairs.items():
        wanted |= {f"{name} with": present, f"{name} without": absent}

    def shot(effects: Chain) -> object:
        simulator = Simulator(Camera(**camera), effects=effects, framing="full" if whole else "crop")
        return lambda: simulator.render(
            scene[:frames], bits[:frames], nearest_m=model.nearest_m, keys=keys, panel_only=not whole
        )

    calls = {name: shot(effects) for name, effects in wanted.items()}
    times = interleaved(calls, rounds, torch.device("cpu"), warm_up=1)  # type: ignore[arg-type]  # all are callable
    ms = {name: median_of(timing.seconds).value / frames * 1e3 for name, timing in times.items()}
    added = sum(ms[f"{name} with"] - ms[f"{name} without"] for name in pairs)
    return ms["scene"], ms["none"], added


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Shipped scenes against the sum of their effects' costs.")
    parser.add_argument("--rounds", type=int, default=9)
    given = parser.parse_args()
    torch.set_num_threads(1)
    print(f"{describe_machine(torch.device('cpu'))}; {given.rounds} rounds\n")
    print("| scene | whole frame, ms | its parts, ms | ratio | panel only, ms | its parts, ms | ratio |")
    print("|---|---|---|---|---|---|---|")
    for path in sorted(SCENES.glob("*.yaml")):
        cells = []
        for whole, frames in ((True, 1), (False, 32)):
            scene, none, added = measured(path, given.rounds, whole, frames)
            cells += [f"{scene:.3g}", f"{none + added:.3g}", f"{scene / (none + added):.2f}"]
        print(f"| `{path.stem}` | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
