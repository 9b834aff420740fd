"""Every shipped classifier, trained on the paper's scenes, in every shipped scene and by LEDs that are On.

    python benchmarks/receivers_by_scene.py

A repeated run continues: trained receivers are in ``--models``, finished parts in their table.
"""

import argparse
import csv
import time
from pathlib import Path

import torch

import vocc_torch as vt
from vocc_torch.measure.counts import half_errors
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.receiver.locators import PaperLocator, RefinedLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import FrameKey

ROOT = Path(__file__).resolve().parent.parent
SCENES = ("paper", "highway", "dashcam", "night", "tunnel", "low_sun", "fog")
LAST = ("mlp_features", "cnn", "mlp")
"""The receivers whose training takes longest; they are trained last."""
RATIOS = (
    "flda_3",
    "flda_3_mix",
    "flda_patch",
    "flda_patch_exposure",
    "logistic",
    "boosted_trees",
    *LAST,
)
"""Receivers whose scores are log-likelihood ratios already without calibration."""
CORNERS = {
    "truth": None,
    "paper": PaperLocator(),
    "refined": RefinedLocator(PaperLocator()),
}
LIT = (0, 1, 4, 16, 48, 60, 63, 64)
"""LEDs of the panel's 64 that are On."""
TABLES = {
    "receivers_by_scene": "scene corners receiver frames found bit_errors ber ber_low ber_high ece_raw ece",
    "receivers_by_lit": "scene lit receiver bits wrong",
}
Rows, Receivers = list[list[object]], dict[str, Receiver]


class Table:
    """A CSV table that is written part by part; a repeated run skips the parts that are there."""

    def __init__(self, folder: Path, name: str) -> None:
        self.path = folder / f"{name}.csv"
        if not self.path.exists():
            self.path.write_text(
                TABLES[name].replace(" ", ",") + "\n", encoding="utf-8"
            )

    def has(self, *part: str) -> bool:
        """Whether rows that begin with these cells are there."""
        with self.path.open(newline="", encoding="utf-8") as file:
            return any(tuple(row[: len(part)]) == part for row in csv.reader(file))

    def add(self, rows: Rows) -> None:
        """Write the rows of a part at once, so that no part is incomplete."""
        lines = [
            ",".join(f"{c:.6g}" if isinstance(c, float) else str(c) for c in row)
            for row in rows
        ]
        if lines:
            with self.path.open("a", encoding="utf-8") as file:
                file.write("\n".join(lines) + "\n")


def calibration_error(
    ratios: torch.Tensor, bits: torch.Tensor, bins: int = 20
) -> float:
    """Expected calibration error: mean distance between stated probability of On and share of On, over bins."""
    order = torch.argsort(ratios.flatten(), stable=True)
    stated, sent = (
        torch.sigmoid(ratios.flatten()[order].double()),
        bits.flatten()[order].double(),
    )
    parts = zip(stated.tensor_split(bins), sent.tensor_split(bins), strict=True)
    apart = [float((a.mean() - b.mean()).abs()) * len(a) for a, b in parts if len(a)]
    return sum(apart) / max(1, len(stated))


def trained(models: Path) -> dict[str, Receiver]:
    """Train the missing receivers at true corners, and load all from their files."""
    shipped = [
        path.stem for path in sorted((ROOT / "conf" / "classifier").glob("*.yaml"))
    ]
    names = [
        "flda_3",
        *(name for name in shipped if name not in ("own", "sklearn", *LAST)),
        *LAST,
    ]
    for name in names:
        if not (path := models / f"{name}.pt").exists():
            begun = time.perf_counter()
            vt.train("paper", locator="truth", classifier=name, frames=1000).save(path)
            print(f"{name} trained in {time.perf_counter() - begun:.0f} s", flush=True)
    return {name: Receiver.load(models / f"{name}.pt", ["sklearn"]) for name in names}


