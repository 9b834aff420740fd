"""One name, colour, marker and line for each receiver and axis, wherever results are shown."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

LineStyle = Literal["-", "--", "-.", ":"]


@dataclass(frozen=True, slots=True)
class Style:
    """How a receiver is drawn.

    Args:
        label: name for people.
        colour: hexadecimal RGB; those of the paper's receivers are from Okabe and Ito's palette, which
            colour-blind readers can tell apart.
        marker: Matplotlib marker.
        line: Matplotlib line style.
    """

    label: str
    colour: str
    marker: str
    line: LineStyle


_KNOWN = {
    "center_greyscale": Style("Center greyscale", "#000000", "v", ":"),
    "average_greyscale": Style("Average greyscale", "#E69F00", "^", ":"),
    "flda_agr": Style("FLDA: AGR", "#56B4E9", "<", "--"),
    "flda_gri": Style("FLDA: GRI", "#CC79A7", ">", "--"),
    "flda_ngr": Style("FLDA: NGR", "#7A7A7A", "d", "--"),
    "flda_agr_ngr": Style("FLDA: AGR + NGR", "#009E73", "D", "-."),
    "flda_2": Style("FLDA: AGR + GRI", "#0072B2", "s", "-"),
    "flda_3": Style("FLDA: AGR + GRI + NGR", "#D55E00", "o", "-"),
    # The classifiers of conf/classifier: colours after Paul Tol's muted ones, and markers of their own.
    "flda_3_mix": Style("FLDA 3, networks' mix", "#A64A1E", "*", "--"),
    "flda_patch": Style("FLDA on 3 x 3 cells", "#117733", "X", "-"),
    "flda_patch_exposure": Style("FLDA on 3 x 3 cells, exposure", "#44AA99", "p", "--"),
    "lmmse": Style("LMMSE equaliser", "#882255", "h", "-"),
    "mlp_features": Style("MLP on features", "#AA4499", "*", "--"),
    "mlp": Style("MLP on 3 x 3 cells", "#332288", "P", "-"),
    "cnn": Style("CNN on 3 x 3 cells", "#CC6677", "8", "-"),
    "tag_planes": Style("AprilTag's planes", "#8A8A1F", "D", "-."),
    "panel_otsu": Style("Otsu per panel", "#5FB3DD", "H", ":"),
    "panel_kmeans": Style("k-means per panel", "#9C6B2F", "d", ":"),
    "logistic": Style("Logistic regression", "#7A7A7A", "<", "-."),
    "svm": Style("Linear SVM", "#661100", ">", "-."),
    "boosted_trees": Style("Boosted trees", "#C4A63B", "s", "-."),
}
# The palettes have no colour left for others: marker and line tell repeated colours apart.
_FREE_COLOURS = ("#009E73", "#7A7A7A", "#CC79A7", "#000000", "#56B4E9", "#E69F00", "#0072B2", "#D55E00")
_FREE_MARKERS = ("X", "p", "h", "P", "*", "8", "H")
_FREE_LINES: tuple[LineStyle, ...] = ("-.", "--", ":")

_AXIS_LABELS = {
    "ambient_lx": "Ambient light (lx)",
    "led_luminance_cd_m2": "LED luminance (cd/m²)",
    "distance_m": "Distance (m)",
    "contrast": "Contrast (G_on \N{MINUS SIGN} G_off)/255",
}


def receiver_styles(receivers: Iterable[str]) -> dict[str, Style]:
    """Give each receiver its style, in the order given.

    The package's own receivers always look the same. Others keep their names and take the free styles in
    alphabetical order, so the same set of receivers looks the same in every figure.

    Args:
        receivers: names of receivers.

    Example:
        >>> styles = receiver_styles(["flda_3", "small_cnn"])
        >>> styles["flda_3"].label, styles["small_cnn"].label, styles["small_cnn"].colour
        ('FLDA: AGR + GRI + NGR', 'small cnn', '#009E73')
    """
    names = list(dict.fromkeys(receivers))
    free = {}
    for place, name in enumerate(sorted(set(names) - set(_KNOWN))):
        colour, line = _FREE_COLOURS[place % len(_FREE_COLOURS)], _FREE_LINES[place % len(_FREE_LINES)]
        marker = _FREE_MARKERS[place % len(_FREE_MARKERS)]
        free[name] = Style(name.replace("_", " "), colour, marker, line)
    return {name: _KNOWN.get(name) or free[name] for name in names}


def axis_label(axis: str) -> str:
    """Give an axis's name for people, with its unit; an unknown axis keeps its own name.

    Example:
        >>> axis_label("distance_m"), axis_label("blooming.sigma_px")
        ('Distance (m)', 'blooming.sigma_px')
    """
    return _AXIS_LABELS.get(axis, axis)


def value_text(value: float) -> str:
    """Write an axis value in as few digits as tell it.

    Example:
        >>> [value_text(value) for value in (32000.0, 0.12, 2.5e-7)]
        ['32000', '0.12', '2.5e-07']
    """
    return f"{value:.10g}"


def count_text(number: int) -> str:
    r"""Write a whole number with its digits in groups of three.

    Example:
        >>> count_text(1024)
        '1\u2009024'
    """
    return f"{number:,}".replace(",", "\N{THIN SPACE}")


LOCATED = {"paper": "panel located", "truth": "true corners", "refined": "panel located, refined"}
"""Where the panel's corners come from, in words."""
