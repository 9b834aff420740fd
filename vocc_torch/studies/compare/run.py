"""What every comparison does: train and count; resumed, with time left."""

import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypeVar

from vocc_torch.measure import runner
from vocc_torch.measure.config import Budget
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.kept_training import KeptTrainings
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.store import Store
from vocc_torch.measure.train import Training, train_alone
from vocc_torch.report.terminal import Console, ProgressView
from vocc_torch.rng import BLOCK_FRAMES

Name = TypeVar("Name", bound=Hashable)

Advance = Callable[[float], None]
"""Called with the units of work done since the last call."""


@dataclass(eq=False)
class Run:
    """What a comparison runs with.

    Args:
        pool: the processes that train and count.
        store: where trainings and blocks are recorded, or None.
        console: where stages are shown, or None.
        stages: how many stages there are.
    """

    pool: Workers
    store: Store | None = None
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
            for learner in ("flda", *(one.name for one in plan.receiver.classifiers))
        }
        with self.stage("training", len(parts)) as advance:
            recorded = None if self.store is None else KeptTrainings([self.store])
            return train_alone(plans, self.pool, recorded, lambda frames: advance(1))

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
                runner.Point(job, rule, self.store, lambda frames, _: advance(frames))
                for job, rule in jobs
            ]
            batches = [job.plan.batch_frames for job, _ in jobs]
            batch_frames = max(batches, default=BLOCK_FRAMES)
            return list(runner.count(points, self.pool, batch_frames))
