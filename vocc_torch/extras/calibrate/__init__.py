"""``task=calibrate``: its section of the configuration; nothing here needs torch."""

from dataclasses import dataclass

from vocc_torch.errors import VoccError

CHANNELS = ("luma", "max", "red", "green", "blue")
MOST_FRAMES = 256


@dataclass
class CalibrateConfig:
    """What ``task=calibrate`` looks at, and what a recording cannot tell.

    Args:
        channel: how colour becomes grey: ``luma`` (Rec. 601), ``max`` (brightest channel), ``red``, ``green``
            or ``blue``.
        frames: frames that are fitted, at most, 2 to 256, spread evenly over the recording; all are read.
        bits: an array .npy (N,R,C) of bool, what the panel showed in frame 0, 1, ..., which may be all On or
            all Off; null decides the bits from the frames.
        ambient_lx: illuminance of the ambient light, lx, by a light meter; null takes what the photon
            transfer curve and ``quantum_efficiency`` say.
        fps: frames a second, above 0 and at most 1e6, for the symbols' times; null takes a video's own times.
        quantum_efficiency: of the sensor, above 0 and at most 1, for the illuminance where that is null.

    Raises:
        VoccError: an unknown channel, or a number out of its range.
    """

    channel: str = "luma"
    frames: int = 24
    bits: str | None = None
    ambient_lx: float | None = None
    fps: float | None = None
    quantum_efficiency: float = 0.6

    def __post_init__(self) -> None:
        """Check the channel and the numbers."""
        if self.channel not in CHANNELS:
            raise VoccError.of(
                "calibrate.channel", repr(self.channel), f"one of {', '.join(CHANNELS)}"
            )
        if not 2 <= self.frames <= MOST_FRAMES:
            raise VoccError.of(
                "calibrate.frames", self.frames, f"from 2 to {MOST_FRAMES}"
            )
        for key, most in (("ambient_lx", 1e9), ("fps", 1e6)):
            value = getattr(self, key)
            if value is not None and not 0 < value <= most:
                raise VoccError.of(
                    f"calibrate.{key}", value, f"above 0 and at most {most:g}, or null"
                )
        if not 0 < self.quantum_efficiency <= 1:
            raise VoccError.of(
                "calibrate.quantum_efficiency",
                self.quantum_efficiency,
                "above 0 and at most 1",
            )
