"""Every key of every task: a command line that sets it is refused by its name, or something comes of it."""

import inspect
from contextlib import suppress
from dataclasses import is_dataclass, replace
from importlib import import_module
from pathlib import Path

import pytest
from composing import NOWHERE, built, composed

from vocc_torch.app.config import AppConfig
from vocc_torch.app.resolve import key_of, refuse_without_effect, said
from vocc_torch.app.tasks import TASKS, demand_used
from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.record_task import with_panel_of
from vocc_torch.extras.messages.signalling import MessagePlan, Signalling
from vocc_torch.extras.messages.transmit_task import plan_of
from vocc_torch.hardware import Camera, PanelShape
from vocc_torch.measure.build import build_panel, build_plan, receiver_plan
from vocc_torch.measure.config import ClassifierSettings, Experiment
from vocc_torch.measure.plan import identity
from vocc_torch.measure.schema import has_key, keys_of, whole
from vocc_torch.measure.sweep import Study
from vocc_torch.studies.compare import Severity
from vocc_torch.studies.decode import decoder
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
CAMERA = {
    **{
        "focal_length_mm": 18.0,
        "sensor_width_mm": 12.0,
        "width_px": 1280,
        "height_px": 720,
        "f_number": 8.0,
    },
    **{"exposure_time_s": 1e-3, "gamma": 1.8, "iso_limits": (100.0, 64000.0)},
}
SECTIONS = {
    "scene": {
        **{
            "name": "other",
            "ambient_lx": 5000.0,
            "led_luminance_cd_m2": 2500.0,
            "distance_m": 45.0,
        },
        **{
            "background_grey": 90.0,
            "offset_x_m": 0.5,
            "offset_y_m": 0.2,
            "effects": {"saturation": {}, "quantization": {"bits": 7}},
        },
    },
    "scene.camera": CAMERA,
    "camera": {**CAMERA, "calibration_constant": 14.0},
    "panel": {
        **{
            "rows": 6,
            "columns": 4,
            "led_diameter_m": 0.02,
            "led_gap_m": 0.04,
            "led_reflectance": 0.3,
        },
        **{"background_reflectance": 0.2, "board_reflectance": 0.1},
    },
    "receiver": {
        **{
            "names": ["flda_2", "flda_3"],
            "locator": "refined",
            "features": ["agr", "gri"],
        },
        **{
            "samples_per_led": 16,
            "gradient": "central",
            "cells": "pixels",
            "save": "flda_2",
            "false_alarms": 0.01,
        },
    },
    "receiver.location": {
        **{
            "closing_px": 13,
            "min_area_px": 50,
            "min_rectangularity": 0.6,
            "min_compactness": 0.8,
        },
        "quadrilateral": "upright",
    },
    "experiment": {
        **{
            "name": "other",
            "axis": "led_luminance_cd_m2",
            "values": (2000.0,),
            "row_axis": "distance_m",
        },
        **{
            "scene": {"distance_m": 45.0},
            "training": {"distance_m": 45.0},
            "rows": (40.0, 50.0),
        },
    },
    "budget": {
        **{
            "frames": 700,
            "training_frames": 600,
            "target_frame_errors": 50,
            "precision": 0.2,
        },
        **{"least_ber": 0.01, "trainings": 2, "sampling": "a.b"},
    },
    "figures": {
        **{"names": ["fig22"], "readings": ["open"]},
        "experiments": {"ambient": replace(FAR, name="ambient")},
    },
    "effects": {
        **{
            "names": ["defocus"],
            "located_frames": 1,
            "severity_frames": 1,
            "repeats": 1,
        },
        "parts": {"defocus": {"defocus": {"focus_distance_m": 9}}},
        "severity": {"defocus": Severity("defocus.focus_distance_m", [12.0, 8.0])},
    },
    "tradeoff": {
        **{"locators": ["truth"], "batch_sizes": [2], "frames": "crops"},
        **{"repeats": 1, "threads": 2},
    },
    "rivals": {
        **{
            "reference": "flda_2",
            "points": {"ambient": 2000},
            "scenes": {},
        },
        **{
            "scene_frames": 1,
            "scene_training_frames": 2,
            "experiments": {"ambient": DIM, "distance": FAR},
        },
    },
    "decode": {
        "channel": "max",
        "annotate": False,
        "scale": 2,
        "most": 2,
        "follow": "true",
        "turn": 90,
        "mirror": True,
        "show": True,
    },
    "export": {"points": "test", "frames": 64, "shard_frames": 64},
    "export_receiver": {"frames": 64},
    "transmit": {
        **{
            "symbol_rate_hz": 50.0,
            "code": "none",
            "code_rate": 0.5,
            "block_symbols": 64,
            "bands": 2,
        },
        **{"sync_cells": 1, "anchors": False, "interleave": False, "scramble": False},
        **{"repeats": 2, "cell_px": 16},
    },
    "record": {
        **{
            "fps": 150.0,
            "drift": 0.01,
            "start_s": 0.1,
            "readout_s": 0.01,
            "dropped": 0.1,
            "repeated": 0.1,
        },
        **{
            "black": 0.1,
            "burst_frames": 3,
            "speed_m_s": 1.0,
            "margin": 2.0,
            "quality": 20,
        },
    },
    "calibrate": {
        **{"channel": "max", "frames": 8, "bits": "bits.npy", "ambient_lx": 900.0},
        **{"quantum_efficiency": 0.5, "fps": 50.0},
    },
    "train_detector": {
        "rounds": 2,
        "scout_steps": 2,
        "judge_steps": 2,
        "placer_steps": 2,
        "batch": 2,
    },
    "receive": {
        **{
            "plan": "p.yaml",
            "fps": 100.0,
            "locate_every": 1,
            "channel": "max",
            "soft": "hard",
        },
        "follow": "true",
    },
    "messages": {
        **{
            "distance_m": [40.0],
            "ambient_lx": [3.0],
            "ratio": [3.0],
            "at_distance_m": 70.0,
            "at_ratio": 3.0,
        },
        **{
            "codes": ["none"],
            "recordings": 2,
            "blocks": 2,
        },
    },
}
SECTIONS["messages.signalling"] = {
    name: value
    for name, value in SECTIONS["transmit"].items()
    if name not in ("repeats", "cell_px")
}
SECTIONS["messages.record"] = SECTIONS["record"]
OTHER = {
    **{
        f"{place}.{name}": value
        for place, keys in SECTIONS.items()
        for name, value in keys.items()
    },
    **{
        "name": "other",
        "seed": 1,
        "precision": "float64",
        "framing": "full",
        "batch_frames": 32,
    },
    **{
        "classifiers": {"own": LMMSE},
        "locators": {"own": PART},
        "features": {"own": PART},
    },
    **{"device": "cpu", "workers": 3, "tensorboard": False},
    **{"executor.kind": "here", "executor.address": "local"},
    **{"input": "photo.png", "model": "receiver.pt", "plug_ins": ["mine.py"]},
}
"""Of every key another value than the default."""


