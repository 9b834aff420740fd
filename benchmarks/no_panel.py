"""False alarms of locators: pictures without a panel in which they find one, and its score.

    python benchmarks/no_panel.py --locators refined detector --streets 96

The pictures are drawn ones and noise, photographs, black and white ones, and held-out streets without a panel, half
of them by night.
"""

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


def print_false_alarms(names: list[str], streets: int) -> None:
    """Print in how many pictures without a panel locators find one, and its score."""
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
        "found",
        "median, highest score of these",
        "lowest false_alarms",
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
    parser.add_argument("--locators", nargs="+", choices=LOCATORS, default=["detector"])
    parser.add_argument(
        "--streets",
        type=int,
        default=0,
        help="frames of held-out streets without a panel",
    )
    options = parser.parse_args()
    torch.set_num_threads(1)
    print_false_alarms(options.locators, options.streets)


if __name__ == "__main__":
    main()
