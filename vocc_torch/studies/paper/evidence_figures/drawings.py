"""The drawings by the figures' names."""

from __future__ import annotations

from collections.abc import Callable

from matplotlib.figure import Figure

from vocc_torch.show.timing_figure import timing_figure
from vocc_torch.studies.paper.evidence_figures.binarisation import histogram_figure
from vocc_torch.studies.paper.evidence_figures.blooming import interference_figure, order_figure
from vocc_torch.studies.paper.evidence_figures.contrast import contrast_figure
from vocc_torch.studies.paper.evidence_figures.gradients import gradients_figure
from vocc_torch.studies.paper.evidence_figures.overlap import overlap_figure
from vocc_torch.studies.paper.evidence_figures.projection import projection_figure
from vocc_torch.studies.paper.evidence_figures.spread import grey_agr_figure, gri_figure, ngr_figure

DRAWINGS: dict[str, Callable[..., Figure]] = {
    "fig04": overlap_figure,
    "fig05_06": interference_figure,
    "fig08": grey_agr_figure,
    "fig09": gradients_figure,
    "fig10": gri_figure,
    "fig12": ngr_figure,
    "fig13_14": projection_figure,
    "fig17": order_figure,
    "fig19": histogram_figure,
    "fig20": contrast_figure,
    "fig25": timing_figure,
}
"""Each takes the figure's title, and the fields of its data as keyword arguments."""
