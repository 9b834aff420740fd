"""The tasks: what runs each, and the keys that its configuration has."""

from dataclasses import dataclass, fields
from functools import cache

from vocc_torch.app.config import AppConfig
from vocc_torch.errors import VoccError, demand_word
from vocc_torch.extras.messages.config import MessagesConfig, RecordConfig
from vocc_torch.extras.messages.signalling import Signalling
from vocc_torch.hardware import Camera
from vocc_torch.measure.config import Budget, PanelSettings, ReceiverSettings
from vocc_torch.measure.schema import has_key, part_of


@dataclass(frozen=True)
class Task:
    """What the command line knows of a task.

    Args:
        run: its function, below ``vocc_torch``.
        keys: keys and sections of its configuration, beside ``task`` and ``name``.
        part: the section that is its own, or None.
        brought: keys that a model file sets in their stead.
    """

    run: str
    keys: tuple[str, ...]
    part: str | None = None
    brought: tuple[str, ...] = ()


def without(section: str, schema: type, *names: str) -> tuple[str, ...]:
    """List the keys of a section, some left out.

    Example:
        >>> without("camera", Camera, "gamma")[:2]
        ('camera.focal_length_mm', 'camera.sensor_width_mm')
    """
    others = (item.name for item in fields(schema) if item.name not in names)
    return tuple(f"{section}.{name}" for name in others)


WORLD = ("seed", "device", "precision", "framing", "batch_frames", "scene")
DEVICES = (*WORLD, "camera", "panel")
FILM = (*WORLD, "camera", *without("panel", PanelSettings, "rows", "columns"))
PARTS = ("classifiers", "locators", "features")
TRAINED = (
    *without("receiver", ReceiverSettings, "names"),
    *PARTS,
    "budget.training_frames",
)
EXECUTED = ("workers", "executor")
RECORDED = ("input", "model", "plug_ins")
BROUGHT = (
    *(
        key
        for key in (*FILM, *TRAINED)
        if key not in ("device", "receiver.false_alarms")
    ),
    "receiver.names",
)

TASKS = {
    "train": Task(
        "studies.curve:run_train", (*DEVICES, *TRAINED, "experiment.training")
    ),
    "test": Task(
        "studies.curve:run_test",
        (
            *DEVICES,
            "receiver",
            *PARTS,
            *EXECUTED,
            "tensorboard",
            "budget",
            "experiment",
        ),
    ),
    "decode": Task(
        "studies.decode.run:run_decode",
        (*DEVICES, *TRAINED, *RECORDED),
        "decode",
        BROUGHT,
    ),
    "figures": Task(
        "studies.paper.run:run_figures",
        (
            *WORLD,
            # A reading of the paper sets the others.
            *without("camera", Camera, "focal_length_mm"),
            *without("panel", PanelSettings, "board_reflectance"),
            *without("receiver", ReceiverSettings, "locator", "false_alarms"),
            *(*PARTS, *EXECUTED, "tensorboard", "budget"),
        ),
        "figures",
    ),
    "effects": Task(
        "studies.compare.effects:run_effects_task",
        (
            *DEVICES,
            *without(
                *("receiver", ReceiverSettings),
                *("locator", "false_alarms", "features"),
            ),
            *without("budget", Budget, "trainings"),
            *(*EXECUTED, "tensorboard"),
        ),
        "effects",
    ),
    "tradeoff": Task(
        "studies.compare.tradeoff:run_tradeoff",
        (
            *DEVICES,
            *without("receiver", ReceiverSettings, "save"),
            *(*PARTS, *EXECUTED, "tensorboard", "budget"),
        ),
        "tradeoff",
    ),
    "classifiers": Task(
        "studies.compare.classifiers:run_classifiers",
        (*DEVICES, "receiver", *PARTS, *EXECUTED, "tensorboard", "budget"),
        "rivals",
    ),
    "collect": Task("studies.collect:run_collect", ("input",)),
    "export": Task(
        "studies.export.run:run_export",
        (*DEVICES, *EXECUTED, "experiment"),
        "export",
    ),
    "export_receiver": Task(
        "studies.export_receiver:run_export_receiver",
        (*DEVICES, *TRAINED, "model", "plug_ins"),
        "export_receiver",
        (*TRAINED, *without("panel", PanelSettings, "rows", "columns")),
    ),
    "transmit": Task(
        "extras.messages.transmit_task:run_transmit",
        ("input", "panel.rows", "panel.columns"),
        "transmit",
    ),
    "record": Task(
        "extras.messages.record_task:run_record", (*FILM, "input"), "record"
    ),
    "receive": Task(
        "extras.messages.receive_task:run_receive",
        (*FILM, *TRAINED, *RECORDED),
        "receive",
        (*BROUGHT, "receiver.false_alarms"),
    ),
    "messages": Task(
        "extras.messages.comparison_task:run_messages",
        (
            *DEVICES,
            *without("receiver", ReceiverSettings, "save"),
            *(*PARTS, *EXECUTED, "budget.training_frames"),
            *("experiment.scene", "experiment.training"),
            *without("messages", MessagesConfig, "signalling", "record"),
            *without(
                *("messages.signalling", Signalling),
                *("code", "code_rate", "interleave", "scramble"),
            ),
            *without("messages.record", RecordConfig, "fps", "start_s", "quality"),
        ),
        "messages",
    ),
    "calibrate": Task(
        "extras.calibrate.task:run_calibrate",
        (
            *("input", "panel", *without("camera", Camera, "iso_limits")),
            *("receiver.locator", "receiver.location", "receiver.false_alarms"),
        ),
        "calibrate",
    ),
    "train_detector": Task(
        "studies.train_detector.run:run_train_detector", ("seed",), "train_detector"
    ),
}


@cache
def schema_of(task: str) -> type[AppConfig]:
    """Give the class of a task's configuration, which has the keys that the task uses.

    Raises:
        VoccError: nothing of that name.
    """
    demand_word("task", task, TASKS)
    keys, part = TASKS[task].keys, TASKS[task].part
    if part is not None and not any(key.startswith(f"{part}.") for key in keys):
        keys = (*keys, part)
    schema: type[AppConfig] = part_of(AppConfig, ("task", "name", *keys))
    return schema


def demand_used(task: str, key: str, said: str) -> None:
    """Refuse a key that other tasks have.

    Args:
        task: that runs.
        key: or a section.
        said: the key and its value.

    Raises:
        VoccError: with the tasks that have it.
    """
    if has_key(AppConfig, key) and not has_key(schema_of(task), key):
        users = ", ".join(name for name in TASKS if has_key(schema_of(name), key))
        raise VoccError(f"{said}: task={task} does not use it, only {users}")


def is_brought(task: str, key: str) -> bool:
    """Whether a model file sets a key, or any key of a section."""
    return any(
        f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}.")
        for other in TASKS[task].brought
    )
