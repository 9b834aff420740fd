"""Every key of every task: a command line that sets it is refused by its name, or something comes of it."""

import inspect
from contextlib import suppress
from dataclasses import is_dataclass, replace
from importlib import import_module
from pathlib import Path

import pytest
import yaml
from composing import built, composed

from vocc_torch.app.config import AppConfig
from vocc_torch.app.resolve import (
    demand_used,
    key_of,
    refuse_without_effect,
    said,
)
from vocc_torch.app.tasks import TASKS
from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.record_task import with_panel_of
from vocc_torch.extras.messages.signalling import MessagePlan, Signalling
from vocc_torch.extras.messages.transmit_task import plan_of
from vocc_torch.hardware import PanelShape
from vocc_torch.measure.build import build_panel, build_plan, receiver_plan
from vocc_torch.measure.config import ClassifierSettings, Experiment
from vocc_torch.measure.plan import identity
from vocc_torch.measure.schema import keys_of
from vocc_torch.studies import run as study_run
from vocc_torch.studies.compare import Severity, report
from vocc_torch.studies.decode import decoder
from vocc_torch.studies.decode.run import receiver_of
from vocc_torch.studies.export.run import identity_of

ROOT = Path(__file__).parents[2]
LMMSE = ClassifierSettings(
    {"_target_": "vocc_torch.receiver.classifiers.LmmseEqualizer"}
)
PART = {"_target_": "vocc_torch.receiver.locators.paper.PaperLocator"}
FAR = Experiment("far", "distance_m", (60.0, 70.0))
DIM = Experiment("dim", "ambient_lx", (1000.0, 2000.0))
GRID = Experiment(
    "dim", "ambient_lx", (2000.0,), row_axis="led_luminance_cd_m2", rows=(1000.0,)
)
DATA = yaml.safe_load(Path(__file__).with_name("other_values.yaml").read_text())
SECTIONS = DATA["values"]
SECTIONS["figures"]["experiments"] = {"ambient": replace(FAR, name="ambient")}
SECTIONS["comparison"]["experiments"] = {"ambient": DIM, "distance": FAR}
SECTIONS["effects"]["severity"] = {
    "defocus": Severity("defocus.focus_distance_m", [12.0, 8.0])
}
for camera in ("camera", "scene.camera"):
    SECTIONS[camera]["iso_limits"] = tuple(SECTIONS[camera]["iso_limits"])
SECTIONS["messages.record"] = SECTIONS["record"]
SECTIONS["messages.signalling"] = {
    name: value
    for name, value in SECTIONS["transmit"].items()
    if name not in ("repeats", "cell_px")
}
OTHER = {
    f"{place}.{name}".lstrip("."): value
    for place, keys in SECTIONS.items()
    for name, value in keys.items()
}
OTHER |= {"classifiers": {"own": LMMSE}, "locators": {"own": PART}}
OTHER["features"] = {"own": PART}
"""Of every key another value than the default."""


ALSO = {
    "experiment.row_axis": {"experiment": GRID},
    "experiment.rows": {"experiment": GRID},
    "budget.least_ber": {"budget.precision": 0.2},
    "receiver.save": {"receiver.names": ["flda_2", "flda_3"]},
    "plug_ins": {"model": "receiver.pt"},
}
"""What must be said beside a key that makes no sense alone."""

LATER = DATA["later"]
"""Keys that act after a study is built, and the test that sees them act."""

WHO = ("workers", "executor")
"""Who counts, which a study leaves to ``Workers.of``."""

FROM_OTHERS = {"tradeoff": {"receiver.locator": "locators"}}
"""Keys that reach a task's own section as interpolations, which Hydra resolves, and where."""


def refuse(settings, word):
    """Refuse what a command line sets without effect."""
    demand_used(settings.task, key_of(word), said(word))
    refuse_without_effect(settings, [word])


