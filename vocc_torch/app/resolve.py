"""From what Hydra composed to the settings, checked; and what Hydra refuses, said in one line."""

import errno
import multiprocessing
import re
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import is_dataclass, replace
from functools import reduce
from importlib import resources
from typing import Any, get_args, get_origin

from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from vocc_torch.app.config import (
    NAMES,
    PARTS,
    TASKS,
    AppConfig,
    keys_of,
    passes_over,
    schema,
)
from vocc_torch.errors import VoccError, section, shown, stdout_refusal
from vocc_torch.files import VIDEO_SUFFIXES
from vocc_torch.measure.schema import refuse_shadowed, unknown_key

OF_MODEL = (
    "seed",
    "precision",
    "framing",
    "batch_frames",
    "scene",
    "camera",
    "panel",
    "receiver",
    "budget",
)
"""What a model was made with, as :data:`PARTS`; the panel's rows and columns are given, and must agree."""

AUTO = "auto"
"""As ``model``: the receiver that ships, or one that is trained where a key of its training is set."""

SHIPPED = "street"
"""The receiver of task=decode that ships."""

GROUPS = ("task", "scene", "camera", "panel", "receiver", "experiment", "budget")

COMPARED = ("every", "rivals")
"""Options of the group receiver that name receivers to compare."""

STATING = ("learned",)
"""Locators that state false alarms."""

ONE_LOCATOR = ("train", "test", "decode", "receive", "classifiers")
"""Tasks that find the panel with receiver.locator and no other."""

N_JOBS = "hydra.launcher.n_jobs"
LAUNCHER = (
    f"{N_JOBS} is not a known key of this launcher: it belongs to hydra/launcher=joblib"
)

LOST_WORKER = (
    "a worker process was ended from outside, perhaps for lack of memory: the jobs that had ended keep their "
    "results; run the others with a smaller hydra.launcher.n_jobs or batch_frames"
)


def resolved(config: DictConfig, words: Sequence[str] = ()) -> AppConfig:
    """Turn Hydra's object into the settings, with every interpolation resolved and everything checked.

    Args:
        config: what Hydra composed.
        words: the overrides of the command line, none of which may be without effect.

    Raises:
        VoccError: a value that is missing, does not resolve, is of another type or breaks a rule.
    """
    try:
        plain: Any = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
        # An interpolation can bring what is no section or list.
        for key, kind in keys_of(AppConfig).items():
            value = reduce(lambda held, name: held.get(name), key.split("."), plain)
            if (is_dataclass(kind) or get_origin(kind) is dict) and not isinstance(
                value, dict
            ):
                raise VoccError.of(key, shown(value), "a mapping, as in {key:value}")
            if get_origin(kind) in (list, tuple) and not isinstance(value, list):
                texts = get_args(kind)[0] is str
                rule = (
                    "a list of texts, as in [a,b]"
                    if texts
                    else "a list of numbers, as in [1,2]"
                )
                raise VoccError.of(key, shown(value), rule)
        # What interpolations brought has a type too.
        typed = OmegaConf.merge(schema(), plain)
        parts = [("messages.record", "record", typed.messages.record)]
        parts.append(("messages.signalling", "transmit", typed.messages.signalling))
        for place in ("rivals.experiments", "figures.experiments"):
            named = OmegaConf.select(typed, place).items()
            parts += [(f"{place}.{name}", "experiment", one) for name, one in named]
        for place, own, one in parts:
            with section(place, before=own):
                OmegaConf.to_object(one)
        with section("receiver.location", before="location"):
            settings = OmegaConf.to_object(typed)
    except MissingMandatoryValue as error:
        raise VoccError(f"{error.full_key} is missing: it must have a value") from None
    except (OmegaConfBaseException, RecursionError) as error:
        raise VoccError(one_line(error, words)) from None
    assert isinstance(settings, AppConfig)
    if settings.model == AUTO:
        settings = replace(settings, model=None if trains(words) else SHIPPED)
    refuse_ignored(settings, words)
    return settings


def trains(words: Sequence[str]) -> bool:
    """Whether a command line of task=decode sets what only a receiver that is trained now can have.

    Example:
        >>> trains(["panel.rows=4", "decode.most=2"]), trains(["classifier=mlp"])
        (False, True)
    """
    keys = [word.lstrip("+~").partition("=")[0].rpartition("@")[2] for word in words]
    keys = [
        key
        for key in keys
        if key not in ("panel.rows", "panel.columns", "receiver.false_alarms")
    ]
    return any(key.split(".")[0] in (*OF_MODEL, *PARTS, "classifier") for key in keys)


