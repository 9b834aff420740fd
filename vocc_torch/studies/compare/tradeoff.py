"""``task=tradeoff``: what each receiver costs in time, and makes in errors on the same frames."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from vocc_torch.errors import VoccError, demand_least, demand_word, whole_number
from vocc_torch.measure import estimate, link, sweep, timing
from vocc_torch.measure.config import Settings
from vocc_torch.measure.curve import Curves, Row
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.stage_times import (
    STAGES,
    Exposure,
    StageTimes,
    TimedReceiver,
    time_stages,
)
from vocc_torch.measure.train import Making
from vocc_torch.receiver.deciders import needs_preambles
from vocc_torch.report.terminal import TableRow, print_rows
from vocc_torch.simulation.simulator import Framing
from vocc_torch.studies.compare import TradeoffConfig, figures
from vocc_torch.studies.compare.report import (
    flat,
    left_out_lines,
    numbers_of,
    write_report,
)
from vocc_torch.studies.run import Case, Run, begin, scene_plan
from vocc_torch.types import resolve_device

FRAMINGS: Mapping[str, Framing] = {"whole": "filled", "crops": "crop"}
"""How frames are rendered that a receiver gets whole, or cut to the panel's surroundings."""


@dataclass(frozen=True)
class PriceSettings:
    """How times are taken and judged."""

    least_frames: int = 48  # timed rounds meet at least so many, whatever the batch
    most_batch: int = 1024  # frames at a time
    busy_share: float = 0.05  # waiting from which times are said to be doubtful


SETTINGS = PriceSettings()


