"""The tasks: what runs each, and the keys that its configuration has."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

import yaml

from vocc_torch.errors import demand_word


@dataclass
class Task:
    """A task of the command line.

    Args:
        run: its function, below ``vocc_torch``.
        keys: keys and sections of its configuration in nested lists, such as ``receiver -names``.
        part: the section that only this task has, or None.
        brought: keys whose values a model file gives, in the same form.
        resumed: pattern of a file in a folder that the task can resume; empty for none.
    """

    run: str
    keys: list[Any]
    part: str | None = None
    brought: list[Any] = field(default_factory=list)
    resumed: str = ""

    def __post_init__(self) -> None:
        """Flatten nested lists, and add the keys that every task has."""
        self.keys, self.brought = (
            ["task", "name", *flat(self.keys)],
            [*flat(self.brought)],
        )
        if self.part is not None and not covers(self.keys, self.part):
            self.keys.append(self.part)


def flat(entries: Iterable[Any]) -> Iterator[str]:
    """Yield the entries of nested lists."""
    for entry in entries:
        if isinstance(entry, list):
            yield from flat(entry)
        else:
            yield entry


def covers(entries: Iterable[str], key: str) -> bool:
    """Whether a key, or any key of a section, is among some entries.

    Example:
        >>> entries = ["executor -kind", "budget.frames"]
        >>> [covers(entries, key) for key in ("executor.kind", "executor.address", "budget")]
        [False, True, True]
    """
    for entry in entries:
        section, *lacking = entry.split(" -")
        below = key.removeprefix(f"{section}.")
        if f"{section}.".startswith(f"{key}."):
            return True
        if below != key and below.partition(".")[0] not in lacking:
            return True
    return False


TASKS = {
    name: Task(**about)
    for name, about in yaml.safe_load(
        resources.files(__package__).joinpath("tasks.yaml").read_text("utf-8")
    )["tasks"].items()
}


def task_named(name: str) -> Task:
    """Give a task.

    Raises:
        VoccError: nothing of that name.
    """
    demand_word("task", name, TASKS)
    return TASKS[name]
