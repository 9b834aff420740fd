"""Drawing of Fig. 20: panels at three contrasts."""

from __future__ import annotations

from matplotlib.figure import Figure

from vocc_torch.reporting.canvas import INK, QUIET, new_figure, write_title
from vocc_torch.reporting.evidence.panels import Floats, Picture, panel_axes


def contrast_figure(
    title: str, *, pictures: tuple[Picture, ...], contrasts: Floats, conditions: Floats, wanted: Floats
) -> Figure:
    """Draw the paper's scenes above, and scenes that have the contrast it states below.

    Args:
        title: the figure's.
        pictures: six panels.
        contrasts: (6,) that come out.
        conditions: (6,4) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        wanted: (6,) that the paper states.
    """
    figure = new_figure(10, 7.9)
    side, high = 0.265, 0.265 * 10 / 7.9
    for index, picture in enumerate(pictures):
        row, column = divmod(index, 3)
        axes = figure.add_axes((0.09 + 0.305 * column, 0.505 - 0.43 * row, side, high))
        panel_axes(axes, picture)
        met = abs(contrasts[index] - wanted[index]) < 0.005
        said = f"contrast {100 * contrasts[index]:.1f} %"
        stated = "" if met else f", the paper says {100 * wanted[index]:.0f} %"
        axes.set_title(
            said + stated,
            fontsize=11.5,
            color=INK,
            loc="left",
            pad=20,
            fontweight="bold" if met else "normal",
        )
        ambient, luminance, _, background = conditions[index]
        thin = f"{ambient:,.0f} lx \N{MIDDLE DOT} {luminance:,.0f} cd/m² \N{MIDDLE DOT} background {background:.0f}"
        axes.text(
            0, 1.025, thin.replace(",", "\N{THIN SPACE}"), transform=axes.transAxes, fontsize=9.5, color=QUIET
        )
        if column == 0:
            axes.set_ylabel(
                ("The paper's scenes", "The stated contrast")[row], fontsize=12, color=INK, labelpad=10
            )
    footnote = (
        "Contrast: (G_on \N{MINUS SIGN} G_off) / 255 of LEDs before any blur, by Eqs 1 to 3, white clipped at 255. "
        f"All at {conditions[0, 2]:.0f} m with the same bits."
    )
    write_title(figure, title, footnote)
    return figure