@dataclass(frozen=True)
class TradeoffStudy:
    """A study of what accuracy costs in time.

    Args:
        plan: world, receivers and budget; its experiment has no part in it.
        config: the study's section of the configuration.
        scene_name: what results call the scene.
        left_out: receivers that were asked for and cannot be built here, and why.

    Raises:
        VoccError: a value outside its range or an unknown name.
    """

    plan: Plan
    config: TradeoffConfig
    scene_name: str = ""
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check every list and every number, before any work is done."""
        config = self.config
        for name in ("locators", "batch_sizes"):
            if not getattr(config, name):
                raise VoccError(
                    f"tradeoff.{name} is empty: it must hold at least one value"
                )
        self.plan.receiver.demand_locators("tradeoff.locators", config.locators)
        demand_word("tradeoff.frames", config.frames, FRAMINGS)
        for batch in config.batch_sizes:
            whole_number("tradeoff.batch_sizes", batch, 1, SETTINGS.most_batch)
        demand_least("tradeoff.", config, repeats=1, threads=0)
        why = "task=tradeoff, which compares receivers on the same frames"
        self.plan.budget.demand_no_stop_rule(why)

    @property
    def keys(self) -> dict[str, Key]:
        """Every receiver with every locator, by a name for tables and folders."""
        return {
            f"{name}-{locator}": Key(locator, name)
            for locator in self.config.locators
            for name in self.plan.receiver.names
        }


class Prices(NamedTuple):
    """What was measured.

    Args:
        rows: by batch, a row of ``tradeoff.csv`` for each receiver and locator; ``ms`` is the median time a
            frame with its quartiles.
        stages: the rows of ``stages.csv``: each stage's median time a frame, and what training took.
        errors: of the receivers in the order of the rows, at one value.
        conditions: what the rows rest on, in words.
    """

    rows: Sequence[Sequence[TableRow]]
    stages: Sequence[TableRow]
    errors: Curves
    conditions: str

    def ranked(self) -> list[TableRow]:
        """Give the rows of all batches; each is compared with those of its batch."""
        return [row for rows in self.rows for row in ranked(rows, self.errors)]

    def best(self) -> list[TableRow]:
        """Give each receiver with the batch in which it is quickest."""
        batches = zip(*self.rows, strict=True)
        return ranked([min(rows, key=milliseconds) for rows in batches], self.errors)


def milliseconds(row: TableRow) -> float:
    """Give the time a frame of a row."""
    return float(row["ms"].value)


def ranked(rows: Sequence[TableRow], errors: Curves) -> list[TableRow]:
    """Add a ``rank`` to each row.

    It is ``frontier`` where no other is quicker and better, by medians and rates; ``beaten`` where one is so
    whose rate is lower beyond chance, else ``perhaps``.

    Args:
        rows: of receivers, in the order of the errors.
        errors: of these receivers, at one value.
    """
    # By intervals of all pairs that hold together at 95 %.
    confidence = estimate.joint_confidence(estimate.all_pairs(len(rows)))
    prices = [(row["ms"].value, row["ber"].value) for row in rows]
    (value,), found = errors.values, []
    for name, row, (ms, ber) in zip(errors.receivers, rows, prices, strict=True):
        surely = [
            errors.difference(name, better, value, confidence).low > 0
            for better, price in zip(errors.receivers, prices, strict=True)
            if price != (ms, ber) and price[0] <= ms and price[1] <= ber
        ]
        rank = "beaten" if any(surely) else "perhaps" if surely else "frontier"
        found.append({**row, "rank": rank})
    return found


def run_tradeoff(settings: Settings, config: TradeoffConfig, folder: Path) -> None:
    """Price receivers, and report it: tables, board and a figure.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    study = build_tradeoff_study(settings, config)
    with begin(settings, folder, study.plan, 3) as run:
        prices = price_receivers(study, run)
    columns = {name: name for name in ("receiver", "locator", "batch", "ms")}
    columns |= {"ber": "BER", "rank": ""}
    note = "frontier: no receiver is quicker and better; beaten: one is; perhaps: one may be"
    lines = [note, "", prices.conditions, *left_out_lines(study.left_out)]
    best = prices.best()
    print_rows(sorted(best, key=milliseconds), columns, "\n".join(lines))
    every, runs = list(map(rounded, prices.ranked())), {}
    for row in every:
        place = {name: row[name] for name in ("receiver", "locator")}
        runs["-".join(place.values())] = (place, numbers_of(row))
    write_report(
        settings,
        folder,
        {"tradeoff": every, "stages": list(map(rounded, prices.stages))},
        {"tradeoff": figures.price_figure(best, prices.conditions)},
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


def price_receivers(study: TradeoffStudy, run: Run) -> Prices:
    """Train every receiver, count errors, and take times once the workers have ended.

    Frames lie as uint8 in the host's memory while times are taken; rendering is not timed.

    Raises:
        VoccError: what training refuses, or a worker that was ended from outside.
    """
    plan, config, experiment = study.plan, study.config, study.plan.experiment
    trained_on = [plan.locating_with(locator) for locator in config.locators]
    with run.pool:
        run.train(trained_on)
        (outcome,) = run.count([Case(plan, trained_on)])
    trainings = dict(zip(config.locators, map(run.training, trained_on), strict=True))
    errors = sweep.curves_of(experiment, study.keys, {experiment.values[0]: outcome})
    device = resolve_device(plan.world.device)
    finders = plan.receiver.finders(config.locators)
    receivers = {
        name: TimedReceiver(
            trainings[key.locator].bank([key.receiver])[key.receiver],
            plan.receiver.reader,
            finders[key.locator],
        )
        for name, key in study.keys.items()
    }
    frames = max(SETTINGS.least_frames, *config.batch_sizes)
    by_batch, stages = list[list[TableRow]](), list[TableRow]()
    with (
        run.stage("times", len(config.batch_sizes)) as advance,
        timing.threads(config.threads),
        timing.watched(device) as waiting,
    ):
        machine = timing.describe_machine(device)
        exposure = Exposure.of(
            replace(plan.world, framing=FRAMINGS[config.frames]),
            plan.world.scene,
            link.block_keys(plan.seed, experiment.name, frames),
            preambles=needs_preambles(plan.receiver.names),
        )
        for batch in config.batch_sizes:
            rounds = max(config.repeats, -(-SETTINGS.least_frames // batch))
            timed = time_stages(receivers, exposure, batch, rounds, device)
            compared = zip(study.keys.values(), errors, timed.values(), strict=True)
            by_batch.append([])
            for key, error, spent in compared:
                cost = trainings[key.locator].making(key.receiver)
                by_batch[-1].append(price_row(study, key, error, batch, spent))
                stages.append(stage_row(key, batch, spent, cost))
            advance(1)
    conditions = conditions_of(study, machine, waiting.share)
    return Prices(by_batch, stages, errors, conditions)


def price_row(
    study: TradeoffStudy, key: Key, error: Row, batch: int, spent: StageTimes
) -> TableRow:
    """Give a receiver's row of ``tradeoff.csv`` in a batch, without its rank."""
    return {
        "receiver": key.receiver,
        "locator": key.locator,
        "device": str(resolve_device(study.plan.world.device)),
        "frames": study.config.frames,
        "batch": batch,
        "ms": spent.total,
        "scenes": study.scene_name,
        "test_frames": error.frames,
        "ber": error.rate,
    }


def stage_row(key: Key, batch: int, spent: StageTimes, cost: Making) -> TableRow:
    """Give a receiver's row of ``stages.csv`` in a batch."""
    return {
        "receiver": key.receiver,
        "locator": key.locator,
        "batch": batch,
        **{f"{stage}_ms": spent.stage(stage).value for stage in STAGES},
        "training_s": cost.training_s,
        "training_frames": cost.frames,
        "parameters": cost.parameters,
        "size_bytes": cost.size_bytes,
    }


def conditions_of(study: TradeoffStudy, machine: str, waited_share: float) -> str:
    """Say what the prices rest on.

    Args:
        study: what was measured.
        machine: what times were taken on.
        waited_share: share of the time in which other work had the processor, 0 to 1.
    """
    handed = "whole frames" if study.config.frames == "whole" else "crops"
    text = (
        f"{study.plan.budget.frames} frames of the scene {study.scene_name}, the same for all;"
        f" times on {handed} in each receiver's best batch; {machine}."
    )
    if waited_share >= SETTINGS.busy_share:
        text += (
            f" Other work had the processor for {100 * waited_share:.0f} % of the time."
        )
    return text


def rounded(row: TableRow) -> TableRow:
    """Give a row's cells as a file has them, floats in five digits: more than any time or rate has."""
    return {
        name: float(f"{cell:.5g}") if isinstance(cell, float) else cell
        for name, cell in flat(row).items()
    }
