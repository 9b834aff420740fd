"""From the settings to a study's plan, and from a classifier's settings to the classifier."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from importlib.util import find_spec
from typing import Any

import torch

from vocc_torch.distributions import SCENE_FIELDS, parsed_scene
from vocc_torch.errors import VoccError, demand_word, section
from vocc_torch.hardware import LedPanel, PanelShape
from vocc_torch.measure.config import (
    ClassifierSettings,
    PanelSettings,
    ReceiverParts,
    Settings,
    WorldSettings,
    effect_settings,
)
from vocc_torch.measure.plan import ClassifierPlan, Plan, ReceiverPlan, World
from vocc_torch.measure.schema import typed
from vocc_torch.plugins import TARGET, PlugIn, is_target
from vocc_torch.receiver.classifiers import Inputs
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.receiver.deciders import FLDA_FEATURES, RECEIVER_NAMES
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.simulation.scene import SceneModel
from vocc_torch.types import resolve_device

PRECISIONS = {"float32": torch.float32, "float64": torch.float64}

RESERVED = (*RECEIVER_NAMES, "flda", "_summary")
"""Names that no classifier may have: those of receivers, and of the board that compares them."""


def build_world(settings: WorldSettings) -> World:
    """Build scene, camera and panel, and check every value.

    Args:
        settings: the resolved configuration.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    if settings.precision not in PRECISIONS:
        raise VoccError.of(
            "precision",
            repr(settings.precision),
            f"{' or '.join(PRECISIONS)}: half precision changes pixels and bits",
        )
    resolve_device(settings.device)
    scene = settings.scene
    with section("scene.camera", before="camera"):
        changes = {
            name: value
            for name, value in vars(scene.camera).items()
            if value is not None
        }
        camera = replace(settings.camera, **changes)
    return World(
        camera=camera,
        panel=build_panel(settings.panel),
        scene=SceneModel(
            **parsed_scene({name: getattr(scene, name) for name in SCENE_FIELDS})
        ),
        effects=effect_settings(scene.effects),
        framing=settings.framing,  # type: ignore[arg-type]  # checked by name in Simulator
        device=settings.device,
        dtype=PRECISIONS[settings.precision],
    )


def build_panel(settings: PanelSettings) -> LedPanel:
    """Build the panel.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    # The section has rows and columns beside what LedPanel has.
    panel: Any = asdict(settings)
    return LedPanel(shape=PanelShape(panel.pop("rows"), panel.pop("columns")), **panel)


def build_plan(settings: Settings) -> Plan:
    """Build the plan that a configuration describes, checking every value on the way.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    world, budget = build_world(settings), settings.budget
    if budget.sampling and settings.task != "test":
        raise VoccError.of(
            "budget.sampling",
            budget.sampling,
            f"null for task={settings.task}: only task=test uses it",
        )
    receivers = receiver_plan(
        settings, world.panel, settings.task in ("train", "decode", "receive")
    )
    draws = (settings.seed, settings.batch_frames)
    return Plan(world, receivers, settings.experiment, budget, *draws)


def receiver_plan(
    settings: ReceiverParts, panel: LedPanel, single: bool = False
) -> ReceiverPlan:
    """Build the plan of the receivers, with every part that plugs in.

    Args:
        settings: the resolved configuration.
        panel: the LED panel, of which the reader needs the shape and the diameter of the LEDs.
        single: whether the task uses one receiver only, the one that it saves.

    Raises:
        VoccError: a value outside its range, or an unknown name, by its key.
    """
    receiver = settings.receiver
    locators = named_parts("locators", settings.locators)
    features = named_parts("features", settings.features)
    locator = part_name("receiver.locator", receiver.locator, locators)
    chosen = [
        part_name("receiver.features", name, features) for name in receiver.features
    ]
    kernel = receiver.gradient
    if receiver.cells not in ("resampled", "pixels"):
        raise VoccError.of(
            "receiver.cells", repr(receiver.cells), "resampled or pixels"
        )
    built = Reader(
        panel.shape,
        receiver.samples_per_led,
        kernel,  # type: ignore[arg-type]  # checked there
        tuple(features.values()),
        panel.led_diameter_m / panel.pitch_m if receiver.cells == "pixels" else None,
    )
    if not {*chosen} <= {*built.names} or len({*chosen}) < len(chosen) or not chosen:
        raise VoccError.of(
            "receiver.features",
            chosen,
            f"of {', '.join(built.names)}, or FILE.py:NAME, each once",
        )
    plugged_in = [
        classifier_plan(name, classifier, chosen)
        for name, classifier in settings.classifiers.items()
    ]
    if (*chosen,) != FEATURE_NAMES:
        flda = PlugIn(
            "receiver.features",
            "flda",
            "vocc_torch.receiver.classifiers.FldaClassifier",
        )
        plugged_in.append(ClassifierPlan("flda", flda, Inputs((*chosen,))))
    save = receiver.save
    if save is None and len(plugged_in) > 1 and single:
        rule = f"one of {', '.join(plan.name for plan in plugged_in)}, the receiver that is kept"
        rule += "; receiver.features made flda" * (plugged_in[-1].name == "flda")
        raise VoccError.of("receiver.save", "null", rule)
    if save is None:
        save = plugged_in[0].name if len(plugged_in) == 1 else "flda_3"
    savable = *FLDA_FEATURES, *(plan.name for plan in plugged_in)
    demand_word("receiver.save", save, savable)
    rates = (
        {} if receiver.false_alarms is None else {"false_alarms": receiver.false_alarms}
    )
    return ReceiverPlan(
        names=(*receiver.names, *(plan.name for plan in plugged_in)),
        classifiers=tuple(plugged_in),
        locator=locator,
        location=PaperLocator(**asdict(receiver.location)),
        reader=built,
        save=save,
        locators=locators,
        preambles=receiver.preambles,
        **rates,
    )


