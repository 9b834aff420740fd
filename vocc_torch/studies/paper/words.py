"""How the scorecard and the report write numbers, units, receivers and readings, in words for people."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.resources import files

import yaml

from vocc_torch.measure.curve import Row
from vocc_torch.measure.estimate import Estimate
from vocc_torch.show.styles import LOCATED, rate_text

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
    **{"contrast": "contrast", "ambient": "ambient light"},
    **{"luminance": "LED luminance", "distance": "distance"},
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

_WRITERS: dict[str, Callable[[float], str]] = {
    "number": lambda value: f"{value:.4g}",
    "share": lambda value: f"{100 * value:.3g} %",
    "area": lambda value: f"{value:.7g}",
    "luminance": lambda value: f"{value:.4g} cd/m2",
    "yes_no": lambda value: "yes" if value else "no",
}
_TIME = re.compile(r"(ms|share)_(\w+?)_(whole_frames|crops)_batch_(\d+)")
_COST = re.compile(r"extra_(total_)?cost_of_ngr_(whole_frames|crops)_batch_(\d+)")


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


def share_interval(share: Estimate) -> str:
    """Write a share with its interval, in per cent; no number where that is wider than 100 points.

    Example:
        >>> share_interval(Estimate(0.24, 0.1, 0.35))
        '24 % [10, 35]'
        >>> share_interval(Estimate(1.0, -126.63, 1.0))
        'not known (95 % interval wider than 100 percentage points)'
    """
    if share.high - share.low > WIDEST_SHARE:
        return "not known (95 % interval wider than 100 percentage points)"
    return f"{percent(share.value)} [{100 * share.low:.0f}, {100 * share.high:.0f}]"


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


def listed(names: Sequence[str], most: int = 4) -> str:
    """Write the first of many names.

    Example:
        >>> listed(["a", "b", "c"], 2), listed(["a", "b"])
        ('a, b and 1 more', 'a, b')
    """
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def reading_text(focal_length_mm: float, locator: str) -> str:
    r"""Name a reading for people.

    Example:
        >>> reading_text(25.0, "paper").replace("\xa0", " ")
        '25 mm lens, panel located'
    """
    return f"{focal_length_mm:g}{_NBSP}mm lens, {LOCATED.get(locator, locator)}"


@cache
def _names() -> list[tuple[re.Pattern[str], str, str]]:
    """Patterns of names: ``numbers.yaml``."""
    text = files(__package__).joinpath("numbers.yaml").read_text("utf-8")
    return [(re.compile(pattern), *written) for pattern, written in yaml.safe_load(text).items()]


def named(name: str, value: float) -> tuple[str, str]:
    r"""A number's name and the number, both for people; an unknown name keeps its words.

    Example:
        >>> named("auc_agr+ngr", 0.9999999), named("wrong_share_gri", 0.0875)[1].replace("\xa0", " ")
        (('AGR + NGR: area under the ROC curve', '0.9999999'), '8.75 %')
    """
    for pattern, label, writer in _names():
        if match := pattern.fullmatch(name):
            parts = {key: part.replace("_", " ") for key, part in match.groupdict().items()}
            number = _WRITERS[writer](value)
            return plain(label.format(**parts)), number if writer == "area" else plain(number)
    return name.replace("_", " "), plain(_WRITERS["number"](value))


def number_table(findings: Mapping[str, float]) -> tuple[list[str], list[tuple[str, ...]]]:
    """Head and rows of a table of a figure's numbers; processing times are laid out by stage.

    Args:
        findings: its numbers by name.
    """
    cells: dict[str, dict[tuple[str, str], str]] = {}
    others = {}
    for name, value in findings.items():
        if match := _TIME.fullmatch(name):
            what, stage, *size = match.groups()
            stage = RECEIVERS.get(stage, stage.replace("_", " "))
            written = f"{value:.3g} ms" if what == "ms" else _WRITERS["share"](value)
        elif match := _COST.fullmatch(name):
            total, *size = match.groups()
            stage = "NGR adds to all image processing" if total else "NGR adds to two features"
            written = _WRITERS["share"](value)
        else:
            others[name] = value
            continue
        row, (frames, batch) = cells.setdefault(stage, {}), size
        row[frames, batch] = ", ".join(filter(None, (row.get((frames, batch)), written)))
    if not cells:
        return ["number", "value"], [named(name, value) for name, value in findings.items()]
    columns = list(dict.fromkeys(at for row in cells.values() for at in row))
    sizes = {"1": "one at a time"}
    head = ["time a frame, and share of panel detection's"]
    head += [f"{at.replace('_', ' ')}, {sizes.get(batch, f'{batch} at once')}" for at, batch in columns]
    rows = [(stage, *(plain(row.get(at, "")) for at in columns)) for stage, row in cells.items()]
    rest = (named(name, value) for name, value in others.items() if not name.endswith(("_low", "_high")))
    return head, [*rows, *((*one, *[""] * (len(columns) - 1)) for one in rest)]
