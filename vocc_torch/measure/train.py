"""Train receivers on simulated frames: FLDA and the classifiers that plug in, with what each took."""

import itertools
import pickle
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure import timing
from vocc_torch.measure.config import Settings
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import Locator, Plan, identity, resolve_device
from vocc_torch.measure.store import canonical
from vocc_torch.receiver import discriminant, reader
from vocc_torch.receiver.bank import FLDA_FEATURES, ReceiverBank, feature_indices
from vocc_torch.receiver.calibration import Calibration, appearance, ranges_of
from vocc_torch.receiver.classifiers import Guarded, Inputs, plugged
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PanelLocator, locator_settings, locator_words
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BLOCK_FRAMES, BlockKey, training_point
from vocc_torch.simulation.scene import SceneModel, narrowed

CALIBRATION_FRAMES = 512
"""Most frames on which a receiver that is kept learns what its scores are worth; at most as many train it."""

FIGURE_SAMPLES = 20_000
"""LEDs kept for the feature histograms."""

if TYPE_CHECKING:
    from vocc_torch.measure.kept_training import KeptTrainings

Told = Callable[[int], None]
_N_FEATURES = len(FLDA_FEATURES["flda_3"])


@dataclass(frozen=True, slots=True)
class Making:
    """What it took to make a receiver.

    Args:
        training_s: wall time of training, s, the simulation of its frames included; 0 without training.
        simulated_s: what of it went into the frames, s, where that is known.
        frames: training frames that it was shown.
        parameters: numbers that decide, where the receiver says it.
        size_bytes: of the trained receiver, pickled.
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
        made: what each of these took, by name.
        more: the same of each further training, on frames of its own.
    """

    flda: FLDA = field(default_factory=lambda: FLDA(_N_FEATURES))
    frames: int = 0
    missed: int = 0
    features: Tensor = field(default_factory=lambda: torch.zeros(0, _N_FEATURES))
    bits: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.bool))
    seconds: float = 0.0
    classifiers: Mapping[str, Guarded] = field(default_factory=dict)
    made: Mapping[str, Making] = field(default_factory=dict)
    more: "tuple[Training, ...]" = ()

    def bank(self, names: Sequence[str]) -> ReceiverBank:
        """Give the named receivers, ready to decide."""
        learners = [
            name
            for name in names
            if name in FLDA_FEATURES or self.made.get(name, Making()).frames
        ]
        banks = [training.bank(learners) for training in self.more] if learners else []
        return ReceiverBank(names, self.flda, self.classifiers, banks)

    @classmethod
    def joined(cls, parts: "Sequence[Training]") -> "Training":
        """Put trainings of different classifiers on the same frames together; FLDA is that of the first."""
        first = parts[0]
        classifiers, makings = dict(first.classifiers), dict(first.made)
        for part in parts[1:]:
            classifiers, makings = (
                {**classifiers, **part.classifiers},
                {**makings, **part.made},
            )
        trainings = tuple(
            cls.joined(column)
            for column in zip(*(part.more for part in parts), strict=True)
        )
        return replace(first, classifiers=classifiers, made=makings, more=trainings)

    def making(self, name: str) -> Making:
        """Say what it took to make a receiver; one that learns nothing has no parameters."""
        if name in self.made:
            return self.made[name]
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


def train(plan: Plan, progress: Told | None = None, *, keep: bool = False) -> Training:
    """Train on the plan's training scenes with its own locator, as :func:`train_each`."""
    return train_each(plan, [plan.receiver.locator], progress, keep=keep)[
        plan.receiver.locator
    ]


def train_each(
    plan: Plan,
    locators: Sequence[Locator],
    progress: Told | None = None,
    *,
    keep: bool = False,
) -> dict[Locator, Training]:
    """Train on the plan's training scenes with each of several locators, all on the same frames.

    It is done as often as the budget says, each time on frames of its own; the first training is the one that
    is kept, and does not depend on how many follow. Frames without a located panel teach nothing and are left
    out.

    Args:
        plan: the study.
        locators: names of the locators.
        progress: called with the frames done since the last call.
        keep: whether the classifiers share frames that are kept in memory, instead of simulating them anew
            for each; they learn the same.

    Raises:
        VoccError: no panel was found in any training frame, or a classifier that cannot be built or trained.
    """
    numbers = range(plan.budget.trainings)
    return several(
        [
            train_once(plan, locators, progress, keep=keep, number=number)
            for number in numbers
        ]
    )


