"""``task=export``: simulated frames as PNG, with their truth as CSV and COCO JSON."""

import shutil
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_folder
from vocc_torch.measure import build, sweep, workers
from vocc_torch.measure.config import Budget, Settings
from vocc_torch.measure.ledger import Label, Ledger, Tally
from vocc_torch.measure.link import block_keys, rendered
from vocc_torch.measure.plan import Plan, identity
from vocc_torch.measure.point_work import Part, PointWork
from vocc_torch.report import folder as run_folder
from vocc_torch.report import samples, terminal
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.simulation import SceneModel
from vocc_torch.simulation.effects.coding import Quantization
from vocc_torch.studies.export import ExportConfig, truth

FRAMES = "frames"
"""The folder of all pictures."""


def run_export(settings: Settings, config: ExportConfig, folder: Path) -> None:
    """Write the frames shard by shard, and then one table and one COCO file of all.

    Raises:
        VoccError: frames that are not of 8 bits, or whatever a stage refuses.
    """
    run_folder.refuse_results(folder, run_folder.LEDGER)
    plan, console = build.build_plan(settings, folder), terminal.Console()
    simulator = plan.world.simulator()
    if not any(isinstance(effect, Quantization) and effect.bits == 8 for effect in simulator.effects):
        raise VoccError("scene.effects.quantization must be {bits: 8}: task=export writes greys of 8 bits")
    kind: sweep.Kind = "test" if config.points == "test" else "train"
    shards = [Shards(plan, point, model, config) for point, model in sweep.scenes_of(plan, kind).items()]
    pool = workers.Workers.of(settings)
    with (
        run_folder.resumable(settings, folder, console),
        run_folder.open_ledger(folder / run_folder.LEDGER, identity_of(plan, config), console) as ledger,
    ):
        for one in shards:  # what workers had begun that were killed
            for left in (folder / one.place(0)).parent.glob(".*.tmp"):
                shutil.rmtree(left, ignore_errors=True)
        run_folder.write_config(settings, folder)
        samples.write_samples(folder, plan, [kind])
        frames = config.frames * len(shards)
        try:
            render(shards, ledger, pool, console)
        except BaseException:
            if not len(ledger):  # nothing to go on from
                shutil.rmtree(folder / FRAMES, ignore_errors=True)
            raise
        files = [folder / place / truth.NAME for one in shards for place in one.places]
        truth.write_truth(folder / truth.NAME, files)
        truth.write_coco(folder / "coco.json", files, simulator.panel.shape)
    console.print(f"{frames} frames", highlight=False)
    places = {"frames": FRAMES, "truth": truth.NAME, "COCO": "coco.json", "samples": run_folder.SAMPLES}
    run_folder.print_places(console, folder, places.items())


def render(
    shards: Sequence["Shards"], ledger: Ledger, pool: workers.Workers, console: terminal.Console
) -> None:
    """Write what is not yet written, shared out over workers."""
    config = shards[0].config
    at_once, rule = config.shard_frames // BLOCK_FRAMES, Budget(config.frames)
    with pool, terminal.ProgressView(config.frames * len(shards), console, "rendering") as view:

        def told(more: int, _: object) -> None:
            view.advance("rendering", more)

        works = [PointWork(one.point, one, rule, ledger, told) for one in shards]
        with workers.worker_losses_told():
            deque(pool.run(works, at_once), maxlen=0)


def identity_of(plan: Plan, config: ExportConfig) -> dict[str, Any]:
    """Name what the files depend on: of a study's identity all but the receivers."""
    told, experiment = identity(plan, ()), plan.experiment
    scenes = {"training": told["experiment"]["training"]}
    if config.points == "test":
        axes = {"values": experiment.values, "row_axis": experiment.row_axis, "rows": experiment.rows}
        scenes = {**told["experiment"], "training": None, **axes}
    kept = {name: told[name] for name in ("seed", "world", "made_with")}
    return {**kept, "experiment": scenes, "export": asdict(config)}


@dataclass(frozen=True)
class Shards:
    """Writes the shards of one point, each a folder of pictures and their truth; picklable for workers.

    Args:
        plan: world, seed, folder and batch size.
        point: name that keys the random draws.
        model: the scenes.
        config: how many frames, and how many of them in a folder.
    """

    plan: Plan
    point: str
    model: SceneModel
    config: ExportConfig

    @property
    def places(self) -> list[str]:
        """The folders below the run's, in order; each is named by its first frame."""
        return [self.place(first) for first in range(0, self.config.frames, self.config.shard_frames)]

    def place(self, first: int) -> str:
        """The folder of the shard that begins with a frame."""
        return f"{FRAMES}/{self.point}/{first:07d}"

    def __call__(self, parts: Sequence[Part]) -> list[dict[Label, Tally]]:
        """Write the shard that some blocks belong to, whole or not at all; nothing is counted."""
        most, plan = self.config.shard_frames, self.plan
        first = parts[0].block * BLOCK_FRAMES // most * most
        place, frames = self.place(first), min(most, self.config.frames - first)
        keys = block_keys(plan.seed, self.point, first + frames)[first // BLOCK_FRAMES :]
        rows: list[run_folder.Cells] = [truth.COLUMNS]
        simulator = plan.world.simulator()
        batches, crop = range(0, frames, plan.batch_frames), plan.world.framing == "crop"
        with atomic_folder(plan.folder / place) as made:
            for scene, bits, names, (seen,) in rendered(simulator, self.model, keys, batches, False, crop):
                panels = simulator.true_panels(scene, names, rendered=True)
                further = simulator.further_bits(scene, names).items()
                sent = {"bits": bits} | {f"bits_{name}": one for name, one in further}
                told = truth.rows_of(scene, sent, names, seen, panels)
                for shown, row in zip(seen.pixels, told, strict=True):
                    name = f"{first + len(rows) - 1:07d}.png"
                    Image.fromarray(shown).save(made / name)
                    rows.append((f"{place}/{name}", *row))
            run_folder.write_rows(made / truth.NAME, rows)
        return [{} for _ in parts]
