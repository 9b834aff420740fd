"""``task=calibrate``: its section of the configuration; nothing here needs torch."""

from dataclasses import dataclass

from vocc_torch.errors import demand_within, demand_word, whole_number

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
        demand_word("calibrate.channel", self.channel, CHANNELS)
        whole_number("calibrate.frames", self.frames, 2, MOST_FRAMES)
        for key, most in (("ambient_lx", 1e9), ("fps", 1e6)):
            value = getattr(self, key)
            demand_within(f"calibrate.{key}", value, 0, most, above=True, null=True)
        efficiency = self.quantum_efficiency
        demand_within("calibrate.quantum_efficiency", efficiency, 0, 1, above=True)
