"""What colours, fillings and sizes mean in the picture of the price list, and what measures its texts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vocc_torch.reporting.canvas import INK, QUIET
from vocc_torch.reporting.styles import Style

FillStyle = Literal["full", "none", "left", "bottom"]

FAINT = 0.38
"""Opacity of what another beats."""

_LOCATED_BY = {"truth": "true corners", "paper": "the paper's locator", "refined": "refined locator"}
_LEFT, _TOP, _GAP = 0.765, 0.885, 0.006


def text_renderer(figure: Figure) -> RendererBase:
    """Give what measures texts on a figure whose canvas draws pixels."""
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    renderer: RendererBase = canvas.get_renderer()  # type: ignore[no-untyped-call]  # Matplotlib has no hint
    return renderer


def draw_legend(
    figure: Figure,
    styles: Mapping[str, Style],
    faces: Mapping[str, FillStyle],
    *,
    varied: bool,
    limits: bool,
) -> None:
    """Write the legend at the figure's right, one part below the other.

    Args:
        figure: with a canvas that draws pixels.
        styles: by receiver.
        faces: how the markers of each locator are filled.
        varied: whether there are receivers at other settings.
        limits: whether there are receivers without errors.
    """
    receivers = [
        _sign(one.label, marker=one.marker, color=one.colour, markersize=9.0) for one in styles.values()
    ]
    located = [_sign(_LOCATED_BY[name], fill=face, markersize=9.0) for name, face in faces.items()]
    if varied:
        located.append(_sign("other K, gradient\nor precision", markersize=5.5))
    others = [
        Line2D([], [], color=INK, linewidth=1.5, label="frontier"),
        _sign("beaten by another", alpha=FAINT + 0.1, markersize=9.0),
    ]
    if limits:
        others.append(_sign("no error: 95 % limit", marker=r"$\downarrow$", markersize=10.0))
    top = _TOP
    for title, handles in (("Receivers", receivers), ("Panel located by", located), (None, others)):
        legend = figure.legend(
            handles=handles,
            title=title,
            loc="upper left",
            bbox_to_anchor=(_LEFT, top),
            frameon=False,
            fontsize=10.2,
            title_fontproperties={"weight": "bold", "size": 10.5},
            alignment="left",
            labelcolor=INK,
            handletextpad=0.5,
            labelspacing=0.42,
        )
        top -= legend.get_window_extent(text_renderer(figure)).height / figure.bbox.height + _GAP


def _sign(
    label: str,
    *,
    markersize: float,
    marker: str = "o",
    color: str = QUIET,
    fill: FillStyle = "full",
    alpha: float = 1.0,
) -> Line2D:
    """Make a marker with its meaning."""
    return Line2D(
        [],
        [],
        color=color,
        alpha=alpha,
        marker=marker,
        markersize=markersize,
        markeredgewidth=1.5 if fill != "full" else None,
        fillstyle=fill,
        markerfacecolor="white" if fill == "none" else color,
        markerfacecoloralt="white",
        linestyle="none",
        label=label,
    )
