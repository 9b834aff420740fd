"""``task=tradeoff``: receivers trained, counted on the same frames, timed when nothing else runs."""

import itertools
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from vocc_torch.errors import VoccError
from vocc_torch.files import write_atomically
from vocc_torch.measure import link, runner, stage_times, timing, train
from vocc_torch.measure.build import PRECISIONS
from vocc_torch.measure.config import Settings
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.plan import Plan, identity
from vocc_torch.receiver import onnx_graph
from vocc_torch.receiver.bank import needs_preambles
from vocc_torch.receiver.locators import PanelLocator, PaperLocator
from vocc_torch.receiver.receiver import Receiver, StagedReceiver
from vocc_torch.report import folder as run_folder
from vocc_torch.report import tensorboard, terminal
from vocc_torch.report.plots import Figure
from vocc_torch.studies.compare import TradeoffConfig, price_report
from vocc_torch.studies.compare.price_figure import price_figure
from vocc_torch.studies.compare.prices import Errors, Place, PriceList, Times
from vocc_torch.studies.compare.run import Advance, Run
from vocc_torch.studies.compare.settings import (
    FRAMINGS,
    TIMING,
    Setting,
    TradeoffStudy,
    build_tradeoff_study,
)
from vocc_torch.types import resolve_device

Receivers = Mapping[Setting, StagedReceiver]
"""Trained receivers."""


def run_tradeoff(settings: Settings, config: TradeoffConfig, folder: Path) -> None:
    """Price receivers, and report it: tables, words, board, and a figure a kind of scenes, frames and device.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    run_folder.refuse_results(folder, run_folder.LEDGER)
    study = build_tradeoff_study(settings, config, folder)
    console = terminal.Console()
    ledger = folder / run_folder.LEDGER
    with (
        run_folder.resumable(settings, folder, console),
        run_folder.open_ledger(ledger, identity_of(study), console) as store,
    ):
        run_folder.write_config(settings, folder)
        run = Run(Workers.of(settings), store, console, 3)
        prices = price_receivers(study, run)
    words = price_report.recommendation(prices)
    price_report.write_prices(folder, prices)
    write_atomically(folder / "recommendation.txt", words.encode())
    tensorboard.write_figures(
        settings,
        folder,
        price_figures(prices),
        texts={"recommendation": f"```\n{words}\n```"},
        runs=price_report.price_runs(prices),
    )
    price_report.print_prices(prices, words, console)
    places = {
        "picture": "tradeoff.png",
        "table": "tradeoff.csv",
        "stages": "stages.csv",
        "words": "recommendation.txt",
    }
    run_folder.print_places(console, folder, places.items(), settings.tensorboard)


def price_figures(prices: PriceList) -> dict[str, Figure]:
    """Draw every kind of scenes, frames and device; the first is ``tradeoff``."""
    figures: dict[str, Figure] = {}
    several = len(prices.times.machines) > 1
    kinds = itertools.product(prices.errors, prices.times.kinds)
    for scenes, (device, frames) in kinds:
        machine = [device.replace(":", "")] if several else []
        name = "-".join(["tradeoff", frames, scenes, *machine])
        figure = price_figure(prices, scenes, device, frames)
        figures[name if figures else "tradeoff"] = figure
    return figures


def price_receivers(study: TradeoffStudy, run: Run) -> PriceList:
    """Train every receiver, count errors, and take times once the workers have ended.

    Args:
        study: the study.
        run: workers, store and progress.

    Raises:
        VoccError: what training refuses, or a worker that was ended from outside.
    """
    scenes = list(study.config.scenes)
    with run.pool:
        receivers, costs = train_receivers(study, run)
        jobs = jobs_of(study, receivers)
        outcomes = run.count([(job, study.rule) for job in jobs.values()])
        errors = dict(
            zip(scenes, (by_training(receivers, of) for of in outcomes), strict=True)
        )
    config = study.config
    places = len(config.frames) * len(config.devices) * len(config.batch_sizes)
    with run.stage("times", places) as advance:
        times = measure_times(study, receivers, advance)
    return PriceList(study, costs, errors, times)


def identity_of(study: TradeoffStudy) -> dict[str, object]:
    """Name what the study's counts depend on."""
    settings = [setting.name for setting in study.settings]
    scenes = {name: dict(scene) for name, scene in study.config.scenes.items()}
    return {
        **identity(study.plan, study.config.locators),
        "settings": settings,
        "scenes": scenes,
    }