ALSO = {
    "experiment.row_axis": {"experiment": GRID},
    "experiment.rows": {"experiment": GRID},
    "budget.least_ber": {"budget.precision": 0.2},
    "receiver.save": {"receiver.names": ["flda_2", "flda_3"]},
    "plug_ins": {"model": "receiver.pt"},
}
"""What must be said beside a key that makes no sense alone."""

LATER = {
    "name": "tests/app/test_run_folder.py::test_only_folders_below_runs_are_given",
    "workers": "tests/measure/test_executors.py::test_two_processes_measure_what_one_measures",
    "executor.kind": "tests/measure/test_executors.py::test_unasked_it_begins_here_and_takes_processes",
    "executor.address": "tests/measure/test_executors.py::test_what_cannot_be_elsewhere_is_refused",
    "tensorboard": "tests/app/test_cli.py::test_default_run_writes_everything",
    "input": "tests/app/test_decode_command.py::test_a_folder_with_and_without_panels",
    "model": "tests/app/test_decode_command.py::test_models_that_do_not_fit",
    "plug_ins": "tests/app/test_kept_receivers.py::test_code_from_outside_runs_only_where_it_is_named_and_un",
    "decode.channel": "tests/studies/decode/test_decode.py::test_channels_see_their_colour",
    "decode.turn": "tests/app/test_decode_command.py::test_a_panel_that_hangs_upside_down_is_read_upright",
    "decode.mirror": "tests/app/test_decode_command.py::test_a_panel_that_hangs_upside_down_is_read_upright",
    "decode.show": "tests/studies/decode/test_viewer.py::test_the_viewer_gets_frame_corners_and_bits",
    "decode.annotate": "tests/app/test_decode_command.py::test_a_receiver_is_trained_where_no_model_is_given",
    "decode.follow": "tests/studies/decode/test_decode.py::test_a_panel_is_followed_in_a_video",
    "decode.scale": "tests/app/test_decode_command.py::test_a_folder_with_and_without_panels",
    "decode.most": "tests/receiver/test_several_panels.py::test_two_panels_are_two_rows",
    "scene.name": "tests/studies/collect/test_collect.py::test_keys_of_an_experiment_that_follow",
}
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
    settings = composed(f"task={task}")
    kept = {"defocus", "night", "ambient", "distance", "dimming", "lmmse"}
    several = {
        "effects": ("parts", "severity"),
        "rivals": ("scenes", "experiments"),
        "figures": ("experiments",),
    }
    mappings = [
        getattr(getattr(settings, section), name)
        for section, names in several.items()
        for name in names
        if has_key(type(settings), f"{section}.{name}")
        and hasattr(getattr(settings, section), name)
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


def counted(study):
    """What the counts of a study come from, and how far they go."""
    trained = learned(study.plan)
    return (
        trained,
        study.identity,
        study.plan.budget,
        study.plan.experiment.values,
        study.locators,
    )


def spent(settings):
    """What a task's results come from, as the package itself names it, and the settings of its own."""
    task = settings.task
    if task == "collect":
        return None
    if task == "transmit":
        return plan_of(settings, settings.transmit), settings.transmit
    if task == "train_detector":
        return settings.seed, settings.train_detector
    if task == "calibrate":
        panel, camera = build_panel(settings.panel), whole(Camera, settings.camera)
        plan = receiver_plan(settings, panel)
        limits = plan.locator, plan.location, plan.false_alarms
        return panel, camera, limits, settings.calibrate
    study, plan = built(settings), None
    if task in ("record", "receive"):
        settings = with_panel_of(settings, MessagePlan(PanelShape(), Signalling()))
    plan = build_plan(settings, NOWHERE)
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
        return grid, [
            counted(Study("", row, (row.receiver.locator,)))
            for row in plan.rows().values()
        ]
    if task == "export":
        return identity_of(plan, settings.export), plan.world.device, plan.batch_frames
    if task == "figures":
        worlds = [learned(one.plan)["world"] for one in study.readings]
        return study.names, [counted(one) for one in study.every_study()], worlds
    if task == "effects":
        scene, names = (
            learned(study.plan_of(study.scene, "paper")),
            (study.shown, study.scene_name),
        )
        return (
            scene,
            names,
            study.pairs,
            study.severities,
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
        return [counted(one) for one in study.studies], scenes, study.config, study.home
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
    if "compare" in module:
        source += inspect.getsource(import_module("vocc_torch.studies.compare.run"))
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
                done = any(
                    f"{of}.{key.rpartition('.')[2]}" in source
                    for of in ("settings", "config")
                )
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