def several(trainings: Sequence[Mapping[Locator, Training]]) -> dict[Locator, Training]:
    """Give the first of some trainings with the others in it, by locator."""
    first, *others = trainings
    return {
        name: replace(training, more=tuple(other[name] for other in others))
        for name, training in first.items()
    }


def train_once(
    plan: Plan,
    locators: Sequence[Locator],
    progress: Told | None,
    *,
    keep: bool,
    number: int,
) -> dict[Locator, Training]:
    """Do one training, by its number, from 0 on, as :func:`train_each`."""
    begun, link, frames = (
        time.perf_counter(),
        Link.of(plan),
        plan.budget.training_frames,
    )
    finders, scenes = (
        plan.receiver.finders(locators),
        plan.experiment.training_model(plan.world),
    )
    fldas = {name: FLDA(_N_FEATURES).to(link.simulator.device) for name in locators}
    samples: dict[str, list[tuple[Tensor, Tensor]]] = {name: [] for name in locators}
    missed = dict.fromkeys(locators, 0)
    keys = block_keys(plan.seed, training_point(number), frames)
    views = link.observe_each(finders, scenes, keys, preambles=False, frames=frames)
    read = (
        [
            (observation.readings.features, observation.panels.found, observation.bits)
            for observation in of.values()
        ]
        for of in views
    )
    # A block at a time: sums then do not depend on the batch's size.
    for parts in in_blocks(
        tuple(itertools.chain(*observations)) for observations in read
    ):
        for name, features, found, bits in zip(
            locators, *(parts[at::3] for at in range(3)), strict=True
        ):
            leds = features[found], bits[found]
            fldas[name].update(leds[0][..., :_N_FEATURES], leds[1])
            missed[name] += int((~found).sum())
            if sum(len(statuses) for _, statuses in samples[name]) < FIGURE_SAMPLES:
                samples[name].append(
                    (leds[0].flatten(0, -2).cpu(), leds[1].reshape(-1).cpu())
                )
        if progress is not None:
            progress(len(parts[0]))
    trained = {}
    for name, flda in fldas.items():
        if missed[name] == frames:
            help_ = "check scene, camera and receiver.location"
            raise VoccError(
                f"training found no panel in any of {frames} frames: {help_}"
            )
        for status, leds in zip(("Off", "On"), flda.count.tolist(), strict=True):
            if not leds:
                refusal = (
                    f"{frames - missed[name]} with a located panel held no {status} LED"
                )
                rule = "raise it, or take receiver.locator=truth for panels too small to be found"
                raise VoccError(
                    f"budget.training_frames is {frames}: {refusal}: {rule}"
                )
        x, bits = (
            torch.cat(parts)[:FIGURE_SAMPLES]
            for parts in zip(*samples[name], strict=True)
        )
        training = Training(
            flda, frames, missed[name], x, bits, time.perf_counter() - begun
        )
        trained[name] = train_classifiers(
            plan, link, finders[name], training, number, keep
        )
    return trained


def training_key(plan: Plan, locators: Sequence[Locator]) -> str:
    """Name all that the trained receivers of a plan depend on; of the experiment only its training scenes."""
    settings = identity(
        replace(plan, receiver=replace(plan.receiver, save="flda_3")), locators
    )
    return canonical({**settings, "experiment": settings["experiment"]["training"]})


