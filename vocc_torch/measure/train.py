"""Train receivers on simulated frames: FLDA and the classifiers that plug in, with what each took."""

import pickle
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from operator import attrgetter
from typing import Any, NamedTuple

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import Settings
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import ClassifierPlan, Plan, identity
from vocc_torch.measure.store import canonical
from vocc_torch.plugins import one_line
from vocc_torch.receiver import discriminant
from vocc_torch.receiver.calibration import Calibration, appearance, ranges_of
from vocc_torch.receiver.classifiers import Guarded, plugged
from vocc_torch.receiver.deciders import FLDA_FEATURES, Bank, bank_of, feature_indices
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import locator_settings, locator_words
from vocc_torch.receiver.reader import Readings
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BLOCK_FRAMES, training_point
from vocc_torch.simulation.scene import SceneModel, narrowed

CALIBRATION_FRAMES = 512
"""Most frames of the calibration of a saved receiver; at most the number of training frames."""

FIGURE_SAMPLES = 20_000
"""LEDs kept for the feature histograms."""

_N_FEATURES = len(FLDA_FEATURES["flda_3"])


@dataclass(frozen=True, slots=True)
class Making:
    """Time and frames of a receiver's training.

    Args:
        training_s: wall time of training, s, the simulation of its frames included; 0 without training.
        simulated_s: part of ``training_s`` in which frames were simulated, s; None if unknown.
        frames: number of training frames.
        parameters: number of trained parameters; None if unknown.
        size_bytes: size of the trained receiver, pickled.
    """

    training_s: float = 0.0
    simulated_s: float | None = None
    frames: int = 0
    parameters: int | None = None
    size_bytes: int | None = None


@dataclass(frozen=True)
class Training:
    """The outcome of training with one locator.

    Args:
        flda: fitted on all three features, from which the receivers on fewer features follow.
        frames: frames simulated for it.
        missed: frames in which no panel was found, which are left out.
        features: (N,3) features of the first LEDs, for figures.
        bits: (N,) their bits.
        seconds: wall time of FLDA's training, the simulation of its frames included.
        classifiers: those that plug in, trained, by name.
        costs: what each of these took, by name.
        further: the same of each further training, on frames of its own.
    """

    flda: FLDA = field(default_factory=lambda: FLDA(_N_FEATURES))
    frames: int = 0
    missed: int = 0
    features: Tensor = field(default_factory=lambda: torch.zeros(0, _N_FEATURES))
    bits: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.bool))
    seconds: float = 0.0
    classifiers: Mapping[str, Guarded] = field(default_factory=dict)
    costs: Mapping[str, Making] = field(default_factory=dict)
    further: "tuple[Training, ...]" = ()

    def bank(self, names: Sequence[str]) -> Bank:
        """Give the named receivers, ready to decide."""
        return bank_of(names, self.flda, self.classifiers)

    def banks(self, names: Sequence[str]) -> list[Bank]:
        """Give the named receivers after each training; of further ones those that learn."""
        learners = [
            name for name in names if name in FLDA_FEATURES or self.making(name).frames
        ]
        further = self.further if learners else ()
        return [self.bank(names), *(training.bank(learners) for training in further)]

    @classmethod
    def joined(cls, parts: "Sequence[Training]") -> "Training":
        """Put trainings of different classifiers on the same frames together; FLDA is that of the first."""
        classifiers, costs = dict[str, Guarded](), dict[str, Making]()
        for part in parts:
            classifiers |= part.classifiers
            costs |= part.costs
        return replace(parts[0], classifiers=classifiers, costs=costs)

    def making(self, name: str) -> Making:
        """Return time, frames and parameters of a receiver's training; some have no parameters."""
        if name in self.costs:
            return self.costs[name]
        if name not in FLDA_FEATURES:
            return Making(parameters=0)
        # What decides, without the sums that it was solved from.
        rule, _ = discriminant.Discriminant.of(
            self.flda.select(feature_indices(name)).statistics
        )
        parameters = len(FLDA_FEATURES[name]) + 1
        return Making(
            self.seconds, None, self.frames, parameters, len(pickle.dumps(rule))
        )


Progress = Callable[[float], object]
"""Called with the share of one receiver's training that was done since the last call."""


def untold(share: float) -> None:
    """Report no progress."""


class Lesson(NamedTuple):
    """One training of one receiver that learns.

    Args:
        plan: has FLDA alone, or a single classifier.
        number: of the training, from 0 on; each has frames and first weights of its own.
    """

    plan: Plan
    number: int


def lessons_of(plan: Plan) -> list[Lesson]:
    """Split the trainings of a plan: FLDA and then each classifier, as often as the budget says."""
    receiver = plan.receiver
    alone = [replace(receiver, names=tuple(FLDA_FEATURES), classifiers=())]
    alone += [
        replace(receiver, names=(recipe.name,), classifiers=(recipe,))
        for recipe in receiver.classifiers
    ]
    numbers = range(plan.budget.trainings)
    return [
        Lesson(replace(plan, receiver=part), number)
        for number in numbers
        for part in alone
    ]


