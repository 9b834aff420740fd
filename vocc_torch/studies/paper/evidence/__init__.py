"""The paper's figures other than bit error rates: each computed from a plan, drawn and tabled."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import Plan
from vocc_torch.show.canvas import figure_pixels, save_figure
from vocc_torch.show.csv_file import write_rows
from vocc_torch.studies.paper.evidence.features import GreyAndAgr, GriAndAgr, NgrAndOthers
from vocc_torch.studies.paper.evidence.figure import PaperFigure
from vocc_torch.studies.paper.evidence.gradients import InwardGradients
from vocc_torch.studies.paper.evidence.greys import BloomingInterference, GreyOverlap
from vocc_torch.studies.paper.evidence.histogram import FrameHistogram
from vocc_torch.studies.paper.evidence.projection import Projection
from vocc_torch.studies.paper.evidence.scenes import BlurOrder, ContrastPanels
from vocc_torch.studies.paper.evidence.timing import ProcessingTime

_FIGURES: tuple[type[PaperFigure], ...] = (
    *(GreyOverlap, BloomingInterference, GreyAndAgr, InwardGradients, GriAndAgr, NgrAndOthers),
    *(Projection, BlurOrder, FrameHistogram, ContrastPanels, ProcessingTime),
)
EVIDENCE = {figure.name: figure for figure in _FIGURES}
"""The figures by name, in the paper's order."""


@dataclass(frozen=True)
class WrittenFigure:
    """A figure that has been computed, drawn and written.

    Args:
        evidence: what it is: its name, title and caption.
        findings: its numbers by name.
        picture: its PNG file.
        table: its CSV file.
        pixels: (H,W,3) uint8 the picture, red, green, blue.
    """

    evidence: type[PaperFigure]
    findings: dict[str, float]
    picture: Path
    table: Path
    pixels: NDArray[np.uint8]


def make_evidence(plan: Plan, folder: Path, names: Sequence[str] = ()) -> Iterator[WrittenFigure]:
    """Compute, draw and write figures one after the other, as ``NAME.png`` and ``NAME.csv``.

    Args:
        plan: the study; its locator is used for Fig. 19's outline and by Fig. 25 only.
        folder: where the files go; made if missing.
        names: the figures; all by default.

    Returns:
        Each figure once it is written, in the paper's order.

    Raises:
        VoccError: an unknown name, before anything is computed; or a file that cannot be written.
    """
    for name in names:
        if name not in EVIDENCE:
            raise VoccError(f"{name!r} is not a figure: known are {', '.join(EVIDENCE)}")
    return (_written(kind, plan, folder) for name, kind in EVIDENCE.items() if not names or name in names)


def _written(kind: type[PaperFigure], plan: Plan, folder: Path) -> WrittenFigure:
    """Compute, draw and write one figure."""
    one = kind.compute(plan)
    picture, table = (folder / f"{kind.name}.{suffix}" for suffix in ("png", "csv"))
    figure = one.draw()
    save_figure(figure, picture)
    write_rows(table, one.rows())
    return WrittenFigure(kind, one.findings(), picture, table, figure_pixels(figure))
