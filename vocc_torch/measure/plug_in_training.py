"""Build and train the classifiers that plug in, each on panels streamed from the simulator."""

from __future__ import annotations

import inspect
import pickle
import random
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from hydra.utils import get_object, instantiate
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import Plan, narrowed
from vocc_torch.measure.plug_in import TARGET, ClassifierPlan
from vocc_torch.receiver.classifiers.inputs import Inputs
from vocc_torch.receiver.classifiers.module_file import ModuleFile
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.classifiers.sklearn_adapter import SklearnClassifier, is_estimator
from vocc_torch.receiver.classifiers.torch_classifier import TorchClassifier
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.simulation import SceneModel


@dataclass(frozen=True)
class TrainedClassifier:
    """A classifier, and what it took to get it.

    Args:
        guarded: the trained classifier.
        seconds: wall time of training, of which ``simulated_s`` went into its frames.
        simulated_s: see there.
        frames: panels that it was shown.
        parameters: numbers that decide, or None where it does not say.
        size_bytes: of the trained classifier, pickled.
    """

    guarded: Guarded
    seconds: float
    simulated_s: float
    frames: int
    parameters: int | None
    size_bytes: int


def built(plan: ClassifierPlan) -> Guarded:
    """Build a classifier, untrained.

    A scikit-learn estimator and a torch module are taken for what they are; a module whose class takes
    ``n_inputs`` is told how many numbers it sees of an LED. Anything else must follow the protocol itself.

    Raises:
        VoccError: a class that does not exist or cannot be built, or that does not follow the protocol.

    Example:
        >>> plan = ClassifierPlan("bayes", {"_target_": "sklearn.naive_bayes.GaussianNB"})
        >>> type(built(plan).classifier).__name__
        'SklearnClassifier'
    """
    settings = dict(plan.build)
    target = str(settings.pop(TARGET))
    home = None if plan.file is None else ModuleFile(plan.file)
    try:
        kind = get_object(target) if home is None else home.named(target)
        if inspect.isclass(kind) and issubclass(kind, nn.Module) and _takes(kind, "n_inputs"):
            settings.setdefault("n_inputs", plan.inputs.size)
        # A module draws its first weights when it is made.
        with seeded(plan.training.seed):
            given = instantiate(settings, _convert_="all")
            made = kind(**given)  # type: ignore[operator]  # refused just below
        if isinstance(made, nn.Module):
            made = TorchClassifier(made, plan.training)
        elif is_estimator(made):
            made = SklearnClassifier(made)
    except VoccError as error:
        raise VoccError(f"classifiers.{plan.name}: {error}") from error
    except (Exception, SystemExit) as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise VoccError(f"classifiers.{plan.name}.build: {target} cannot be built ({reason})") from error
    return Guarded(plan.name, made, plan.inputs, home)


def _takes(kind: type, argument: str) -> bool:
    """Whether a class can be built with an argument of that name."""
    return argument in inspect.signature(kind).parameters