def of(task):
    """A task's settings; of effects, scenes and classifiers some alone, because a study builds each."""
    few = ["figures.readings=[board]"] if task == "figures" else []
    settings = composed(f"task={task}", *few)
    kept = {"defocus", "night", "ambient", "distance", "dimming", "lmmse"}
    several = {
        "effects": ("parts", "severity"),
        "comparison": ("scenes", "experiments"),
        "figures": ("experiments",),
    }
    mappings = [
        getattr(getattr(settings, section), name)
        for section, names in several.items()
        for name in names
    ]
    if task in ("classifiers", "tradeoff"):
        mappings.append(settings.classifiers)
    for mapping in mappings:
        for name in set(mapping) - kept:
            del mapping[name]
    return settings


def changed(settings, key, value):
    """The settings with one key changed."""
    first, _, rest = key.partition(".")
    return replace(
        settings,
        **{first: changed(getattr(settings, first), rest, value) if rest else value},
    )


def learned(plan):
    """What a trained receiver comes from."""
    told = identity(plan, [plan.receiver.locator])
    told["experiment"] = told["experiment"]["training"]
    return told | {
        "save": plan.receiver.save,
        "batches": (plan.world.device, plan.batch_frames),
    }


def counted(plan, locators=()):
    """What the counts of a study come from, and how far they go."""
    locators = locators or (plan.receiver.locator,)
    return (
        learned(plan),
        identity(plan, locators),
        plan.budget,
        plan.experiment.values,
        locators,
    )


def spent(settings):
    """What a task's results come from, as the package itself names it, and the settings of its own."""
    task = settings.task
    if task == "collect":
        return None
    if task == "transmit":
        return plan_of(settings, settings.transmit), settings.transmit
    if task == "train_detector":
        return settings.seed, settings.device, settings.train_detector
    if task == "calibrate":
        panel, camera = build_panel(settings.panel), settings.camera
        plan = receiver_plan(settings, panel)
        limits = plan.locator, plan.location, plan.false_alarms
        return panel, camera, limits, settings.calibrate
    study, plan = built(settings), None
    if task in ("record", "receive"):
        settings = with_panel_of(settings, MessagePlan(PanelShape(), Signalling()))
    plan = build_plan(settings)
    # Which name no receivers; train alone narrows scenes.
    if task in (
        "train",
        "decode",
        "export_receiver",
    ):
        scenes = plan.experiment.training if task == "train" else {}
        one, experiment = (
            replace(plan.receiver, names=("flda_3",)),
            replace(plan.experiment, training=scenes),
        )
        trained = learned(replace(plan, receiver=one, experiment=experiment))
        return trained, settings.export_receiver
    if task in ("record", "receive"):
        one = replace(plan, receiver=replace(plan.receiver, names=("flda_3",)))
        one = replace(one, experiment=replace(plan.experiment, training={}))
        told = (
            learned(one)
            if task == "receive"
            else (learned(one)["world"], learned(one)["batches"])
        )
        return told, plan.seed, settings.record, settings.receive, settings.framing
    if task == "messages":
        told = identity(plan, [plan.receiver.locator])["experiment"]["scene"]
        return (
            learned(replace(plan, receiver=replace(plan.receiver, save="flda_3"))),
            told,
            settings.messages,
        )
    if task == "test":
        grid = plan.experiment.row_axis, plan.experiment.rows
        return grid, [counted(row) for row in plan.rows().values()]
    if task == "export":
        return identity_of(plan, settings.export), plan.world.device, plan.batch_frames
    if task == "figures":
        worlds = [learned(one.plan)["world"] for one in study.readings]
        return (
            study.names,
            [
                counted(one.plan, [plan.receiver.locator for plan in one.trained_on])
                for one in study.studies
            ],
            worlds,
        )
    if task == "effects":
        scene, names = (
            learned(study.plan_of(study.scene, "paper", 1)),
            (study.shown, study.scene_name),
        )
        return (
            scene,
            names,
            study.pairs,
            study.measured,
            study.config,
            study.plan.budget,
        )
    if task == "tradeoff":
        plan = replace(study.plan, receiver=replace(study.plan.receiver, save=None))
        trained = learned(plan)
        return trained, study.config, study.scene_name, study.plan.budget
    if task == "classifiers":
        scenes = {
            name: identity(one, ["truth"]) for name, one in study.scene_plans.items()
        }
        studies = list(map(counted, study.plans.values()))
        return studies, scenes, study.config, study.home
    return None