def count(receivers: Receivers, scene: str, corners: list[str], frames: int) -> Rows:
    """Give the rows of a scene, all receivers on the same frames."""
    world = vt.load_scene(scene)
    rows = []
    link = Link(world.simulator(), None, Reader(world.panel.shape))
    sent, found = [], {at: [] for at in corners}
    scores = {(at, name): [] for at in corners for name in receivers}
    keys, finders = (
        block_keys(0, f"receivers {scene}", frames),
        {at: CORNERS[at] for at in corners},
    )
    with torch.inference_mode():
        for seen in link.observe_each(
            finders, world.scene, keys, preambles=False, frames=frames
        ):
            sent.append(seen[corners[0]].bits)
            for at in corners:
                found[at].append(seen[at].panels.found)
                for name, receiver in receivers.items():
                    scores[at, name].append(receiver.score(seen[at].readings))
    bits = torch.cat(sent)
    for (at, name), parts in scores.items():
        score, there = torch.cat(parts), torch.cat(found[at])
        wrong = half_errors(score >= 0, bits, there)
        table = torch.stack([wrong, there, ~there])[:, None].numpy()
        groups, leds = 0 * table[0, 0], world.panel.shape.leds
        (counts,) = FrameErrors(table, groups, leds).counts
        rate, ratios = ber_interval(counts), receivers[name].calibration(score[there])
        errors = calibration_error(score[there], bits[there]) if name in RATIOS else ""
        row = [
            scene,
            at,
            name,
            frames,
            int(there.sum()),
            counts.bit_errors,
            counts.ber,
            rate.low,
            rate.high,
        ]
        rows.append([*row, errors, calibration_error(ratios, bits[there])])
    return rows


def of_lit(receivers: Receivers, scene: str, lit: int, frames: int = 64) -> Rows:
    """Give wrong bits at the true corners of panels that all have as many LEDs On."""
    world, random = vt.load_scene(scene), torch.Generator().manual_seed(lit)
    simulator, (block,) = world.simulator(), block_keys(0, f"lit {scene}", frames)
    drawn, bits = world.scene.draw(block, world.panel.shape)
    bits = (
        torch.rand(frames, bits[0].numel(), generator=random).argsort(dim=1) < lit
    ).view_as(bits)
    keys = [FrameKey(block, frame) for frame in range(frames)]
    taken = simulator.render(
        drawn, bits, nearest_m=world.scene.nearest_m, keys=keys, panel_only=True
    )
    with torch.inference_mode():
        readings = Reader(world.panel.shape).read(
            taken, simulator.true_panels(drawn, keys, rendered=True)
        )
        decided = {
            name: receiver.score(readings) >= 0 for name, receiver in receivers.items()
        }
    return [
        [scene, lit, name, bits.numel(), int((read != bits).sum())]
        for name, read in decided.items()
    ]


def main() -> None:
    """Train, count and write what is missing."""
    parser = argparse.ArgumentParser(
        description="Receivers by scene and by LEDs that are On."
    )
    parser.add_argument(
        "--frames", type=int, default=2048, help="of each scene at the true corners"
    )
    parser.add_argument(
        "--located", type=int, default=256, help="of each scene with each locator"
    )
    parser.add_argument("--models", type=Path, default=Path("runs/receivers-by-scene"))
    parser.add_argument("--results", type=Path, default=ROOT / "docs" / "results")
    given = parser.parse_args()
    torch.set_num_threads(1)
    given.models.mkdir(parents=True, exist_ok=True)
    receivers = trained(given.models)
    scenes, shares = (Table(given.results, name) for name in TABLES)
    for scene, lit in (
        (a, b) for a in SCENES for b in LIT if not shares.has(a, str(b))
    ):
        shares.add(of_lit(receivers, scene, lit))
    for corners, frames in (
        (["truth"], given.frames),
        (["paper", "refined"], given.located),
    ):
        for scene in (one for one in SCENES if not scenes.has(one, corners[0])):
            scenes.add(count(receivers, scene, corners, frames))
            print(f"{scene}, {corners}", flush=True)


if __name__ == "__main__":
    main()
