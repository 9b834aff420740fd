"""What a comparison of many receivers comes to, in plain words."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator

from vocc_torch.measure.curve import Row
from vocc_torch.show.styles import axis_label, value_text
from vocc_torch.show.text_table import rate_text
from vocc_torch.studies.classifiers.rivals import Rivals, Transfer
from vocc_torch.studies.classifiers.rivals_figure import KNOWS, ratio_text


def summary(rivals: Rivals, width: int = 100) -> str:
    """Say which receiver is best, what it takes, how far it is from what is possible, and where it fails.

    Args:
        rivals: what was measured.
        width: columns that a line may take.
    """
    left_out = [f"Left out: {name}, since {why}." for name, why in rivals.left_out.items()]
    parts = [_reading(rivals), *left_out, *_best(rivals), *_marks(rivals), *_abroad(rivals)]
    return "\n\n".join(textwrap.fill(part, width, break_on_hyphens=False) for part in parts) + "\n"


def _reading(rivals: Rivals) -> str:
    """Say how to read the table."""
    locator = next(iter(rivals.curves.values())).locator
    return (
        "The fewest wrong bits over all points first. 95 % intervals, frames as the units; <: no errors, "
        f"one-sided limit; locator: {locator}. of {rivals.reference}: the rate over that of "
        f"{rivals.reference}, on the same frames. training: on one thread, simulating its frames included. "
        "bits: from the rectified panel to a frame's bits, features and patches included, in batches of 64."
    )


def _at(rivals: Rivals, experiment: str, value: float) -> str:
    """Name a point."""
    unit = axis_label(rivals.curves[experiment].axis).partition("(")[2].rstrip(")")
    return f"at {value_text(value)} {unit}".rstrip()


def _point(rivals: Rivals, experiment: str, receiver: str, value: float) -> Row:
    """Find a receiver's point."""
    rows = rivals.tables()[experiment].of(receiver)
    return next(row for row in rows if row.value == value)


def _best(rivals: Rivals) -> Iterator[str]:
    """Say which of those that learn is best, and its price."""
    learnt = [name for name in rivals.ranked() if name in rivals.learners and name != rivals.reference]
    if not learnt or not rivals.points:
        return
    best, made = learnt[0], rivals.making[learnt[0]]
    said = []
    for experiment, value in rivals.points.items():
        row, ratio = _point(rivals, experiment, best, value), rivals.ratio(experiment, best, value)
        rate = f"no errors in {row.bits} bits (below {rate_text(row.ber_high)})"
        if not row.error_free:
            rate = f"{rate_text(row.ber)} ({rate_text(row.ber_low)} to {rate_text(row.ber_high)})"
        share = ""
        if ratio is not None:
            most = ratio_text(type(ratio)(ratio.high, ratio.high, ratio.high))
            share = f", at most {most}" if ratio.high < 1 or not ratio.value else f", {ratio_text(ratio)}"
            of = "times" if share.endswith(" x") else "of"
            share = f"{share.removesuffix(' x')} {of} the rate of {rivals.reference}"
        said.append(f"{_at(rivals, experiment, value)} {rate}{share}")
    price = [f"{made.training_s:.1f} s of training on {made.frames} frames"]
    if made.parameters is not None:
        price.append(f"{made.parameters} parameters")
    if made.size_bytes is not None:
        price.append(f"{made.size_bytes / 1000:.3g} kB")
    price.append(f"{rivals.bits_ms[best]:.2g} ms a frame from the rectified panel to its bits")
    own = rivals.bits_ms[rivals.reference]
    price[-1] += f" ({rivals.reference}: {own:.2g} ms)"
    total = {
        name: sum(curves.total(name).half_errors for curves in rivals.curves.values()) for name in learnt
    }
    tied = [name for name in learnt[1:] if total[name] == total[best]]
    also = f" As few wrong bits over all points: {', '.join(tied)}." if tied else ""
    yield (
        f"Best of those that learn: {best}, {'; '.join(said)}. It is chosen by these very frames, which "
        f"flatters its rates.{also} Its price: {', '.join(price)}."
    )


def _marks(rivals: Rivals) -> Iterator[str]:
    """Say what is possible, and whether any receiver got below it."""
    marks = [(name, value, one) for name, of in rivals.marks.items() for value, one in of.items()]
    if marks:
        wrong = sum(one.counts.half_errors for *_, one in marks) / 2
        frames = sum(one.counts.frames for *_, one in marks)
        bits = sum(one.counts.bits for *_, one in marks)
        proven = sum(one.proven for *_, one in marks)
        seconds = sorted(one.seconds_a_frame for *_, one in marks)[len(marks) // 2]
        beaten = [
            f"{name} {value_text(value)} ({', '.join(one.best)})"
            for name, value, one in marks
            if not one.lowest
        ]
        held = (
            f"fewer wrong bits than the genie had receivers at {'; '.join(beaten)}"
            if beaten
            else "no receiver has fewer wrong bits at any point"
        )
        each = {
            name: sum(one.receivers[name].half_errors for *_, one in marks) / 2 for name in rivals.receivers
        }
        least = min(each.values())
        best = ", ".join(name for name in rivals.ranked() if each[name] == least)
        yield (
            f"What is possible: the genie, which {KNOWS} and searches the likeliest bits, has {wrong:g} "
            f"wrong bits of {bits} in the first {frames // len(marks)} frames of each point ({proven} of "
            f"{frames} frames proven), at {1e3 * seconds:.0f} ms a frame. On these frames {held}; the best "
            f"over all points has {least:g} ({best})."
        )
    for name, why in rivals.unmarked.items():
        yield f"No genie's mark for {name}: {why}."


def _abroad(rivals: Rivals) -> Iterator[str]:
    """Say where learning in other scenes hurts the most, for the best and for the reference."""
    for scene, why in rivals.lost.items():
        yield f"Without the scenes {scene}: {why}."
    apart = [one for one in rivals.transfers if one.trained_on != one.tested_on]
    learnt = {one.receiver for one in apart}
    best = [name for name in rivals.ranked() if name in learnt][:1]
    told = {
        name: [one for one in apart if one.receiver == name]
        for name in dict.fromkeys([*best, rivals.reference])
        if name in learnt
    }
    comparisons = sum(map(len, told.values()))
    for name, own in told.items():
        out = [one for one in own if one.trained_on == rivals.home]
        back = [one for one in own if one.tested_on == rivals.home]
        there, here = _listed(out, "tested_on", comparisons), _listed(back, "trained_on", comparisons)
        yield (
            f"In other scenes: {name} trained on {rivals.home} is {there}; trained elsewhere and tested on "
            f"{rivals.home} it is {here}. "
            f"Surely: with 95 % for all {comparisons} comparisons that are told here together."
        )


def _listed(transfers: list[Transfer], side: str, comparisons: int) -> str:
    """List the scenes that surely make a difference among so many comparisons, the worst first."""
    surely: list[tuple[float, str]] = []
    for one in transfers:
        if not one.worse(comparisons):
            continue
        ratio, scene = one.ratio, str(getattr(one, side)).replace("_", " ")
        if ratio is None:
            surely.append((math.inf, f"{scene} ({rate_text(one.counts.ber)} against none)"))
        else:
            surely.append((ratio.value, f"{scene} ({ratio_text(ratio).replace(' x', ' times')})"))
    if not surely:
        return "as good everywhere as one trained there, as far as these frames tell"
    ordered = [text for _, text in sorted(surely, reverse=True)]
    return f"surely worse than one trained on the scenes of the test in {', '.join(ordered)}"
