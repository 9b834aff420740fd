"""How often task=decode takes a picture without a panel for one: pictures found, and those without a warning.

    python benchmarks/no_panel.py
    python benchmarks/no_panel.py --locators paper refined detector --streets 200

Writes the table of docs/locators.md to the terminal, or that of docs/detector.md: what locators claim, and how
surely, in these pictures, black and white ones, and held-out streets without a panel, half of them by night.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from skimage import color, data
from sklearn.datasets import load_sample_images

import vocc_torch as vt
from vocc_torch.receiver.locators import LOCATORS, PaperLocator, locator_named
from vocc_torch.recordings.frames import RecordedFrame
from vocc_torch.studies.decode.judge import DOUBTFUL_SCORE
from vocc_torch.studies.decode.reading import read_panels
from vocc_torch.types import StatedPanels

SHIPPED = (
    "astronaut",
    "brick",
    "camera",
    "cell",
    "chelsea",
    "clock",
    "coffee",
    "coins",
    "colorwheel",
    "grass",
)
SHIPPED += (
    "gravel",
    "hubble_deep_field",
    "logo",
    "moon",
    "page",
    "rocket",
    "text",
    "horse",
    "checkerboard",
)
RECEIVERS = (("paper", "flda_3"), ("refined", "tag_planes"), ("detector", "tag_planes"))
DISTANCES_M = (30, 50, 70)
Picture = NDArray[np.uint8]


def grey(picture: NDArray[np.generic]) -> Picture:
    """Turn any picture into grey bytes."""
    plain = np.asarray(picture, dtype=float) / (
        255.0 if picture.dtype == np.uint8 else 1.0
    )
    return np.uint8(
        255 * (color.rgb2gray(plain[..., :3]) if plain.ndim == 3 else plain)
    )


def photographs() -> list[Picture]:
    """Give the photographs and drawings that come with scikit-image and scikit-learn."""
    found = [grey(one) for one in load_sample_images().images]
    for name in SHIPPED:
        try:
            found.append(grey(getattr(data, name)()))
        except (ImportError, OSError):  # not shipped with every version
            continue
    return found


def without_panel() -> Iterator[Picture]:
    """Give pictures that show no panel of LEDs, 140 in all."""
    random, size = np.random.default_rng(1), (240, 320)
    y, x = np.mgrid[: size[0], : size[1]]
    for _ in range(20):
        yield np.uint8(random.integers(0, 256, size))
        slope = random.normal(size=2)
        yield np.uint8(255 * (0.5 + 0.5 * np.sin((slope[0] * x + slope[1] * y) / 200)))
        spots = gaussian_filter(
            (random.random(size) < 3e-4).astype(float), random.uniform(1, 8)
        )
        yield np.uint8(60 + 190 * spots / max(spots.max(), 1e-9))
        square, (side, down, right) = (
            np.full(size, 90, np.uint8),
            random.integers((15, 0, 0), (90, 150, 230)),
        )
        square[down : down + side, right : right + side] = random.integers(150, 256)
        yield square
    pictures = photographs()
    yield from pictures
    for _ in range(140 - 80 - len(pictures)):
        whole = pictures[random.integers(len(pictures))]
        high, wide = (int(n * random.uniform(0.2, 0.6)) for n in whole.shape)
        down, right = (
            random.integers(whole.shape[0] - high),
            random.integers(whole.shape[1] - wide),
        )
        yield whole[down : down + high, right : right + wide]


def with_panel(
    distance_m: float, lit: int | None = None
) -> tuple[list[Picture], torch.Tensor]:
    """Render 64 frames of the paper's scenes at a distance, with as many LEDs On where that is given."""
    world = vt.load_scene("paper", f"scene.distance_m={distance_m}")
    (batch,) = vt.simulate(world, 64, point="no panel")
    frames, bits = batch.frames, batch.bits
    if lit is not None:
        bits = torch.full_like(bits, lit == bits[0].numel())
        frames = world.simulator().render(batch.scene, bits)
    return [np.ascontiguousarray(one) for one in frames.grey[:, 0].numpy()], bits


