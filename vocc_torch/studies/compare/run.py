"""What every comparison does: train, count and report; resumed."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from vocc_torch.measure import intervals, runner
from vocc_torch.measure.config import Budget, Settings
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.kept_training import KeptTrainings
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.store import Store
from vocc_torch.measure.train import Training, train_plans
from vocc_torch.report import folder as run_folder
from vocc_torch.report import run_ledgers, styles, tensorboard
from vocc_torch.report.plots import Figure
from vocc_torch.report.terminal import Console, ProgressView
from vocc_torch.rng import BLOCK_FRAMES

Advance = Callable[[float], None]
"""Called with the units of work done since the last call."""

Row: TypeAlias = dict[str, str | int | float | None]
"""A row of a table by its columns; what is missing is blank."""


@dataclass(eq=False)
class Run:
    """What a comparison runs with.

    Args:
        pool: the processes that train and count.
        store: where trainings and blocks are recorded.
        console: where stages are shown, or None.
        stages: how many stages there are.
    """

    pool: Workers
    store: Store
    console: Console | None = None
    stages: int = 1
    _begun: int = field(default=0, init=False)

    @contextmanager
    def stage(self, name: str, units: float) -> Iterator[Advance]:
        """Show a stage under a bar with the time left, and print how long it took.

        Args:
            name: what is done.
            units: units of work.
        """
        self._begun += 1
        label = f"{self._begun} of {self.stages}: {name}"
        start_s = time.perf_counter()
        if self.console is None:
            yield lambda done: None
            return
        with ProgressView(max(1.0, units), self.console, label, unit="") as view:
            yield lambda done: view.advance(label, done)
        spent_s = time.perf_counter() - start_s
        self.console.print(f"{name:<20} {spent_s:6.1f} s", highlight=False)

    def train(self, plans: Sequence[Plan]) -> list[Training]:
        """Train every plan with its locator.

        Raises:
            VoccError: no panel in any training frame, or a classifier that cannot be trained.
        """
        parts = {
            repr((plan.world, plan.receiver.reader, plan.receiver.locator, learner))
            for plan in plans
            for learner in (
                "flda",
                *(classifier.name for classifier in plan.receiver.classifiers),
            )
        }
        with self.stage("training", len(parts)) as advance:
            recorded = KeptTrainings([self.store])
            return train_plans(plans, self.pool, recorded, lambda frames: advance(1))

    def count(
        self,
        jobs: Sequence[tuple[runner.Job, Budget]],
        name: str = "bit errors",
    ) -> list[runner.Outcome]:
        """Count the errors of each job until its budget is spent.

        Args:
            jobs: with the rule that ends each.
            name: of the stage.
        """
        with self.stage(name, sum(rule.frames for _, rule in jobs)) as advance:
            points = [
                runner.PointTask(
                    job, rule, self.store, lambda frames, _: advance(frames)
                )
                for job, rule in jobs
            ]
            batches = [job.plan.batch_frames for job, _ in jobs]
            batch_frames = max(batches, default=BLOCK_FRAMES)
            return list(runner.count(points, self.pool, batch_frames))


@contextmanager
def comparison(
    settings: Settings, folder: Path, identity: dict[str, object], stages: int
) -> Iterator[Run]:
    """Open a comparison's store in its folder, and its workers.

    Args:
        settings: the configuration.
        folder: the run's folder.
        identity: what the counts depend on.
        stages: how many stages there are.

    Raises:
        VoccError: a folder with other results, or a store of other counts.
    """
    run_folder.refuse_results(folder, run_folder.LEDGER)
    console, ledger = Console(), folder / run_folder.LEDGER
    with (
        run_ledgers.resumable(settings, folder, console),
        run_ledgers.open_ledger(ledger, identity, console) as store,
    ):
        run_folder.write_config(settings, folder)
        yield Run(Workers.of(settings), store, console, stages)


def write_report(
    settings: Settings,
    folder: Path,
    rows: Mapping[str, Sequence[Row]],
    figures: Mapping[str, Figure],
    others: Sequence[str] = (),
    **board: Mapping[str, Any] | Any,
) -> None:
    """Write tables and figures, the board where it is wanted, and say where they are.

    Args:
        settings: the configuration.
        folder: the run's folder.
        rows: of the tables, by the file's name without its end; one without rows is not written.
        figures: by the file's name without its end.
        others: files that were written before.
        **board: what else :func:`vocc_torch.report.tensorboard.write_figures` takes.
    """
    places = [("file", name) for name in others]
    for name, table in rows.items():
        if table:
            fullest = sorted(table, key=len, reverse=True)
            columns = list(dict.fromkeys(column for row in fullest for column in row))
            lines = [[row.get(column) for column in columns] for row in table]
            file = f"{name}.csv"
            run_folder.write_rows(folder / file, [columns, *lines], short=True)
            places.append(("table", file))
    tensorboard.write_figures(settings, folder, figures, **board)
    places += [("figure", f"{name}.png") for name in figures]
    run_folder.print_places(Console(), folder, places, settings.tensorboard)


def ends(name: str, found: Estimate | None) -> Row:
    """Give an estimate's cells.

    Example:
        >>> ends("ms", Estimate(2.0, 1.0, 3.0))
        {'ms': 2.0, 'ms_low': 1.0, 'ms_high': 3.0}
    """
    names = name, f"{name}_low", f"{name}_high"
    values = (found.value, found.low, found.high) if found else (None, None, None)
    return dict(zip(names, values, strict=True))


def rate_texts(rate: Estimate) -> tuple[str, str]:
    """Write a rate and its interval, or its limit.

    Example:
        >>> rate_texts(Estimate(0.0, 0.0, 1e-4))
        ('< 1.0e-4', '')
    """
    if rate.value == 0:
        return f"< {styles.rate_text(rate.high)}", ""
    return styles.rate_text(rate.value), styles.ends_text(rate.low, rate.high)


def counted(counts: Counts) -> Row:
    """Give the cells of counts: frames, bits and the bit error rate with its interval."""
    rate = intervals.ber_interval(counts)
    cells: Row = {"frames": counts.frames, "bits": counts.bits}
    return {**cells, "bit_errors": counts.bit_errors, **ends("ber", rate)}


def numbers_of(row: Row) -> dict[str, float]:
    """Give a row's numbers, for the board."""
    return {
        name: float(cell)
        for name, cell in row.items()
        if isinstance(cell, int | float) and not isinstance(cell, bool)
    }
