"""The paper's figures by name: what each shows, what computes it and what draws it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import Plan
from vocc_torch.studies.paper.evidence.binarisation import frame_histogram
from vocc_torch.studies.paper.evidence.blooming import blooming_interference, blur_order
from vocc_torch.studies.paper.evidence.contrast import contrast_panels
from vocc_torch.studies.paper.evidence.data import FigureData
from vocc_torch.studies.paper.evidence.gradients import inward_gradients
from vocc_torch.studies.paper.evidence.overlap import grey_overlap
from vocc_torch.studies.paper.evidence.projection import projection
from vocc_torch.studies.paper.evidence.spread import grey_and_agr, gri_and_agr, ngr_and_others
from vocc_torch.studies.paper.evidence.timing import processing_time

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Evidence:
    """One figure of the paper.

    Args:
        name: its name here.
        title: its headline.
        caption: what the paper shows in it.
        compute: gives its data from a plan.
    """

    name: str
    title: str
    caption: str
    compute: Callable[[Plan], FigureData]

    def draw(self, data: FigureData) -> Figure:
        """Draw the data: its fields are the drawing's arguments, by name."""
        # Matplotlib is loaded here and not above: computing needs none.
        from vocc_torch.studies.paper.evidence_figures.drawings import DRAWINGS

        fields = dataclasses.fields(data)  # type: ignore[arg-type]  # every FigureData is a dataclass
        arrays = {field.name: getattr(data, field.name) for field in fields}
        return DRAWINGS[self.name](self.title, **arrays)


_FIGURES = (
    Evidence(
        "fig04",
        "Fig. 4: greys of On and Off LEDs overlap between frames",
        "On LEDs of one frame are darker than Off LEDs of another, so no fixed threshold serves every frame.",
        grey_overlap,
    ),
    Evidence(
        "fig05_06",
        "Figs 5 and 6: blooming turns an Off LED's grey into that of an On LED",
        "A panel without and with blooming; an Off LED among bright neighbours can be mistaken for On.",
        blooming_interference,
    ),
    Evidence(
        "fig08",
        "Fig. 8: average grey against average greyscale ratio (AGR)",
        "Twenty of 100 sample frames; over the 100, average greys of On and Off overlap and AGR parts them.",
        grey_and_agr,
    ),
    Evidence(
        "fig09",
        "Fig. 9: gradients and radial inward vectors inside LEDs",
        "In an On LED gradients point inwards and GRI is positive; in an Off LED outwards, GRI negative.",
        inward_gradients,
    ),
    Evidence(
        "fig10",
        "Fig. 10: gradient radial inwardness (GRI), alone and with AGR",
        "GRI alone parts most LEDs; AGR and GRI together part all of them.",
        gri_and_agr,
    ),
    Evidence(
        "fig12",
        "Fig. 12: neighbour greyscale ratio (NGR) and the others",
        "NGR alone overlaps completely, but it helps AGR and it helps GRI; the three together part best.",
        ngr_and_others,
    ),
    Evidence(
        "fig13_14",
        "Figs 13 and 14: projection on Fisher's discriminant vector w",
        "The vector w on which On and Off LEDs lie farthest apart for their spread, with the threshold.",
        projection,
    ),
    Evidence(
        "fig17",
        "Fig. 17: a Gaussian after gamma encoding against one before it",
        "Blurred after gamma, as graphics software does, LEDs look dull; before it, as in a camera, bright.",
        blur_order,
    ),
    Evidence(
        "fig19",
        "Fig. 19: grey values of a whole frame and Otsu's threshold",
        "The background fills most of the frame, darker than the panel; Otsu's threshold parts the two.",
        frame_histogram,
    ),
    Evidence(
        "fig20",
        "Fig. 20: panels at a contrast of 6, 30 and 50 %",
        "Blooming grows with the contrast of On and Off LEDs, which follows from ambient light and LEDs.",
        contrast_panels,
    ),
    Evidence(
        "fig25",
        "Fig. 25: processing time, normalised to panel detection",
        "Bit detectors take 5, 7, 12 and 14 % of panel detection's time; NGR adds 1.78 % to the whole.",
        processing_time,
    ),
)

EVIDENCE: dict[str, Evidence] = {figure.name: figure for figure in _FIGURES}
"""The figures by name, in the paper's order."""


def selected(names: Sequence[str] = ()) -> tuple[Evidence, ...]:
    """Give the named figures in the paper's order, each once; no name means all.

    Raises:
        VoccError: an unknown name.

    Example:
        >>> [figure.name for figure in selected(["fig20", "fig04"])]
        ['fig04', 'fig20']
        >>> selected(["fig99"])  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: 'fig99' is not a figure: known are fig04, fig05_06, ...
    """
    for name in names:
        if name not in EVIDENCE:
            raise VoccError(f"{name!r} is not a figure: known are {', '.join(EVIDENCE)}")
    return tuple(figure for name, figure in EVIDENCE.items() if not names or name in names)
