"""A receiver by stages: locate, rectify, measure, decide; and the one that a user keeps in a file.

The file is JSON text with a checksum, which no reader can be tricked into executing. Python's shortest
decimal form of a float64 keeps every number exactly.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self, get_args

import torch

from vocc_torch.errors import VoccError, demand_kind
from vocc_torch.files import write_atomically
from vocc_torch.receiver.bank import FLDA_FEATURES, Preambles, ReceiverBank
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PanelLocator, locator_from, locator_settings
from vocc_torch.receiver.reader import Reader, Readings
from vocc_torch.types import Frames, Images, Panels, PanelShape

FORMAT = "vocc_torch.receiver"
FORMAT_VERSION = 2
MOST_BYTES = 1 << 20
"""Most bytes of a model's file; a panel's size does not change its few kilobytes."""
_READABLE = (1, FORMAT_VERSION)  # version 1 has one number for each mean and scatter: the second one is 0
_DTYPES = {"float64": torch.float64, "int64": torch.int64}

Settings = dict[str, Any]


def _checksum(content: Mapping[str, object]) -> str:
    """Hash everything but the checksum itself, in a canonical form."""
    rest = {key: value for key, value in content.items() if key != "sha256"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_model(path: Path, settings: Settings, state: Mapping[str, torch.Tensor]) -> None:
    """Write settings and a classifier's state, whole or not at all.

    Args:
        path: the file, replaced whole.
        settings: what JSON can hold.
        state: float64 and int64 tensors by name.

    Raises:
        VoccError: the file cannot be written.
    """
    numbers: Settings = {}
    for name, value in state.items():
        dtype, shape = str(value.dtype).removeprefix("torch."), list(value.shape)
        numbers[name] = {"dtype": dtype, "shape": shape, "values": value.cpu().flatten().tolist()}
    content: Settings = {"format": FORMAT, "version": FORMAT_VERSION}
    content |= {"settings": settings, "classifier": numbers}
    content["sha256"] = _checksum(content)
    write_atomically(path, (json.dumps(content, indent=1) + "\n").encode())


def read_model(path: Path) -> tuple[Settings, dict[str, torch.Tensor]]:
    """Read what :func:`write_model` wrote.

    Raises:
        VoccError: a file that is missing, damaged, of another kind or of another version.
    """
    try:
        if path.stat().st_size > MOST_BYTES or not path.is_file():  # reading a pipe would wait for ever
            raise ValueError
        content = json.loads(path.read_bytes())
        fits = isinstance(content, dict) and content.get("sha256") == _checksum(content)
    except FileNotFoundError:
        raise VoccError(f"model {path} does not exist: give the receiver.pt that task=train wrote") from None
    except (OSError, ValueError, RecursionError):
        raise VoccError(f"model {path} is no receiver: it is damaged or of another kind") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise VoccError(f"model {path} is not a vocc_torch receiver: give the one that task=train wrote")
    if (version := content.get("version")) not in _READABLE:
        allowed = " and ".join(map(str, _READABLE))
        raise VoccError(f"model {path} has format version {version}: this package reads versions {allowed}")
    if not fits:
        raise VoccError(f"model {path} is damaged (its checksum does not fit): train it again")
    try:
        state = {}
        for key, value in content["classifier"].items():
            numbers = torch.tensor(value["values"], dtype=_DTYPES[value["dtype"]])
            state[key] = numbers.reshape(value["shape"])
        return dict(content["settings"]), state
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise VoccError(f"model {path} is damaged ({type(error).__name__}): train it again") from None


class Decoded(NamedTuple):
    """What a receiver read from B frames.

    Args:
        bits: (B,R,C) bool, True = On; all Off where no panel was found.
        scores: (B,R,C) float64, at least 0 is On; zeros where no panel was found.
        corners_px: (B,4,2) float64 image coordinates, clockwise from the top left; zeros where not found.
        found: (B,) bool.
        panel_score: (B,) float64, how panel-like the chosen blob is, 0 to 1.
        candidates: (B,) int64, how many blobs could have been the panel.
    """

    bits: torch.Tensor
    scores: torch.Tensor
    corners_px: torch.Tensor
    found: torch.Tensor
    panel_score: torch.Tensor
    candidates: torch.Tensor


@dataclass(frozen=True, slots=True)
class StagedReceiver:
    """Named receivers that share location, rectification and measurement, stage by stage.

    Each stage is a method that takes what those before it gave, so it can be shared, replaced and timed
    alone: :meth:`locate`, :meth:`rectify`, :meth:`measure`, :meth:`decide`. Each does only what the named
    receivers need. A call runs them all.

    Args:
        bank: the receivers by name, and how they decide.
        reader: the panel's shape, samples of an LED and gradient.
        locator: finds the panel, or None where corners are known.
        dtype: working precision of rectification; see :func:`vocc_torch.receiver.rectification.rectify`.

    Example:
        >>> frames = Frames.whole(torch.full((1, 40, 40), 50, dtype=torch.uint8))
        >>> corners = torch.tensor([[[8.0, 8.0], [32.0, 8.0], [32.0, 32.0], [8.0, 32.0]]])
        >>> panels, flda = Panels.known(corners), FLDA(3)
        >>> _ = flda.update(torch.rand(64, 3), torch.arange(64) % 2)
        >>> staged = StagedReceiver(ReceiverBank(["flda_3", "flda_agr"], flda), Reader(PanelShape(4, 4)))
        >>> patches = staged.rectify(frames, panels)
        >>> scores = staged.decide(staged.measure(frames, panels, patches))
        >>> sorted(scores), tuple(scores["flda_3"].shape)
        (['flda_3', 'flda_agr'], (1, 4, 4))
    """

    bank: ReceiverBank
    reader: Reader
    locator: PanelLocator | None = None
    dtype: torch.dtype | None = None

    def locate(self, frames: Frames) -> Panels:
        """Find the panel in each frame.

        Raises:
            VoccError: there is no locator, or frames that it cannot read.
        """
        if self.locator is None:
            raise VoccError("this receiver has no locator: give it one, or the panels' corners")
        return self.locator(frames, self.reader.shape)

    def rectify(self, frames: Frames, panels: Panels) -> torch.Tensor | None:
        """Resample located panels, (B,1,(R+2)K,(C+2)K); None where only single pixels are read."""
        if not self.bank.needs_patches:
            return None
        return self.reader.rectify([frames], panels, self.dtype)[0]

    def measure(self, frames: Frames, panels: Panels, patches: torch.Tensor | None) -> Readings:
        """Measure what the receivers decide on; features and grey values that none needs are zeros.

        Args:
            frames: B frames.
            panels: where the panel is in each.
            patches: what :meth:`rectify` gave.
        """
        return self.reader.measure(frames, panels, patches, self.bank.needed)

    def preambles(self, on: Frames, off: Frames, panels: Panels) -> Preambles:
        """Measure the grey levels of the all-On and the all-Off frame of the same scenes."""
        takes = (self.measure(take, panels, self.rectify(take, panels)).greys for take in (on, off))
        return Preambles(*takes)

    def decide(self, readings: Readings, preambles: Preambles | None = None) -> dict[str, torch.Tensor]:
        """Score every LED with every receiver: name to (B,R,C) float64, at least 0 is On (Eq. 18).

        Raises:
            VoccError: a greyscale receiver without preambles.
        """
        return self.bank.scores(readings, preambles)

    def __call__(
        self, frames: Images, panels: Panels | None = None, preambles: Preambles | None = None
    ) -> dict[str, torch.Tensor]:
        """Run all stages; location is left out where the panels are known."""
        frames = Frames.of(frames)
        where = self.locate(frames) if panels is None else panels
        return self.decide(self.measure(frames, where, self.rectify(frames, where)), preambles)


class Receiver(torch.nn.Module):
    """Locate the panel, rectify it, measure its LEDs and decide their bits.

    Args:
        name: the FLDA receiver's name, which says which features it uses.
        locator: the panel locator.
        reader: rectification and features; it holds the panel's shape.
        classifier: fitted on the named features.

    Raises:
        VoccError: an unknown name, or a classifier of another number of features.
    """

    def __init__(self, name: str, locator: PanelLocator, reader: Reader, classifier: FLDA) -> None:
        super().__init__()
        demand_kind("locator", locator, *get_args(PanelLocator))
        demand_kind("reader", reader, Reader)
        demand_kind("classifier", classifier, torch.nn.Module)
        if name not in tuple(FLDA_FEATURES):
            raise VoccError.of("receiver name", repr(name), f"one of {', '.join(FLDA_FEATURES)}")
        if classifier.n_features != (needed := len(FLDA_FEATURES[name])):
            raise VoccError(f"classifier has {classifier.n_features} features: {name} needs {needed}")
        self.name, self.locator, self.reader, self.classifier = name, locator, reader, classifier

    @property
    def shape(self) -> PanelShape:
        """Rows and columns of the panel."""
        return self.reader.shape

    def decode(self, images: Images) -> Decoded:
        """Read the bits of B whole images.

        Args:
            images: (B,H,W) or (B,1,H,W) uint8 grey values, or one image (H,W); a tensor on any device or a
                NumPy array.

        Raises:
            VoccError: another type or shape.
        """
        with torch.inference_mode():
            decoded = self.forward(Frames.of(images, "images"))
        # Copies, for tensors made in inference mode take no part in autograd.
        return Decoded(*(one.clone() for one in decoded))

    def forward(self, frames: Images, panels: Panels | None = None) -> Decoded:
        """Read the bits of frames or crops, at known panels where they are given; score 0 is On (Eq. 18).

        Args:
            frames: B frames or crops, or whole images as :meth:`decode` takes.
            panels: where the panel is in each, or None to locate it.

        Raises:
            VoccError: frames that no locator reads, or floating ones that hold no grey values at a panel.
        """
        frames = Frames.of(frames)
        where = self.locator(frames, self.shape) if panels is None else panels
        features = self.reader.read_features(frames, where, FLDA_FEATURES[self.name])
        found = where.found.view(-1, 1, 1)
        scores = torch.where(found, self.classifier.decision_function(features), 0.0)
        bits = (scores >= 0) & found
        return Decoded(bits, scores, where.corners_px, where.found, where.score, where.candidates)

    def save(self, path: str | Path) -> None:
        """Write the receiver to one file of text: settings and numbers, no code, and a checksum.

        Raises:
            VoccError: no path, or the file cannot be written.
        """
        demand_kind("path", path, str, Path)
        settings: Settings = {"name": self.name, "rows": self.shape.rows, "columns": self.shape.columns}
        settings |= {"samples_per_led": self.reader.samples_per_led, "gradient": self.reader.gradient}
        settings["locator"] = locator_settings(self.locator)
        write_model(Path(path), settings, self.classifier.state_dict())

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a receiver that :meth:`save` wrote; nothing in the file is executed.

        Raises:
            VoccError: no path, or a file that is missing, damaged, of another kind or of another version.
        """
        demand_kind("path", path, str, Path)
        settings, state = read_model(Path(path))
        try:
            shape = PanelShape(settings["rows"], settings["columns"])
            reader = Reader(shape, settings["samples_per_led"], settings["gradient"])
            classifier = FLDA(n_features=len(FLDA_FEATURES[settings["name"]]))
            classifier.load_state_dict(state)
            if not bool(classifier.direction.isfinite().all()):
                raise VoccError("its statistics are not finite")
            return cls(settings["name"], locator_from(settings["locator"]), reader, classifier)
        except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise VoccError(f"model {path} is damaged ({reason}): train it again") from None
