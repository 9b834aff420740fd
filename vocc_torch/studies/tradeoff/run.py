"""``task=tradeoff``: receivers trained, counted on the same frames, timed when nothing else runs."""

import itertools
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from vocc_torch.errors import VoccError
from vocc_torch.files import write_atomically
from vocc_torch.measure import (
    build,
    frame_errors,
    genie,
    likelihood,
    link,
    runner,
    stage_times,
    timing,
    train,
)
from vocc_torch.measure.config import Settings
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.kept_training import KeptTrainings
from vocc_torch.measure.plan import Plan, identity
from vocc_torch.measure.store import Store
from vocc_torch.receiver import onnx_graph
from vocc_torch.receiver.bank import needs_preambles
from vocc_torch.receiver.locators import PanelLocator, PaperLocator
from vocc_torch.receiver.receiver import Receiver, StagedReceiver
from vocc_torch.report import folder as run_folder
from vocc_torch.report import tensorboard, terminal
from vocc_torch.report.canvas import Figure
from vocc_torch.studies.tradeoff import TradeoffConfig, figure, plan, report
from vocc_torch.studies.tradeoff.prices import Algorithms, Place, PriceList
from vocc_torch.types import resolve_device

END_TO_END = "flda_3"
"""The receiver that is timed in one go too, as a check on the sum of its stages; else the first one."""


def run_tradeoff(settings: Settings, config: TradeoffConfig, folder: Path) -> None:
    """Price receivers, and report it: table, words, board, and a picture a kind of scenes, frames and device.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    run_folder.refuse_results(folder, run_folder.LEDGER)
    study = plan.build_tradeoff_study(settings, config, folder)
    console = terminal.Console()
    with (
        run_folder.resumable(settings, folder, console),
        run_folder.open_ledger(
            folder / run_folder.LEDGER, identity_of(study), console
        ) as store,
        console.status("training, counting, timing"),
    ):
        run_folder.write_config(settings, folder)
        prices = price_receivers(
            study, Workers.of(settings), terminal.Stopwatch(console).stage, store
        )
    words = report.recommendation(prices)
    figures: dict[str, Figure] = {}
    for scenes, (device, frames) in itertools.product(prices.errors, prices.kinds):
        where = [device.replace(":", "")] if len(prices.machines) > 1 else []
        name = "-".join(["tradeoff", frames, scenes, *where]) if figures else "tradeoff"
        figures[name] = figure.tradeoff_figure(prices, scenes, device, frames)
    if (shares := figure.shares_figure(prices)) is not None:
        figures["fig25"] = shares
    report.write_prices(folder / "tradeoff.csv", prices)
    write_atomically(folder / "recommendation.txt", words.encode())
    texts, runs = {"recommendation": f"```\n{words}\n```"}, report.price_runs(prices)
    tensorboard.write_figures(settings, folder, figures, texts=texts, runs=runs)
    report.print_prices(prices, words, console)
    places = {
        "picture": "tradeoff.png",
        "table": "tradeoff.csv",
        "words": "recommendation.txt",
    }
    run_folder.print_places(console, folder, places.items(), settings.tensorboard)


def price_receivers(
    study: plan.TradeoffStudy,
    workers: Workers,
    stage: terminal.Stage = nullcontext,
    store: Store | None = None,
) -> PriceList:
    """Train every receiver, count errors, and take times once the workers have ended.

    Args:
        study: the study.
        workers: who trains and counts.
        stage: hears which stage begins and ends.
        store: where trainings and blocks are recorded, or None.

    Raises:
        VoccError: what training refuses, or a worker that was ended from outside.
    """
    with workers:
        with stage("training"):
            receivers, costs = train_receivers(study, workers, store)
        with stage("bit errors"):
            errors, *further = count_receivers(study, receivers, workers, store)
        with stage("what is possible"):
            references, no_references = measure_references(study, workers, store)
    with stage("times"):
        times = measure_times(study, receivers)
    if further:
        names = study.config.scenes
        times["algorithms"] = {
            name: Algorithms([one[name] for one in (errors, *further)])
            for name in names
        }
    return PriceList(study, costs, errors, references, no_references, **times)


def identity_of(study: plan.TradeoffStudy) -> dict[str, object]:
    """Name what the study's counts depend on."""
    settings = [setting.name for setting in study.settings]
    scenes = {name: dict(scene) for name, scene in study.config.scenes.items()}
    return {
        **identity(study.plan, study.config.locators),
        "settings": settings,
        "scenes": scenes,
    }


