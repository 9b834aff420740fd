"""The rare-event estimator: does its interval hold the truth, and what do wrong frames look like?

    python benchmarks/rare.py coverage
    python benchmarks/rare.py frames 1400 experiment=ambient receiver.locator=truth classifier=tag_planes
    python benchmarks/rare.py seeds 1600 experiment=ambient receiver.locator=truth classifier=tag_planes
    python benchmarks/rare.py picture 1600 experiment=ambient receiver.locator=truth classifier=tag_planes
    python benchmarks/rare.py strata 1800 experiment=ambient receiver.locator=refined classifier=tag_planes

``coverage`` simulates studies with errors whose rate is known: an LED that is Off between four that are On is
wrong where luminance, distance and background all lie in the last part of their distributions, or are so far
up together. ``frames`` resamples the weighted errors of real frames, whose mean is then the truth. ``seeds``
repeats one study, with pilots and frames of their own. ``picture`` draws frames that a receiver has wrong.
``strata`` counts frames that all have some outer rows and columns dark, each kind with the probability that
it has, and no weights: what a locator's failures must come to.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from hydra import compose, initialize_config_module
from matplotlib.figure import Figure

from vocc_torch.app.config import register_schema
from vocc_torch.app.resolve import resolved
from vocc_torch.measure import frame_errors, rare, sweep, train
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Budget
from vocc_torch.measure.counts import WeightedCounts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.point_work import parts_of, stop_reason
from vocc_torch.measure.tilted import WIDTHS, Component, TiltedScenes
from vocc_torch.measure.workers import Workers
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.types import PanelShape

SHAPE, NAMES = PanelShape(8, 8), ("led_luminance_cd_m2", "distance_m", "background_grey")


ENDS = {
    "each": [0, 0, 0, 0, 0, 0.1, 0.2, 0.2, 0.25, 0.25],
    "sum": [0, 0, 0, 0, 0, 0, 0, 0.1, 0.2, 0.7],
    "missed": [0, 0, 0, 0, 0, 0, 0, 0, 0.1, 0.9],
}
"""Where three values are sought: too little, a little too far out, and hardly where the errors are."""


def toy_scenes(frames: int, law: str) -> TiltedScenes:
    """Tilt towards Off LEDs between On ones and upper ends of values."""
    template = np.full((5, 5), 0.5)
    template[1:4, 2], template[2, 1:4], template[2, 2] = 0.9, 0.9, 0.1
    tilts = dict.fromkeys(NAMES, 0.8 * np.array(ENDS[law]) + 0.2 * WIDTHS)
    seeks = rare.around_leds(SHAPE, frames, template, 0.5, {0: 1.0, 1: 0.1, 2: 0.1}, tilts)
    return TiltedScenes.of(SceneModel(), [Component.nominal(BLOCK_FRAMES - frames, SHAPE), seeks])


def toy_errors(placed: Mapping[str, np.ndarray], bits: np.ndarray, share: float, law: str) -> np.ndarray:
    """Count the wrong LEDs of each frame of a block."""
    around = [bits[:, :-2, 1:-1], bits[:, 2:, 1:-1], bits[:, 1:-1, :-2], bits[:, 1:-1, 2:]]
    surrounded = ~bits[:, 1:-1, 1:-1] & np.logical_and.reduce(around)
    left = 1 - np.stack([placed[name] for name in NAMES])
    hard = (left.max(axis=0) if law == "each" else left.sum(axis=0)) <= share
    return surrounded.sum(axis=(1, 2)) * hard


def told(name: str, truth: float, counts: Sequence[WeightedCounts], spent: float) -> None:
    """Print how often intervals hold the truth."""
    found = [ber_interval(one) for one in counts]
    low, high = sum(one.low > truth for one in found), sum(one.high < truth for one in found)
    cover, mean = 1 - (low + high) / len(found), np.mean([one.value for one in found])
    error = np.std([one.value for one in found]) / len(found) ** 0.5 / truth
    kish = np.median([one.weighted**2 / max(1, one.squares) for one in counts])
    width = np.median([(one.high - one.low) / truth for one in found])
    print(
        f"| {name} | {truth:.2g} | {kish:.0f} | {100 * (mean / truth - 1):+.1f} ± {100 * error:.1f} "
        f"| {100 * cover:.1f} ± {100 * (cover * (1 - cover) / len(found)) ** 0.5:.1f} "
        f"| {100 * high / len(found):.1f} / {100 * low / len(found):.1f} | {width:.2f} | {spent:.0f} |"
    )


COLUMNS = (
    "studies",
    "BER",
    "effective wrong frames",
    "bias, %",
    "covers, %",
    "truth above / below, %",
    "width / BER",
)
HEAD = f"| {' | '.join((*COLUMNS, 'CPU s'))} |\n{'|---' * (len(COLUMNS) + 1)}|"


LAWS = (
    *(("each", 0.1, 48, 4), ("each", 0.1, 48, 16), ("each", 0.03, 48, 16), ("each", 0.1, 4, 16)),
    *(("sum", 0.2, 48, 16), ("sum", 0.2, 48, 32), ("missed", 0.2, 48, 32)),
)
"""Whether LEDs are wrong in this last share of each value or of their sum; frames of 64 that seek; blocks."""


def coverage(studies: int) -> None:
    """Simulate studies of a receiver whose rate is known."""
    print(HEAD)
    for law, share, frames, blocks in LAWS:
        begin, counts, scenes = time.process_time(), [], toy_scenes(frames, law)
        truth = 36 / 64 / 32 * share**3 / (1 if law == "each" else 6)
        for study in range(studies):
            total = WeightedCounts()
            for block in range(blocks):
                drawn = scenes.drawn(BlockKey(study, "toy", block), SHAPE)
                wrong, weights = toy_errors(*drawn, share, law), scenes.weights(*drawn)
                found = np.ones(len(wrong), dtype=bool)
                total += WeightedCounts.weigh(2 * wrong, found, SHAPE.leds, weights, scenes.nominal)
            counts.append(total)
        name = f"{law}, {blocks * BLOCK_FRAMES} frames, {frames} of 64 sought"
        told(name, truth, counts, time.process_time() - begin)


def planned(words: Sequence[str]) -> Plan:
    """Compose a plan as the command line does."""
    register_schema()
    with initialize_config_module("vocc_torch.conf", version_base="1.3"):
        return build_plan(resolved(compose("config", overrides=list(words)), words), Path("runs"))


def trained(plan: Plan) -> dict[str, ReceiverBank]:
    """Train with the plan's locator."""
    return {plan.receiver.locator: train.train(plan).bank(plan.receiver.names)}


