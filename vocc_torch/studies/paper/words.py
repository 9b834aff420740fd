"""How the scorecard and the report write numbers, units, receivers and readings, in words for people."""

import importlib.resources
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import yaml

from vocc_torch.measure import curve, estimate
from vocc_torch.report.styles import LOCATED, rate_text


def read_yaml(name: str) -> dict[str, Any]:
    """A YAML file of this folder."""
    text = importlib.resources.files(__package__).joinpath(name).read_text("utf-8")
    return dict(yaml.safe_load(text))


_NUMBERS: dict[str, tuple[str, ...]] = read_yaml("numbers.yaml")
FIGURES: dict[str, dict[str, Any]] = read_yaml("figures.yaml")
"""What each figure says, by name, in the paper's order; what goes beyond the paper comes last."""
_WORDS = read_yaml("words.yaml")
RECEIVERS: dict[str, str] = _WORDS["receivers"]
EXPERIMENTS: dict[str, str] = _WORDS["experiments"]
LABELS: dict[str, str] = _WORDS["labels"]
WIDEST_SHARE = 1.0
"""Beyond this width the interval of a share tells nothing of its size."""
_NAMES = re.compile(rf"\b(?:{'|'.join(RECEIVERS)}|(?:agr|gri|ngr)(?:\+(?:agr|gri|ngr))*)\b")
_LONG = re.compile(r"\b\d{2,}\.\d{3,}\b")
_TYPOGRAPHY = [(re.compile(pattern), written) for pattern, written in _WORDS["typography"]]
_WRITERS: dict[str, Callable[[float], str]] = {
    "number": lambda value: plain(f"{value:.4g}"),
    "share": lambda value: plain(f"{100 * value:.3g} %"),
    "area": lambda value: f"{value:.7g}",
    "luminance": lambda value: plain(f"{value:.4g} cd/m2"),
    "ms": lambda value: plain(f"{value:.3g} ms"),
    "yes_no": lambda value: "yes" if value else "no",
}


def plain(text: str) -> str:
    r"""Write words of the scorecard for people: receivers by name, no line ends between number and unit.

    Example:
        >>> plain("flda_3 0.3 at 3% contrast and 8000 cd/m2").replace("\xa0", "~")
        'AGR + GRI + NGR 0.3 at 3~% contrast and 8000~cd/m²'
    """
    text = _NAMES.sub(lambda one: RECEIVERS.get(one[0]) or one[0].upper().replace("+", " + "), text)
    text = _LONG.sub(lambda one: f"{float(one[0]):.1f}", text)
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


def point(row: curve.Row) -> str:
    """Write a bit error rate with its interval, or its limit where there was no error.

    Example:
        >>> point(curve.Row("s", "distance_m", 30.0, "flda_3", "", 1, 64, 0.0, 0.0, 0.0, 0.04, 0, 0, ""))
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


def share_interval(share: estimate.Estimate) -> str:
    """Write a share with its interval, in per cent; no number where that is wider than 100 points.

    Example:
        >>> share_interval(estimate.Estimate(0.24, 0.1, 0.35))
        '24 % [10, 35]'
        >>> share_interval(estimate.Estimate(1.0, -126.63, 1.0))
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
    unit = "% contrast" if axis == "contrast" else _WORDS["units"].get(axis, axis)
    *first, last = (f"{100 * v:.0f}" if axis == "contrast" else f"{v:g}" for v in values)
    return f"{', '.join(first)} and {last} {unit}" if first else f"{last} {unit}"


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
    return f"{focal_length_mm:g}\N{NO-BREAK SPACE}mm lens, {LOCATED.get(locator, locator)}"


def named(name: str, value: float) -> tuple[str, str, str]:
    r"""A number's name and the number, both for people, and its column in a table; see ``numbers.yaml``.

    An unknown name keeps its words. The column is empty where the figure's numbers stand in one column; the
    name is empty where the number is not shown.

    Example:
        >>> named("auc_agr+ngr", 0.9999999), named("wrong_share_gri", 0.0875)[1].replace("\xa0", " ")
        (('AGR + NGR: area under the ROC curve', '0.9999999', ''), '8.75 %')
    """
    for pattern, (label, writer, *column) in _NUMBERS.items():
        if match := re.fullmatch(pattern, name):
            texts = (text.format(**match.groupdict()) for text in (label, *column, ""))
            label, at, *_ = (plain(text).replace("_", " ") for text in texts)
            return label, _WRITERS[writer](value), at
    return name.replace("_", " "), _WRITERS["number"](value), ""


def number_table(findings: Mapping[str, float]) -> tuple[list[str], list[tuple[str, ...]]]:
    """Head and rows of a table of a figure's numbers; processing times are laid out by stage.

    Args:
        findings: its numbers by name.
    """
    rows: dict[str, dict[str, str]] = {}
    for name, value in findings.items():
        label, number, column = named(name, value)
        if label:
            row = rows.setdefault(label, {})
            row[column] = ", ".join(filter(None, (row.get(column), number)))
    columns = list(dict.fromkeys(column for row in rows.values() for column in row if column))
    if not columns:
        return ["number", "value"], [(label, *row.values()) for label, row in rows.items()]
    cells = {label: {columns[0]: row.pop("", ""), **row} for label, row in rows.items()}
    head = ["time a frame, and share of panel detection's", *columns]
    return head, [(label, *(row.get(at, "") for at in columns)) for label, row in cells.items()]
