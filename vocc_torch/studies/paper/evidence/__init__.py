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
from vocc_torch.show.folder import write_rows
from vocc_torch.studies.paper.evidence import base, features, greys, scenes, timing, vectors

_FIGURES: tuple[type[base.PaperFigure], ...] = (
    *(greys.GreyOverlap, greys.BloomingInterference, features.GreyAndAgr, vectors.InwardGradients),
    *(features.GriAndAgr, features.NgrAndOthers, vectors.Projection, scenes.BlurOrder),
    *(scenes.FrameHistogram, scenes.ContrastPanels, timing.ProcessingTime),
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

    evidence: type[base.PaperFigure]
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
    source = base.Source(plan)
    return (_written(kind, source, folder) for name, kind in EVIDENCE.items() if not names or name in names)


def _written(kind: type[base.PaperFigure], source: base.Source, folder: Path) -> WrittenFigure:
    """Compute, draw and write one figure."""
    one = kind.compute(source)
    picture, table = (folder / f"{kind.name}.{suffix}" for suffix in ("png", "csv"))
    figure = one.draw()
    save_figure(figure, picture)
    write_rows(table, one.rows())
    return WrittenFigure(kind, one.findings(), picture, table, figure_pixels(figure))
