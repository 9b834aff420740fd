"""``task=tradeoff``: receivers trained, counted on the same frames, timed when nothing else runs."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch
from matplotlib.figure import Figure
from rich.console import Console
from torch import Tensor

from vocc_torch.files import write_atomically
from vocc_torch.measure.config import Settings
from vocc_torch.measure.frame_errors import FrameErrors, FrameJob
from vocc_torch.measure.genie import GenieReference, genie_reference
from vocc_torch.measure.likelihood import UnknownLikelihoodError
from vocc_torch.measure.link import Observation, block_keys
from vocc_torch.measure.plan import resolve_device
from vocc_torch.measure.stage_times import Exposure, StageTimes, time_stages
from vocc_torch.measure.timing import describe_machine, threads
from vocc_torch.measure.train import Making, train_alone
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import needs_preambles
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.folder import as_markdown, print_place, refuse_results, refuse_unused, write_config
from vocc_torch.show.tensorboard import quiet_threads, write_boards
from vocc_torch.show.terminal import Stopwatch
from vocc_torch.studies.tradeoff.config import TradeoffConfig
from vocc_torch.studies.tradeoff.figure import shares_figure, tradeoff_figure
from vocc_torch.studies.tradeoff.plan import DTYPES, FRAMINGS, Setting, TradeoffStudy, build_tradeoff_study
from vocc_torch.studies.tradeoff.price_list import Place, PriceList, ReceiverTimes
from vocc_torch.studies.tradeoff.tables import print_prices, write_price_board, write_prices
from vocc_torch.studies.tradeoff.words import recommendation

END_TO_END = "flda_3"
"""The receiver that is timed in one go too, as a check on the sum of its stages; else the first one."""


def run_tradeoff(settings: Settings, config: TradeoffConfig, folder: Path) -> None:
    """Price receivers, and report it.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    refuse_unused(settings)
    refuse_results(folder)
    study, console, watch = build_tradeoff_study(settings, config, folder), Console(), Stopwatch()
    with console.status("starting") as status, watch.stage("receivers"):
        prices = price_receivers(study, Workers(settings.workers), status.update)
    console.print(f"receivers    {watch.seconds['receivers']:6.1f} s", highlight=False)
    words = recommendation(prices)
    _write(settings, prices, words, folder)
    print_prices(prices, words, console)
    places = {"picture": "tradeoff.png", "table": "tradeoff.csv", "words": "recommendation.txt"}
    for what, name in places.items():
        print_place(console, what, folder / name)
    if settings.tensorboard:
        from vocc_torch.show.folder import board_hint

        print_place(console, "board", board_hint(folder / "tensorboard"))


def _write(settings: Settings, prices: PriceList, words: str, folder: Path) -> None:
    """Write table, words, the board and pictures, one for each kind of scenes, frames and device."""
    figures: dict[str, Figure] = {}
    for scenes in prices.errors:
        for device, frames in prices.kinds:
            parts = [frames, scenes, *([device.replace(":", "")] if len(prices.times.machines) > 1 else [])]
            name = "-".join(["tradeoff", *parts]) if figures else "tradeoff"
            figures[name] = tradeoff_figure(prices, scenes, device, frames)
    if (shares := shares_figure(prices)) is not None:
        figures["fig25"] = shares
    write_config(settings, folder)
    write_prices(folder / "tradeoff.csv", prices)
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")
    write_atomically(folder / "recommendation.txt", words.encode())
    if settings.tensorboard:
        texts = {"configuration": as_markdown(settings), "recommendation": f"```\n{words}\n```"}
        with quiet_threads():
            write_boards(folder / "tensorboard", {}, figures, {}, texts)
            write_price_board(folder / "tensorboard", prices)


def price_receivers(
    study: TradeoffStudy, workers: Workers, told: Callable[[str], None] = lambda stage: None
) -> PriceList:
    """Train every receiver, count errors, and take times once the workers have ended.

    Args:
        study: the study.
        workers: who trains and counts.
        told: hears what is begun.

    Raises:
        VoccError: what training refuses, or a worker that was ended from outside.
    """
    with worker_losses_told(), workers:
        told("training")
        receivers, costs = train_receivers(study, workers)
        told("bit errors")
        errors = count_receivers(study, receivers, workers)
        told("what is possible")
        references, no_references = _references(study, workers)
    told("times")
    return PriceList(
        settings=study.settings,
        costs=costs,
        errors=errors,
        times=measure_times(study, receivers),
        error_device=str(resolve_device(study.plan.world.device)),
        sensor_px=study.plan.world.camera.sensor_px,
        scene=study.scene_name,
        frames_a_preamble=study.config.frames_a_preamble,
        references=references,
        no_references=no_references,
        missing=study.missing,
        left_out=study.left_out,
    )


def train_receivers(
    study: TradeoffStudy, workers: Workers
) -> tuple[dict[Setting, StagedReceiver], dict[Setting, Making]]:
    """Train the receiver of every setting; settings that differ in precision alone share their training.

    Raises:
        VoccError: no panel in any training frame, or a classifier that cannot be built or trained.
    """
    plans = study.trainings
    trained = dict(zip(plans, train_alone(list(plans.values()), workers), strict=True))
    finders = study.plan.receiver.finders([setting.locator for setting in study.settings])
    receivers, costs = {}, {}
    for setting in study.settings:
        training = trained[study.training_of(setting)]
        bank = training.bank([setting.receiver])
        receivers[setting] = StagedReceiver(
            bank, study.reader(setting), finders[setting.locator], DTYPES[setting.dtype]
        )
        costs[setting] = training.making(setting.receiver)
    return receivers, costs