def train_plans(
    plans: Sequence[Plan],
    locators: Sequence[Sequence[Locator]],
    workers: Workers,
    kept: "KeptTrainings | None" = None,
    told: Told = lambda frames: None,
) -> list[dict[Locator, Training]]:
    """Train every plan with each of its locators, each receiver by itself on one thread.

    So many train at the same time and each has a price. Receivers that train alike are trained once: FLDA on
    the same scenes through the same reader is one pass over the frames for all its features.

    Args:
        plans: the studies.
        locators: of each plan.
        workers: who does it; here too on one thread.
        kept: what was trained before, and where it is kept; None for nowhere.
        told: called with the training frames of each receiver that is trained, or was.

    Returns:
        For each plan the training of its receivers by locator. ``making`` says what each took.

    Raises:
        VoccError: as :func:`train_each`, or a worker that was ended from outside.
    """
    keys_of_plans: list[list[str]] = []
    parts: dict[str, tuple[Plan, tuple[Locator, ...]]] = {}
    for plan, named in zip(plans, locators, strict=True):
        # A part need not have the receiver that is kept.
        receiver, keys = replace(plan.receiver, save="flda_3"), list[str]()
        alone = [replace(receiver, names=tuple(FLDA_FEATURES), classifiers=())]
        alone += [
            replace(receiver, names=(classifier.name,), classifiers=(classifier,))
            for classifier in receiver.classifiers
        ]
        for part in (replace(plan, receiver=receiver_part) for receiver_part in alone):
            keys.append(training_key(part, named))
            parts[keys[-1]] = part, tuple(named)
        keys_of_plans.append(keys)

    def panels(key: str) -> int:
        return sum(
            classifier.frames or classifier.training.frames
            for classifier in parts[key][0].receiver.classifiers
        )

    known = {
        key: None if kept is None else kept.known(key, part)
        for key, (part, _) in parts.items()
    }
    trained = {key: training for key, training in known.items() if training is not None}
    # The longest training begins first.
    longest = sorted(
        (key for key in parts if key not in trained), key=panels, reverse=True
    )
    for key in trained:
        told(parts[key][0].budget.training_frames)
    calls = {key: workers.submit(train_part, parts[key]) for key in longest}
    for key, call in calls.items():
        trained[key] = call.result()
        told(parts[key][0].budget.training_frames)
        if kept is not None:
            kept.keep(key, parts[key][0], trained[key])
    return [
        {name: Training.joined([trained[key][name] for key in keys]) for name in named}
        for keys, named in zip(keys_of_plans, locators, strict=True)
    ]


def train_alone(
    plans: Sequence[Plan],
    workers: Workers,
    kept: "KeptTrainings | None" = None,
    told: Told = lambda frames: None,
) -> list[Training]:
    """Train every plan with its own locator, as :func:`train_plans`."""
    locators = [plan.receiver.locator for plan in plans]
    trained = train_plans(plans, [[name] for name in locators], workers, kept, told)
    return [by_name[name] for by_name, name in zip(trained, locators, strict=True)]


def train_part(part: tuple[Plan, Sequence[Locator]]) -> dict[Locator, Training]:
    """Train a receiver by itself on one thread with each of some locators: FLDA, or a plan's classifier."""
    plan, locators = part
    with timing.threads(1):
        if not plan.receiver.classifiers:
            return train_each(plan, locators)
        link, finders, trained = (
            Link.of(plan),
            plan.receiver.finders(locators).items(),
            [],
        )
        for number in range(plan.budget.trainings):
            learn = partial(
                train_classifiers, plan, link, training=Training(), number=number
            )
            trained.append({name: learn(finder) for name, finder in finders})
        return several(trained)


def trained_receiver(plan: Plan, training: Training) -> Receiver:
    """Put the receiver together that the plan keeps, ready to decode recordings and to be saved."""
    name = plan.receiver.save
    learned = training.classifiers.get(name)
    classifier = (
        training.flda.select(feature_indices(name)) if learned is None else learned
    )
    # Nobody knows the true corners in a recording: there the paper's locator stands in for them.
    locator = (
        plan.receiver.finders([plan.receiver.locator])[plan.receiver.locator]
        or plan.receiver.location
    )
    return Receiver(name, locator, plan.receiver.reader, classifier)


def calibrated_receiver(plan: Plan, training: Training) -> Receiver:
    """Put the plan's receiver together with what its scores are worth, found on frames of its scenes.

    These frames are neither trained on nor tested.
    """
    link, frames = Link.of(plan), min(CALIBRATION_FRAMES, plan.budget.training_frames)
    model, keys = (
        plan.experiment.training_model(plan.world),
        block_keys(plan.seed, "calibrate", frames),
    )
    receiver = trained_receiver(plan, training).to(link.simulator.device)
    scores, bits, looks = [], [], []
    for observation in link.observe(model, keys, preambles=False, frames=frames):
        found = observation.panels.found
        scores.append(receiver.score(observation.readings)[found].cpu())
        bits.append(observation.bits[found].cpu())
        looks.append(appearance(observation.readings)[found].cpu())
    if len(look := torch.cat(looks)):
        receiver.calibration = Calibration.of(torch.cat(scores), torch.cat(bits))
        receiver.trained_on = ranges_of(look)
    return receiver


