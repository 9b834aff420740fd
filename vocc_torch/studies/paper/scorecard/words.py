"""Numbers as the scorecard writes them."""

from __future__ import annotations

from collections.abc import Iterable

from vocc_torch.measure.curve import Row

UNITS = {
    "ambient_lx": "lx",
    "led_luminance_cd_m2": "cd/m2",
    "distance_m": "m",
}
"""Units of the axes' values; a contrast is written in per cent."""


def rate(value: float) -> str:
    """Write a bit error rate with two digits.

    Example:
        >>> rate(6.6e-4), rate(0.0)
        ('6.6e-4', '0')
    """
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def point(row: Row) -> str:
    """Write a bit error rate with its interval, or its limit where there was no error.

    Example:
        >>> point(Row("s", "distance_m", 30.0, "flda_3", "truth", 1, 64, 0.0, 0.0, 0.0, 0.04, 0, 0, "x"))
        '< 4.0e-2, no error in 1 frame'
    """
    if row.error_free:
        return f"< {rate(row.ber_high)}, no error in {row.frames} frame{'s' if row.frames > 1 else ''}"
    return f"{rate(row.ber)} [{rate(row.ber_low)}, {rate(row.ber_high)}]"


def percent(share: float, digits: int = 0) -> str:
    """Write a share in per cent.

    Example:
        >>> percent(0.236), percent(0.0178, 2)
        ('24 %', '1.78 %')
    """
    return f"{100 * share:.{digits}f} %"


WIDEST_SHARE = 1.0
"""Beyond this width the interval of a share tells nothing of its size."""


def percent_interval(share: float, low: float, high: float, digits: int = 0) -> str:
    """Write a share with its interval, in per cent; no number where that is wider than 100 points.

    Example:
        >>> percent_interval(0.24, 0.1, 0.35), percent_interval(1.0, -126.63, 1.0)
        ('24 % [10, 35]', 'not known (95 % interval wider than 100 percentage points)')
    """
    if high - low > WIDEST_SHARE:
        return "not known (95 % interval wider than 100 percentage points)"
    return f"{percent(share, digits)} [{100 * low:.{digits}f}, {100 * high:.{digits}f}]"


def place(axis: str, value: float) -> str:
    """Write a value of an axis with its unit.

    Example:
        >>> place("ambient_lx", 8000.0), place("contrast", 0.33)
        ('8000 lx', '33 % contrast')
    """
    return places(axis, (value,))


def places(axis: str, values: Iterable[float]) -> str:
    """Write values of an axis one by one, with their unit.

    Example:
        >>> places("ambient_lx", (2000.0, 8000.0)), places("contrast", (0.27, 0.33, 0.39))
        ('2000 and 8000 lx', '27, 33 and 39 % contrast')
    """
    shown = [f"{100 * value:.0f}" if axis == "contrast" else f"{value:g}" for value in values]
    unit = "% contrast" if axis == "contrast" else UNITS.get(axis, axis)
    return f"{' and '.join([*filter(None, [', '.join(shown[:-1])]), shown[-1]])} {unit}"


def listed(names: list[str], most: int = 4) -> str:
    """Write the first of many names.

    Example:
        >>> listed(["a", "b", "c"], 2), listed(["a", "b"])
        ('a, b and 1 more', 'a, b')
    """
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"