def test_every_key_is_here():
    keys = {key for key, kind in keys_of(AppConfig).items() if not is_dataclass(kind)}
    assert set(OTHER) | {"task"} == keys
    for key, test in LATER.items():
        path, _, name = test.partition("::")
        assert f"def {name}" in (ROOT / path).read_text(), key


@pytest.mark.parametrize("task", sorted(TASKS))
def test_every_key_is_refused_by_its_name_or_has_an_effect(task):
    base = of(task)
    module, _, run = TASKS[task].run.partition(":")
    place = import_module(f"vocc_torch.{module}")
    of_two = module == "studies.curve"
    source = inspect.getsource(getattr(place, run) if of_two else place)
    if task == "decode":
        source += inspect.getsource(decoder)
    if "receiver_of(settings" in source:
        source += inspect.getsource(receiver_of)
    if "begin(settings" in source:
        source += inspect.getsource(study_run)
    if "compare" in module:
        source += inspect.getsource(report)
    usual, silent, refused = spent(base), [], []
    brought = FROM_OTHERS.get(task, {})
    others = (
        composed(f"task={task}", *(f"{key}={OTHER[key]}" for key in brought))
        if brought
        else None
    )
    for key, value in (
        OTHER
        | (
            {"receiver.locator": "paper"}
            if task in ("decode", "receive", "messages", "calibrate")
            else {}
        )
        | ({"receiver.names": ["flda_3"]} if task == "messages" else {})
    ).items():
        settings, alone, word = base, usual, f"{key}={value}"
        for name, also in ALSO.get(key, {}).items():
            # The task may refuse that, or not have it.
            with suppress(VoccError, TypeError):
                alone, settings = (
                    spent(changed(base, name, also)),
                    changed(base, name, also),
                )
        tests = key.startswith("experiment.") and key != "experiment.training"
        if task == "export" and tests:
            settings = changed(settings, "export.points", "test")
            alone = spent(settings)
        try:
            refuse(settings, word)
            # The study reads it, or its section.
            if key in LATER:
                name = key.rpartition(".")[2]
                uses = f"settings.{name}", f"config.{name}", f"{name}_of(settings"
                words = " ".join(source.split()).replace("( ", "(")
                done = any(use in words for use in uses)
                done = done or key in ("name", "scene.name")
                done = done or (
                    key.partition(".")[0] in WHO and "Workers.of(settings)" in source
                )
            elif key in brought:
                own = [getattr(one.tradeoff, brought[key]) for one in (base, others)]
                done = own[0][0] != own[1][0] and own[1][0] == value
            else:
                done = spent(changed(settings, key, value)) != alone
        except VoccError as error:
            done = key in str(error)
            refused.append(key)
        silent += [] if done else [key]
    assert not silent, silent
    assert len(refused) >= 20 - 14 * (task == "test")


def test_with_a_model_what_it_was_made_with_is_refused():
    base, used = (
        replace(of("decode"), model="r.pt"),
        {"name", "device", "input", "model", "plug_ins"},
    )
    # Of which the model has one, and another may be given.
    used.add("receiver.false_alarms")
    for key, value in OTHER.items():
        if (
            key in used
            or key.startswith("decode.")
            or key in ("panel.rows", "panel.columns")
        ):
            refuse(base, f"{key}={value}")
        else:
            with pytest.raises(
                VoccError, match=f"^{key} is .*(the model brings|does not use)"
            ):
                refuse(base, f"{key}={value}")
    with pytest.raises(
        VoccError, match=r"^receiver.false_alarms is 0.1: the model brings"
    ):
        refuse(replace(of("receive"), model="r.pt"), "receiver.false_alarms=0.1")
