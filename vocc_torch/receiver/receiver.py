"""A receiver by stages, which a user keeps in a file: locate, rectify, measure, decide."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple, Self

import torch
from torch import Tensor

from vocc_torch import __version__
from vocc_torch.boundary import checked, demand_fields
from vocc_torch.errors import VoccError, demand_kind, shown, whole_number
from vocc_torch.files import demand_folder
from vocc_torch.plugins import PlugIn
from vocc_torch.receiver.calibration import APPEARANCE, Calibration, Ranges, appearance
from vocc_torch.receiver.classifiers import Guarded
from vocc_torch.receiver.classifiers.inputs import demand_features
from vocc_torch.receiver.deciders import classifier_from, decider_of, model_of
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PanelLocator, locator_from, locator_settings
from vocc_torch.receiver.locators.second_looks import locate_several
from vocc_torch.receiver.model_file import UNFIT, Settings, read_model, write_model
from vocc_torch.receiver.reader import Reader, Readings
from vocc_torch.sources import package_digest
from vocc_torch.types import Frames, Images, Panels, PanelShape, StatedPanels

MOST_LETTERS = 400
"""Most letters of a refusal that a model file brings about: it may quote the file."""


class Decoded(NamedTuple):
    """What a receiver read from B frames.

    Args:
        bits: (B,R,C) bool, True = On; all Off where no panel was found.
        scores: (B,R,C) float64, at least 0 is On; zeros where no panel was found.
        corners_px: (B,4,2) float64 image coordinates, clockwise from the top left; zeros where not found.
        found: (B,) bool.
        panel_score: (B,) float64 score of the chosen candidate, 0 to 1.
        candidates: (B,) int64, number of places that could be the panel.
        llr: (B,R,C) float64 log-likelihood ratios, log P(On) / P(Off), with the signs of the bits; the
            scores if the receiver is not calibrated; zeros where no panel was found.
        appearance: (B,3) float64: pitch of the cells (px), mean grey of the panel, and grey of its brightest cell
            minus that of its darkest.
        false_alarms: (B,) float64, expected false alarms in a frame without a panel at this score; NaN if
            unknown.
    """

    bits: Tensor
    scores: Tensor
    corners_px: Tensor
    found: Tensor
    panel_score: Tensor
    candidates: Tensor
    llr: Tensor
    appearance: Tensor
    false_alarms: Tensor

    @property
    def panels(self) -> StatedPanels:
        """Where the panels are."""
        judged = self.found, self.panel_score, self.candidates
        return StatedPanels(self.corners_px, *judged, self.false_alarms)


class Receiver(torch.nn.Module):
    """Locate the panel, rectify it, measure its LEDs and decide their bits.

    Args:
        name: name of the FLDA receiver, which selects its features, or of the classifier.
        locator: the panel locator.
        reader: rectification and features; holds the panel's shape.
        classifier: FLDA fitted on the named features, or another trained classifier.
        calibration: calibration of the scores, or None.
        trained_on: ranges of pitch, level and contrast in training; empty if unknown.

    Raises:
        VoccError: an unknown name, or a classifier for other features.
    """

    _place: Tensor

    def __init__(
        self,
        name: str,
        locator: PanelLocator,
        reader: Reader,
        classifier: FLDA | Guarded,
        calibration: Calibration | None = None,
        trained_on: Ranges | None = None,
    ) -> None:
        super().__init__()
        demand_kind("locator", locator, PanelLocator)
        demand_kind("reader", reader, Reader)
        self.decider = decider_of(name, classifier)
        demand_features(self.decider.features, reader.names)
        self.name, self.locator, self.reader = name, locator, reader
        self.calibration, self.trained_on = calibration, trained_on or {}
        self.register_buffer("_place", torch.empty(0), persistent=False)

    @property
    def classifier(self) -> FLDA | Guarded:
        """FLDA or another classifier."""
        decider = self.decider
        return decider if isinstance(decider, Guarded) else decider.classifier

    @property
    def device(self) -> torch.device:
        """Device of the classifier."""
        return self._place.device

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
        return self._decode(Frames.of(images, "images"))

    def decode_several(self, images: Images, most: int) -> tuple[list[int], Decoded]:
        """Read up to ``most`` panels per image. Return the image number of each panel, and what was read.

        Raises:
            VoccError: as :meth:`decode`, or a locator that sees one panel alone.
        """
        frames = Frames.of(images, "images")
        if not self.locator.finds_several:
            raise VoccError(
                "this receiver's locator sees one panel in a frame: detector sees several"
            )
        whole_number("most", most, 1)
        with torch.inference_mode():
            found = locate_several(self.locator, frames, self.shape, most)
            limit = self.locator.most_false_alarms
            whose, panels = found.panels(len(frames), limit, most)
        return whose.tolist(), self._decode(frames[whose], panels)

    def _decode(self, frames: Frames, panels: Panels | None = None) -> Decoded:
        """Read bits without a record for gradients."""
        with torch.inference_mode():
            decoded = self.forward(frames, panels)
        # Copies, for tensors made in inference mode take no part in autograd.
        return Decoded(*(batch.clone() for batch in decoded))

    def forward(self, frames: Images, panels: Panels | None = None) -> Decoded:
        """Read the bits of frames or crops, at ``panels`` if given; score 0 is On (Eq. 18).

        Args:
            frames: B frames or crops, or whole images as :meth:`decode` takes.
            panels: where the panel is in each, or None to locate it.

        Raises:
            VoccError: frames that no locator reads, or floating ones that hold no grey values at a panel.
        """
        frames = Frames.of(frames)
        located = self.locator(frames, self.shape) if panels is None else panels
        needed = {*self.decider.features, "average"}
        readings = self.reader.read(frames, located, needed)
        found = located.found.view(-1, 1, 1)
        scores = torch.where(found, self.score(readings), 0.0)
        bits = (scores >= 0) & found
        judged = located.corners_px, located.found, located.score, located.candidates
        llr = scores if self.calibration is None else self.calibration(scores)
        unknown = torch.full_like(located.score, torch.nan)
        stated = getattr(located, "false_alarms", unknown)
        return Decoded(bits, scores, *judged, llr * found, appearance(readings), stated)

    def score(self, readings: Readings) -> Tensor:
        """Score every LED of located panels, (B,R,C) float64; at least 0 is On."""
        return self.decider.score(readings)

    def get_extra_state(self) -> Settings:
        """Return the state of classifier and calibration for ``state_dict``."""
        settings, arrays = model_of(self.decider)
        return {
            "name": self.name,
            "classifier": settings,
            "arrays": dict(arrays),
            "calibration": self.calibration and asdict(self.calibration),
        }

    def set_extra_state(self, state: Settings) -> None:
        """Load a state of :meth:`get_extra_state`; the classifier's name must be the same.

        Raises:
            VoccError: a classifier of another name, or one from outside: only ``load`` takes its code.
        """
        if state["name"] != self.name:
            raise VoccError.of("the state's receiver", repr(state["name"]), self.name)
        self.calibration = Calibration.read(state["calibration"])
        learned = classifier_from(self.name, state["classifier"], state["arrays"])
        self.decider = decider_of(self.name, learned).to(self.device)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """Follow moves between devices with what decides, which is no module."""
        super()._apply(fn, recurse)  # type: ignore[no-untyped-call]  # torch has no hints here
        self.decider = self.decider.to(self.device)
        return self

    @checked
    def save(self, path: str | Path) -> None:
        """Write the receiver to one file of text: settings, arrays and a checksum, and no code.

        Raises:
            VoccError: no path, a missing folder, a part that cannot be kept, or the file cannot be written.
        """
        if not Path(path).name:
            raise VoccError.of("path", shown(str(path)), "that of a file")
        demand_folder(path)
        decider, arrays = model_of(self.decider)
        names = self.decider.features
        package = {"version": __version__, "source": package_digest("vocc_torch")}
        settings: Settings = {
            "name": self.name,
            "rows": self.shape.rows,
            "columns": self.shape.columns,
            "package": package,
            "samples_per_led": self.reader.samples_per_led,
            "gradient": self.reader.gradient,
            "disc_share": self.reader.disc_share,
            "features": [f.settings for f in self.reader.more if f.name in names],
            "locator": locator_settings(self.locator),
            "trained_on": self.trained_on,
            "calibration": self.calibration and asdict(self.calibration),
        }
        if decider:
            settings["classifier"] = decider
        write_model(Path(path), settings, arrays)

    @classmethod
    @checked
    def load(cls, path: str | Path, plug_ins: Sequence[str] = ()) -> Self:
        """Read a receiver that :meth:`save` wrote; nothing in the file is executed.

        Args:
            path: the file.
            plug_ins: Python files and packages whose code the receiver may run, such as ``mine.py``: those
                that its parts from outside come from.

        Raises:
            VoccError: no path, a file that is missing, damaged, of another kind or of another version, or a
                part whose code was not named or has changed.
        """
        settings, state = read_model(Path(path))
        try:
            features = [
                PlugIn.admitted("receiver.features", feature, plug_ins)
                for feature in settings.get("features", [])
            ]
            shape = PanelShape(settings["rows"], settings["columns"])
            samples, gradient = settings["samples_per_led"], settings["gradient"]
            share = settings.get("disc_share")
            reader = Reader(shape, samples, gradient, tuple(features), share)
            locator = locator_from(settings["locator"], plug_ins)
            demand_fields("receiver.locator", locator)
            calibration = Calibration.read(settings.get("calibration"))
            ranges, name = settings.get("trained_on") or {}, settings["name"]
            trained_on = {
                quantity: (float(ranges[quantity][0]), float(ranges[quantity][1]))
                for quantity in APPEARANCE
                if ranges
            }
            described = settings.get("classifier")
            classifier = classifier_from(name, described, state, plug_ins)
            return cls(name, locator, reader, classifier, calibration, trained_on)
        except UNFIT as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            if len(reason) > MOST_LETTERS:
                reason = f"{reason[:MOST_LETTERS]} ..."
            if isinstance(error, VoccError):
                raise VoccError(f"model {path}: {reason}") from None
            raise VoccError(
                f"model {path} is damaged ({reason}): train it again"
            ) from None
