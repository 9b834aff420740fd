"""Drawing of Fig. 20: panels at three contrasts."""

from __future__ import annotations

from matplotlib.figure import Figure

from vocc_torch.show.canvas import INK, QUIET, new_figure, write_title
from vocc_torch.studies.paper.evidence_figures.panels import Floats, Picture, panel_axes

_MET = 0.005
"""Contrasts this close are the same in whole percents."""


def contrast_figure(
    title: str,
    *,
    pictures: tuple[Picture, ...],
    contrasts: Floats,
    seen: Floats,
    conditions: Floats,
    wanted: Floats,
) -> Figure:
    """Draw the paper's scenes above, and scenes that have the contrast it states below.

    Args:
        title: the figure's.
        pictures: six panels.
        contrasts: (6,) that come out before any blur.
        seen: (6,) the same in the pictures.
        conditions: (6,4) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        wanted: (6,) that the paper states.
    """
    figure = new_figure(10, 8.4)
    for index, picture in enumerate(pictures):
        row, column = divmod(index, 3)
        axes = figure.add_axes((0.075 + 0.31 * column, 0.55 - 0.44 * row, 0.28, 0.28 * 10 / 8.4))
        panel_axes(axes, picture)
        stated = (
            f" (paper: {100 * wanted[index]:.0f} %)" if abs(contrasts[index] - wanted[index]) > _MET else ""
        )
        said = f"contrast {100 * contrasts[index]:.1f} %{stated}"
        axes.set_title(said, fontsize=11.5, color=INK, loc="left", pad=20, fontweight="bold")
        ambient, luminance, _, background = conditions[index]
        parts = (f"{ambient:,.0f} lx", f"{luminance:,.0f} cd/m²", f"background {background:.0f}")
        scene = " \N{MIDDLE DOT} ".join(parts).replace(",", "\N{THIN SPACE}")
        axes.text(0, 1.025, scene, transform=axes.transAxes, fontsize=9.5, color=QUIET)
        within = f"in the picture {100 * seen[index]:.1f} %"
        axes.text(
            0.5, -0.025, within, transform=axes.transAxes, fontsize=10, color=INK, ha="center", va="top"
        )
        if column == 0:
            axes.set_ylabel(
                ("The paper's scenes", "The stated contrast")[row], fontsize=12, color=INK, labelpad=10
            )
    footnote = (
        "Contrast: (G_on \N{MINUS SIGN} G_off) / 255 of LEDs before any blur, by Eqs 1 to 3, "
        "white clipped at 255; in the picture: of the LEDs' centre pixels,\n"
        f"after blooming. All at {conditions[0, 2]:.0f} m with the same bits."
    )
    write_title(figure, title, footnote)
    return figure
