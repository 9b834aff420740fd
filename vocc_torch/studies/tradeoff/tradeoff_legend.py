"""What fillings, sizes and strengths mean in the picture of the price list, and what measures its texts."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vocc_torch.show.canvas import INK, QUIET
from vocc_torch.studies.tradeoff.tradeoff_dots import LOCATED_BY, STRENGTH, FillStyle


def text_renderer(figure: Figure) -> RendererBase:
    """Give what measures texts on a figure whose canvas draws pixels."""
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    renderer: RendererBase = canvas.get_renderer()  # type: ignore[no-untyped-call]  # Matplotlib has no hint
    return renderer


def draw_legend(
    figure: Figure,
    faces: Mapping[str, FillStyle],
    *,
    bottom: float,
    varied: bool,
    doubtful: bool,
    beaten: bool,
) -> None:
    """Write the legend as a row.

    Args:
        figure: the figure.
        faces: how the markers of each locator are filled.
        bottom: its lower end, as a share of the figure's height.
        varied: whether there are receivers at other settings.
        doubtful: whether there are some that are beaten, perhaps by chance.
        beaten: whether there are some that are surely beaten.
    """
    handles = [_sign(LOCATED_BY[name].removeprefix("the "), fill=face) for name, face in faces.items()]
    if varied:
        handles.append(_sign("other K, gradient or precision", markersize=5.5))
    handles.append(Line2D([], [], color=INK, linewidth=1.5, label="frontier"))
    if doubtful:
        handles.append(_sign("beaten, perhaps by chance", alpha=STRENGTH["perhaps"]))
    if beaten:
        handles.append(_sign("surely beaten", alpha=STRENGTH["beaten"]))
    figure.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(0.012, bottom),
        ncols=len(handles),
        frameon=False,
        fontsize=10,
        labelcolor=INK,
        handletextpad=0.35,
        columnspacing=1.5,
        borderaxespad=0,
    )


def _sign(label: str, *, markersize: float = 9.0, fill: FillStyle = "full", alpha: float = 1.0) -> Line2D:
    """Make a marker with its meaning."""
    return Line2D(
        [],
        [],
        color=QUIET,
        alpha=alpha,
        marker="o",
        markersize=markersize,
        markeredgewidth=1.5 if fill != "full" else None,
        fillstyle=fill,
        markerfacecolor="white" if fill == "none" else QUIET,
        markerfacecoloralt="white",
        linestyle="none",
        label=label,
    )
