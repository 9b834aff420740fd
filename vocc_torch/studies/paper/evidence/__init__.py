"""The paper's figures other than bit error rates."""

from collections.abc import Mapping
from dataclasses import dataclass

from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import plots

Numbers = Mapping[str, float | Estimate]
"""What a figure shows, by name; a measured number has an interval."""


@dataclass(frozen=True)
class PaperFigure:
    """One figure of the paper.

    Args:
        numbers: what it shows.
        picture: as drawn.
    """

    numbers: Numbers
    picture: plots.Figure

    def estimates(self, name: str) -> dict[str, Estimate]:
        """The numbers under the figure's name; one without an interval is exact."""
        return {
            f"{name}.{key}": found
            if isinstance(found, Estimate)
            else Estimate(found, found, found)
            for key, found in self.numbers.items()
        }
