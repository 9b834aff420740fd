"""An executor that loses calls, forgets them, and gives them back in an order of its own."""

import itertools
import random
import threading
from concurrent.futures import Future

from vocc_torch.measure import schedule, workers
from vocc_torch.measure.executors import Engine


class GoneError(Exception):
    """What an engine says of a node that it lost."""


class Unreliable(Engine):
    """Does calls in an order of its own; of every few calls one is lost, and one first left undone.

    Args:
        fates: what becomes of the calls in turn: ``done``, ``lost`` (and it says so), or ``silent`` until the
            next call has been done, by when it may have been handed out again.
    """

    lost, cancels = (GoneError,), False

    def __init__(self, fates, rng=None):
        self.fates, self.rng = itertools.cycle(fates), rng or random.Random(0)
        self.handed, self.silent, self.waiting = [], [], []
        self.here = threading.Lock()

    def slots(self):
        return 2

    def submit(self, call, /, *given):
        future, fate = Future(), next(self.fates)
        self.handed.append(given)
        late = [one for one in self.silent if one[2] == given]
        self.silent = [one for one in self.silent if one[2] != given]
        (self.silent if fate == "silent" else self.waiting).append((future, call, given, fate))
        # What was silent comes after its copy.
        threading.Timer(0.01, self.some, [late]).start()
        return future

    def some(self, late):
        with self.here:
            self.rng.shuffle(self.waiting)
            todo, self.waiting[:] = [*self.waiting, *late], []
            for future, call, given, fate in todo:
                if fate == "lost":
                    future.set_exception(GoneError("a node"))
                else:
                    future.set_result(call(*given))

    def shutdown(self, wait=True, *, cancel_futures=False):
        pass


def on(monkeypatch, engine, overdue_s=0.2):
    """Let executor=ray be this engine."""
    monkeypatch.setattr(workers, "engine_of", lambda *_: engine)
    monkeypatch.setattr(schedule, "OVERDUE_S", overdue_s)
    monkeypatch.setattr(schedule, "OVERDUE", 0)
    return engine