def refuse_ignored(settings: AppConfig, words: Sequence[str]) -> None:
    """Refuse what a command line asks for and would not get.

    Args:
        settings: the configuration that came of it.
        words: its overrides.

    Raises:
        VoccError: a setting of the camera that the scene makes itself, effects set to none, several options
            of one group, which would be mixed, what the task or its input passes over, what a model brings
            itself, or what the experiment sets in the scene's stead.

    Example:
        >>> from vocc_torch.measure.config import Experiment
        >>> experiment = Experiment("d", "distance_m", (50.0,))
        >>> settings = AppConfig(task="test", name="x", experiment=experiment)
        >>> refuse_ignored(settings, ["scene.effects={}"])
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: scene.effects={} takes none away: write ~scene.effects.NAME for each
    """
    task, experiment = settings.task, settings.experiment
    for word in words:
        key, _, value = word.lstrip("+~").partition("=")
        # Where a group goes: scene@rivals.scenes.night=fog.
        key = key.rpartition("@")[2]
        place = "classifiers" if key == "classifier" else key
        group, _, name = place.partition(".")
        said = f"{key} is {value}" if value else word
        refuse_shadowed(settings.scene, word)
        if key in GROUPS and value.startswith("["):
            raise VoccError(
                f"{key} is {value}: it must be one option, several in a multirun (-m {key}=a,b)"
            )
        if passes_over(task, place) and (key, value) != ("experiment", task):
            users = ", ".join(one for one in TASKS if not passes_over(one, place))
            raise VoccError(f"{said}: task={task} does not use it, only {users}")
        if (
            key == "receiver"
            and value in COMPARED
            and passes_over(task, "receiver.names")
        ):
            rule = f"task={task} keeps one, which receiver.save or classifier names"
            raise VoccError(f"{said}: these are receivers to compare, and {rule}")
        film = str(settings.input).lower().endswith(VIDEO_SUFFIXES) and task == "decode"
        if (
            film
            and key in ("decode.scale", "decode.annotate")
            and value not in ("1", "false")
        ):
            raise VoccError(
                f"{said}: pictures are annotated, and input {settings.input} is a video"
            )
        trains, points = name.startswith("training"), settings.export.points
        chosen = key == "experiment" and experiment.training
        if (
            task == "export"
            and group == "experiment"
            and trains != (points == "train")
            and not chosen
        ):
            raise VoccError(
                f"{said}: export.points={points} does not use it; leave it out"
            )
        if key == "plug_ins" and settings.model in (None, SHIPPED):
            raise VoccError(
                f"{said}: it must be empty without a model, a new one names its parts"
            )
        reads = task in ("decode", "receive")
        own_parts = {
            *(OF_MODEL if reads else ("panel", "receiver", "budget.training_frames")),
            *PARTS,
        }
        other_rate = task == "decode" and key == "receiver.false_alarms"
        if (
            settings.model
            and {group, key} & own_parts
            and name not in ("rows", "columns")
            and not other_rate
        ):
            raise VoccError(
                f"{said}: the model brings its own; leave {key} or model out"
            )
        finder = settings.receiver.locator if task in ONE_LOCATOR else None
        if (
            place == "receiver.false_alarms"
            and not settings.model
            and finder not in (None, *STATING)
        ):
            raise VoccError(
                f"{said}: only learned states them, and receiver.locator is {finder}"
            )
        if (
            place.startswith("receiver.location")
            and finder
            and finder not in NAMES["Locators"].split(", ")
        ):
            raise VoccError(
                f"{said}: only {NAMES['Locators']} use it, and receiver.locator is {finder}"
            )
        own = name in experiment.training
        tested = name in {*experiment.scene, experiment.axis, experiment.row_axis}
        if (
            group == "scene"
            and own
            and (task == "train" or (task == "test" and tested))
        ):
            rule = f"the experiment {experiment.name} sets its own: give experiment.training.{name}"
            raise VoccError(
                f"{said}: {rule}" + f" or experiment.scene.{name}" * (task == "test")
            )


