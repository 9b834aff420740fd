"""Keep other people's threads from printing what this application says in its own words."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet_threads() -> Iterator[None]:
    """Keep TensorBoard's writing thread from printing the OSError that ``write_board`` then raises."""
    shown = threading.excepthook
    threading.excepthook = lambda failure: None if issubclass(failure.exc_type, OSError) else shown(failure)
    try:
        yield
    finally:
        threading.excepthook = shown
