"""``task=transmit``, ``task=record``, ``task=receive``, ``task=messages``: their sections, without torch."""

import re
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise

from vocc_torch.errors import (
    VoccError,
    demand_ranges,
    demand_within,
    demand_word,
    within,
)
from vocc_torch.extras.messages.signalling import Signalling
from vocc_torch.recordings import CHANNELS

PLAN, FRAMES = "plan.yaml", "frames.npy"
"""What a receiver must know, and the film as an array, in the folder of ``task=transmit``."""


@dataclass
class TransmitConfig(Signalling):
    """How ``task=transmit`` writes a message, and the film that it makes.

    Args:
        repeats: how many times the message is shown, 1 to 1000.
        cell_px: side of an LED cell in the film, px, 1 to 256.
    """

    repeats: int = within(1, 1000, default=1, whole=True)
    cell_px: int = within(1, 256, default=32, whole=True)


@dataclass
class RecordConfig:
    """The simulated camera of ``task=record``.

    Args:
        fps: frames per second, above 0 to 1e6.
        drift: relative error of the panel's clock, positive if it is slow, -0.1 to 0.1.
        start_s: time of the first frame after the film's start, s, at least 0; null draws it within a
            symbol.
        readout_s: rolling shutter: time from the first row's exposure to the last row's, s, above 0 to 1.
        dropped: probability that a frame is lost, 0 to below 1.
        burst_frames: consecutive frames per loss, 1 to 10,000.
        repeated: probability that a frame repeats the previous one, 0 to below 1.
        black: probability that a frame is black, 0 to below 1.
        speed_m_s: speed at which the panel moves away, m/s.
        margin: with framing=crop: recorded size in units of the panel's surroundings, 1 to 100.
        quality: x264 rate factor of the film, 0 (lossless) to 51.

    Raises:
        VoccError: a value out of its range.
    """

    fps: float = within(0, 1e6, above=True, default=240.0)
    drift: float = within(-0.1, 0.1, default=0.0)
    start_s: float | None = within(0, 1e6, null=True, default=None)
    readout_s: float = within(0, 1, above=True, default=0.004)
    dropped: float = within(0, 0.999, default=0.0)
    burst_frames: int = within(1, 10_000, default=1, whole=True)
    repeated: float = within(0, 0.999, default=0.0)
    black: float = within(0, 0.999, default=0.0)
    speed_m_s: float = within(-1000, 1000, default=0.0)
    margin: float = within(1, 100, default=1.5)
    quality: int = within(0, 51, default=12, whole=True)

    def __post_init__(self) -> None:
        """Check every range."""
        demand_ranges("record", self)

    def symbol_s(self, rate_hz: float) -> float:
        """Give how long a symbol shows at the rate of the panel's own clock."""
        return (1 + self.drift) / rate_hz


@dataclass
class ReceiveConfig:
    """How ``task=receive`` reads a recording.

    Args:
        plan: the plan.yaml of task=transmit; null takes the one beside the input.
        fps: frames per second; null takes the film's time stamps. Without time stamps each frame is
            expected at most one symbol after the previous one.
        locate_every: locate the panel in every n-th frame, 1 to 10000.
        follow: follow the panel from frame to frame: ``auto`` if it moves, ``true`` always, ``false``
            never.
        channel: how colour becomes grey: ``luma``, ``max``, ``red``, ``green`` or ``blue``.
        soft: soft values: ``scores`` (of the receiver), ``calibrated`` (log-likelihood ratios) or ``hard``
            (bits).

    Raises:
        VoccError: a value out of its range.
    """

    plan: str | None = None
    fps: float | None = within(0, 1e6, above=True, null=True, default=None)
    locate_every: int = within(1, 10_000, default=8, whole=True)
    follow: str = "auto"
    channel: str = "luma"
    soft: str = "scores"

    def __post_init__(self) -> None:
        """Check every range."""
        self.follow = self.follow.lower()  # true and false are written by YAML too
        hint = (
            "; task=decode decode.channel=auto says which of them suits the recording"
        )
        demand_word(
            "receive.channel", self.channel, CHANNELS, hint * (self.channel == "auto")
        )
        demand_word("receive.soft", self.soft, ("scores", "calibrated", "hard"))
        demand_word("receive.follow", self.follow, ("auto", "true", "false"))
        demand_ranges("receive", self)


AXES = {
    "distance_m": "at_distance_m",
    "ambient_lx": "at_distance_m",
    "ratio": "at_ratio",
}
"""What a study of messages varies, and the key whose range holds for it; ``ratio`` is frames a symbol."""


@dataclass
class MessagesConfig:
    """How far messages carry: what ``task=messages`` varies, and what it sends.

    Args:
        distance_m: distances of the panel, m, ascending; [] leaves them out.
        ambient_lx: illuminances by ambient light, lx, ascending; [] leaves them out.
        ratio: camera frames per symbol, 1.5 to 100, ascending; [] leaves them out.
        at_distance_m: distance while another quantity varies, m.
        at_ratio: frames per symbol while another quantity varies.
        codes: codes to compare: none, or rs or ldpc with a rate, such as ldpc-0.5.
        recordings: recordings per point, each of another scene, at least 2.
        blocks: symbol blocks per recording, 1 to 1000.
        signalling: how symbols are written, without the code.
        record: the camera, without its frame rate.

    Raises:
        VoccError: a value out of its range.
    """

    distance_m: list[float] = field(default_factory=lambda: [50.0, 70.0, 90.0])
    ambient_lx: list[float] = field(default_factory=list)
    ratio: list[float] = field(default_factory=list)
    at_distance_m: float = within(0, 1e6, above=True, default=80.0)
    at_ratio: float = within(1.5, 100.0, default=2.4)
    codes: list[str] = field(default_factory=lambda: ["ldpc-0.7"])
    recordings: int = within(2, 100_000, default=6, whole=True)
    blocks: int = within(1, 1000, default=1, whole=True)
    signalling: Signalling = field(default_factory=Signalling)
    record: RecordConfig = field(default_factory=RecordConfig)

    def __post_init__(self) -> None:
        """Check every range."""
        demand_ranges("messages", self)
        ranges = {item.name: item.metadata for item in fields(self)}
        for name, alike in AXES.items():
            values = getattr(self, name)
            for value in values:
                demand_within(f"messages.{name}", value, **ranges[alike])
            if not all(a < b for a, b in pairwise(values)):
                raise VoccError.of(f"messages.{name}", values, "ascending")
        if not any(getattr(self, axis) for axis in AXES):
            raise VoccError(
                "messages varies nothing: give values of messages.distance_m, ambient_lx or ratio"
            )
        if not self.codes or len({*self.codes}) < len(self.codes):
            raise VoccError.of("messages.codes", self.codes, "codes, each once")
        for code in self.codes:
            self.options(code)

    def options(self, code: str) -> Signalling:
        """Give how a code's packets are written.

        Raises:
            VoccError: another word than a code with its rate.
        """
        if not (found := re.fullmatch(r"none|(rs|ldpc)-(0?\.\d*[1-9]\d*)", code)):
            raise VoccError.of(
                "messages.codes",
                repr(code),
                "none, or rs or ldpc with a rate above 0 and below 1, such as ldpc-0.5",
                "has",
            )
        rate, name = float(found[2] or 0.5), found[1] or "none"
        return replace(self.signalling, code=name, code_rate=rate, scramble=True)
