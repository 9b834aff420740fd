"""The tasks: what runs each, and the keys that its configuration has."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from typing import Any

import yaml

from vocc_torch.app.config import AppConfig
from vocc_torch.errors import VoccError, demand_word
from vocc_torch.measure.schema import has_key, keys_of, part_of


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

    @classmethod
    def of(
        cls, run: str, keys: Any, part: str | None = None, brought: Any = ()
    ) -> "Task":
        """Read a task as ``tasks.yaml`` has it."""
        return cls(run, tuple(expanded(keys)), part, tuple(expanded(brought)))


def expanded(entries: Iterable[Any]) -> Iterator[str]:
    """Give the keys of nested lists; of a section that lacks some keys all others.

    Example:
        >>> list(expanded(["seed", ["executor -kind"]]))
        ['seed', 'executor.address']
    """
    for entry in entries:
        if isinstance(entry, list):
            yield from expanded(entry)
            continue
        section, *lacking = entry.split(" -")
        if not lacking:
            yield section
        for item in fields(keys_of(AppConfig)[section]) if lacking else ():
            if item.name not in lacking:
                yield f"{section}.{item.name}"


TASKS = {
    name: Task.of(**about)
    for name, about in yaml.safe_load(
        resources.files(__package__).joinpath("tasks.yaml").read_text("utf-8")
    )["tasks"].items()
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