def receiver_for(
    plan: Plan,
    model: Path | None,
    plug_ins: Sequence[str] = (),
    *,
    at_truth: bool = False,
) -> Receiver:
    """Load the receiver, or train one on the plan's scenes where no model is given.

    Args:
        plan: the study.
        model: a receiver's file.
        plug_ins: files of code that it may name.
        at_truth: whether it learns at the true corners, which is quick where its locator is slow.

    Raises:
        VoccError: a model that cannot be read or is for another panel.
    """
    if model is None:
        studied = plan.at_true_corners() if at_truth else plan
        untouched = replace(studied.experiment, training={})
        receiver = calibrated_receiver(
            studied, train(replace(studied, experiment=untouched))
        )
        (locator,) = plan.receiver.finders([plan.receiver.locator]).values()
        receiver.locator = receiver.locator if locator is None else locator
        return receiver
    receiver = Receiver.load(model, plug_ins).to(resolve_device(plan.world.device))
    expected, has = plan.receiver.reader.shape, receiver.shape
    if expected != has:
        refusal = f"model {model} reads a panel of {has.rows} x {has.columns} LEDs"
        other = f"panel.rows x panel.columns is {expected.rows} x {expected.columns}"
        raise VoccError(f"{refusal}, and {other}: make them agree")
    return receiver


def settings_used(settings: Settings, receiver: Receiver) -> Settings:
    """Say in the settings which receiver was used, where a model brought it."""
    if settings.model is None:
        return settings
    settings_of_locator: dict[str, Any] = locator_settings(receiver.locator)
    name, locators = locator_words(receiver.locator)
    limits = asdict(settings.receiver.location)
    limits |= {
        key: value
        for key, value in settings_of_locator.get("paper", settings_of_locator).items()
        if key in limits
    }
    named = replace(
        settings.receiver,
        save=receiver.name,
        locator=name,
        location=replace(settings.receiver.location, **limits),
        false_alarms=None if locators else settings_of_locator.get("false_alarms"),
    )
    classifiers = {
        name: classifier
        for name, classifier in settings.classifiers.items()
        if name == receiver.name
    }
    return replace(settings, receiver=named, classifiers=classifiers, locators=locators)


def in_blocks(batches: Iterable[tuple[Tensor, ...]]) -> Iterator[tuple[Tensor, ...]]:
    """Collect batches of frames into blocks, so that sums do not depend on a simulation's batches.

    Args:
        batches: tensors of equal length each.

    Yields:
        The same frames, 64 at a time; what there is of the last block at the end.

    Example:
        >>> [len(block) for block, in in_blocks((torch.zeros(50),) for _ in range(3))]
        [64, 64, 22]
    """
    waiting: list[tuple[Tensor, ...]] = []
    for batch in batches:
        waiting.append(batch)
        while sum(len(parts[0]) for parts in waiting) >= BLOCK_FRAMES:
            joined = [torch.cat(parts) for parts in zip(*waiting, strict=True)]
            waiting = [tuple(part[BLOCK_FRAMES:] for part in joined)]
            yield tuple(part[:BLOCK_FRAMES] for part in joined)
    if any(len(parts[0]) for parts in waiting):
        yield tuple(torch.cat(parts) for parts in zip(*waiting, strict=True))


Read = tuple[reader.Readings, Tensor, Tensor]
"""Readings of some frames, their bits, and whether the panel was found."""


