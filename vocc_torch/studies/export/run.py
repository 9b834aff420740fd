"""``task=export``: simulated frames as PNG, with their truth as CSV and COCO JSON."""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_folder, read_file, remove, write_atomically
from vocc_torch.measure import build, executors, sweep
from vocc_torch.measure.config import Settings
from vocc_torch.measure.link import block_keys, rendered
from vocc_torch.measure.plan import Plan, identity
from vocc_torch.measure.store import what_changed
from vocc_torch.report import folder as run_folder
from vocc_torch.report import samples, terminal
from vocc_torch.simulation import SceneModel
from vocc_torch.simulation.effects.coding import Quantization
from vocc_torch.studies.export import ExportConfig, manifest, truth

FRAMES = "frames"
"""The folder of all pictures."""

IDENTITY = "export.json"
"""What the files depend on."""


def run_export(settings: Settings, config: ExportConfig, folder: Path) -> None:
    """Write the frames shard by shard, and then one table and one COCO file of all.

    A shard is a folder with a manifest of its files. A shard that agrees with its manifest is not rendered
    again.

    Raises:
        VoccError: frames that are not of 8 bits, files of other settings, or whatever a stage refuses.
    """
    plan, console = build.build_plan(settings), terminal.Console()
    effects = plan.world.simulator().effects
    if not any(isinstance(part, Quantization) and part.bits == 8 for part in effects):
        raise VoccError(
            "scene.effects.quantization must be {bits: 8}: task=export writes greys of 8 bits"
        )
    kind: sweep.Kind = "test" if config.points == "test" else "train"
    shards = [
        Shard(folder, plan, point, model, config, first)
        for point, model in sweep.scenes_of(plan, kind).items()
        for first in range(0, config.frames, config.shard_frames)
    ]
    frames = sum(shard.frames for shard in shards)
    with run_folder.resumable(settings, folder, console, IDENTITY, FRAMES):
        demand_identity(folder / IDENTITY, identity_of(plan, config))
        for left in (folder / FRAMES).glob("**/.*.tmp"):
            remove(left)
        run_folder.write_config(settings, folder)
        samples.write_samples(folder, plan, [kind])
        complete, pool = 0, executors.Workers.of(settings)
        with pool, terminal.ProgressView(frames, console, "rendering") as view:
            written = pool.map(Shard.write, shards)
            for shard, is_new in zip(shards, written, strict=True):
                complete += not is_new
                view.advance("rendering", shard.frames)
        if complete:
            text = f"resuming: {complete} of {len(shards)} folders are complete"
            run_folder.say(console, text)
        table, coco = folder / truth.NAME, folder / "coco.json"
        truth.write_truth(
            table, [folder / shard.place / truth.NAME for shard in shards]
        )
        truth.write_coco(coco, table, plan.world.panel.shape)
    run_folder.say(console, f"{frames} frames")
    places = {
        "frames": FRAMES,
        "truth": truth.NAME,
        "COCO": coco.name,
        "samples": run_folder.SAMPLES,
    }
    run_folder.print_places(console, folder, places.items())


def demand_identity(path: Path, settings: dict[str, Any]) -> None:
    """Write what the files of a run depend on, or refuse a run of other settings.

    Raises:
        VoccError: files of other settings, with what changed, or a file that does not say.
    """
    text = json.dumps(settings, sort_keys=True)
    if path.exists():
        try:
            known = json.loads(read_file(path))
        except (ValueError, RecursionError):
            raise VoccError(
                f"{path} is damaged: give another name=, or delete the folder"
            ) from None
        if changed := what_changed(known, json.loads(text)):
            raise VoccError(
                f"{path} is of other settings: {', '.join(changed[:3])}: give another name="
            )
    write_atomically(path, text.encode())


def identity_of(plan: Plan, config: ExportConfig) -> dict[str, Any]:
    """Name what the files depend on: of a study's identity all but the receivers."""
    study, experiment = identity(plan, ()), plan.experiment
    scenes = {"training": study["experiment"]["training"]}
    if config.points == "test":
        axes = {
            name: getattr(experiment, name) for name in ("values", "row_axis", "rows")
        }
        scenes = {**study["experiment"], "training": None, **axes}
    shared = {name: study[name] for name in ("seed", "world", "made_with")}
    return {**shared, "experiment": scenes, "export": asdict(config)}


@dataclass(frozen=True)
class Shard:
    """A folder of pictures and their truth; picklable for executors.

    Args:
        folder: the run's.
        plan: world, seed and batch size.
        point: name that keys the random draws.
        model: the scenes.
        config: how many frames, and how many of them in a folder.
        first: number of its first frame.
    """

    folder: Path
    plan: Plan
    point: str
    model: SceneModel
    config: ExportConfig
    first: int

    @property
    def place(self) -> str:
        """Its folder below the run's."""
        return f"{FRAMES}/{self.point}/{self.first:07d}"

    @property
    def frames(self) -> int:
        """How many frames it has."""
        return min(self.config.shard_frames, self.config.frames - self.first)

    def write(self) -> bool:
        """Write the shard unless it is complete, and say whether it was written."""
        target = self.folder / self.place
        if manifest.agrees(target):
            return False
        with atomic_folder(target) as folder:
            rows = [truth.COLUMNS, *self.render(folder)]
            run_folder.write_rows(folder / truth.NAME, rows)
            manifest.write(folder)
        return True

    def render(self, folder: Path) -> Iterable[run_folder.Cells]:
        """Render the pictures into a folder; yield the row of each."""
        plan, number = self.plan, self.first
        keys = block_keys(plan.seed, self.point, number + self.frames, number)
        simulator = plan.world.simulator()
        batches = range(0, self.frames, plan.batch_frames)
        crop = plan.world.framing == "crop"
        for scene, bits, names, (takes,) in rendered(
            simulator, self.model, keys, batches, False, crop
        ):
            panels = simulator.true_panels(scene, names, rendered=True)
            sent = {"bits": bits}
            for name, values in simulator.further_bits(scene, names).items():
                sent[f"bits_{name}"] = values
            rows = truth.rows_of(scene, sent, names, takes, panels)
            for pixels, row in zip(takes.pixels, rows, strict=True):
                name = f"{number:07d}.png"
                Image.fromarray(pixels).save(folder / name)
                yield (f"{self.place}/{name}", *row)
                number += 1
