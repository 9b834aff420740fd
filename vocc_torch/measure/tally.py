"""Every receiver's counts on some frames; moved to :mod:`vocc_torch.measure.frame_errors`."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.counts import half_errors as half_errors
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.paired import PairedCounts

Tallies: TypeAlias = tuple[list[Counts], dict[tuple[int, int], PairedCounts]]


def tallies(half_errors: NDArray[np.int64], bits_per_frame: int, found: NDArray[np.bool_]) -> Tallies:
    """Use ``FrameErrors(...).counts`` and ``.pairs`` instead."""
    errors = FrameErrors(half_errors, found, bits_per_frame)
    return errors.counts, errors.pairs