def proposed(plan: Plan, value: float) -> tuple[dict[str, ReceiverBank], str, TiltedScenes]:
    """Train, and find the proposal of a point."""
    banks = trained(plan)
    name, model = sweep.point_name(plan.experiment, value), plan.experiment.model_at(plan.world, value)
    return banks, name, rare.proposal(plan, banks, model, name, Workers(1).submit)


def resampled(plan: Plan, value: float, blocks: int, studies: int) -> None:
    """Draw studies, with repetition, from the blocks of a real point, whose mean is their truth."""
    banks, name, scenes = proposed(plan, value)
    begin, rule, random = time.process_time(), Budget(precision=0.2), np.random.default_rng(0)
    parts = list(parts_of(blocks * BLOCK_FRAMES))
    counted = [rare.count_parts(plan, banks, name, scenes, [part])[0] for part in parts]
    print(HEAD)
    for label in counted[0]:
        own = [one[label] for one in counted]
        truth = sum(own[1:], own[0]).ber
        for taken in (16, 64, 128):
            drawn = random.integers(blocks, size=(studies, taken))
            counts = [sum((own[i] for i in row[1:]), own[row[0]]) for row in drawn.tolist()]
            told(f"{label[1]} at {value:g}, {taken * 64} frames", truth, counts, time.process_time() - begin)
        stopped = []
        for _ in range(studies):
            total, count = 0, 0
            while not count or (stop_reason(rule, {label: total}, count) is None and count < 4096):
                total, count = own[random.integers(blocks)] + total, count + 1
            stopped.append(total)
        told(f"{label[1]} at {value:g}, stopped at 20 %", truth, stopped, time.process_time() - begin)


