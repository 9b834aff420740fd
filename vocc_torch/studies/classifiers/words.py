"""``summary.txt``: what a comparison comes to; values are computed here, words are the template's."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from statistics import median_high

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import Row
from vocc_torch.measure.estimate import Estimate
from vocc_torch.show.page import render
from vocc_torch.show.styles import axis_label, value_text
from vocc_torch.show.text_table import rate_text
from vocc_torch.studies.classifiers.results import Comparison, Transfer

KNOWS = "knows the scene"
"""What the genie is called in pictures and tables."""


def ratio_text(ratio: Estimate) -> str:
    """Write a ratio as a fraction or a multiple; a limit where the receiver made no error.

    Example:
        >>> [ratio_text(Estimate(*one)) for one in ((0, 0, 0.0027), (0.031, 0.02, 0.05), (4.2, 3.0, 6.0))]
        ['< 1/370', '1/32', '4.2 x']
    """
    limit, value = ("< ", ratio.high) if ratio.value == 0 else ("", ratio.value)
    if value > 0.95:
        return f"{limit}{value:.2g} x" if value < 99.5 else f"{limit}{value:.0f} x"
    part = 1 / value
    return f"{limit}1/{part:.2g}" if part < 9.95 else f"{limit}1/{float(f'{part:.2g}'):.0f}"


def point_label(comparison: Comparison, experiment: str) -> str:
    """Write the value that the summary states, with its unit, such as "70 m"."""
    unit = axis_label(comparison.curves[experiment].axis).partition("(")[2].rstrip(")")
    return f"{value_text(comparison.points[experiment])} {unit}".rstrip()


def summary(comparison: Comparison, width: int = 100) -> str:
    """Say which receiver is best, what it costs, how far it is from what is possible, and where it fails.

    Args:
        comparison: what was measured.
        width: columns that a line may take.
    """
    ranked, reference, wrong = comparison.ranked, comparison.reference, comparison.half_errors
    learners = [name for name in ranked if comparison.costs[name].frames and name != reference]
    best = learners[0] if learners and comparison.points else None
    apart = [one for one in comparison.transfers if one.trained_on != one.tested_on]
    moved = [name for name in ranked if any(one.receiver == name for one in apart)]
    stated = list(dict.fromkeys([*moved[:1], *(name for name in moved if name == reference)]))
    apart = [one for one in apart if one.receiver in stated]
    text = render(
        __package__,
        "summary.txt.j2",
        comparison=comparison,
        locator=next(iter(comparison.curves.values())).locator,
        best=best,
        points=[] if best is None else _points(comparison, best),
        tied=[] if best is None else [name for name in learners[1:] if wrong[name] == wrong[best]],
        genie=_genie(comparison),
        elsewhere={
            name: _where_worse([one for one in apart if one.receiver == name], comparison.home, len(apart))
            for name in stated
        },
        comparisons=len(apart),
        knows=KNOWS,
    )
    parts = text.strip().split("\n\n")
    return "\n\n".join(textwrap.fill(part, width, break_on_hyphens=False) for part in parts) + "\n"


def _points(comparison: Comparison, receiver: str) -> list[tuple[str, Row | None, str]]:
    """Give where a receiver's rate is stated, the rate, and how it compares with the reference's in words."""
    said = []
    for experiment, value in comparison.points.items():
        ratio, share = comparison.ratio(experiment, receiver, value), ""
        if ratio is not None:
            below = ratio.high < 1 or not ratio.value
            share = ratio_text(Estimate(*[ratio.high] * 3) if below else ratio)
            share = f"{share.removesuffix(' x')} times" if share.endswith(" x") else f"{share} of"
            share = f", {'at most ' if below else ''}{share} the rate of {comparison.reference}"
        said.append((point_label(comparison, experiment), comparison.row(experiment, receiver, value), share))
    return said


def _genie(comparison: Comparison) -> dict[str, object] | None:
    """Add up what the genie and the receivers did on the genie's frames of all points."""
    points = {(name, value): one for name, some in comparison.genie.items() for value, one in some.items()}
    if not points:
        return None
    references = [one.genie for one in points.values()]
    total = sum((one.counts for one in references), Counts())
    wrong = {
        name: sum(one.receivers[name].bit_errors for one in points.values()) for name in comparison.ranked
    }
    least = min(wrong.values())
    return {
        "counts": total,
        "frames_a_point": total.frames // len(points),
        "proven": sum(one.proven for one in references),
        "ms_a_frame": 1e3 * median_high(one.seconds_a_frame for one in references),
        "beaten": [
            f"{name} {value_text(value)} ({', '.join(one.best)})"
            for (name, value), one in points.items()
            if not one.unbeaten
        ],
        "least": least,
        "best": [name for name, errors in wrong.items() if errors == least],
    }


def _where_worse(transfers: Sequence[Transfer], home: str, comparisons: int) -> list[str]:
    """List where a receiver trained in other scenes than those of the test is surely worse.

    Args:
        transfers: of one receiver.
        home: the scenes of the experiments.
        comparisons: how many are stated together.

    Returns:
        The scenes of the test of those trained at home, and the scenes of the training of those tested there:
        the worst first, each with the ratio; empty where there are none.
    """
    lists = []
    for outward in (True, False):
        worse = [
            one for one in transfers if (one.trained_on == home) == outward and one.surely_worse(comparisons)
        ]
        worse.sort(key=lambda one: math.inf if one.ratio is None else one.ratio.value, reverse=True)
        texts = [
            f"{(one.tested_on if outward else one.trained_on).replace('_', ' ')} "
            + (
                f"({rate_text(one.counts.ber)} against none)"
                if one.ratio is None
                else f"({ratio_text(one.ratio).replace(' x', ' times')})"
            )
            for one in worse
        ]
        lists.append(", ".join(texts))
    return lists
