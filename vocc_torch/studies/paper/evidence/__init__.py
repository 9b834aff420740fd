"""The paper's figures other than bit error rates."""

from collections.abc import Mapping
from typing import NamedTuple

from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import plots


class PaperFigure(NamedTuple):
    """One figure of the paper.

    Args:
        numbers: what it shows, by name; a measured number has an interval.
        picture: as drawn.
    """

    numbers: Mapping[str, float | Estimate]
    picture: plots.Figure

    def estimates(self, name: str) -> dict[str, Estimate]:
        """The numbers under the figure's name; one without an interval is exact."""
        return {
            f"{name}.{key}": found
            if isinstance(found, Estimate)
            else Estimate(found, found, found)
            for key, found in self.numbers.items()
        }