def train_receivers(
    study: plan.TradeoffStudy, workers: Workers, store: Store | None = None
) -> tuple[dict[plan.Setting, StagedReceiver], dict[plan.Setting, train.Making]]:
    """Train the receiver of every setting; settings that differ in precision alone share their training.

    Raises:
        VoccError: no panel in any training frame, or a classifier that cannot be built or trained.
    """
    kept = None if store is None else KeptTrainings([store])
    trained = train.train_alone(
        [study.training(setting) for setting in study.settings], workers, kept
    )
    finders = study.plan.receiver.finders(
        [setting.locator for setting in study.settings]
    )
    receivers, costs = {}, {}
    for setting, training in zip(study.settings, trained, strict=True):
        bank, dtype = training.bank([setting.receiver]), build.PRECISIONS[setting.dtype]
        receivers[setting] = StagedReceiver(
            bank, study.reader(setting), finders[setting.locator], dtype
        )
        costs[setting] = training.making(setting.receiver)
    return receivers, costs


@dataclass(frozen=True, eq=False)
class Apart:
    """Receivers that measure apart from each other; see :class:`vocc_torch.measure.runner.Deciders`.

    Args:
        receivers: each with its key.
    """

    receivers: Sequence[tuple[Key, StagedReceiver]]

    @property
    def keys(self) -> tuple[Key, ...]:
        """Whose decisions they are."""
        return tuple(key for key, _ in self.receivers)

    @property
    def needs_preambles(self) -> bool:
        """Whether any of the receivers needs frames of known bits."""
        return any(
            needs_preambles(receiver.bank.names) for _, receiver in self.receivers
        )

    def finders(self, _: Plan) -> dict[str, PanelLocator | None]:
        """Give the locators by name."""
        return {key.locator: receiver.locator for key, receiver in self.receivers}

    def __call__(
        self, views: Mapping[str, link.Observation], /
    ) -> Iterator[tuple[torch.Tensor, link.Observation]]:
        """Decide one batch; receivers that rectify alike share it."""
        for key, one in self.receivers:
            seen, patches, preambles = views[key.locator], None, None
            if one.bank.needs_patches:
                rectify = partial(one.rectify, seen.frames, seen.panels)
                patches = seen.once((one.reader.samples_per_led, one.dtype), rectify)
            if needs_preambles(one.bank.names):
                preambles = one.preambles(seen.takes[1], seen.takes[2], seen.panels)
            (scores,) = one.decide(
                one.measure(seen.frames, seen.panels, patches), preambles
            ).values()
            yield scores >= 0, seen


def count_receivers(
    study: plan.TradeoffStudy,
    receivers: Mapping[plan.Setting, StagedReceiver],
    workers: Workers,
    store: Store | None = None,
) -> list[dict[str, frame_errors.FrameErrors]]:
    """Count every receiver's errors on the budget's frames of each kind of scenes, after each training."""
    apart = Apart(
        [
            (Key(setting.locator, setting.name, number), replace(receiver, bank=bank))
            for setting, receiver in receivers.items()
            for number, bank in enumerate((receiver.bank, *receiver.bank.more))
        ]
    )
    points = [
        runner.Point(
            runner.Job(study.plan, study.model(name), study.point(name), apart),
            study.rule,
            store,
        )
        for name in study.config.scenes
    ]
    counted = list(runner.count(points, workers, study.plan.batch_frames))
    numbers = range(1 + max(key.training for key in apart.keys))
    places = [
        [
            counted[0].errors.place(Key(setting.locator, setting.name, number))
            for setting in receivers
        ]
        for number in numbers
    ]
    return [
        {
            name: outcome.errors.of(rows)
            for name, outcome in zip(study.config.scenes, counted, strict=True)
        }
        for rows in places
    ]