def repeated(plan: Plan, value: float, seeds: int) -> None:
    """Repeat the study of one training's receivers, each time with a pilot and frames of its own."""
    banks, name = trained(plan), sweep.point_name(plan.experiment, value)
    (locator,), model = banks, plan.experiment.model_at(plan.world, value)
    print(f"| seed | frames | effective wrong frames | BER | CPU s |\n{'|---' * 5}|")
    found: dict[str, list[Estimate]] = {one: [] for one in banks[locator].names}
    for seed in range(1, seeds + 1):
        begin, own = time.process_time(), replace(plan, seed=seed)
        scenes = rare.proposal(own, banks, model, name, Workers(1).submit)
        parts, total, count = list(parts_of(plan.budget.frames)), {}, 0
        while count < len(parts) and (not count or stop_reason(plan.budget, total, count) is None):
            for one in rare.count_parts(own, banks, name, scenes, parts[count : count + 16]):
                total = {label: more + total.get(label, 0) for label, more in one.items()}
            count += 16
        for label, counts in total.items():
            found[label[1]].append(one := ber_interval(counts))
            kish = counts.weighted**2 / max(1, counts.squares)
            print(
                f"| {label[1]}, {seed} | {counts.frames} | {kish:.0f} | {one.value:.3g} [{one.low:.3g}, "
                f"{one.high:.3g}] | {time.process_time() - begin:.0f} |",
                flush=True,
            )
    for label, each in found.items():
        rates = np.array([one.value for one in each])
        mean, held = rates.mean(), sum(one.low <= rates.mean() <= one.high for one in each)
        spread, most = 100 * rates.std(ddof=1) / mean, 100 * abs(rates / mean - 1).max()
        print(f"{label}: {mean:.3g}, spread {spread:.0f} %, at most {most:.0f} %; {held} of {seeds} hold it")


def strata(plan: Plan, value: float, blocks: int) -> None:
    """Count frames whose outer lines are dark, and give each kind's share of the rate."""
    banks, model = trained(plan), plan.experiment.model_at(plan.world, value)
    each = frame_errors.Banks(list(banks.items()))
    print(f"| dark | share of frames | misplaced | their share of the BER | CPU s |\n{'|---' * 5}|")
    corner, two, opposite = (np.full((1, 8, 8), 0.5) for _ in range(3))
    corner[0, 0], corner[0, :, 0], two[0, :2], opposite[0, ::7] = 1e-15, 1e-15, 1e-15, 1e-15
    kinds = (("a row and a column", corner, 4), ("two at a side", two, 4), ("two opposite", opposite, 2))
    for name, maps, ways in kinds:
        begin, share = time.process_time(), ways * 2.0 ** -int((maps < 0.5).sum())
        scenes = TiltedScenes.of(model, [Component(BLOCK_FRAMES, maps, np.ones(1))])
        job = frame_errors.FrameJob(plan, scenes, f"strata/{name}", tuple(banks), each, each.needs_preambles)
        halves = np.array(job.count(range(blocks), blocks * BLOCK_FRAMES).half_errors)[0]
        wrong = halves / 2 / SHAPE.leds * (halves > 12)  # six bits and more: no single LEDs
        error = share * wrong.std() / len(wrong) ** 0.5
        print(
            f"| {name} | {share:.2g} | {(wrong > 0).sum()} of {len(wrong)} "
            f"| {share * wrong.mean():.2e} ± {error:.1e} | {time.process_time() - begin:.0f} |"
        )


