"""``task=calibrate``: its section of the configuration; nothing here needs torch."""

from dataclasses import dataclass

from vocc_torch.errors import demand_ranges, demand_word, within
from vocc_torch.recordings import CHANNELS

MOST_FRAMES = 256


@dataclass
class CalibrateConfig:
    """What ``task=calibrate`` fits, and values that a recording does not contain.

    Args:
        channel: how colour becomes grey: ``luma`` (Rec. 601), ``max`` (brightest channel), ``red``, ``green``
            or ``blue``.
        frames: most frames to fit, 2 to 256, spread evenly over the recording.
        bits: known bits of each frame, an .npy file of bool (N,R,C); null decides the bits from the frames.
        ambient_lx: illuminance by ambient light, lx, from a light meter; null estimates it from the noise
            and ``quantum_efficiency``.
        quantum_efficiency: quantum efficiency of the sensor, above 0 and at most 1; used if ``ambient_lx`` is null.

    Raises:
        VoccError: an unknown channel, or a number out of its range.
    """

    channel: str = "luma"
    frames: int = within(2, MOST_FRAMES, default=24, whole=True)
    bits: str | None = None
    ambient_lx: float | None = within(0, 1e9, above=True, null=True, default=None)
    quantum_efficiency: float = within(0, 1, above=True, default=0.6)

    def __post_init__(self) -> None:
        """Check the channel and the numbers."""
        demand_word("calibrate.channel", self.channel, CHANNELS)
        demand_ranges("calibrate", self)