def row(
    receiver: vt.Receiver, pictures: list[Picture], bits: torch.Tensor | None
) -> list[int]:
    """Count pictures, those found, scored well and not warned of, and of these those with a wrong bit."""
    nowhere = np.zeros((1, 1, 3), np.uint8)
    frames = (
        RecordedFrame("", i, None, nowhere, one) for i, one in enumerate(pictures)
    )
    read = list(read_panels(receiver, frames))
    calm = [i for i, one in enumerate(read) if one.found and not one.is_doubtful]
    sure = [i for i in calm if not read[i].unlike and not read[i].one_level]
    well = sum(one.found and one.panel_score >= DOUBTFUL_SCORE for one in read)
    wrong = (
        0
        if bits is None
        else sum(bool((read[i].bits != bits[i].numpy()).any()) for i in calm)
    )
    return [
        len(read),
        sum(one.found for one in read),
        well,
        len(calm),
        wrong,
        len(sure),
    ]


def claimed(names: list[str], streets: int) -> None:
    """Print in how many pictures without a panel locators claim one, and how surely."""
    pictures = list(without_panel())
    kinds = {"drawn and noise": pictures[:80], "photographs and crops": pictures[80:]}
    kinds["black, white"] = [np.full((240, 320), level, np.uint8) for level in (0, 255)]
    for scene in ("street_held_out", "street_held_out_night") if streets else ():
        world = vt.load_scene(scene, "+scene.effects.panel_absent={}")
        batches = vt.simulate(world, streets // 2, batch=8, point=f"no panel, {scene}")
        kinds[scene] = [
            one for batch in batches for one in batch.frames.grey[:, 0].numpy()
        ]
    heads = (
        "locator",
        "pictures",
        "",
        "claimed",
        "median, greatest score of these",
        "least false alarms",
    )
    print(f"| {' | '.join(heads)} |\n" + "|---" * len(heads) + "|")
    for name in names:
        locator = locator_named(name, PaperLocator())
        for kind, some in kinds.items():
            panels = [locator(one[None].copy(), vt.PanelShape()) for one in some]
            scores = [float(one.score[0]) for one in panels if bool(one.found[0])]
            shown = f"{np.median(scores):.2f}, {max(scores):.2f}" if scores else ""
            stated = [
                float(one.false_alarms[0])
                for one in panels
                if isinstance(one, StatedPanels)
            ]
            least = f"{min(stated):.2g}" if stated else "states none"
            print(
                f"| `{name}` | {kind} | {len(some)} | {len(scores)} | {shown} | {least} |",
                flush=True,
            )


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--locators",
        nargs="+",
        choices=LOCATORS,
        help="for the table of docs/detector.md",
    )
    parser.add_argument(
        "--streets",
        type=int,
        default=0,
        help="frames of held-out streets without a panel",
    )
    given = parser.parse_args()
    torch.set_num_threads(1)
    if given.locators:
        claimed(given.locators, given.streets)
        return
    kinds: dict[str, tuple[list[Picture], torch.Tensor | None]] = {
        "no panel": (list(without_panel()), None)
    }
    kinds |= {f"panel at {one} m": with_panel(one) for one in DISTANCES_M}
    kinds["all LEDs On, 50 m"] = with_panel(50, 64)
    heads = [
        "frames",
        "found",
        f"score of {DOUBTFUL_SCORE:g} or more",
        "not doubtful",
        "of these wrong",
    ]
    print(
        f"| receiver | | {' | '.join(heads)} | no warning at all |\n" + "|---" * 8 + "|"
    )
    for locator, classifier in RECEIVERS:
        # As task=decode has it.
        taught_by = "truth" if locator == "detector" else locator
        receiver = vt.train("paper", locator=taught_by, classifier=classifier)
        receiver.locator = locator_named(locator, PaperLocator())
        for kind, (pictures, bits) in kinds.items():
            cells = " | ".join(map(str, row(receiver, pictures, bits)))
            print(f"| {locator}, `{classifier}` | {kind} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
