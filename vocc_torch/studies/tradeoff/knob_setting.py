"""What a setting of the renderer's knobs costs and buys."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vocc_torch.studies.tradeoff.price_list import Quartiles


@dataclass(frozen=True, slots=True)
class KnobSetting:
    """What one setting of the renderer's knobs costs and how near it comes to the reference.

    Args:
        knob: which knob is turned; ``none`` for the settings as they are.
        value: where it stands.
        cost_ms: quartiles of the time a frame, ms.
        rounds: timed rounds.
        frames_a_call: frames rendered in a timed call.
        worst_dn: greatest error of a grey value in the frames, digital numbers, before quantisation.
        rms_dn: root mean square of the errors about the panel, digital numbers.
        changed: share of the pixels about the panel whose 8-bit value differs.
    """

    knob: str
    value: str
    cost_ms: Quartiles
    rounds: int
    frames_a_call: int
    worst_dn: float
    rms_dn: float
    changed: float

    @property
    def exact(self) -> bool:
        """Whether no difference can be seen in float64's own rounding."""
        return math.isclose(self.worst_dn, 0.0, abs_tol=1e-9)
