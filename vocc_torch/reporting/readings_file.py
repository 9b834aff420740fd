"""CSV files of many readings: the rates of every focal length and locator, and what location costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple

from vocc_torch.evaluation.curve import COLUMNS
from vocc_torch.evaluation.curves import Measured
from vocc_torch.evaluation.relative import relative_gain

Line = tuple[str | int | float, ...]


def rate_lines(experiments: Mapping[float, Measured]) -> list[Line]:
    """Give an experiment's points under every reading, the head first.

    Args:
        experiments: the experiment by focal length, mm.

    Example:
        >>> rate_lines({})[0][:3]
        ('focal_length_mm', 'experiment', 'axis')
    """
    lines: list[Line] = [("focal_length_mm", *COLUMNS)]
    for focal_mm, measured in experiments.items():
        for curves in measured.curves.values():
            table = curves.table()
            for receiver in table.receivers:
                lines += [(focal_mm, *astuple(row)) for row in table.of(receiver)]
    return lines


def location_lines(experiments: Mapping[float, Mapping[str, Measured]]) -> list[Line]:
    """Give what location costs at every point with both locators, the head first.

    ``location_share`` is the part of the bit error rate that is gone with true corners on the same frames,
    with its 95 % interval; empty where the located panel gave no error.

    Args:
        experiments: by focal length, mm, and experiment.

    Example:
        >>> location_lines({})[0][-3:]
        ('location_share', 'location_share_low', 'location_share_high')
    """
    head = ("focal_length_mm", "experiment", "axis", "value", "receiver", "frames", "ber_located", "ber_true")
    lines: list[Line] = [(*head, "location_share", "location_share_low", "location_share_high")]
    for focal_mm, by_name in experiments.items():
        for measured in by_name.values():
            for (receiver, value), paired in measured.location.items():
                located, true = (measured.curves[name].counts[receiver, value] for name in ("paper", "truth"))
                gain = relative_gain(located, true, paired)
                shares: Line = ("", "", "") if gain is None else (gain.gain, gain.low, gain.high)
                curves = measured.curves["paper"]
                place = (focal_mm, curves.experiment, curves.axis, value, receiver)
                lines.append((*place, located.frames, located.ber, true.ber, *shares))
    return lines