def named_parts(section: str, parts: Mapping[str, Any]) -> dict[str, PlugIn]:
    """Give the parts of a section by their names."""
    return {
        name: PlugIn.of(f"{section}.{name}", part, name) for name, part in parts.items()
    }


def part_name(key: str, text: str, parts: dict[str, PlugIn]) -> str:
    """Give the name of a part; one that is given as FILE.py:NAME joins the others.

    Raises:
        VoccError: no word.
    """
    if not isinstance(text, str):
        raise VoccError.of(key, [text], "a list of words", "has")
    if not is_target(text):
        return text
    part = PlugIn.of(key, text)
    parts[part.name] = part
    return part.name


def classifier_plan(
    name: str, config: ClassifierSettings, features: Sequence[str] = FEATURE_NAMES
) -> ClassifierPlan:
    """Build the plan of a classifier that plugs in, checking its settings.

    Args:
        name: name of the classifier in the results, a word.
        config: settings of the classifier.
        features: its inputs if the settings name none.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    key = f"classifiers.{name}"
    if not name.isidentifier() or name in RESERVED:
        raise VoccError(
            f"{key}: a classifier's name must be a word, and none of {', '.join(RESERVED)}"
        )
    with section(key):
        with section("training"):
            recipe = typed(TrainingRecipe, config.training)
        arguments = dict(config.build)
        if config.file is not None:
            arguments[TARGET] = f"{config.file}:{arguments.get(TARGET)}"
        build = PlugIn.of(f"{key}.build", arguments, name)
        refuse_unused_recipe(config, build)
        return ClassifierPlan(
            name=name,
            build=build,
            inputs=Inputs.parse(config.inputs, features),
            training=recipe,
            frames=config.frames,
            scene=parsed_scene(config.scene),
        )


def refuse_unused_recipe(config: ClassifierSettings, build: PlugIn) -> None:
    """Refuse a number of frames for a torch module, which has its recipe, and a recipe for anything else.

    Raises:
        VoccError: either of them, or a class that cannot be found.
    """
    recipe = {word: value for word, value in config.training.items() if word != "seed"}
    if config.frames is None and not recipe:
        return
    kind = build.found()
    kind = kind if isinstance(kind, type) else type(build.build(kind, build.arguments))
    if not issubclass(kind, torch.nn.Module):
        for word, value in recipe.items():
            raise VoccError.of(
                f"training.{word}", value, "left out: a recipe is for torch modules"
            )
    elif config.frames is not None:
        raise VoccError.of(
            "frames", config.frames, "null: a torch module trains on training.frames"
        )


def without_absent(
    receiver: ReceiverPlan,
) -> tuple[ReceiverPlan, dict[str, str]]:
    """Leave out the classifiers of scikit-learn where that is not installed, and say why.

    Args:
        receiver: the receivers.

    Returns:
        The receivers that can be built, and the reason for each other one by its name.
    """
    why = "scikit-learn is not installed; pip install scikit-learn adds it"
    absent = {
        classifier.name: why
        for classifier in receiver.classifiers
        if any(target.startswith("sklearn.") for target in classifier.build.targets)
        and find_spec("sklearn") is None
    }
    present = replace(
        receiver,
        names=tuple(name for name in receiver.names if name not in absent),
        classifiers=tuple(
            one for one in receiver.classifiers if one.name not in absent
        ),
        save="flda_3" if receiver.save in absent else receiver.save,
    )
    return present, absent
