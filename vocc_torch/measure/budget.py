"""How many frames a study spends, and when it may stop before."""

from __future__ import annotations

from dataclasses import dataclass

from vocc_torch.errors import VoccError


@dataclass(frozen=True)
class Budget:
    """How many frames a study spends.

    Args:
        frames: test frames a point at most, at least 1.
        training_frames: at least 2.
        target_frame_errors: stop a point once every receiver has this many frames in error, or None to
            spend all.
        precision: stop a point once every receiver's 95 % interval reaches at most this share of its bit
            error rate to either side, above 0 and below 1, or None.
        least_ber: with ``precision``, a receiver whose interval lies below this rate needs no more frames; 0
            to below 1.

    Raises:
        VoccError: a number outside its range, or two stop rules that contradict each other.
    """

    frames: int = 1024
    training_frames: int = 1000
    target_frame_errors: int | None = None
    precision: float | None = None
    least_ber: float = 0.0

    def __post_init__(self) -> None:
        """Check every range."""
        for name, least in (("frames", 1), ("training_frames", 2), ("target_frame_errors", 1)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise VoccError(f"budget.{name} is {value}: it must be at least {least}")
        if self.precision is not None and not 0 < self.precision < 1:
            raise VoccError(f"budget.precision is {self.precision}: it must be above 0 and below 1, or null")
        if not 0 <= self.least_ber < 1:
            raise VoccError(f"budget.least_ber is {self.least_ber}: it must be at least 0 and below 1")
        if self.least_ber and self.precision is None:
            raise VoccError(
                f"budget.least_ber is {self.least_ber}: it needs budget.precision; without it it must be 0"
            )
        if self.precision is not None and self.target_frame_errors is not None:
            raise VoccError(
                f"budget.precision is {self.precision} and budget.target_frame_errors is "
                f"{self.target_frame_errors}: give one of them, null for the other"
            )