def assembled(plan: Plan, learned: Sequence[Training]) -> Training:
    """Put together what came of each lesson of a plan, in their order."""
    size = len(learned) // plan.budget.trainings
    starts = range(0, len(learned), size)
    first, *further = (Training.joined(learned[at : at + size]) for at in starts)
    return replace(first, further=tuple(further))


def train(plan: Plan, progress: Progress = untold) -> Training:
    """Train FLDA and the plan's classifiers on its training scenes, as often as the budget says.

    Each training has its own frames. The first training is saved and does not depend on the number of
    trainings. Frames without a located panel are left out.

    Args:
        plan: the study.
        progress: called with the share of the work done since the last call, 1 in all for each receiver that
            learns.

    Raises:
        VoccError: no panel was found in any training frame, or a classifier that cannot be built or trained.
    """
    lessons = lessons_of(plan)
    return assembled(plan, [train_part(lesson, progress) for lesson in lessons])


def train_part(lesson: Lesson, progress: Progress = untold) -> Training:
    """Train one receiver once.

    FLDA reports progress block by block, another classifier once it is trained.

    Raises:
        VoccError: as :func:`train`.
    """
    plan, number = lesson
    model = plan.experiment.training_model(plan.world)
    point, link = training_point(number), Link.of(plan)
    if not plan.receiver.classifiers:
        stream = PanelStream(link, model, plan.seed, attrgetter("features"), point)
        return train_flda(plan, stream, progress)
    # Training frames have the same names as those of FLDA; test frames never do.
    (recipe,) = plan.receiver.classifiers
    model = narrowed(model, recipe.scene, f"classifiers.{recipe.name}.scene")
    stream = PanelStream(link, model, plan.seed, recipe.inputs.of, point)
    training = train_classifier(recipe, stream, number, plan.budget.training_frames)
    progress(1 / plan.budget.trainings)
    return training


