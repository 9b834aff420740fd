"""From the words of the command line to a task's settings, checked; and refusals in one line."""

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import Any, cast

from hydra.core.override_parser.types import Override
from hydra.errors import HydraException, MissingConfigException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from vocc_torch.app.config import AppConfig, described, used
from vocc_torch.app.tasks import TASKS, covers, task_named
from vocc_torch.errors import VoccError, section, stdout_refusal
from vocc_torch.measure.schema import (
    RENAMED,
    demand_shape,
    has_key,
    keys_of,
    merge,
    options_of,
    parsed,
    refusal,
    refusals,
    refuse_shadowed,
    unknown_key,
)

AUTO = "auto"
"""As ``model``: the receiver that ships, or one that is trained where a key of its training is set."""

SHIPPED = "street"
"""The receiver of task=decode that ships."""


def task_plain(root: DictConfig) -> dict[str, Any]:
    """Give what Hydra composed as plain values, with every key that the task has."""
    plain: Any = OmegaConf.to_container(root)
    plain.pop("hydra", None)
    task = task_named(str(plain["task"]))
    merged: Any = OmegaConf.to_container(merge(AppConfig, used(plain, task)))
    return used(merged, task)


OmegaConf.register_new_resolver(
    "described", lambda _root_: described(task_plain(_root_)), replace=True
)

ONE_LOCATOR = ("train", "test", "decode", "receive", "classifiers")
"""Tasks that find the panel with receiver.locator and no other."""

HYDRA_ERRORS = (
    HydraException,
    OmegaConfBaseException,
    ValueError,
    TypeError,
    OverflowError,
    RecursionError,
)
"""What Hydra raises, also at a list of numbers for a group's option and at a number that no float holds."""

LOST_WORKER = (
    "a worker process was ended from outside, perhaps for lack of memory: the jobs that had ended keep their "
    "results; run the others with a smaller hydra.launcher.n_jobs or batch_frames"
)


def hydra_words(words: Sequence[str], sweeps: bool = False) -> list[str]:
    """Give the words as Hydra takes them, which then leaves the check of the keys to the schema.

    Args:
        words: of the command line.
        sweeps: whether commas separate values.

    Raises:
        VoccError: a word that cannot be read, several values, or a group with another thing than a name.

    Example:
        >>> hydra_words(["seed=1", "scene=night", "~scene.effects.blooming"])
        ['++seed=1', 'scene=night', '~scene.effects.blooming']
    """
    taken = []
    for word, override in zip(words, parsed(words), strict=True):
        key = str(override.key_or_group)
        place = override.package or key
        if place.partition(".")[0] in RENAMED:
            raise VoccError(unknown_key(place, keys_of(AppConfig)))
        if override.is_sweep_override() and not sweeps:
            rule = "one value; -m runs several, and a list is written [a,b]"
            raise VoccError.of(key, word.partition("=")[2], rule)
        is_group = bool(options_of(key))
        chooses = is_group or "/" in key or override.package is not None
        own = chooses or key.startswith("hydra.") or override.is_delete()
        if is_group and not override.is_delete():
            demand_option(override)
        else:
            demand_shape(override, keys_of(AppConfig))
        taken.append(word if own else f"++{word.lstrip('+')}")
    return taken


def demand_option(override: Override) -> None:
    """Refuse another thing than a name for the option of a group.

    Raises:
        VoccError: with the group.
    """
    group = str(override.key_or_group)
    if override.is_sweep_override():
        return
    value: Any = override.value()
    several = isinstance(value, list) and group == "classifier"
    names = value if several else [value]
    if not all(isinstance(name, str) and "$" not in name for name in names):
        rule = "one of the options that vocc-torch --help lists"
        raise VoccError.of(group, override.get_value_element_as_str(), rule)


def resolved(config: DictConfig, words: Sequence[str] = ()) -> AppConfig:
    """Turn what Hydra composed into the task's settings, every value checked.

    Args:
        config: what Hydra composed.
        words: the overrides of the command line, none of which may be without effect.

    Raises:
        VoccError: a value that is missing, does not resolve, is of another type or breaks a rule, a key that
            the task does not have, or a word without effect.
    """
    try:
        plain: Any = OmegaConf.to_container(config, resolve=True)
    except (OmegaConfBaseException, RecursionError) as error:
        raise VoccError(complaint(error)) from None
    task = task_named(name := str(plain.get("task")))
    for word in words:
        if word != f"experiment={name}":
            demand_used(name, key_of(word), said(word))
    if plain.get("model") == AUTO:
        trains = any(covers(task.brought, key_of(word)) for word in words)
        plain["model"] = None if trains else SHIPPED
    kinds = keys_of(AppConfig)
    with refusals({key: kinds[key] for key in kinds if covers(task.keys, key)}):
        merged = merge(AppConfig, used(plain, task))
        for key in OmegaConf.missing_keys(merged) & kinds.keys():
            if not covers(task.keys, key):
                empty = None if kinds[key] is Any else kinds[key]()
                OmegaConf.update(merged, key, empty)
        settings: Any = None
        for place, usual, node in sections(merged):
            with section(place, before=usual):
                settings = OmegaConf.to_object(node)
    refuse_without_effect(settings, words)
    return cast(AppConfig, settings)


