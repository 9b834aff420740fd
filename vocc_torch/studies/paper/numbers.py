"""A figure's numbers with names that people can read: ``numbers.yaml``."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cache
from importlib.resources import files

import yaml

from vocc_torch.studies.paper.words import RECEIVERS, plain

_WRITERS: dict[str, Callable[[float], str]] = {
    "number": lambda value: f"{value:.4g}",
    "share": lambda value: f"{100 * value:.3g} %",
    "area": lambda value: f"{value:.7g}",
    "luminance": lambda value: f"{value:.4g} cd/m2",
    "yes_no": lambda value: "yes" if value else "no",
}
_TIME = re.compile(r"(ms|share)_(\w+?)_(whole_frames|crops)_batch_(\d+)")
_COST = re.compile(r"extra_(total_)?cost_of_ngr_(whole_frames|crops)_batch_(\d+)")


@cache
def _names() -> list[tuple[re.Pattern[str], str, str]]:
    """Read the patterns of names."""
    text = files(__package__).joinpath("numbers.yaml").read_text("utf-8")
    return [(re.compile(pattern), *written) for pattern, written in yaml.safe_load(text).items()]


def named(name: str, value: float) -> tuple[str, str]:
    r"""Give a number's name and the number, both for people; an unknown name keeps its words.

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
    """Give a figure's numbers as the head and the rows of a table; processing times are laid out by stage.

    Args:
        findings: its numbers by name.
    """
    cells: dict[str, dict[tuple[str, str], str]] = {}
    others = {}
    for name, value in findings.items():
        if match := _TIME.fullmatch(name):
            what, stage, *at = match.groups()
            stage = RECEIVERS.get(stage, stage.replace("_", " "))
            written = f"{value:.3g} ms" if what == "ms" else _WRITERS["share"](value)
        elif match := _COST.fullmatch(name):
            stage = "NGR adds to all image processing" if match[1] else "NGR adds to two features"
            at, written = [match[2], match[3]], _WRITERS["share"](value)
        else:
            others[name] = value
            continue
        row = cells.setdefault(stage, {})
        row[at[0], at[1]] = ", ".join(filter(None, (row.get((at[0], at[1])), written)))
    if not cells:
        return ["number", "value"], [named(name, value) for name, value in findings.items()]
    columns = list(dict.fromkeys(at for row in cells.values() for at in row))
    head = ["time a frame, and share of panel detection's"]
    for frames, batch in columns:
        size = "one at a time" if batch == "1" else f"{batch} at once"
        head.append(f"{frames.replace('_', ' ')}, {size}")
    rows = [(stage, *(plain(row.get(at, "")) for at in columns)) for stage, row in cells.items()]
    rest = (named(name, value) for name, value in others.items() if not name.endswith(("_low", "_high")))
    return head, [*rows, *((label, value, *[""] * (len(columns) - 1)) for label, value in rest)]
