"""The paper's figures other than bit error rates: their data, computed from a plan; drawn one floor below."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vocc_torch.measure.plan import Plan
from vocc_torch.show.csv_file import write_rows
from vocc_torch.studies.paper.evidence.data import FigureData
from vocc_torch.studies.paper.evidence.registry import EVIDENCE, Evidence, selected

__all__ = ["EVIDENCE", "Evidence", "FigureData", "Made", "make_evidence", "selected"]


@dataclass(frozen=True)
class Made:
    """A figure that has been computed, drawn and written.

    Args:
        evidence: what it is.
        findings: its numbers by name.
        picture: its PNG file.
        table: its CSV file.
        pixels: (H,W,3) uint8 the picture, red, green, blue.
        seconds: how long it took to compute, draw and write.
    """

    evidence: Evidence
    findings: dict[str, float]
    picture: Path
    table: Path
    pixels: NDArray[np.uint8]
    seconds: float


def make_evidence(plan: Plan, folder: Path, names: Sequence[str] = ()) -> Iterator[Made]:
    """Compute, draw and write figures one after the other, as ``NAME.png`` and ``NAME.csv``.

    Args:
        plan: the study; its locator is not used, except for Fig. 19's outline.
        folder: where the files go; made if missing.
        names: the figures; all by default.

    Yields:
        Each figure once it is written.

    Raises:
        VoccError: an unknown name, before anything is computed; or a file that cannot be written.
    """
    return _make(plan, folder, selected(names))


def _make(plan: Plan, folder: Path, figures: Sequence[Evidence]) -> Iterator[Made]:
    """Do the work of ``make_evidence``, whose names are checked when it is called."""
    from vocc_torch.show.canvas import figure_pixels, save_figure  # loads Matplotlib

    for evidence in figures:
        begin = time.perf_counter()
        data = evidence.compute(plan)
        picture, table = (folder / f"{evidence.name}.{suffix}" for suffix in ("png", "csv"))
        figure = evidence.draw(data)
        save_figure(figure, picture)
        write_rows(table, data.rows())
        pixels = figure_pixels(figure)
        seconds = time.perf_counter() - begin
        yield Made(evidence, data.findings(), picture, table, pixels, seconds)