NO_OPTION = re.compile(
    r"null|true|false|[-+]?([.\d_]+(e[-+]?\d+)?|\.?inf|\.?nan)|(int|float|bool)\(.*|[\[{$].*",
    re.I | re.S,
)
"""What the command line's grammar reads as another thing than a name."""

KINDS = {"Integer": "a whole number", "Float": "a number"}
KINDS |= dict.fromkeys(("Boolean", "bool"), "true or false")

SAID = (
    resources.files("vocc_torch.app")
    .joinpath("complaints.txt")
    .read_text(encoding="utf-8")
)
"""What is said instead of what Hydra says."""


def one_line(error: BaseException, arguments: Sequence[str] = ()) -> str:
    r"""Say in one line what Hydra refused.

    Args:
        error: an error of Hydra or OmegaConf; its cause is read too.
        arguments: the command line, which names the key where the error does not.

    Example:
        >>> one_line(ValueError("Could not override 'sede'.\nKey 'sede' is not in struct"))
        'sede is not a known key: did you mean seed?'
    """
    text = "\n".join(str(e) for e in (error, error.__cause__) if e is not None)
    longest = max(arguments, key=len, default="a value").lstrip("+~").partition("=")[0]
    if isinstance(error, RecursionError):
        return f"{longest} has brackets in brackets, too many of them"
    if "integer string conversion" in text:
        return (
            f"{longest} is a number of thousands of digits: it must have at most 4300"
        )
    override = getattr(error, "override", None)
    if override is not None:
        given = " ".join(str(override).split())
        return f"{given} cannot be read: write key=value, a list as [a,b], and quote what is special"
    group = "Config group override must be", "possible interpolation keys"
    if any(words in text for words in group) or isinstance(error, TypeError):
        for key, _, value in (word.lstrip("+").partition("=") for word in arguments):
            if key in ("", *GROUPS) and NO_OPTION.fullmatch(value):
                return f"{key} is {value}: it must be one of the options that vocc-torch --help lists"
    lines = [line for line in SAID.splitlines() if not line.startswith("#")]
    for pattern, words in zip(lines[::2], lines[1::2], strict=True):
        if match := re.search(
            pattern.replace("FULL_KEY", r"full_key: (?P<key>[\w.\[\]]+)"), text
        ):
            found = {"key": "", "kind": "", **match.groupdict(default="")}
            found["kind"] = KINDS.get(found["kind"], found["kind"])
            if "{unknown}" in words:
                found["unknown"] = (
                    LAUNCHER
                    if found["key"] == N_JOBS
                    else unknown_key(found["key"], AppConfig)
                )
            if "{options}" in words:
                listed = re.search(
                    r"Available options in '.*':\s*\n((?:\s+.+\n?)+?)Config search path",
                    text,
                )
                files = resources.files("vocc_torch.conf").joinpath(found["key"])
                there = files.iterdir() if files.is_dir() else ()
                ours = sorted(one.name.removesuffix(".yaml") for one in there)
                found["options"] = (
                    ", ".join(listed[1].split() if listed else ours) or "none"
                )
            return words.strip().format_map(found)
    return " ".join(text.split("Set the environment variable")[0].split())


def refusal(error: Exception, arguments: Sequence[str]) -> str | None:
    """Say what was refused before or between the jobs; None for an error that is not the user's.

    Args:
        error: what ended the application, outside its jobs.
        arguments: the command line.
    """
    if isinstance(error, BrokenProcessPool):
        return LOST_WORKER
    if isinstance(error, multiprocessing.TimeoutError):
        return (
            "hydra.launcher.timeout is shorter than a job: give more seconds, or null"
        )
    if isinstance(error, VoccError):
        return str(error)
    # Hydra trips over a group whose option is a list of numbers, and over a number that no float holds.
    hydras = (
        HydraException
        | OmegaConfBaseException
        | ValueError
        | TypeError
        | OverflowError
        | RecursionError
    )
    if isinstance(error, hydras):
        return one_line(error, arguments)
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        longest = max((word.partition("=")[0] for word in arguments), key=len)
        return f"{shown(longest)} has {len(longest)} letters: it is no known key"
    if isinstance(error, OSError):
        if refused := stdout_refusal(error):
            return refused
        where = f" {error.filename}" if error.filename else ""
        return f"cannot make the run's folder{where} ({error.strerror}): choose another with name="
    return None