@dataclass
class PanelStream:
    """Training panels as a classifier sees them, simulated anew whenever they are asked for.

    Args:
        link: simulation and reader.
        locator: what finds the panel, or None for true corners.
        model: the training scenes.
        seed: root seed.
        inputs: what the classifier sees.
    """

    link: Link
    locator: PanelLocator | None
    model: SceneModel
    seed: int
    inputs: Inputs
    frames: int = 0
    seconds: float = 0.0

    def __call__(self, first: int, count: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Give frames ``first`` to ``first + count`` in blocks; those without a located panel are left out.

        Blocks, because sums of a classifier's own must not depend on the batches of the simulation.

        Raises:
            VoccError: ``first`` is no multiple of a block.
        """
        if first % BLOCK_FRAMES:
            raise VoccError(f"first is {first}: it must be a multiple of {BLOCK_FRAMES}")
        keys = block_keys(self.seed, "train", first + count)[first // BLOCK_FRAMES :]
        views = self.link.observe_each({"": self.locator}, self.model, keys, preambles=False, frames=count)
        waiting: list[tuple[Tensor, Tensor, Tensor]] = []
        begun = time.perf_counter()
        for seen in (view[""] for view in views):
            x = self.inputs.of(seen.readings, seen.readings.cell_px, self.link.reader.shape)
            waiting.append((x, seen.bits, seen.panels.found))
            while sum(len(found) for *_, found in waiting) >= BLOCK_FRAMES:
                whole = [torch.cat(parts) for parts in zip(*waiting, strict=True)]
                waiting = [(whole[0][BLOCK_FRAMES:], whole[1][BLOCK_FRAMES:], whole[2][BLOCK_FRAMES:])]
                self.seconds += time.perf_counter() - begun
                yield self._located(*(part[:BLOCK_FRAMES] for part in whole))
                begun = time.perf_counter()
        self.seconds += time.perf_counter() - begun
        if any(len(found) for *_, found in waiting):
            yield self._located(*(torch.cat(parts) for parts in zip(*waiting, strict=True)))

    def _located(self, x: Tensor, bits: Tensor, found: Tensor) -> tuple[Tensor, Tensor]:
        """Leave out the panels that were not found, and count the others."""
        self.frames += int(found.sum())
        return x[found], bits[found]


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Let Python, NumPy and torch draw from a seed, and go on afterwards as if nobody had drawn.

    Args:
        seed: at least 0.

    Example:
        >>> with seeded(0):
        ...     first = torch.rand(1)
        >>> with seeded(0):
        ...     torch.equal(torch.rand(1), first)
        True
    """
    # Estimators without a random_state draw from NumPy's global generator: there is no other to give them.
    kept, state = np.random.get_state(), random.getstate()  # noqa: NPY002
    try:
        with torch.random.fork_rng():
            random.seed(seed)
            np.random.seed(seed % 2**32)  # noqa: NPY002
            torch.manual_seed(seed)
            yield
    finally:
        np.random.set_state(kept)  # noqa: NPY002
        random.setstate(state)


def train_classifiers(
    plan: Plan, link: Link, locators: Mapping[str, PanelLocator | None]
) -> dict[str, dict[str, TrainedClassifier]]:
    """Train a plan's classifiers one after the other, with each of several locators.

    Training frames have the same names as those of FLDA; test frames never do.

    Args:
        plan: the study.
        link: simulation and reader.
        locators: by name; None takes the simulator's true corners.

    Returns:
        By locator and classifier.

    Raises:
        VoccError: a classifier that cannot be built or trained, by its name.
    """
    return {
        name: {one.name: _trained(one, plan, link, locator) for one in plan.receiver.classifiers}
        for name, locator in locators.items()
    }


def _trained(one: ClassifierPlan, plan: Plan, link: Link, locator: PanelLocator | None) -> TrainedClassifier:
    """Train one."""
    guarded = built(one)
    model = narrowed(plan.experiment.training_model(plan.world), one.scene, f"classifiers.{one.name}.scene")
    stream = PanelStream(link, locator, model, plan.seed, one.inputs)
    begun = time.perf_counter()
    with seeded(one.training.seed):
        guarded.fit_stream(stream, one.frames or plan.budget.training_frames)
    # An interrupted training that went on has a price too.
    seconds = time.perf_counter() - begun + float(getattr(guarded.classifier, "earlier_s", 0.0))
    counted = getattr(guarded.classifier, "parameters_count", None)
    parameters = int(counted) if counted is not None else None
    return TrainedClassifier(
        guarded, seconds, stream.seconds, stream.frames, parameters, _packed_bytes(guarded)
    )


def _packed_bytes(guarded: Guarded) -> int:
    """Measure a trained classifier, or refuse one that cannot be sent to another process."""
    try:
        return len(pickle.dumps(guarded))
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise VoccError(
            f"classifier {guarded.name}: it must be possible to pickle it, for other processes ({reason})"
        ) from error
