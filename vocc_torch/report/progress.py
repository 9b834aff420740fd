"""A progress bar with the time left, on a terminal alone."""

from collections.abc import Iterable, Iterator
from typing import Self, TypeVar

from rich import progress
from rich.console import Console

from vocc_torch.report.folder import say

T = TypeVar("T")


class ProgressView:
    """A progress bar over all frames of a run, as a context manager; without a terminal, lines alone.

    Args:
        frames: how many in all.
        console: where to draw; standard output by default.
        doing: what is done first.
        unit: what is counted; empty for no speed.

    Example:
        >>> with ProgressView(128, Console(width=60)) as view:
        ...     view.advance("ambient", 128)
        ...     view.say("ambient is measured")
        ambient is measured
    """

    def __init__(
        self,
        frames: float,
        console: Console | None = None,
        doing: str = "training",
        unit: str = "frames",
    ) -> None:
        """Prepare the view; nothing is drawn before the context is entered."""
        self.console = console or Console()
        self._unit = unit
        drawn = self.console.is_terminal and not self.console.is_dumb_terminal
        self._bar = progress.Progress(
            "{task.description}",
            progress.BarColumn(None),
            "{task.percentage:>3.0f} %",
            "[progress.data.speed]{task.fields[speed]}",
            progress.TimeRemainingColumn(),
            "left",
            console=self.console,
            disable=not drawn,
            refresh_per_second=4,
            transient=True,
            expand=True,
        )
        self._bar.add_task(doing, total=frames, speed="")
        (self._task,) = self._bar.tasks

    def __enter__(self) -> Self:
        """Start drawing, where there is a terminal to draw on."""
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Clear the live view; what was printed around it stays."""
        self._bar.stop()

    @property
    def done(self) -> float:
        """Frames counted so far."""
        return self._task.completed

    def advance(self, doing: str, frames: float) -> None:
        """Add finished frames, and name the current stage."""
        speed, unit = self._task.speed or 0.0, self._unit
        text = f"{speed:,.0f} {unit}/s" if speed and unit else ""
        self._bar.update(self._task.id, advance=frames, description=doing, speed=text)

    def counted(self, items: Iterable[T], doing: str) -> Iterator[T]:
        """Pass items on, each counted when the next one is asked for."""
        for item in items:
            yield item
            self.advance(doing, 1)

    def say(self, text: str) -> None:
        """Print a line that stays."""
        say(self.console, text)