def picture(plan: Plan, value: float, path: Path) -> None:
    """Draw twelve frames of the saved receiver with a wrong bit, drawn as often as their weights say."""
    banks, name, scenes = proposed(plan, value)
    link, (locator, bank) = Link.of(plan), next(iter(banks.items()))
    kept, place = [], list(bank.names).index(plan.receiver.save)
    for block in range(64):
        key, first = BlockKey(plan.seed, name, block), 0
        weights = scenes.weights(*scenes.drawn(key, plan.world.panel.shape))
        for seen in link.observe(scenes, [key], preambles=False):
            decided = list(bank.scores(seen.readings, seen.preambles).values())[place] >= 0
            wrong = (decided != seen.bits) & seen.panels.found.view(-1, 1, 1)
            for i in torch.nonzero(wrong.flatten(1).any(1) | ~seen.panels.found).flatten().tolist():
                kept.append((weights[first + i] * max(1, int(wrong[i].sum())), seen, i, wrong[i]))
            first += len(seen.bits)
    if not kept:
        print("no wrong frame of 4096")
        return
    share = np.array([one[0] for one in kept]) / sum(one[0] for one in kept)
    drawn = np.random.default_rng(0).choice(len(kept), size=min(12, len(kept)), replace=False, p=share)
    figure = Figure(figsize=(12, 7.4), dpi=110)
    for number, row in enumerate(drawn.tolist()):
        _, seen, i, wrong = kept[row]
        axes = figure.add_subplot(3, 4, number + 1)
        true = (
            link.simulator.true_panels(seen.scene, [], rendered=True).corners_px[i] - seen.frames.origin_px[i]
        )
        grey = seen.frames.grey[i, 0].numpy()
        axes.imshow(grey, cmap="gray", vmin=60, vmax=255, extent=(0, grey.shape[1], grey.shape[0], 0))
        (left, top), (right, bottom) = true[0].tolist(), true[2].tolist()
        for r, c in torch.nonzero(wrong).tolist():
            x = left + (c + 0.5) * (right - left) / wrong.shape[1]
            y = top + (r + 0.5) * (bottom - top) / wrong.shape[0]
            colour = "tab:orange" if seen.bits[i, r, c] else "tab:red"
            axes.plot(x, y, "s", ms=11, mfc="none", mec=colour, mew=1.5)
        found = (seen.panels.corners_px[i] - seen.frames.origin_px[i]).numpy()
        axes.plot(*found[[0, 1, 2, 3, 0]].T, color="tab:blue", lw=1)
        pitch = (right - left) / wrong.shape[1]
        axes.set_xlim(left - 2 * pitch, right + 2 * pitch)
        axes.set_ylim(bottom + 2 * pitch, top - 2 * pitch)
        one = seen.scene
        axes.set_title(
            f"{float(one.led_luminance_cd_m2[i]):.0f} cd/m2, {float(one.distance_m[i]):.1f} m, "
            f"grey {float(one.background_grey[i]):.0f}\n{int(wrong.sum())} wrong",
            fontsize=8,
        )
        axes.set_axis_off()
    title = (
        f"{plan.receiver.save} at {plan.experiment.axis} = {value:g}, locator {locator}: {len(kept)} wrong"
    )
    title += " of 4096 tilted frames, twelve drawn by their weight; red: sent Off, orange: sent On"
    figure.suptitle(title, fontsize=10)
    figure.tight_layout()
    figure.savefig(path)
    print(f"{len(kept)} wrong frames; {path}")


def main() -> None:
    """Read the command line and run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("coverage", "frames", "seeds", "picture", "strata"))
    parser.add_argument("value", nargs="?", type=float, help="of the experiment's axis")
    parser.add_argument("words", nargs="*", help="as on the command line of vocc-torch")
    parser.add_argument("--studies", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--blocks", type=int, default=256)
    parser.add_argument("--out", type=Path, default=Path("wrong_frames.png"))
    given = parser.parse_args()
    if given.what == "coverage":
        coverage(given.studies)
    elif given.what == "frames":
        resampled(planned(given.words), given.value, given.blocks, given.studies)
    elif given.what == "strata":
        strata(planned(given.words), given.value, min(given.blocks, 64))
    elif given.what == "seeds":
        repeated(planned(given.words), given.value, given.seeds)
    else:
        picture(planned(given.words), given.value, given.out)


if __name__ == "__main__":
    main()
