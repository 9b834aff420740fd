"""Watches what is rendered, what receivers are taught and what they are asked, and says what leaked."""

import hashlib
from pathlib import Path

import torch

from vocc_torch.measure import train as train_module
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.flda import FLDA
from vocc_torch.report import samples
from vocc_torch.simulation import Simulator
from vocc_torch.studies import run as run_module

SHIPPED = sorted(
    path.stem
    for path in (Path(__file__).parents[1] / "conf" / "classifier").glob("*.yaml")
)
SHIPPED = [name for name in SHIPPED if name not in ("sklearn", "own")]
NETWORKS = ("cnn", "mlp", "mlp_features")
LITTLE = (
    *(
        "device=cpu",
        "workers=1",
        "tensorboard=false",
        "budget.frames=32",
        "budget.training_frames=32",
    ),
    *(
        "experiment.values=[1000]",
        "receiver.names=[average_greyscale,flda_gri,flda_3]",
    ),
    *(f"classifier=[{','.join(SHIPPED)}]",),
    *(
        f"classifiers.{name}.training.{value}"
        for name in NETWORKS
        for value in ("frames=32", "epochs=1")
    ),
)
"""All that is shipped, at a small budget."""

ONE = (
    *LITTLE[:3],
    "budget.frames=64",
    "budget.training_frames=64",
    "experiment.values=[4000]",
)
"""Fewer still."""


def digest(*tensors):
    """What tells tensors from others."""
    made = hashlib.sha256()
    for one in tensors:
        made.update(one.detach().contiguous().cpu().numpy().tobytes())
    return made.digest()[:16]


def columns(x):
    """Digests of each panel's numbers, one for each thing seen of the LEDs, (B,R,C,F).

    What is the same at all LEDs of a panel, as its cell size and white are, tells no frame from another.
    """
    rows = x.detach().to(torch.float32).flatten(1, -2)
    varied = (rows != rows[:, :1]).any(1)
    return {
        digest(rows[panel, :, column])
        for panel in range(len(rows))
        for column in range(rows.shape[-1])
        if varied[panel, column]
    }


class Watch:
    """Puts itself between the simulator and the receivers of this process.

    Training is what happens within the three functions that train; all else that is rendered is for tests.
    Were there a fourth that trains, its frames would count as test frames that were taught. Frames on which a
    receiver learns what its scores are worth are a phase of their own, and those of samples.png another.
    """

    def __init__(self, monkeypatch):
        self.phase = "test"
        phases = ("train", "test", "calibrate", "show")
        self.keys, self.frames, self.bits = (
            {phase: set() for phase in phases} for _ in range(3)
        )
        self.taught, self.asked, self.labels = set(), set(), set()
        self.pupils, self.examined = set(), set()
        self._on_simulator(monkeypatch)
        self._on_receivers(monkeypatch)
        training = (
            (train_module, "train_flda", "train"),
            (train_module, "train_classifier", "train"),
            (run_module, "calibrated_receiver", "calibrate"),
            (samples, "write_samples", "show"),
        )
        for module, name, phase in training:
            monkeypatch.setattr(
                module, name, self._within(phase, getattr(module, name))
            )

    def leaks(self):
        """Kinds of things that training and tests have in common; there must be none."""
        common = {
            "frames of one name": self.keys["train"] & self.keys["test"],
            "pictures": self.frames["train"] & self.frames["test"],
            "bits": self.bits["train"] & self.bits["test"],
            "labels of test frames": self.labels & self.bits["test"],
            "labels of no training frame": self.labels - self.bits["train"],
            "what is seen of a panel": self.taught & self.asked,
        }
        for other in ("train", "test"):
            for kind in (self.keys, self.frames, self.bits):
                common.setdefault("frames of calibration", set()).update(
                    kind["calibrate"] & kind[other]
                )
        return {kind for kind, shared in common.items() if shared}

    def _on_simulator(self, monkeypatch):
        render = Simulator.render

        def watched(simulator, scene, bits, *, keys=(), **rest):
            frames = render(simulator, scene, bits, keys=keys, **rest)
            for i, key in enumerate(keys):
                # Preambles are of known bits, and belong to a test frame's scene.
                if key.take == "frame":
                    self.keys[self.phase].add(key)
                    self.frames[self.phase].add(
                        digest(frames.grey[i], frames.origin_px[i])
                    )
                    self.bits[self.phase].add(digest(bits[i]))
            return frames

        monkeypatch.setattr(Simulator, "render", watched)

    def _on_receivers(self, monkeypatch):
        stream = Guarded.fit_stream

        def streamed(guarded, batches, frames):
            def told(first, count):
                for x, bits in batches(first, count):
                    self._teach(guarded.name, x, bits)
                    yield x, bits

            return stream(guarded, told, frames)

        monkeypatch.setattr(Guarded, "fit_stream", streamed)
        for kind, method in ((FLDA, "fit"), (FLDA, "update"), (Guarded, "fit")):
            monkeypatch.setattr(kind, method, self._teaching(getattr(kind, method)))
        asked = ((FLDA, "unchecked_scores"), (Guarded, "decision_function"))
        for kind, method in asked:
            monkeypatch.setattr(kind, method, self._asking(getattr(kind, method)))

    def _teaching(self, method):
        def watched(pupil, x, bits):
            # A classifier's own FLDA may get its LEDs in a row, without panels.
            if x.ndim == 4:
                self._teach(_name(pupil), x, bits)
            return method(pupil, x, bits)

        return watched

    def _asking(self, method):
        def watched(pupil, x):
            if self.phase == "test":
                self.examined.add(_name(pupil))
                self.asked |= columns(x)
            return method(pupil, x)

        return watched

    def _teach(self, name, x, bits):
        self.pupils.add(name)
        self.taught |= columns(x)
        self.labels |= {digest(one) for one in bits}

    def _within(self, phase, function):
        def watched(*arguments, **rest):
            before, self.phase = self.phase, phase
            try:
                return function(*arguments, **rest)
            finally:
                self.phase = before

        return watched


def _name(pupil):
    return pupil.name if isinstance(pupil, Guarded) else f"FLDA of {pupil.n_features}"