@dataclass(frozen=True, eq=False)
class Apart:
    """Receivers that measure apart from each other; see :class:`vocc_torch.measure.frame_errors.Receivers`.

    Args:
        receivers: each with the name of its locator.
    """

    receivers: Sequence[tuple[str, StagedReceiver]]

    def __call__(self, views: Mapping[str, Observation], /) -> Iterator[tuple[Tensor, Tensor]]:
        """Decide one batch; receivers that rectify alike share it."""
        for locator, one in self.receivers:
            seen = views[locator]
            rectify = partial(one.rectify, seen.frames, seen.panels)
            patches = (
                seen.once((one.reader.samples_per_led, one.dtype), rectify)
                if one.bank.needs_patches
                else None
            )
            needed = needs_preambles(one.bank.names)
            preambles = one.preambles(seen.takes[1], seen.takes[2], seen.panels) if needed else None
            (scores,) = one.decide(one.measure(seen.frames, seen.panels, patches), preambles).values()
            yield scores >= 0, seen.panels.found


def count_receivers(
    study: TradeoffStudy, receivers: Mapping[Setting, StagedReceiver], workers: Workers
) -> dict[str, FrameErrors]:
    """Count every receiver's errors on the budget's frames of each kind of scenes."""
    apart = Apart([(setting.locator, one) for setting, one in receivers.items()])
    preambles = needs_preambles([setting.receiver for setting in receivers])
    locators = tuple(dict.fromkeys(setting.locator for setting in receivers))
    calls = {
        name: FrameJob(
            study.plan, study.model(name), study.point(name), locators, apart, preambles
        ).handed_out(study.plan.budget.frames, workers)
        for name in study.scenes
    }
    return {name: FrameErrors.joined(call.result() for call in some) for name, some in calls.items()}


def measure_times(study: TradeoffStudy, receivers: Mapping[Setting, StagedReceiver]) -> ReceiverTimes:
    """Time every stage of every receiver, with each batch size, kind of frames and device.

    Frames are those of the first kind of scenes, uint8, in the host's memory. Rendering is not timed.
    """
    config, scenes = study.config, next(iter(study.scenes))
    keys = block_keys(study.plan.seed, study.point(scenes), study.timed_frames)
    names = {setting.name: one for setting, one in receivers.items()}
    preambles = needs_preambles([setting.receiver for setting in receivers])
    # The same receiver with each locator is timed in one go too.
    checked: dict[str, Setting] = {}
    for setting in sorted(receivers, key=lambda one: one.receiver != END_TO_END):
        checked.setdefault(setting.locator, setting)
    by_place: dict[tuple[Setting, Place], StageTimes] = {}
    end_to_end: dict[Place, float] = {}
    crop_px = study.plan.world.camera.sensor_px
    wall = processor = 0.0
    with threads(config.threads):
        machines = {name: describe_machine(resolve_device(name)) for name in config.devices}
        for kind in config.frames:
            world = replace(study.plan.world, framing=FRAMINGS[kind])
            exposure = Exposure.of(world, study.model(scenes), keys, preambles=preambles)
            if kind == "crops":
                crop_px = (int(exposure.frames.grey.shape[-2]), int(exposure.frames.grey.shape[-1]))
            for name, batch in itertools.product(config.devices, config.batch_sizes):
                place = Place(name, kind, batch)
                timed = time_stages(
                    names,
                    exposure,
                    batch,
                    study.rounds(batch),
                    resolve_device(name),
                    frames_a_preamble=config.frames_a_preamble,
                    in_one_go=[setting.name for setting in checked.values()],
                )
                by_place |= {(one, place): timed.by_receiver[one.name] for one in receivers}
                end_to_end[place] = timed.in_one_go
                wall, processor = wall + timed.wall_s, processor + timed.processor_s
        used = torch.get_num_threads()
    # An accelerator that is waited for takes no processor either.
    cpu_alone = all(resolve_device(name).type == "cpu" for name in config.devices)
    waited = max(0.0, 1 - processor / wall) if cpu_alone else 0.0
    first = next(iter(checked.values())).receiver
    return ReceiverTimes(by_place, end_to_end, first, machines, used, waited, crop_px)


def _references(study: TradeoffStudy, workers: Workers) -> tuple[dict[str, GenieReference], dict[str, str]]:
    """Let a decoder that knows the scene have the first of each kind's frames, or say why it has none."""
    if not study.config.genie_frames:
        return {}, dict.fromkeys(study.scenes, "tradeoff.genie_frames is 0")
    plan, frames = study.plan, min(study.config.genie_frames, study.plan.budget.frames)
    references, refused = {}, {}
    for name in study.scenes:
        try:
            references[name] = genie_reference(plan, study.model(name), study.point(name), frames, workers)
        except UnknownLikelihoodError as error:
            # Pixels full before they are white show only once scenes are drawn, and perhaps in one kind.
            refused[name] = str(error)
    return references, refused