def measure_times(
    study: plan.TradeoffStudy, receivers: Mapping[plan.Setting, StagedReceiver]
) -> dict[str, Any]:
    """Time every stage of every receiver, with each batch size, kind of frames and device.

    Frames are those of the first kind of scenes, uint8, in the host's memory. Rendering is not timed.

    Returns:
        What a price list says of times, by its arguments' names.
    """
    config, scenes = study.config, next(iter(study.config.scenes))
    frames = max(plan.LEAST_FRAMES, *config.batch_sizes)  # whole batches of every size
    keys = link.block_keys(study.plan.seed, study.point(scenes), frames)
    names = {setting.name: one for setting, one in receivers.items()}
    preambles = needs_preambles([setting.receiver for setting in receivers])
    devices = {name: resolve_device(name) for name in config.devices}
    # The same receiver with each locator is timed in one go too.
    last_counts = sorted(
        reversed(list(receivers)), key=lambda one: one.receiver == END_TO_END
    )
    checked = {one.locator: one for one in last_counts}
    in_one_go = [setting.name for setting in checked.values()]
    times: dict[tuple[plan.Setting, Place], stage_times.StageTimes] = {}
    end_to_end: dict[Place, float] = {}
    crop_px = study.plan.world.camera.sensor_px
    wall = processor = 0.0
    graphs: dict[tuple[str, Place], Any] = {}
    served = config.frames_a_preamble
    timed_stages = partial(
        stage_times.time_stages, names, frames_a_preamble=served, in_one_go=in_one_go
    )
    with timing.threads(config.threads), tempfile.TemporaryDirectory() as folder:
        drawn, no_graphs = (
            draw_graphs(study, receivers, Path(folder)) if config.onnx else ({}, {})
        )
        machines = {
            name: timing.describe_machine(device) for name, device in devices.items()
        }
        for kind in config.frames:
            world = replace(study.plan.world, framing=plan.FRAMINGS[kind])
            seen = stage_times.Exposure.of(
                world, study.model(scenes), keys, preambles=preambles
            )
            if kind == "crops":
                crop_px = (
                    int(seen.frames.grey.shape[-2]),
                    int(seen.frames.grey.shape[-1]),
                )
            for place in (
                Place(name, kind, size)
                for name in devices
                for size in config.batch_sizes
            ):
                device, rounds = devices[place.device], study.rounds(place.batch)
                own = drawn if device.type == "cpu" else {}
                timed = timed_stages(seen, place.batch, rounds, device, graphs=own)
                graphs |= {(one, place): spent for one, spent in timed.graphs.items()}
                times |= {
                    (one, place): timed.by_receiver[one.name] for one in receivers
                }
                end_to_end[place] = timed.in_one_go
                wall, processor = wall + timed.wall_s, processor + timed.processor_s
        used = torch.get_num_threads()
    # An accelerator that is waited for takes no processor either.
    cpu_alone = all(device.type == "cpu" for device in devices.values())
    waited = max(0.0, 1 - processor / wall) if cpu_alone else 0.0
    first = next(iter(checked.values())).receiver
    told = {
        "machines": machines,
        "threads": used,
        "waited_share": waited,
        "crop_px": crop_px,
    }
    told |= {"graphs": graphs, "no_graphs": no_graphs}
    return {"times": times, "end_to_end": end_to_end, "in_one_go": first, **told}


def draw_graphs(
    study: plan.TradeoffStudy,
    receivers: Mapping[plan.Setting, StagedReceiver],
    folder: Path,
) -> tuple[dict[str, stage_times.Graph], dict[str, str]]:
    """Draw each receiver's ONNX graph, at the first of all lists, ready to be run.

    Args:
        study: the study.
        receivers: trained.
        folder: for the graphs' files.

    Returns:
        The graphs by receiver, and why each other receiver has none.
    """
    drawn, refused = dict[str, stage_times.Graph](), dict[str, str]()
    simulator, keys = (
        study.plan.world.simulator(),
        link.block_keys(study.plan.seed, "graph", 2),
    )
    model = study.model(next(iter(study.config.scenes)))
    ((scene, _, names, (seen,)),) = link.rendered(
        simulator, model, keys, range(0, 2, 2), False
    )
    corners = simulator.true_panels(scene, names).corners_px - seen.origin_px[:, None]
    given = seen.grey[:, 0].round().clamp(0, 255).to(torch.uint8).cpu(), corners.cpu()
    for setting, one in receivers.items():
        name = setting.receiver
        if name in {*drawn, *refused}:
            continue
        try:
            onnx_graph.write_graph(
                whole_receiver(name, one), folder / f"{name}.onnx", *given
            )
            drawn[name] = onnx_graph.read_graph(
                folder / f"{name}.onnx", study.config.threads
            )
        except VoccError as error:
            refused[name] = str(error)
    return drawn, refused


def whole_receiver(name: str, one: StagedReceiver) -> Receiver:
    """Put the receiver of a bank together as it is kept in a file, on the CPU.

    Raises:
        VoccError: one that decides by frames of known bits.
    """
    if needs_preambles([name]):
        raise VoccError(
            f"receiver {name} needs frames of known bits: no ONNX graph has these"
        )
    decider: Any = one.bank.deciders[name].to(torch.device("cpu"))
    return Receiver(name, one.locator or PaperLocator(), one.reader, decider)


def measure_references(
    study: plan.TradeoffStudy, workers: Workers, store: Store | None = None
) -> tuple[dict[str, genie.GenieReference], dict[str, str]]:
    """Let a decoder that knows the scene have the first of each kind's frames, or say why it has none."""
    if not study.config.genie_frames:
        return {}, dict.fromkeys(study.config.scenes, "tradeoff.genie_frames is 0")
    frames = min(study.config.genie_frames, study.plan.budget.frames)
    references, refused = {}, {}
    for name in study.config.scenes:
        try:
            kind = study.plan, study.model(name), study.point(name)
            references[name] = genie.genie_reference(*kind, frames, workers, store)
        except likelihood.UnknownLikelihoodError as error:
            # Pixels full before they are white show only once scenes are drawn, and perhaps in one kind.
            refused[name] = str(error)
    return references, refused
