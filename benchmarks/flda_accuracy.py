"""How far FLDA in float64 is from the 50-digit answer, by condition number: a table and a figure.

    python benchmarks/flda_accuracy.py

Writes docs/results/flda_accuracy.csv and docs/images/flda-accuracy.png, in under a minute.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from exact_flda import DIGITS, FAMILIES, SAMPLES, Draw, draws
from matplotlib.axes import Axes

from vocc_torch.files import write_atomically
from vocc_torch.receiver.discriminant import CONDITION_LIMIT
from vocc_torch.report import canvas
from vocc_torch.report.canvas import FINE_GRID, INK, QUIET

DOCS = Path(__file__).resolve().parents[1] / "docs"
TABLE, PICTURE = DOCS / "results" / "flda_accuracy.csv", DOCS / "images" / "flda-accuracy.png"
DRAWS, SEED = 500, 5
EPS = float(np.finfo(np.float64).eps)
BLUE, VERMILION, SHADE = "#0072B2", "#D55E00", "#FBF1DC"  # of Okabe and Ito's palette, as reporting/styles.py
COLUMNS = tuple(Draw.__dataclass_fields__)


def bound(condition: float) -> float:
    """Give the error that is allowed at a condition number."""
    return 10 * condition * EPS


def table_text(found: list[Draw]) -> str:
    """Write the comparisons as CSV, ordered by condition number."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for one in sorted(found, key=lambda draw: draw.condition):
        numbers = (f"{v:.3e}" for v in (one.condition, one.offset, one.direction_error, one.threshold_error))
        writer.writerow([one.family, one.features, *numbers, int(one.warned)])
    return out.getvalue()


def _clouds(axes: Axes, found: list[Draw]) -> None:
    """Draw the errors: full marks where nothing was said, rings where the warning came."""
    for name, colour, marker in (("direction", BLUE, "o"), ("threshold", VERMILION, "D")):
        for warned in (False, True):
            chosen = [one for one in found if one.warned == warned]
            x = [one.reach for one in chosen]
            y = [max(getattr(one, f"{name}_error"), 1e-18) for one in chosen]
            face = "none" if warned else colour
            label = None if warned else f"error of the {name}"
            size = 15 if marker == "o" else 11
            axes.scatter(
                x, y, size, marker=marker, facecolor=face, edgecolor=colour if warned else "none",
                linewidth=0.8, alpha=0.6, label=label, zorder=3,
            )  # fmt: skip


def _lines(axes: Axes) -> None:
    """Draw the bound, the spacing of float64 and the region where the warning comes."""
    ends = np.array([1.0, 1e18])
    axes.plot([ends[0], CONDITION_LIMIT], [bound(1), bound(CONDITION_LIMIT)], color=INK, lw=1.6)
    axes.plot([CONDITION_LIMIT, ends[1]], [bound(CONDITION_LIMIT), bound(ends[1])], color=QUIET, lw=1, ls=":")
    axes.axhline(EPS, color=QUIET, lw=1, ls="--")
    axes.axvspan(CONDITION_LIMIT, ends[1], color=SHADE, lw=0, zorder=0)


def _words(axes: Axes) -> None:
    """Name the lines where they run, so that the legend holds the dots only."""
    axes.figure.draw_without_rendering()
    (x0, y0), (x1, y1) = axes.transData.transform([(1e2, bound(1e2)), (1e8, bound(1e8))])
    slope = float(np.degrees(np.arctan2(y1 - y0, x1 - x0)))
    axes.text(
        2e5, bound(2e5) * 3, "10 x condition number x offset x machine epsilon",
        rotation=slope, rotation_mode="anchor", fontsize=10.5, color=INK, va="bottom",
    )  # fmt: skip
    axes.text(7e11, EPS / 1.6, "machine epsilon, 2.2e-16", fontsize=9.5, color=QUIET, va="top", ha="right")
    axes.text(
        1.7e12, 4e-16, "condition number above 1e12:\nFLDAWarning, least-norm or\nseparating direction",
        fontsize=10, color=INK, va="bottom", linespacing=1.4,
    )  # fmt: skip


def draw_figure(found: list[Draw], path: Path) -> None:
    """Draw error against condition number."""
    figure = canvas.new_figure(10, 6.4)
    axes = figure.add_axes((0.085, 0.185, 0.895, 0.725))
    axes.set(xscale="log", yscale="log", xlim=(1e1, 1e17), ylim=(3e-19, 30))
    axes.set_xlabel(
        "Condition number of the within-class covariance x offset of the features, in their deviations"
    )
    axes.set_ylabel("Relative error")
    axes.set_xticks(10.0 ** np.arange(1, 18, 2))
    axes.set_yticks(10.0 ** np.arange(-18, 2, 3))
    axes.minorticks_off()
    axes.grid(color=FINE_GRID, lw=0.8)
    canvas.quiet_axes(axes)
    _lines(axes)
    _clouds(axes, found)
    _words(axes)
    axes.legend(loc="upper left", frameon=False, fontsize=10.5, markerscale=1.6, handletextpad=0.3)
    held = [one for one in found if not one.warned]
    worst = max(max(one.direction_error, one.threshold_error) / one.reach / EPS for one in held)
    footnote = (
        f"{len(found)} training sets of {SAMPLES} samples, 2 to 8 features, in {len(FAMILIES)} families, "
        f"each against its {DIGITS}-digit answer.\nThe {len(held)} solved without a warning: at most "
        f"{worst:.1f} x condition number x offset x machine epsilon. Rings: solved with the warning."
    )
    canvas.write_title(figure, "FLDA in float64 against 50-digit arithmetic", footnote)
    canvas.save_figure(figure, path)


def main() -> None:
    """Compare, write, and say what came out."""
    found = draws(DRAWS, SEED)
    write_atomically(TABLE, table_text(found).encode())
    draw_figure(found, PICTURE)
    held = [one for one in found if not one.warned]
    for name in ("direction_error", "threshold_error"):
        worst = max(getattr(one, name) / one.reach / EPS for one in held)
        print(
            f"{name}: at most {worst:.2f} x condition x offset x eps in {len(held)} sets; {len(found)} in all"
        )


if __name__ == "__main__":
    main()
