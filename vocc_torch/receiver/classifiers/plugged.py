"""Classifiers from settings, and from the arrays and numbers that a model file keeps of them."""

import inspect
import random
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from vocc_torch.boundary import demand_fields
from vocc_torch.errors import VoccError
from vocc_torch.plugins import PlugIn, one_line
from vocc_torch.receiver.classifiers.estimator_file import TRUSTED, skops_io, unpacked
from vocc_torch.receiver.classifiers.estimators import SklearnClassifier, is_estimator
from vocc_torch.receiver.classifiers.inputs import Inputs, Patch
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.classifiers.training import TorchClassifier, TrainingRecipe

SKOPS = "skops"
"""The name under which an estimator's file, made by skops, stands among the arrays."""

SHIPPED = tuple(
    f"vocc_torch.receiver.classifiers.{kind}"
    for kind in (
        "FldaClassifier",
        "LmmseEqualizer",
        "Mlp",
        "PanelKMeans",
        "PanelOtsu",
        "PatchCnn",
        "TagPlanes",
        "scaled",
    )
)
"""The classifiers that ship: a model file may name them without permission."""

MOST_LETTERS = 1000
"""Most letters of the arguments of a classifier that ships, as text."""

NUMPY = "numpy"
"""The name under which it is said which arrays are NumPy's."""


def classifier_of(
    plug_in: PlugIn, inputs: Inputs, recipe: TrainingRecipe | None = None
) -> Guarded:
    """Build a classifier, untrained.

    A scikit-learn estimator and a torch module are taken for what they are; a module whose class takes
    ``n_inputs`` is told how many numbers it sees of an LED. Anything else must follow the protocol itself.

    Args:
        plug_in: its class and arguments.
        inputs: what it sees of each LED.
        recipe: how a torch module is trained.

    Raises:
        VoccError: a class that does not exist or cannot be built, or that does not follow the protocol.

    Example:
        >>> bayes = PlugIn("classifiers.bayes.build", "bayes", "sklearn.naive_bayes.GaussianNB")
        >>> type(classifier_of(bayes, Inputs()).classifier).__name__
        'SklearnClassifier'
    """
    recipe = recipe or TrainingRecipe()
    kind, arguments = plug_in.found(), dict(plug_in.arguments)
    of_torch = isinstance(kind, type) and issubclass(kind, nn.Module)
    if of_torch and "n_inputs" in inspect.signature(kind).parameters:
        arguments.setdefault("n_inputs", inputs.size)
    # A module draws its first weights when it is made.
    with seeded(recipe.seed):
        built = plug_in.build(kind, arguments)
    if isinstance(built, nn.Module):
        built = TorchClassifier(built, recipe)
    elif is_estimator(built):
        try:
            built = SklearnClassifier(built)
        except VoccError as error:
            raise VoccError(f"classifiers.{plug_in.name}: {error}") from error
    return Guarded(plug_in.name, built, inputs, plug_in)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Seed the generators of Python, NumPy and torch, and restore their states at the end.

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
    numpy_state, state = np.random.get_state(), random.getstate()  # noqa: NPY002
    try:
        with torch.random.fork_rng():
            random.seed(seed)
            np.random.seed(seed % 2**32)  # noqa: NPY002
            torch.manual_seed(seed)
            yield
    finally:
        np.random.set_state(numpy_state)  # noqa: NPY002
        random.setstate(state)


def state_of(guarded: Guarded) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Take what a trained classifier has learned.

    One with ``state_dict`` and ``load_state_dict`` says it itself, an estimator is packed by skops, and of
    any other the attributes are kept.

    Returns:
        Numbers and texts by name, and tensors by name.

    Raises:
        VoccError: an attribute that is no number, text, tensor or array, or skops is not installed.

    Example:
        >>> from vocc_torch.receiver.classifiers.rules import TagPlanes
        >>> state_of(Guarded("planes", TagPlanes(), Inputs()))
        ({'sharpening': 0.25, 'rounds': 2}, {})
    """
    classifier: Any = guarded.classifier
    if isinstance(classifier, SklearnClassifier):
        io, release = skops_io(guarded.name)
        packed = bytearray(io.dumps(classifier.estimator))
        return {"release": release}, {
            SKOPS: torch.frombuffer(packed, dtype=torch.uint8)
        }
    if callable(getattr(classifier, "state_dict", None)):
        return {}, dict(classifier.state_dict())
    values: dict[str, Any] = {}
    arrays: dict[str, Tensor] = {}
    for name, value in vars(classifier).items():
        if isinstance(value, Tensor | np.ndarray):
            arrays[name] = torch.as_tensor(value)
            if isinstance(value, np.ndarray):
                values.setdefault(NUMPY, []).append(name)
        elif isinstance(value, bool | int | float | str | None):
            values[name] = value
        else:
            rule = "a number, text, tensor or array, or give it state_dict and load_state_dict"
            raise VoccError.of(
                f"classifier {guarded.name}: its {name}",
                f"a {type(value).__name__}",
                rule,
            )
    return values, arrays


def model_of(guarded: Guarded) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Take what a model file keeps of a classifier: settings and arrays; :func:`loaded` reads them back.

    Raises:
        VoccError: it was not built from settings, or as :func:`state_of`.
    """
    if guarded.plug_in is None:
        raise VoccError(
            f"classifier {guarded.name} was not built from settings: it cannot be saved"
        )
    values, arrays = state_of(guarded)
    inputs = asdict(guarded.inputs)
    return {**guarded.plug_in.settings, "inputs": inputs, "values": values}, arrays