def train_flda(plan: Plan, stream: "PanelStream", progress: Progress) -> Training:
    """Train FLDA, and keep some of its features for figures.

    Raises:
        VoccError: no panel was found in any training frame, or LEDs of one status alone.
    """
    begun, frames = time.perf_counter(), plan.budget.training_frames
    flda = FLDA(_N_FEATURES).to(stream.link.simulator.device)
    samples: list[tuple[Tensor, Tensor]] = []
    # A block at a time: sums then do not depend on the batch's size.
    blocks = -(-frames // BLOCK_FRAMES)
    for features, bits in stream(0, frames):
        progress(1 / (blocks * plan.budget.trainings))
        flda.update(features[..., :_N_FEATURES], bits)
        if sum(len(statuses) for _, statuses in samples) < FIGURE_SAMPLES:
            samples.append((features.flatten(0, -2).cpu(), bits.reshape(-1).cpu()))
    if not stream.frames:
        raise VoccError(
            f"training found no panel in any of {frames} frames: check scene, camera and receiver.location"
        )
    for status, leds in zip(("Off", "On"), flda.count.tolist(), strict=True):
        if not leds:
            raise VoccError(
                f"budget.training_frames is {frames}: "
                f"{stream.frames} with a located panel held no {status} LED: "
                "raise it, or take receiver.locator=truth for panels too small to be found"
            )
    x, bits = (
        torch.cat(parts)[:FIGURE_SAMPLES] for parts in zip(*samples, strict=True)
    )
    missed = frames - stream.frames
    return Training(flda, frames, missed, x, bits, time.perf_counter() - begun)


def training_key(plan: Plan, number: int = 0) -> str:
    """Name all that a plan's trained receivers depend on; of the experiment only its training scenes."""
    settings = identity(plan, [plan.receiver.locator])
    training = settings["experiment"]["training"]
    return canonical({**settings, "experiment": training, "number": number})


def trained_receiver(plan: Plan, training: Training) -> Receiver:
    """Put the receiver together that the plan keeps, ready to decode recordings and to be saved."""
    name = plan.receiver.save
    classifier: Any = training.classifiers.get(name)
    if classifier is None:
        classifier = training.flda.select(feature_indices(name))
    # Nobody knows the true corners in a recording: there the paper's locator stands in for them.
    locator = plan.receiver.finder or plan.receiver.location
    return Receiver(name, locator, plan.receiver.reader, classifier)


def calibrated_receiver(plan: Plan, training: Training) -> Receiver:
    """Build the plan's receiver and calibrate its scores on frames of its scenes.

    The frames of the calibration are used neither in training nor in the test.
    """
    link, frames = Link.of(plan), min(CALIBRATION_FRAMES, plan.budget.training_frames)
    model = plan.experiment.training_model(plan.world)
    keys = block_keys(plan.seed, "calibrate", frames)
    receiver = trained_receiver(plan, training).to(link.simulator.device)
    batches = []
    for seen in link.observe(model, keys, preambles=False, frames=frames):
        columns = receiver.score(seen.readings), seen.bits, appearance(seen.readings)
        batches.append([column[seen.panels.found].cpu() for column in columns])
    scores, bits, looks = map(torch.cat, zip(*batches, strict=True))
    if len(looks):
        receiver.calibration = Calibration.of(scores, bits)
        receiver.trained_on = ranges_of(looks)
    return receiver


def receiver_for(plan: Plan, *, at_truth: bool = False) -> Receiver:
    """Train a receiver on the plan's scenes.

    Args:
        plan: the study.
        at_truth: whether it learns at the true corners, which is quick where its locator is slow.
    """
    studied = plan.locating_with("truth") if at_truth else plan
    experiment = replace(plan.experiment, training={})
    training = train(replace(studied, experiment=experiment))
    receiver = calibrated_receiver(studied, training)
    receiver.locator = plan.receiver.finder or receiver.locator
    return receiver


def settings_used(settings: Settings, receiver: Receiver) -> Settings:
    """Say in the settings which receiver was used, where a model brought it."""
    if settings.model is None:
        return settings
    settings_of_locator: dict[str, Any] = locator_settings(receiver.locator)
    name, locators = locator_words(receiver.locator)
    location = settings.receiver.location
    limits = settings_of_locator.get("paper", settings_of_locator)
    known = {key: limits[key] for key in asdict(location) if key in limits}
    named = replace(
        settings.receiver,
        save=receiver.name,
        locator=name,
        location=replace(location, **known),
        false_alarms=None if locators else settings_of_locator.get("false_alarms"),
    )
    classifiers = {
        name: classifier
        for name, classifier in settings.classifiers.items()
        if name == receiver.name
    }
    return replace(settings, receiver=named, classifiers=classifiers, locators=locators)


@dataclass
class PanelStream:
    """Training panels as a classifier sees them, simulated anew whenever they are asked for.

    Args:
        link: simulation, locator and reader.
        model: the training scenes.
        seed: root seed.
        inputs: gives what the classifier sees.
        point: name that keys the frames.
        frames: panels that it was shown so far.
        seconds: wall time that went into them so far.
    """

    link: Link
    model: SceneModel
    seed: int
    inputs: Callable[[Readings], Tensor]
    point: str
    frames: int = 0
    seconds: float = 0.0

    def __call__(self, first: int, count: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield frames ``first`` to ``first + count`` in blocks, without frames whose panel was not located.

        Raises:
            VoccError: ``first`` is no multiple of a block.
        """
        if first % BLOCK_FRAMES:
            raise VoccError.of("first", first, f"a multiple of {BLOCK_FRAMES}")
        keys = block_keys(self.seed, self.point, first + count, first)
        # Batches may be smaller or larger than a block.
        blocks = -(-self.link.batch_frames // BLOCK_FRAMES)
        begun = time.perf_counter()
        for start in range(0, len(keys), blocks):
            views = self.link.observe(
                self.model,
                keys[start : start + blocks],
                preambles=False,
                frames=count - start * BLOCK_FRAMES,
            )
            seen = [
                (self.inputs(at.readings), at.bits, at.panels.found) for at in views
            ]
            parts = map(torch.cat, zip(*seen, strict=True))
            split = (torch.split(part, BLOCK_FRAMES) for part in parts)
            for x, bits, found in zip(*split, strict=True):
                self.frames += int(found.sum())
                self.seconds += time.perf_counter() - begun
                yield x[found], bits[found]
                begun = time.perf_counter()
        self.seconds += time.perf_counter() - begun


def train_classifier(
    recipe: ClassifierPlan, stream: PanelStream, number: int, frames: int
) -> Training:
    """Train a classifier.

    Args:
        recipe: what is trained, and how.
        stream: the training frames.
        number: of the training, from which its first weights follow.
        frames: training frames where the recipe has no number of its own.

    Raises:
        VoccError: a classifier that cannot be built or trained, by its name.
    """
    steps = replace(recipe.training, seed=recipe.training.seed + number)
    guarded = plugged.classifier_of(recipe.build, recipe.inputs, steps)
    begun = time.perf_counter()
    with plugged.seeded(steps.seed):
        guarded.fit_stream(stream, recipe.frames or frames)
    # An interrupted training that went on has a price too.
    earlier_s = float(getattr(guarded.classifier, "earlier_s", 0.0))
    seconds = time.perf_counter() - begun + earlier_s
    try:
        size = len(pickle.dumps(guarded))
    except Exception as error:
        raise VoccError(
            f"classifier {recipe.name}: it must be possible to pickle it, for other processes ({one_line(error)})"
        ) from error
    counted = getattr(guarded.classifier, "parameters_count", None)
    parameters = None if counted is None else int(counted)
    cost = Making(seconds, stream.seconds, stream.frames, parameters, size)
    return Training(classifiers={recipe.name: guarded}, costs={recipe.name: cost})
