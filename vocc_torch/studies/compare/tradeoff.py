"""``task=tradeoff``: receivers trained, counted on the same frames, timed when nothing else runs."""

from collections.abc import Iterable
from dataclasses import astuple, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

from vocc_torch.files import write_atomically
from vocc_torch.measure import link, stage_times, sweep, timing
from vocc_torch.measure.config import Settings
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import Key
from vocc_torch.receiver.deciders import needs_preambles
from vocc_torch.report.terminal import TableRow, print_rows
from vocc_torch.studies.compare import TradeoffConfig, figures
from vocc_torch.studies.compare.prices import (
    FRAMINGS,
    SETTINGS,
    OperatingPoint,
    PriceList,
    TradeoffStudy,
    recommendation,
    setting_name,
)
from vocc_torch.studies.compare.report import numbers_of, write_report
from vocc_torch.studies.run import Case, Run, begin, scene_plan
from vocc_torch.types import resolve_device


def run_tradeoff(settings: Settings, config: TradeoffConfig, folder: Path) -> None:
    """Price receivers, and report it: tables, words, board and a figure.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    study = build_tradeoff_study(settings, config)
    with begin(settings, folder, study.plan, 3) as run:
        prices = price_receivers(study, run)
    words = recommendation(prices)
    write_atomically(folder / "recommendation.txt", words.encode())
    quickest = price_rows(prices, sorted(prices.points(), key=attrgetter("ms")))
    columns = {name: name for name in ("receiver", "locator", "batch", "ms")}
    columns |= {"ber": "BER", "rank": ""}
    note = "frontier: nothing is both quicker and better; beaten: surely, perhaps: by chance"
    print_rows(quickest, columns, f"{note}\n\n{words}")
    every = [
        point for batch in study.config.batch_sizes for point in prices.points(batch)
    ]
    rows = price_rows(prices, every)
    runs = {
        f"{row['receiver']}-{row['locator']}": (
            {name: row[name] for name in ("receiver", "locator")},
            numbers_of(row),
        )
        for row in rows
    }
    write_report(
        settings,
        folder,
        {"tradeoff": rows, "stages": stage_rows(prices)},
        {"tradeoff": figures.price_figure(prices)},
        texts={"recommendation": f"```\n{words}\n```"},
        runs=runs,
    )


def build_tradeoff_study(settings: Settings, config: TradeoffConfig) -> TradeoffStudy:
    """Build the study that ``task=tradeoff`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan, left_out = scene_plan(settings)
    # What ${receiver.locator} brought goes by its name.
    names = {settings.receiver.locator: plan.receiver.locator}
    locators = [names.get(name, name) for name in dict.fromkeys(config.locators)]
    batch_sizes = sorted(set(config.batch_sizes))
    config = replace(config, locators=locators, batch_sizes=batch_sizes)
    return TradeoffStudy(plan, config, settings.scene.name, left_out)


def price_receivers(study: TradeoffStudy, run: Run) -> PriceList:
    """Train every receiver, count errors, and take times once the workers have ended.

    Frames lie as uint8 in the host's memory while times are taken; rendering is not timed.

    Raises:
        VoccError: what training refuses, or a worker that was ended from outside.
    """
    plan, config, keys = study.plan, study.config, study.keys
    trained = {locator: plan.locating_with(locator) for locator in config.locators}
    with run.pool:
        run.train(list(trained.values()))
        (outcome,) = run.count([Case(plan, list(trained.values()))])
    trainings = {locator: run.training(of) for locator, of in trained.items()}
    experiment, names = plan.experiment, {setting_name(key): key for key in keys}
    outcomes = {experiment.values[0]: outcome}
    errors = sweep.curves_of(experiment, names, outcomes)
    device = resolve_device(plan.world.device)
    finders = plan.receiver.finders(config.locators)
    receivers = {
        name: stage_times.TimedReceiver(
            trainings[key.locator].bank([key.receiver])[key.receiver],
            plan.receiver.reader,
            finders[key.locator],
        )
        for name, key in names.items()
    }
    frames = max(SETTINGS.least_frames, *config.batch_sizes)
    times: dict[tuple[Key, int], stage_times.StageTimes] = {}
    with (
        run.stage("times", len(config.batch_sizes)) as advance,
        timing.threads(config.threads),
        timing.watched(device) as waiting,
    ):
        machine = timing.describe_machine(device)
        exposure = stage_times.Exposure.of(
            replace(plan.world, framing=FRAMINGS[config.frames]),
            plan.world.scene,
            link.block_keys(plan.seed, experiment.name, frames),
            preambles=needs_preambles(plan.receiver.names),
        )
        for batch in config.batch_sizes:
            rounds = max(config.repeats, -(-SETTINGS.least_frames // batch))
            timed = stage_times.time_stages(receivers, exposure, batch, rounds, device)
            times |= {(names[name], batch): spent for name, spent in timed.items()}
            advance(1)
    costs = {key: trainings[key.locator].making(key.receiver) for key in keys}
    return PriceList(study, costs, errors, times, machine, waiting.share)


def price_rows(prices: PriceList, points: Iterable[OperatingPoint]) -> list[TableRow]:
    """Give the rows of ``tradeoff.csv``: a row for each receiver, locator and batch.

    ``ms`` is the median time a frame with its quartiles. ``rank`` compares receivers with the same batch.
    """
    study = prices.study
    return [
        {
            "receiver": point.key.receiver,
            "locator": point.key.locator,
            "device": str(resolve_device(study.plan.world.device)),
            "frames": study.config.frames,
            "batch": point.batch,
            "ms": rounded(point.time_ms),
            "scenes": study.scene_name,
            "test_frames": prices.frames,
            "ber": rounded(point.ber),
            "rank": point.rank,
        }
        for point in points
    ]


def stage_rows(prices: PriceList) -> list[TableRow]:
    """Give the rows of ``stages.csv``: each stage's median time a frame, and what training took."""
    rows: list[TableRow] = []
    for (key, batch), times in prices.times.items():
        cost = prices.costs[key]
        cells: TableRow = {
            "receiver": key.receiver,
            "locator": key.locator,
            "batch": batch,
        }
        cells |= {f"{name}_ms": times.stage(name).value for name in stage_times.STAGES}
        cells |= {"training_s": cost.training_s, "training_frames": cost.frames}
        cells |= {"parameters": cost.parameters, "size_bytes": cost.size_bytes}
        rows.append({name: rounded(cell) for name, cell in cells.items()})
    return rows


def rounded(cell: Any) -> Any:
    """Round floats and estimates to five digits, more than any time or rate has."""
    if isinstance(cell, Estimate):
        return Estimate(*map(rounded, astuple(cell)))
    return float(f"{cell:.5g}") if isinstance(cell, float) else cell