def restored(
    plug_in: PlugIn,
    inputs: Inputs,
    values: Mapping[str, Any],
    arrays: Mapping[str, Tensor],
) -> Guarded:
    """Build a classifier that knows what :func:`state_of` took.

    Args:
        plug_in: its class, whose code is run; of an estimator only if it comes from a file.
        inputs: what it sees of each LED.
        values: numbers and texts.
        arrays: tensors.

    Raises:
        VoccError: what does not fit its class, or an estimator with parts that skops does not trust, or of
            another release of scikit-learn.
    """
    try:
        if SKOPS in arrays:
            io, release = skops_io(plug_in.name)
            if values["release"] != release:
                raise VoccError(
                    f"scikit-learn was {values['release']} and is {release}: train it again"
                )
            # Of the classes that skops does not know, those of the file that the user named.
            modules: tuple[str, ...] = ()
            if plug_in.file is not None:
                plug_in.file.module()
                modules = (f"{plug_in.file.module_name}.",)
            estimator = unpacked(
                arrays[SKOPS].numpy().tobytes(),
                io,
                lambda name: name in TRUSTED or name.startswith(modules),
            )
            learned = SklearnClassifier(estimator)
            return Guarded(plug_in.name, learned, inputs, plug_in)
        if plug_in.target in SHIPPED:
            demand_size(plug_in, inputs, arrays)
        guarded = classifier_of(plug_in, inputs)
        classifier: Any = guarded.classifier
        if callable(getattr(classifier, "load_state_dict", None)):
            classifier.load_state_dict(dict(arrays))
            return guarded
        if plug_in.target in SHIPPED:
            demand_learned(vars(classifier), values, arrays)
        learns = {**values, **arrays}
        learns |= {name: arrays[name].numpy() for name in learns.pop(NUMPY, [])}
        for name, value in learns.items():
            if name.startswith("__") or callable(getattr(classifier, name, None)):
                raise VoccError(f"{name} is no attribute that it learns")
            setattr(classifier, name, value)
        return guarded
    except Exception as error:
        reason = str(error) if isinstance(error, VoccError) else one_line(error)
        raise VoccError(
            f"classifier {plug_in.name} cannot take up what it learned ({reason})"
        ) from error


def demand_size(plug_in: PlugIn, inputs: Inputs, arrays: Mapping[str, Tensor]) -> None:
    """Refuse a network of other sizes than its arrays, before it takes memory.

    Raises:
        VoccError: arguments that make other arrays.
    """
    if sum(map(len, map(str, plug_in.arguments.values()))) > MOST_LETTERS:
        raise VoccError("its arguments are too long")
    with torch.device("meta"):
        sketch: Any = classifier_of(plug_in, inputs).classifier
    if isinstance(sketch, TorchClassifier):
        for name, value in sketch.module.state_dict(prefix="module.").items():
            if name not in arrays or arrays[name].shape != value.shape:
                raise VoccError(f"its arguments do not fit {name}")


def demand_learned(
    begun: Mapping[str, object],
    values: Mapping[str, Any],
    arrays: Mapping[str, Tensor],
) -> None:
    """Refuse attributes that a classifier that ships does not learn: its arguments say the others.

    Args:
        begun: attributes before it learns; what it learns is None.
        values: numbers and texts of a file.
        arrays: tensors of a file.

    Raises:
        VoccError: there is one.
    """
    strays = [
        name
        for name, value in values.items()
        if name not in begun or begun[name] != value
    ]
    strays += [name for name in arrays if begun.get(name, name) is not None]
    if strays:
        raise VoccError(f"{strays[0]} is no attribute that it learns")


def loaded(
    settings: Mapping[str, Any],
    arrays: Mapping[str, Tensor],
    plug_ins: Sequence[str],
) -> Guarded:
    """Build a classifier from what :func:`model_of` gave; one whose code was not named is refused.

    Of an estimator of scikit-learn nothing is built: skops reads it, and trusts what it knows.

    Args:
        settings: as :attr:`PlugIn.settings` has them, its inputs, and numbers and texts that it learned.
        arrays: that it learned.
        plug_ins: Python files and packages that the user names.

    Raises:
        VoccError: as :meth:`PlugIn.admitted` and :func:`restored`.
    """
    features, patch = (settings["inputs"][key] for key in ("features", "patch"))
    patch = None if patch is None else Patch(**patch)
    if patch is not None:
        demand_fields("inputs.patch", patch)
    inputs, described = Inputs(tuple(features), patch), settings
    if SKOPS in arrays:
        described, plug_ins = {**settings, "arguments": {}}, (*plug_ins, "sklearn")
    key = f"classifiers.{settings['name']}"
    plug_in = PlugIn.admitted(key, described, plug_ins, SHIPPED)
    return restored(plug_in, inputs, settings["values"], arrays)
