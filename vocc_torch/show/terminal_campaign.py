"""A view of a campaign of many experiments: one progress bar, and a line for each that is finished."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class CampaignView:
    """A progress bar over all frames of a campaign, as a context manager; without a terminal, lines.

    Args:
        frames: test frames in all.
        console: where to draw.

    Example:
        >>> with CampaignView(128, Console(width=60)) as view:
        ...     view.advance("ambient", 128)
        ...     view.say("ambient is measured")
        ambient is measured
    """

    def __init__(self, frames: int, console: Console) -> None:
        self._console = console
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=console,
            transient=True,
            expand=True,
            disable=not console.is_terminal or console.is_dumb_terminal,
        )
        self._task = self._progress.add_task("training", total=frames)

    def __enter__(self) -> Self:
        """Start drawing, where there is a terminal to draw on."""
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Clear the bar."""
        self._progress.stop()

    def advance(self, what: str, frames: int) -> None:
        """Count frames that were added, and name what is under way."""
        self._progress.update(self._task, advance=frames, description=what)

    def say(self, text: str) -> None:
        """Print a line that stays."""
        self._console.print(text, soft_wrap=True, highlight=False)
