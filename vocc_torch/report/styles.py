"""How results look and read wherever they are shown: names, colours, markers, lines, and numbers as text."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import cycle
from typing import Any, Literal

import yaml


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
    line: Literal["-", "--", "-.", ":"]


LOOKS: Any = yaml.safe_load(
    files(__package__).joinpath("styles.yaml").read_text("utf-8")
)
"""The tables of ``styles.yaml``."""
_KNOWN = {name: Style(*look) for name, look in LOOKS["receivers"].items()}


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
    looks = zip(
        *(cycle(LOOKS[part]) for part in ("colours", "markers", "lines")), strict=True
    )
    others = zip(sorted(set(names) - set(_KNOWN)), looks, strict=False)
    known = _KNOWN | {
        name: Style(name.replace("_", " "), *look) for name, look in others
    }
    return {name: known[name] for name in names}


def axis_label(axis: str) -> str:
    """Give an axis's name for people, with its unit; an unknown axis keeps its own name.

    Example:
        >>> axis_label("distance_m"), axis_label("blooming.sigma_px")
        ('Distance (m)', 'blooming.sigma_px')
    """
    return str(LOOKS["axes"].get(axis, axis))


def place_text(axis: str, value: float) -> str:
    """Write a value of an axis with its unit.

    Example:
        >>> place_text("ambient_lx", 8000.0), place_text("contrast", 0.33)
        ('8000 lx', '33 % contrast')
    """
    if axis == "contrast":
        return f"{100 * value:.0f} % contrast"
    unit = axis_label(axis).partition("(")[2].rstrip(")")
    return f"{value_text(value)} {unit or axis}"


def scale_of(values: Sequence[float], axis: str = "") -> str:
    """Give the scale of an axis: logarithmic for values above 0 over more than a decade.

    Args:
        values: of the axis.
        axis: its name; a contrast is a share of a whole, and always linear.

    Example:
        >>> scale_of([1e3, 32e3]), scale_of([30.0, 70.0]), scale_of([0.01, 0.5], "contrast")
        ('log', 'linear', 'linear')
    """
    is_wide = bool(values) and 0 < 10 * min(values) < max(values)
    return "log" if is_wide and axis != "contrast" else "linear"


def value_text(value: float) -> str:
    """Write an axis value in as few digits as identify it.

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


def range_text(numbers: Iterable[int]) -> str:
    r"""Write a whole number, or the least and the most of several.

    Example:
        >>> range_text([64, 64]), range_text([64, 1000, 512]), range_text([])
        ('64', '64 to 1\u2009000', 'no')
    """
    ends = sorted(set(numbers))
    return " to ".join(map(count_text, [*ends[:1], *ends[1:][-1:]])) or "no"


def rate_text(rate: float) -> str:
    """Write a rate with two digits.

    Example:
        >>> rate_text(6.6e-4), rate_text(0.0)
        ('6.6e-4', '0')
    """
    mantissa, exponent = f"{rate:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}" if rate else "0"


def rate_or_limit(rate: float, high: float) -> str:
    """Write a rate, or its limit where there were no errors.

    Example:
        >>> rate_or_limit(6.6e-4, 1e-3), rate_or_limit(0.0, 1e-3)
        ('6.6e-4', '< 1.0e-3')
    """
    return rate_text(rate) if rate else f"< {rate_text(high)}"