@dataclass
class PanelStream:
    """Training panels as a classifier sees them, simulated anew whenever they are asked for, or kept.

    Args:
        link: simulation and reader.
        locator: what finds the panel, or None for true corners.
        model: the training scenes.
        seed: root seed.
        inputs: what the classifier sees.
        kept: what was read of each block; None to keep nothing.
        point: name that keys the frames.
        frames: panels that it was shown so far.
        seconds: wall time that went into them so far.
    """

    link: Link
    locator: PanelLocator | None
    model: SceneModel
    seed: int
    inputs: Inputs
    kept: dict[int, list[Read]] | None = None
    point: str = "train"
    frames: int = 0
    seconds: float = 0.0

    def __call__(self, first: int, count: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield frames ``first`` to ``first + count`` in blocks; those without a located panel are left out.

        Raises:
            VoccError: ``first`` is no multiple of a block.
        """
        if first % BLOCK_FRAMES:
            raise VoccError(
                f"first is {first}: it must be a multiple of {BLOCK_FRAMES}"
            )
        begun = time.perf_counter()
        for x, bits, found in in_blocks(self._seen(first, count)):
            self.frames += int(found.sum())
            self.seconds += time.perf_counter() - begun
            yield x[found], bits[found]
            begun = time.perf_counter()
        self.seconds += time.perf_counter() - begun

    def _seen(self, first: int, count: int) -> Iterator[tuple[Tensor, ...]]:
        """Yield what the classifier sees, bits, and whether the panel was found, batch by batch."""
        keys = block_keys(self.seed, self.point, first + count, first)
        parts = (
            [self._simulated(keys, count)]
            if self.kept is None
            else map(self._known, keys)
        )
        for readings, bits, found in (read for part in parts for read in part):
            used = min(len(bits), count)
            count -= used
            x = self.inputs.of(readings, readings.cell_px, self.link.reader.shape)
            yield x[:used], bits[:used], found[:used]

    def _known(self, key: BlockKey) -> list[Read]:
        """Give what is read of a block, which is kept."""
        assert self.kept is not None
        if key.block not in self.kept:
            self.kept[key.block] = list(self._simulated([key], BLOCK_FRAMES))
        return self.kept[key.block]

    def _simulated(self, keys: Sequence[BlockKey], frames: int) -> Iterator[Read]:
        """Yield what is read of the first frames of some blocks."""
        views = self.link.observe_each(
            {"": self.locator}, self.model, keys, preambles=False, frames=frames
        )
        for observation in (view[""] for view in views):
            # Without the frames themselves, which would fill the memory where panels are kept.
            yield observation.readings, observation.bits, observation.panels.found


def train_classifiers(
    plan: Plan,
    link: Link,
    locator: PanelLocator | None,
    training: Training,
    number: int,
    keep: bool = False,
) -> Training:
    """Train a plan's classifiers one after the other.

    Training frames have the same names as those of FLDA; test frames never do.

    Args:
        plan: the study.
        link: simulation and reader.
        locator: what finds the panel, or None for the simulator's true corners.
        training: what is trained already.
        number: of the training, from 0 on; each has frames and first weights of its own.
        keep: whether to keep simulated frames in memory for the next classifier.

    Returns:
        The training with the classifiers too, and what each took.

    Raises:
        VoccError: a classifier that cannot be built or trained, by its name.
    """
    panels: dict[SceneModel, dict[int, list[Read]]] = {}
    classifiers, makings, scenes = {}, {}, plan.experiment.training_model(plan.world)
    for classifier in plan.receiver.classifiers:
        model = narrowed(
            scenes, classifier.scene, f"classifiers.{classifier.name}.scene"
        )
        shared = panels.setdefault(model, {}) if keep else None
        stream = PanelStream(
            link,
            locator,
            model,
            plan.seed,
            classifier.inputs,
            shared,
            training_point(number),
        )
        recipe = replace(classifier.training, seed=classifier.training.seed + number)
        guarded, begun = (
            plugged.classifier_of(classifier.build, classifier.inputs, recipe),
            time.perf_counter(),
        )
        with plugged.seeded(recipe.seed):
            guarded.fit_stream(stream, classifier.frames or plan.budget.training_frames)
        # An interrupted training that went on has a price too.
        seconds = (
            time.perf_counter()
            - begun
            + float(getattr(guarded.classifier, "earlier_s", 0.0))
        )
        counted = getattr(guarded.classifier, "parameters_count", None)
        try:
            size = len(pickle.dumps(guarded))
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            rule = "it must be possible to pickle it, for other processes"
            raise VoccError(
                f"classifier {classifier.name}: {rule} ({reason})"
            ) from error
        classifiers[classifier.name] = guarded
        parameters = None if counted is None else int(counted)
        makings[classifier.name] = Making(
            seconds, stream.seconds, stream.frames, parameters, size
        )
    return replace(training, classifiers=classifiers, made=makings)
