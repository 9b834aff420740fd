"""How long each stage of a run takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch:
    """Adds up wall-clock seconds by stage.

    Example:
        >>> watch = Stopwatch()
        >>> with watch.stage("nothing"):
        ...     pass
        >>> list(watch.seconds)
        ['nothing']
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time of what is done within."""
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.lap(name, begun)

    def lap(self, name: str, begun: float) -> float:
        """Count the time since ``begun`` (of ``time.perf_counter``) and give the time now."""
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - begun
        return now
