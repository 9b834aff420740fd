"""One way to read what the paper leaves open, with everything that was measured under it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable, Row
from vocc_torch.measure.curves import Curves, Measured
from vocc_torch.measure.grid import Grid

Findings = Mapping[str, Mapping[str, float]]
"""Numbers of the paper's other figures, by figure and name."""


@dataclass(frozen=True)
class Reading:
    """A focal length and a locator, with the experiments and the other figures' numbers.

    Args:
        focal_length_mm: of the lens: the paper's text says 18 mm, its Table 1 says 25 mm.
        locator: where the panel's corners come from, ``truth`` or ``paper``.
        experiments: by name: ``contrast``, ``ambient``, ``luminance``, ``distance``; some may be missing.
        findings: of the figures that are no error rates; they are not bound to this reading.
        dimming: ambient light by LED luminance, with this locator and the report's own focal length; None
            where it was not measured.

    Raises:
        VoccError: an experiment without this locator.

    Example:
        >>> reading = Reading(25.0, "paper", {}, {"fig20": {"contrast_paper_scene_6": 0.031}})
        >>> reading.name, reading.finding("fig20", "contrast_paper_scene_6"), reading.finding("fig8", "auc")
        ('25 mm, paper', 0.031, None)
    """

    focal_length_mm: float
    locator: str
    experiments: Mapping[str, Measured]
    findings: Findings
    dimming: Grid | None = None

    def __post_init__(self) -> None:
        """Refuse a locator that was not measured."""
        for name, measured in self.experiments.items():
            if self.locator not in measured.curves:
                known = ", ".join(measured.curves)
                raise VoccError(f"locator is {self.locator!r}: experiment {name} has {known}")

    @property
    def name(self) -> str:
        """The reading in words."""
        return f"{self.focal_length_mm:g} mm, {self.locator}"

    def located_by(self, locator: str) -> Reading:
        """Give the reading with the same focal length and another locator."""
        return replace(self, locator=locator)

    def curves(self, experiment: str) -> Curves | None:
        """Give an experiment's curves with this reading's locator, or None where it was not run."""
        measured = self.experiments.get(experiment)
        return None if measured is None else measured.curves[self.locator]

    def row(self, experiment: str, receiver: str, value: float) -> Row | None:
        """Give a point with its interval, or None where it was not measured."""
        curves = self.curves(experiment)
        if curves is None or (receiver, value) not in curves.counts:
            return None
        # The limit of a point without errors looks at the receiver's other points.
        table = BerTable(point for point in curves.points() if point.receiver == receiver)
        return next(row for row in table if row.value == value)

    def finding(self, figure: str, name: str) -> float | None:
        """Give a number of a figure, or None where it was not computed or is no number."""
        value = self.findings.get(figure, {}).get(name)
        return value if value is not None and math.isfinite(value) else None