def demand_used(task: str, key: str, said: str) -> None:
    """Refuse a key that only other tasks use, and an unknown key of a known section.

    Args:
        task: name of the task that runs.
        key: a key or a section.
        said: the key and its value.

    Raises:
        VoccError: with the tasks that use the key.
    """
    keys, is_known = keys_of(AppConfig), has_key(AppConfig, key)
    if not is_known and key.partition(".")[0] in keys:
        raise VoccError(unknown_key(key, keys))
    users = [name for name in TASKS if covers(TASKS[name].keys, key)]
    if is_known and task not in users:
        raise VoccError(f"{said}: task={task} does not use it, only {', '.join(users)}")


def sections(merged: DictConfig) -> Iterator[tuple[str, str, DictConfig]]:
    """List what a configuration consists of, the whole at last, with a key whose class names another one.

    Yields:
        The key, the key that the class names in refusals, and the values.
    """
    yield "messages.record", "record", merged.messages.record
    yield "messages.signalling", "transmit", merged.messages.signalling
    for part in ("comparison", "figures"):
        for name, node in merged[part].experiments.items():
            yield f"{part}.experiments.{name}", "experiment", node
    yield "receiver.location", "location", merged


def key_of(word: str) -> str:
    """Give the key or section that an override sets.

    Example:
        >>> key_of("~seed"), key_of("classifier=[mlp]"), key_of("scene@comparison.scenes.x=fog")
        ('seed', 'classifiers', 'comparison.scenes.x')
    """
    key = word.lstrip("+~").partition("=")[0].rpartition("@")[2]
    return "classifiers" if key == "classifier" else key


def said(word: str) -> str:
    """Say an override, for a refusal."""
    key, _, value = word.lstrip("+~").partition("=")
    return f"{key.rpartition('@')[2]} is {value}" if value else word


def refuse_without_effect(settings: AppConfig, words: Sequence[str]) -> None:
    """Refuse overrides of the command line that would have no effect.

    Args:
        settings: the configuration with the overrides.
        words: the overrides.

    Raises:
        VoccError: a key that the model, the scene or the experiment sets, or one of another locator.

    Example:
        >>> from vocc_torch.measure.config import Experiment
        >>> experiment = Experiment("d", "distance_m", (50.0,))
        >>> settings = AppConfig(task="test", name="x", experiment=experiment)
        >>> refuse_without_effect(settings, ["scene.effects={}"])
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: scene.effects={} takes none away: write ~scene.effects.NAME for each
    """
    for word in words:
        refuse_shadowed(settings.scene, word)
        if reason := without_effect(settings, key_of(word)):
            raise VoccError(f"{said(word)}: {reason}")


def without_effect(settings: AppConfig, key: str) -> str:
    """Say why a key has no effect beside the model, the locator or the experiment; empty if it has one."""
    task, model, experiment = settings.task, settings.model, settings.experiment
    section, _, name = key.partition(".")
    if model and covers(TASKS[task].brought, key):
        group = "classifier" if key == "classifiers" else key
        return f"the model brings its own; leave {group} or model out"
    if key == "plug_ins" and model in (None, SHIPPED):
        return "it must be empty without a model, a new one names its parts"
    if key == "receiver.false_alarms" and not model and task in ONE_LOCATOR:
        # A model finds panels with its own locator.
        locator = settings.receiver.locator
        rule = f"only detector states them, and receiver.locator is {locator}"
        return rule * (locator != "detector")
    if section == "scene" and name in experiment.training:
        training = f"the experiment {experiment.name} sets its own: give experiment.training.{name}"
        if task == "train":
            return training
        tested = {*experiment.scene, experiment.axis, experiment.row_axis}
        if task == "test" and name in tested:
            return f"{training} or experiment.scene.{name}"
    return ""


def complaint(error: BaseException) -> str:
    r"""Say in one line what Hydra or OmegaConf refused.

    Example:
        >>> complaint(ValueError("two\nlines"))
        'two lines'
    """
    chain: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and cause not in chain:
        # The package's own refusal says most, whatever Hydra wraps it in.
        if isinstance(cause, VoccError):
            return str(cause)
        chain.append(cause)
        cause = cause.__cause__ or cause.__context__
    for cause in chain:
        if isinstance(cause, MissingConfigException) and cause.missing_cfg_file:
            group, _, name = cause.missing_cfg_file.rpartition("/")
            if (group, name) == ("hydra/launcher", "joblib"):
                hint = "jobs at the same time need pip install 'vocc-torch[parallel]'"
                return f"{group} is {name!r}: {hint}"
            options = ", ".join(cause.options or options_of(group))
            return f"{group} is {name!r}: it must be one of {options}"
        if isinstance(cause, OmegaConfBaseException) and cause.full_key:
            return refusal(cause, keys_of(AppConfig))
    return " ".join(str(error).split("Set the environment variable")[0].split())


def ended_by(error: Exception) -> str | None:
    """Say what was refused before or between the jobs; None for an error that is not the user's.

    Args:
        error: what ended the application, outside its jobs.
    """
    if isinstance(error, BrokenProcessPool):
        return LOST_WORKER
    if isinstance(error, multiprocessing.TimeoutError):
        return (
            "hydra.launcher.timeout is shorter than a job: give more seconds, or null"
        )
    if isinstance(error, HYDRA_ERRORS):
        return complaint(error)
    if isinstance(error, OSError):
        if refused := stdout_refusal(error):
            return refused
        place = f" {error.filename}" if error.filename else ""
        return f"cannot make the run's folder{place} ({error.strerror}): choose another with name="
    return None