def train_receivers(
    study: TradeoffStudy, run: Run
) -> tuple[dict[Setting, StagedReceiver], dict[Setting, train.Making]]:
    """Train the receiver of every setting; settings that differ in precision alone share their training.

    Raises:
        VoccError: no panel in any training frame, or a classifier that cannot be built or trained.
    """
    trained = run.train([study.training(setting) for setting in study.settings])
    locators = [setting.locator for setting in study.settings]
    finders = study.plan.receiver.finders(locators)
    receivers, costs = {}, {}
    for setting, training in zip(study.settings, trained, strict=True):
        receivers[setting] = StagedReceiver(
            training.bank([setting.receiver]),
            study.reader(setting),
            finders[setting.locator],
            PRECISIONS[setting.dtype],
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
        for key, receiver in self.receivers:
            view, patches, preambles = views[key.locator], None, None
            if receiver.bank.needs_patches:
                rectify = partial(receiver.rectify, view.frames, view.panels)
                same = receiver.reader.samples_per_led, receiver.dtype
                patches = view.once(same, rectify)
            if needs_preambles(receiver.bank.names):
                on, off = view.takes[1:3]
                preambles = receiver.preambles(on, off, view.panels)
            readings = receiver.measure(view.frames, view.panels, patches)
            (scores,) = receiver.decide(readings, preambles).values()
            yield scores >= 0, view


def jobs_of(study: TradeoffStudy, receivers: Receivers) -> dict[str, runner.Job]:
    """Give what counts each kind of scenes: every receiver after each training."""
    apart = Apart(
        [
            (Key(setting.locator, setting.name, number), replace(receiver, bank=bank))
            for setting, receiver in receivers.items()
            for number, bank in enumerate((receiver.bank, *receiver.bank.more))
        ]
    )
    return {
        name: runner.Job(study.plan, study.model(name), study.point(name), apart)
        for name in study.config.scenes
    }


def by_training(receivers: Receivers, outcome: runner.Outcome) -> Errors:
    """Sort errors by training; what learns nothing is the same after each."""
    errors = outcome.errors
    numbers = range(1 + max(key.training for key in errors.keys))
    places = [
        [
            errors.place(Key(setting.locator, setting.name, number))
            for setting in receivers
        ]
        for number in numbers
    ]
    return Errors([errors.of(rows) for rows in places])


def measure_times(
    study: TradeoffStudy, receivers: Receivers, advance: Advance
) -> Times:
    """Time every stage of every receiver, with each batch size, kind of frames and device.

    Frames are those of the first kind of scenes, uint8, in the host's memory. Rendering is not timed.
    """
    config, scenes = study.config, next(iter(study.config.scenes))
    frames = max(TIMING.least_frames, *config.batch_sizes)
    keys = link.block_keys(study.plan.seed, study.point(scenes), frames)
    preambles = needs_preambles([setting.receiver for setting in receivers])
    devices = {name: resolve_device(name) for name in config.devices}
    # The same receiver with each locator is timed in one go too.
    order = sorted(receivers, key=lambda setting: setting.receiver != TIMING.in_one_go)
    in_one_go = {setting.locator: setting.name for setting in reversed(order)}
    stages: dict[tuple[Setting, Place], stage_times.StageTimes] = {}
    ratios: dict[Place, float] = {}
    graphs: dict[tuple[str, Place], Any] = {}
    crop_px = study.plan.world.camera.sensor_px
    wall_s = processor_s = 0.0
    with timing.threads(config.threads), tempfile.TemporaryDirectory() as folder:
        drawn: dict[str, stage_times.Graph] = {}
        refused: dict[str, str] = {}
        if config.onnx:
            drawn, refused = draw_graphs(study, receivers, Path(folder))
        machines = {
            name: timing.describe_machine(device) for name, device in devices.items()
        }
        for kind in config.frames:
            world = replace(study.plan.world, framing=FRAMINGS[kind])
            exposure = stage_times.Exposure.of(
                world, study.model(scenes), keys, preambles=preambles
            )
            if kind == "crops":
                height, width = exposure.frames.grey.shape[-2:]
                crop_px = height, width
            for name, size in itertools.product(devices, config.batch_sizes):
                place, device = Place(name, kind, size), devices[name]
                timed = stage_times.time_stages(
                    {setting.name: one for setting, one in receivers.items()},
                    exposure,
                    size,
                    study.rounds(size),
                    device,
                    frames_a_preamble=config.frames_a_preamble,
                    in_one_go=list(in_one_go.values()),
                    graphs=drawn if device.type == "cpu" else {},
                )
                for setting in receivers:
                    stages[setting, place] = timed.by_receiver[setting.name]
                for receiver, graph_ms in timed.graphs.items():
                    first = next(one for one in receivers if one.receiver == receiver)
                    spent = stages[first, place].summed(stage_times.BIT_DETECTION)
                    pair = graph_ms, stage_times.median_of(spent)
                    graphs[receiver, place] = pair
                ratios[place] = timed.in_one_go
                wall_s += timed.wall_s
                processor_s += timed.processor_s
                advance(1)
        threads = torch.get_num_threads()
    # An accelerator that is waited for takes no processor either.
    cpu_alone = all(device.type == "cpu" for device in devices.values())
    waited = max(0.0, 1 - processor_s / wall_s) if cpu_alone else 0.0
    return Times(
        stages,
        ratios,
        order[0].receiver,
        machines,
        threads,
        waited,
        crop_px,
        graphs,
        refused,
    )


def draw_graphs(
    study: TradeoffStudy, receivers: Receivers, folder: Path
) -> tuple[dict[str, stage_times.Graph], dict[str, str]]:
    """Draw each receiver's ONNX graph, at the first of all lists, ready to be run.

    Args:
        study: the study.
        receivers: trained.
        folder: for the graphs' files.

    Returns:
        The graphs by receiver, and why each other receiver has none.
    """
    drawn: dict[str, stage_times.Graph] = {}
    refused: dict[str, str] = {}
    simulator = study.plan.world.simulator()
    keys = link.block_keys(study.plan.seed, "graph", 2)
    model = study.model(next(iter(study.config.scenes)))
    ((scene, _, names, (frames,)),) = link.rendered(
        simulator, model, keys, range(0, 2, 2), False
    )
    corners = simulator.true_panels(scene, names).corners_px
    pixels = frames.grey[:, 0].round().clamp(0, 255).to(torch.uint8).cpu()
    example = pixels, (corners - frames.origin_px[:, None]).cpu()
    for setting, receiver in receivers.items():
        name = setting.receiver
        if name in drawn or name in refused:
            continue
        path = folder / f"{name}.onnx"
        try:
            onnx_graph.write_graph(as_saved(name, receiver), path, *example)
            drawn[name] = onnx_graph.read_graph(path, study.config.threads)
        except VoccError as error:
            refused[name] = str(error)
    return drawn, refused


def as_saved(name: str, receiver: StagedReceiver) -> Receiver:
    """Put the receiver of a bank together as a file has it, on the CPU.

    Raises:
        VoccError: one that decides by frames of known bits.
    """
    if needs_preambles([name]):
        rule = "needs frames of known bits: no ONNX graph has these"
        raise VoccError(f"receiver {name} {rule}")
    decider: Any = receiver.bank.deciders[name].to(torch.device("cpu"))
    return Receiver(name, receiver.locator or PaperLocator(), receiver.reader, decider)
