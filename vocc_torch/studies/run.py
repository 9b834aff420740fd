"""What every study does: train receivers, and count their errors case by case; resumed."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from vocc_torch.measure import kept_training, runner, sweep
from vocc_torch.measure.build import build_plan, without_absent
from vocc_torch.measure.config import Settings
from vocc_torch.measure.curve import Curves
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.plan import Experiment, Locator, Plan, identity
from vocc_torch.measure.store import Store, canonical
from vocc_torch.measure.train import Training, calibrated_receiver, training_key
from vocc_torch.report import folder as run_folder
from vocc_torch.report.terminal import Console, ProgressView, Stopwatch

Advance = Callable[[float], None]
"""Called with the units of work done since the last call."""


class Case(NamedTuple):
    """Frames of one set of scenes, decoded by receivers of one or more trainings.

    Args:
        plan: scenes, receivers and number of frames.
        trained_on: plans of the trainings, each with the locator whose corners its receivers use.
        value: of the experiment's axis; None leaves the scenes unchanged.
    """

    plan: Plan
    trained_on: Sequence[Plan]
    value: float | None = None


def cases_of(plan: Plan, trained_on: Sequence[Plan]) -> list[Case]:
    """Give a case for each value of a curve that is simulated."""
    return [Case(plan, trained_on, at) for at in plan.experiment.simulated_values]


@dataclass(eq=False)
class Run:
    """Workers, store and console of a running study.

    Args:
        pool: the processes that train and count.
        store: where trainings and blocks are recorded.
        console: where stages are shown.
        stages: how many stages there are.
    """

    pool: Workers
    store: Store
    console: Console = field(default_factory=lambda: Console(quiet=True))
    stages: int = 1
    _trainings: dict[str, Training] = field(default_factory=dict, init=False)
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
        with (
            Stopwatch(self.console).stage(name),
            ProgressView(max(1.0, units), self.console, label, unit="") as view,
        ):
            yield lambda done: view.advance(label, done)

    def training(self, plan: Plan) -> Training:
        """Give the training of a plan that :meth:`train` was called with."""
        return self._trainings[training_key(plan)]

    def train(self, plans: Sequence[Plan], name: str = "training") -> None:
        """Train every plan with its locator.

        Args:
            plans: equal ones are trained once.
            name: of the stage.

        Raises:
            VoccError: no panel in any training frame, or a classifier that cannot be trained.
        """
        missing = {training_key(plan): plan for plan in plans}
        learners = sum(1 + len(plan.receiver.classifiers) for plan in missing.values())
        with self.stage(name, learners) as advance:
            trained, trained_now = kept_training.train_plans(
                list(missing.values()), self.pool, self.store, advance
            )
        if not trained_now:
            run_folder.say(self.console, "resuming: the receivers are trained already")
        self._trainings |= zip(missing, trained, strict=True)

    def count(
        self, cases: Sequence[Case], name: str = "bit errors"
    ) -> list[runner.Outcome]:
        """Count the errors of each case until its budget is spent; blocks in the store are not counted again.

        Args:
            cases: their plans must have been trained.
            name: of the stage.
        """
        jobs = list(map(self.job, cases))
        frames = sum(job.plan.frames_in_point for job in jobs)
        with self.stage(name, frames) as advance:
            return list(sweep.outcomes(jobs, self.pool, self.store, advance))

    def curves(
        self, plan: Plan, trained_on: Sequence[Plan], name: str
    ) -> dict[Locator, Curves]:
        """Count the errors at every value of a plan's axis.

        Args:
            plan: what is counted.
            trained_on: plans of the trainings, each with a locator of its own.
            name: of the stage.

        Returns:
            The curves by locator.
        """
        counted = self.count(cases_of(plan, trained_on), name)
        values = plan.experiment.simulated_values
        outcomes = dict(zip(values, counted, strict=True))
        locators = [source.receiver.locator for source in trained_on]
        return {at: sweep.curves_at(plan, at, outcomes) for at in locators}

    def job(self, case: Case) -> runner.Job:
        """Give the job of a case, with the trainings of each locator numbered."""
        plan, banks = case.plan, list[runner.NumberedBank]()
        for source in case.trained_on:
            locator = source.receiver.locator
            for bank in self.training(source).banks(plan.receiver.names):
                number = sum(locator == other for other, _, _ in banks)
                banks.append((locator, bank, number))
        settings = identity(plan, [locator for locator, _, _ in banks])
        settings["trained_on"] = list(map(training_key, case.trained_on))
        text = canonical(settings)
        digest = hashlib.sha256(text.encode()).hexdigest()
        job = sweep.job_of(plan, banks, case.value)
        return replace(job, name=f"{job.point} {digest}")


def scene_plan(settings: Settings) -> tuple[Plan, dict[str, str]]:
    """Build the plan of the scene itself, without the ranges of an experiment.

    Returns:
        The plan, and the receivers that cannot be built here with the reason.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan = build_plan(settings)
    receiver, left_out = without_absent(plan.receiver)
    nearest_m = plan.world.scene.nearest_m
    experiment = Experiment(settings.task, "distance_m", (nearest_m,))
    return replace(plan, receiver=receiver, experiment=experiment), left_out


@contextmanager
def begin(settings: Settings, folder: Path, plan: Plan, stages: int) -> Iterator[Run]:
    """Open a study's store in its folder, and its workers.

    Args:
        settings: the configuration.
        folder: the run's folder.
        plan: of the whole study; each case adds its further settings.
        stages: how many stages there are.

    Raises:
        VoccError: a folder with other results, or a store with other settings.
    """
    console, ledger = Console(), folder / run_folder.LEDGER
    begun = not ledger.exists()
    counted_for = identity(plan, [plan.receiver.locator])
    # Created before the training, so that a wrong number is refused at once; no process starts yet.
    pool = Workers.of(settings)
    with (
        run_folder.resumable(settings, folder, console),
        Store.open(ledger, counted_for) as store,
    ):
        if known := len(store):
            counted = (
                f"resuming: {known} blocks of frames are already counted in {ledger}"
            )
            run_folder.say(console, counted)
        run_folder.write_config(settings, folder)
        try:
            yield Run(pool, store, console, stages)
        finally:
            if begun and not len(store):
                with suppress(OSError):
                    ledger.unlink()


def write_training(
    settings: Settings, plan: Plan, training: Training, folder: Path
) -> None:
    """Write ``receiver.pt`` and the configuration that it was trained with."""
    calibrated_receiver(plan, training).save(folder / "receiver.pt")
    run_folder.write_config(settings, folder)
