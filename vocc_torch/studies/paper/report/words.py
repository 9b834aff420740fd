"""How the report writes numbers, units, receivers and readings."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from vocc_torch.measure.intervals import Interval
from vocc_torch.show.report.inline import literal
from vocc_torch.show.styles import LOCATED
from vocc_torch.studies.paper.scorecard.reading import Reading
from vocc_torch.studies.paper.scorecard.words import percent, rate

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

_NBSP, _WORD_JOINER = "\N{NO-BREAK SPACE}", "\N{WORD JOINER}"
_UNIT = re.compile(r"(?<=\d) (?=(?:%|lx|cd/m|mm|min|ms|m|kbps)(?![a-z]))")
_HYPHEN = re.compile(r"(?<=\de-)(?=\d)|(?<=\b[IVX]-)(?=[A-D])|(?<=-[A-D]-)(?=\d)")
_PLACE = re.compile(r"\b(Figs?\.?|Eqs?\.?|Table|job|batch) (?=\d)")
_PERCENT = re.compile(r"(?<=\d)%")
_MINUS = re.compile(r"(?<![\w.)])-(?=\d)")
_MINUS_ZERO = re.compile("\N{MINUS SIGN}0(?![.\\d])")
_RECEIVER = re.compile(r"\b(" + "|".join(sorted(RECEIVERS, key=len, reverse=True)) + r")\b")
_FEATURES = re.compile(r"\b(?:agr|gri|ngr)(?:\+(?:agr|gri|ngr))*\b")
_LONG = re.compile(r"\b\d{2,}\.\d{3,}\b")


def plain(text: str) -> str:
    r"""Write words of the scorecard for people: receivers by name, no line ends between number and unit.

    Example:
        >>> plain("flda_3 0.3 at 3% contrast and 8000 cd/m2").replace("\xa0", "~")
        'AGR + GRI + NGR 0.3 at 3~% contrast and 8000~cd/m²'
    """
    text = _RECEIVER.sub(lambda match: RECEIVERS[match[0]], text)
    text = _FEATURES.sub(lambda match: match[0].upper().replace("+", " + "), text)
    text = _LONG.sub(lambda match: f"{float(match[0]):.1f}", text)
    text = _PERCENT.sub(" %", text)
    text = _MINUS_ZERO.sub("0", _MINUS.sub("\N{MINUS SIGN}", text.replace("cd/m2", "cd/m\u00b2")))
    return spaced(text.replace("[inf", "[\N{INFINITY}").replace(", inf]", ", \N{INFINITY}]"))


def spaced(text: str) -> str:
    r"""Keep numbers with their units in one line, words with the number of a figure, and powers of ten.

    Example:
        >>> spaced("Fig. 22 at 8000 lx, 24 %").replace("\xa0", "~"), len(spaced("6.6e-4"))
        ('Fig.~22 at 8000~lx, 24~%', 7)
    """
    text = _PLACE.sub(rf"\1{_NBSP}", _UNIT.sub(_NBSP, text))
    return _HYPHEN.sub(_WORD_JOINER, text)


def inline(text: str) -> str:
    r"""Write words of the scorecard as inline text that stands for itself.

    Example:
        >>> print(inline("0.52 [0.39, 0.68]"))
        0.52 \[0.39, 0.68\]
    """
    return literal(plain(text))


def sentence(text: str) -> str:
    """Begin with a capital letter and end with a full stop.

    Example:
        >>> sentence("the order differs")
        'The order differs.'
    """
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def reading_text(reading: Reading) -> str:
    r"""Name a reading for people.

    Example:
        >>> reading_text(Reading(25.0, "paper", {}, {})).replace("\xa0", " ")
        '25 mm lens, panel located'
    """
    return f"{reading.focal_length_mm:g}{_NBSP}mm lens, {LOCATED.get(reading.locator, reading.locator)}"


def rate_interval(ber: float, low: float, high: float) -> str:
    r"""Write a rate with its interval; a limit where there was no error.

    Example:
        >>> told = rate_interval(5e-4, 4e-4, 6.2e-4), rate_interval(0, 0, 3e-5)
        >>> [text.replace("\u2060", "").replace("\xa0", "~") for text in told]
        ['5.0e-4 [4.0e-4, 6.2e-4]', '<~3.0e-5']
    """
    return spaced(f"{rate(ber)} [{rate(low)}, {rate(high)}]" if ber > 0 else f"<{_NBSP}{rate(high)}")


def rate_with(ber: float, interval: Interval) -> str:
    """Write a rate with its interval, as :func:`rate_interval`."""
    return rate_interval(ber, interval.low, interval.high)


def share_interval(share: float, low: float, high: float) -> str:
    r"""Write a share with its interval, in per cent.

    Example:
        >>> share_interval(0.913, 0.89, 0.93).replace("\xa0", "~")
        '91~% [89, 93]'
    """
    return plain(f"{percent(share)} [{100 * low:.0f}, {100 * high:.0f}]")


def ratio_interval(ratio: float, low: float, high: float) -> str:
    """Write a ratio with its interval; where the value is infinite only the low end is known.

    Example:
        >>> ratio_interval(2.54, 1.85, 3.14), ratio_interval(math.inf, 5.18, math.inf)
        ('2.54 [1.85, 3.14]', 'at least 5.18')
    """
    if math.isinf(ratio):
        return f"at least {low:.3g}"
    upper = "\N{INFINITY}" if math.isinf(high) else f"{high:.3g}"
    return f"{ratio:.3g} [{low:.3g}, {upper}]"


def listed(parts: Sequence[str], last: str = "and") -> str:
    """Join words as a sentence does.

    Example:
        >>> listed(["a", "b", "c"]), listed(["a"])
        ('a, b and c', 'a')
    """
    *first, end = parts
    return f"{', '.join(first)} {last} {end}" if first else end
