"""How the scorecard and the report write numbers, units, receivers and readings."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from vocc_torch.measure.curve import Row
from vocc_torch.show.styles import LOCATED
from vocc_torch.show.text_table import rate_text

UNITS = {"ambient_lx": "lx", "led_luminance_cd_m2": "cd/m2", "distance_m": "m"}
"""Units of the axes' values; a contrast is written in per cent."""
RECEIVERS = {
    "center_greyscale": "centre greyscale",
    "average_greyscale": "average greyscale",
    "flda_agr_ngr": "AGR + NGR",
    "flda_agr": "AGR",
    "flda_gri": "GRI",
    "flda_ngr": "NGR",
    "flda_2": "AGR + GRI",
    "flda_3": "AGR + GRI + NGR",
}
"""Receivers within a sentence: those of FLDA by their features, as in the figures' legends."""
EXPERIMENTS = {
    "contrast": "contrast",
    "ambient": "ambient light",
    "luminance": "LED luminance",
    "distance": "distance",
}
"""What the experiments vary."""
WIDEST_SHARE = 1.0
"""Beyond this width the interval of a share tells nothing of its size."""

_NBSP, _WORD_JOINER = "\N{NO-BREAK SPACE}", "\N{WORD JOINER}"
_RECEIVER = re.compile(r"\b(" + "|".join(sorted(RECEIVERS, key=len, reverse=True)) + r")\b")
_FEATURES = re.compile(r"\b(?:agr|gri|ngr)(?:\+(?:agr|gri|ngr))*\b")
_LONG = re.compile(r"\b\d{2,}\.\d{3,}\b")
_TYPOGRAPHY = (
    (re.compile(r"(?<=\d)%"), " %"),
    (re.compile(r"cd/m2"), "cd/m\N{SUPERSCRIPT TWO}"),
    (re.compile(r"(?<![\w.)])-(?=\d)"), "\N{MINUS SIGN}"),
    (re.compile("\N{MINUS SIGN}0(?![.\\d])"), "0"),
    (re.compile(r"\binf\b"), "\N{INFINITY}"),
    # A number stays in one line with its unit, a figure with its number, and a power of ten in one piece.
    (re.compile(r"(?<=\d) (?=(?:%|lx|cd/m|mm|min|ms|m|kbps)(?![a-z]))"), _NBSP),
    (re.compile(r"\b(Figs?\.?|Eqs?\.?|Table|job|batch) (?=\d)"), rf"\1{_NBSP}"),
    (re.compile(r"(?<=\de-)(?=\d)|(?<=\b[IVX]-)(?=[A-D])|(?<=-[A-D]-)(?=\d)"), _WORD_JOINER),
)


def plain(text: str) -> str:
    r"""Write words of the scorecard for people: receivers by name, no line ends between number and unit.

    Example:
        >>> plain("flda_3 0.3 at 3% contrast and 8000 cd/m2").replace("\xa0", "~")
        'AGR + GRI + NGR 0.3 at 3~% contrast and 8000~cd/m²'
    """
    text = _RECEIVER.sub(lambda match: RECEIVERS[match[0]], text)
    text = _FEATURES.sub(lambda match: match[0].upper().replace("+", " + "), text)
    text = _LONG.sub(lambda match: f"{float(match[0]):.1f}", text)
    for pattern, written in _TYPOGRAPHY:
        text = pattern.sub(written, text)
    return text


def sentence(text: str) -> str:
    """Write words for people, from a capital letter to a full stop; nothing stays nothing.

    Example:
        >>> sentence("the order differs")
        'The order differs.'
    """
    text = plain(text)
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") or not text else ".")


def point(row: Row) -> str:
    """Write a bit error rate with its interval, or its limit where there was no error.

    Example:
        >>> point(Row("s", "distance_m", 30.0, "flda_3", "truth", 1, 64, 0.0, 0.0, 0.0, 0.04, 0, 0, "x"))
        '< 4.0e-2, no error in 1 frame'
    """
    if row.error_free:
        return f"< {rate_text(row.ber_high)}, no error in {row.frames} frame{'s' if row.frames > 1 else ''}"
    return f"{rate_text(row.ber)} [{rate_text(row.ber_low)}, {rate_text(row.ber_high)}]"


def percent(share: float, digits: int = 0) -> str:
    """Write a share in per cent.

    Example:
        >>> percent(0.236), percent(0.0178, 2)
        ('24 %', '1.78 %')
    """
    return f"{100 * share:.{digits}f} %"


def share_interval(share: float, low: float, high: float) -> str:
    """Write a share with its interval, in per cent; no number where that is wider than 100 points.

    Example:
        >>> share_interval(0.24, 0.1, 0.35), share_interval(1.0, -126.63, 1.0)
        ('24 % [10, 35]', 'not known (95 % interval wider than 100 percentage points)')
    """
    if high - low > WIDEST_SHARE:
        return "not known (95 % interval wider than 100 percentage points)"
    return f"{percent(share)} [{100 * low:.0f}, {100 * high:.0f}]"


def place(axis: str, *values: float) -> str:
    """Write values of an axis with their unit.

    Example:
        >>> place("ambient_lx", 8000.0), place("contrast", 0.27, 0.33, 0.39)
        ('8000 lx', '27, 33 and 39 % contrast')
    """
    unit = "% contrast" if axis == "contrast" else UNITS.get(axis, axis)
    return f"{joined([f'{100 * v:.0f}' if axis == 'contrast' else f'{v:g}' for v in values])} {unit}"


def joined(parts: Sequence[str]) -> str:
    """Join words as a sentence does.

    Example:
        >>> joined(["a", "b", "c"]), joined(["a"])
        ('a, b and c', 'a')
    """
    *first, last = parts
    return f"{', '.join(first)} and {last}" if first else last


def listed(names: Iterable[str], most: int = 4) -> str:
    """Write the first of many names.

    Example:
        >>> listed(["a", "b", "c"], 2), listed(["a", "b"])
        ('a, b and 1 more', 'a, b')
    """
    every = list(names)
    rest = len(every) - most
    return ", ".join(every[:most]) + (f" and {rest} more" if rest > 0 else "")


def reading_text(focal_length_mm: float, locator: str) -> str:
    r"""Name a reading for people.

    Example:
        >>> reading_text(25.0, "paper").replace("\xa0", " ")
        '25 mm lens, panel located'
    """
    return f"{focal_length_mm:g}{_NBSP}mm lens, {LOCATED.get(locator, locator)}"
