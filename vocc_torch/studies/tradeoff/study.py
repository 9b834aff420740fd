"""The price list of receivers: trained, counted on the same frames, and timed when nothing else runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor

from vocc_torch.measure.frame_errors import FrameErrors, FrameJob
from vocc_torch.measure.genie.genie import GenieReference, genie_reference
from vocc_torch.measure.genie.likelihood import UnknownLikelihoodError
from vocc_torch.measure.link import Observation, block_keys
from vocc_torch.measure.plan import resolve_device
from vocc_torch.measure.stage_times import Exposure, StageTimes, time_stages
from vocc_torch.measure.timing import describe_machine, threads
from vocc_torch.measure.train import Making, train_alone
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import needs_preambles
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.studies.tradeoff.plan import DTYPES, FRAMINGS, Setting, TradeoffStudy
from vocc_torch.studies.tradeoff.price_list import Place, PriceList, ReceiverTimes

END_TO_END = "flda_3"
"""The receiver that is timed in one go too, as a check on the sum of its stages; else the first one."""


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
    preambles = any(needs_preambles([setting.receiver]) for setting in receivers)
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
    preambles = any(needs_preambles([setting.receiver]) for setting in receivers)
    checked = _in_one_go(list(receivers))
    by_place: dict[tuple[Setting, Place], StageTimes] = {}
    end_to_end: dict[Place, float] = {}
    machines: dict[str, str] = {}
    crop_px = study.plan.world.camera.sensor_px
    wall = processor = 0.0
    with threads(config.threads):
        for kind in config.frames:
            world = replace(study.plan.world, framing=FRAMINGS[kind])
            exposure = Exposure.of(world, study.model(scenes), keys, preambles=preambles)
            if kind == "crops":
                crop_px = (int(exposure.frames.grey.shape[-2]), int(exposure.frames.grey.shape[-1]))
            for name in config.devices:
                device = resolve_device(name)
                machines[name] = describe_machine(device)
                for batch in config.batch_sizes:
                    place, rounds = Place(name, kind, batch), study.rounds(batch)
                    timed = time_stages(
                        names,
                        exposure,
                        batch,
                        rounds,
                        device,
                        frames_a_preamble=config.frames_a_preamble,
                        in_one_go=[setting.name for setting in checked],
                    )
                    by_place |= {(one, place): timed.by_receiver[one.name] for one in receivers}
                    end_to_end[place] = timed.in_one_go
                    wall, processor = wall + timed.wall_s, processor + timed.processor_s
        used = torch.get_num_threads()
    # An accelerator that is waited for takes no processor either.
    cpu_alone = all(resolve_device(name).type == "cpu" for name in config.devices)
    waited = max(0.0, 1 - processor / wall) if cpu_alone else 0.0
    return ReceiverTimes(by_place, end_to_end, checked[0].receiver, machines, used, waited, crop_px)


def _in_one_go(settings: Sequence[Setting]) -> list[Setting]:
    """Choose what is timed in one go too: the same receiver with each locator."""
    return [
        next((one for one in same if one.receiver == END_TO_END), same[0])
        for locator in dict.fromkeys(setting.locator for setting in settings)
        if (same := [one for one in settings if one.locator == locator])
    ]


def _references(study: TradeoffStudy, workers: Workers) -> tuple[dict[str, GenieReference], dict[str, str]]:
    """Let a decoder that knows the scene have the first of each kind's frames, or say why it has none."""
    references: dict[str, GenieReference] = {}
    if not study.config.genie_frames:
        return references, dict.fromkeys(study.scenes, "tradeoff.genie_frames is 0")
    plan, refused = study.plan, {}
    frames = min(study.config.genie_frames, plan.budget.frames)
    for name in study.scenes:
        try:
            references[name] = genie_reference(plan, study.model(name), study.point(name), frames, workers)
        except UnknownLikelihoodError as error:
            # Pixels full before they are white show only once scenes are drawn, and perhaps in one kind.
            refused[name] = str(error)
    return references, refused
