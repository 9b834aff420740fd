"""``task=tradeoff``: receivers trained, counted on the same frames, timed when nothing else runs."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch

from vocc_torch.files import write_atomically
from vocc_torch.measure import link, runner, stage_times, sweep, timing
from vocc_torch.measure.build import build_plan, without_absent
from vocc_torch.measure.config import Budget, Settings
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.plan import Experiment, identity
from vocc_torch.measure.train import Training
from vocc_torch.receiver.bank import needs_preambles
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.report.terminal import Console
from vocc_torch.studies.compare import TradeoffConfig, price_report
from vocc_torch.studies.compare.prices import (
    FRAMINGS,
    TIMING,
    PriceList,
    Setting,
    TradeoffStudy,
)
from vocc_torch.studies.compare.run import Run, comparison, numbers_of, write_report
from vocc_torch.types import resolve_device

POINT = "tradeoff"
"""The point that keys the random draws of all test frames."""

Trainings = Mapping[str, Training]
"""Trained receivers, by the locator's name."""


def run_tradeoff(settings: Settings, config: TradeoffConfig, folder: Path) -> None:
    """Price receivers, and report it: tables, words, board and a figure.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    study = build_tradeoff_study(settings, config, folder)
    counted_for = identity(study.plan, study.config.locators)
    with comparison(settings, folder, counted_for, 3) as run:
        prices = price_receivers(study, run)
    words = price_report.recommendation(prices)
    write_atomically(folder / "recommendation.txt", words.encode())
    price_report.print_prices(prices, words, Console())
    rows = price_report.price_rows(prices)
    settings_of = {setting.name: setting for setting in study.settings}
    numbers = {
        name: ({"receiver": setting.receiver, "locator": setting.locator}, numbers)
        for name, setting in settings_of.items()
        for row in rows
        if (row["receiver"], row["locator"]) == (setting.receiver, setting.locator)
        for numbers in [numbers_of(row)]
    }
    write_report(
        settings,
        folder,
        {"tradeoff": rows, "stages": price_report.stage_rows(prices)},
        {"tradeoff": price_report.price_figure(prices)},
        ["recommendation.txt"],
        texts={"recommendation": f"```\n{words}\n```"},
        runs=numbers,
    )


def build_tradeoff_study(
    settings: Settings, config: TradeoffConfig, folder: Path
) -> TradeoffStudy:
    """Build the study that ``task=tradeoff`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan = build_plan(settings, folder)
    receiver, left_out = without_absent(plan.receiver)
    # All frames are of the scene itself: no experiment narrows them.
    experiment = Experiment(POINT, "distance_m", (plan.world.scene.nearest_m,))
    # What ${receiver.locator} brought goes by its name.
    names = {settings.receiver.locator: plan.receiver.locator}
    locators = [names.get(name, name) for name in dict.fromkeys(config.locators)]
    config = replace(
        config, locators=locators, batch_sizes=sorted(set(config.batch_sizes))
    )
    plan = replace(plan, receiver=receiver, experiment=experiment)
    return TradeoffStudy(plan, config, settings.scene.name, left_out)


def price_receivers(study: TradeoffStudy, run: Run) -> PriceList:
    """Train every receiver, count errors, and take times once the workers have ended.

    Args:
        study: the study.
        run: workers, store and progress.

    Raises:
        VoccError: what training refuses, or a worker that was ended from outside.
    """
    plan, names = study.plan, study.plan.receiver.names
    plans = [
        replace(plan, receiver=replace(plan.receiver, locator=locator))
        for locator in study.config.locators
    ]
    with run.pool:
        trainings = dict(zip(study.config.locators, run.train(plans), strict=True))
        banks = [
            (locator, bank, number)
            for locator, training in trainings.items()
            for first in [training.bank(names)]
            for number, bank in enumerate((first, *first.more))
        ]
        job = runner.Job(plan, plan.world.scene, POINT, runner.Banks(banks))
        (outcome,) = run.count([(job, Budget(plan.budget.frames))])
    receivers = {
        setting.name: Key(setting.locator, setting.receiver)
        for setting in study.settings
    }
    outcomes = {plan.experiment.values[0]: outcome}
    errors = sweep.curves_of(POINT, plan.experiment.axis, receivers, outcomes)
    with run.stage("times", len(study.config.batch_sizes)) as advance:
        device = resolve_device(plan.world.device)
        with timing.threads(study.config.threads), timing.watched(device) as waiting:
            machine = timing.describe_machine(device)
            timings = {}
            for batch in study.config.batch_sizes:
                timings[batch] = time_batch(study, trainings, batch, device)
                advance(1)
    return PriceList(
        study,
        {
            setting: trainings[setting.locator].making(setting.receiver)
            for setting in study.settings
        },
        errors,
        {
            (setting, batch): timed[setting.name]
            for batch, timed in timings.items()
            for setting in study.settings
        },
        machine,
        waiting.share,
    )


def time_batch(
    study: TradeoffStudy, trainings: Trainings, batch: int, device: torch.device
) -> dict[str, stage_times.StageTimes]:
    """Time every stage of every receiver on uint8 frames in the host's memory; rendering is not timed."""
    plan = study.plan
    finders = plan.receiver.finders(study.config.locators)

    def receiver_of(setting: Setting) -> StagedReceiver:
        bank = trainings[setting.locator].bank([setting.receiver])
        return StagedReceiver(bank, plan.receiver.reader, finders[setting.locator])

    frames = max(TIMING.least_frames, *study.config.batch_sizes)
    exposure = stage_times.Exposure.of(
        replace(plan.world, framing=FRAMINGS[study.config.frames]),
        plan.world.scene,
        link.block_keys(plan.seed, POINT, frames),
        preambles=needs_preambles(plan.receiver.names),
    )
    receivers = {setting.name: receiver_of(setting) for setting in study.settings}
    return stage_times.time_stages(
        receivers, exposure, batch, study.rounds(batch), device
    )
