"""A figure's numbers with names that people can read."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from vocc_torch.show.report.document import Align, Table
from vocc_torch.show.report.inline import literal
from vocc_torch.studies.paper.report.words import RECEIVERS, plain, spaced


def _number(value: float) -> str:
    """Write a number with four digits."""
    return plain(f"{value:.4g}")


def _share(value: float) -> str:
    """Write a share in per cent."""
    return spaced(f"{100 * value:.3g} %")


def _area(value: float) -> str:
    """Write an area under a curve, with the digits that tell the best from the second best."""
    return f"{value:.7g}"


def _luminance(value: float) -> str:
    """Write a luminance."""
    return spaced(f"{value:.4g} cd/m\u00b2")


_Writer = Callable[[float], str]
_KNOWN: dict[str, tuple[str, _Writer]] = {
    "dark_frame_highest_on_grey": ("dark frame: average grey of the brightest On LED", _number),
    "dark_frame_mean_on_grey": ("dark frame: average grey of On LEDs", _number),
    "bright_frame_lowest_off_grey": ("bright frame: average grey of the darkest Off LED", _number),
    "bright_frame_mean_off_grey": ("bright frame: average grey of Off LEDs", _number),
    "contradicting_pairs_share": (
        "pairs of frames in which On LEDs of one are darker, on average, than Off LEDs of the other",
        _share,
    ),
    "best_fixed_threshold_grey": ("fixed grey threshold with the fewest wrong LEDs", _number),
    "best_fixed_threshold_wrong_share": ("LEDs on its wrong side", _share),
    "average_grey_auc": ("average grey: area under the ROC curve", _area),
    "led_row": ("the marked LED's row", _number),
    "led_column": ("the marked LED's column", _number),
    "grey_without_blooming": ("its average grey without blooming", _number),
    "grey_with_blooming": ("its average grey with blooming", _number),
    "on_neighbours": ("neighbours of it that are On", _number),
    "neighbours_mean_grey": ("average grey of its neighbours", _number),
    "gri": ("its GRI, grey values a pixel", _number),
    "misread_off_leds": ("Off LEDs of the sample that average grey reads as On", _number),
    "misread_off_share": ("the same as a share of all Off LEDs", _share),
    "gri_on": ("GRI of the On LED shown, grey values a pixel", _number),
    "gri_off": ("GRI of the Off LED shown, grey values a pixel", _number),
    "highest_grey_after_gamma": ("brightest pixel, Gaussian after gamma encoding", _number),
    "highest_grey_before_gamma": ("brightest pixel, Gaussian before gamma encoding", _number),
    "highest_grey_no_blooming": ("brightest pixel without a Gaussian", _number),
    "mean_loss": ("grey values lost with the Gaussian after gamma, on average", _number),
    "greatest_loss": ("grey values lost with the Gaussian after gamma, at most", _number),
    "brighter_after_gamma_share": ("pixels that are brighter with the Gaussian after gamma", _share),
    "threshold": ("threshold", _number),
    "background_grey": ("grey value of the background", _number),
    "off_grey": ("grey value of an Off LED before any blur", _number),
    "on_grey": ("grey value of an On LED before any blur", _number),
    "panel_share_of_frame": ("pixels of the frame that the panel's cells cover", _share),
    "foreground_share_of_on_cells": ("pixels of On cells above the threshold", _share),
    "foreground_share_of_off_cells": ("pixels of Off cells above the threshold", _share),
    "foreground_pixels_outside_panel": ("pixels above the threshold outside the cells", _number),
    "threads": ("threads", _number),
    "waited_share": ("of the time other work had the processor:", _share),
    "wrong_share_on": ("On LEDs below the threshold", _share),
    "wrong_share_off": ("Off LEDs above the threshold", _share),
    "auc_projection": ("projection on w: area under the ROC curve", _area),
}
_WHERE = {"": "", "_nearer_half": ", nearer half of the frames", "_farther_half": ", farther half"}
_SCENES = {"paper_scene": "the paper's scene of {} %", "true": "a scene of truly {} %"}
_OF_SCENE: dict[str, tuple[str, _Writer]] = {
    "contrast": ("contrast before any blur", _share),
    "contrast_in_picture": ("contrast in the picture", _share),
    "led_luminance_cd_m2": ("LED luminance", _luminance),
    "background_grey": ("grey value of the background", _number),
}
_AREA = re.compile(r"auc_([a-z+_]+)")
_WRONG = re.compile(r"wrong_share_([a-z+_]+)")
_SEPARABLE = re.compile(r"separable_([a-z+_]+)")
_NEGATIVE = re.compile(r"gri_negative_share_(on|off)(\w*)")
_WEIGHT = re.compile(r"w_(agr|gri|ngr)(_per_deviation)?")
_SCENE = re.compile(r"(\w+?)_(paper_scene|true)_(\d+)")
_TIME = re.compile(r"(ms|share)_(\w+?)_(whole_frames|crops)_batch_(\d+)")
_COST = re.compile(r"extra_(total_)?cost_of_ngr_(whole_frames|crops)_batch_(\d+)")


def named(name: str, value: float) -> tuple[str, str]:
    r"""Give a number's name and the number, both for people; an unknown name keeps its words.

    Example:
        >>> named("auc_agr+ngr", 0.9999999), named("wrong_share_gri", 0.0875)[1].replace("\xa0", " ")
        (('AGR + NGR: area under the ROC curve', '0.9999999'), '8.75 %')
    """
    if name in _KNOWN:
        label, write = _KNOWN[name]
        return label, write(value)
    if match := _AREA.fullmatch(name):
        return f"{_features(match[1])}: area under the ROC curve", _area(value)
    if match := _WRONG.fullmatch(name):
        beside = "line or plane (FLDA)" if "+" in match[1] else "threshold"
        return f"{_features(match[1])}: LEDs on the wrong side of the best {beside}", _share(value)
    if match := _SEPARABLE.fullmatch(name):
        return f"{_features(match[1])}: some straight line or plane parts all LEDs", "yes" if value else "no"
    if (match := _NEGATIVE.fullmatch(name)) and match[2] in _WHERE:
        return f"{match[1].capitalize()} LEDs with negative GRI{_WHERE[match[2]]}", _share(value)
    if match := _WEIGHT.fullmatch(name):
        unit = f" times {match[1].upper()}'s standard deviation" if match[2] else ""
        return f"weight of {match[1].upper()} in w{unit}", _number(value)
    if (match := _SCENE.fullmatch(name)) and match[1] in _OF_SCENE:
        what, write = _OF_SCENE[match[1]]
        return spaced(f"{_SCENES[match[2]].format(match[3])}: {what}"), write(value)
    return name.replace("_", " "), _number(value)


def _features(text: str) -> str:
    """Write features: those of FLDA in capitals."""
    return plain(text.replace("_", " "))


def numbers_table(title: str, findings: Mapping[str, float]) -> Table:
    """Give a figure's numbers as a table to be opened.

    Args:
        title: the figure's headline.
        findings: its numbers by name; times are laid out by stage.
    """
    caption = literal(spaced(f"Numbers of {title.partition(':')[0]}"))
    if any(_TIME.fullmatch(name) for name in findings):
        return _times_table(caption, findings)
    lines = [named(name, value) for name, value in findings.items()]
    rows = tuple((literal(label), literal(number)) for label, number in lines)
    return Table(("number", "value"), rows, ("left", "right"), caption=caption, folded=True)


def _times_table(caption: str, findings: Mapping[str, float]) -> Table:
    """Lay processing times out by stage and by what is handed over."""
    cells: dict[str, dict[tuple[str, str], str]] = {}
    others = []
    for name, value in findings.items():
        if match := _TIME.fullmatch(name):
            _, stage, *at = match.groups()
            ms = findings.get(f"ms_{stage}_{at[0]}_batch_{at[1]}")
            share = findings.get(f"share_{stage}_{at[0]}_batch_{at[1]}")
            parts = [f"{ms:.3g} ms" if ms is not None else "", _share(share) if share is not None else ""]
            text = ", ".join(part for part in parts if part)
            cells.setdefault(_stage(stage), {})[at[0], at[1]] = spaced(text)
        elif match := _COST.fullmatch(name):
            what = "NGR adds to all image processing" if match[1] else "NGR adds to two features"
            cells.setdefault(what, {})[match[2], match[3]] = _share(value)
        else:
            others.append(" ".join(named(name, value)))
    columns = tuple(dict.fromkeys(at for line in cells.values() for at in line))
    header = ("stage", *(f"{frames.replace('_', ' ')}, {_batch(batch)}" for frames, batch in columns))
    rows = tuple(
        (literal(label), *(literal(line.get(at, "")) for at in columns)) for label, line in cells.items()
    )
    told = f"{caption}: time a frame, and share of panel detection's"
    if others:
        told += f" ({literal(', '.join(others))})"
    right: Align = "right"
    return Table(header, rows, ("left", *[right] * len(columns)), caption=told, folded=True)


def _stage(name: str) -> str:
    """Name a stage of processing."""
    return RECEIVERS.get(name, name.replace("_", " "))


def _batch(frames: str) -> str:
    """Say how many frames are handed over at once."""
    return "one at a time" if frames == "1" else f"{frames} at once"
