"""Rules for the numbers of single figures and samples, which have no interval, in the paper as here."""

from __future__ import annotations

from collections.abc import Callable

from vocc_torch.studies.paper.scorecard.judgement import Judgement, not_measured
from vocc_torch.studies.paper.scorecard.orders import Judge
from vocc_torch.studies.paper.scorecard.reading import Reading


def figure_number(figure: str, name: str, holds: Callable[[float], bool], text: str, otherwise: str) -> Judge:
    """Claim that a number of a figure has a property.

    Args:
        figure: the figure.
        name: the number's.
        holds: whether it is as claimed.
        text: how to write what was measured, with the figure's numbers by name in braces.
        otherwise: the reason where it does not hold.
    """

    def judge(reading: Reading) -> Judgement:
        value = reading.finding(figure, name)
        if value is None:
            return not_measured(f"{name} of {figure}")
        try:
            measured = text.format_map(reading.findings[figure])
        except KeyError as missing:
            return not_measured(f"{missing.args[0]} of {figure}")
        return Judgement("agree", measured) if holds(value) else Judgement("differ", measured, otherwise)

    return judge


def parted_by_a_line(figure: str, features: str) -> Judge:
    """Claim that a straight line, FLDA's or another one, parts all On LEDs of a sample from all Off LEDs."""

    def judge(reading: Reading) -> Judgement:
        parted = reading.finding(figure, f"separable_{features}")
        wrong = reading.finding(figure, f"wrong_share_{features}")
        if parted is None or wrong is None:
            return not_measured(f"whether a line parts {features} of {figure}")
        measured = (
            f"{'a' if parted else 'no'} straight line parts all of them; {wrong:.2%} are wrong along FLDA's"
        )
        if parted:
            return Judgement("agree", measured)
        return Judgement(
            "differ", measured, "whichever the line, some LEDs of this sample are on the wrong side"
        )

    return judge


def more_than(figure: str, more: str, less: tuple[str, ...], *, of_figure: str | None = None) -> Judge:
    """Claim that one number of a figure is above others; as of one sample, without an interval.

    Args:
        figure: the figure.
        more: the number that is claimed to be above.
        less: the others.
        of_figure: another figure of the same sample that has the others.
    """

    def judge(reading: Reading) -> Judgement:
        names = {more: figure} | dict.fromkeys(less, of_figure or figure)
        values = {name: reading.finding(at, name) for name, at in names.items()}
        found = {name: value for name, value in values.items() if value is not None}
        if len(found) < len(values):
            missing = next(name for name in values if name not in found)
            return not_measured(f"{missing} of {names[missing]}")
        measured = ", ".join(f"{_words(name)} {value:.7g}" for name, value in found.items())
        over = [name for name in less if found[name] > found[more]]
        if over:
            return Judgement("differ", measured, f"{_words(over[0])} is higher")
        if any(found[name] == found[more] for name in less):
            return Judgement("cannot say", measured, "equal in this sample")
        return Judgement("agree", measured)

    return judge


def between(figure: str, low: str, middle: str, high: str) -> Judge:
    """Claim that one number of a figure lies between two others."""

    def judge(reading: Reading) -> Judgement:
        found = [reading.finding(figure, name) for name in (low, middle, high)]
        below, value, over = found
        if below is None or value is None or over is None:
            return not_measured(figure)
        measured = f"{_words(low)} {below:g}, {_words(middle)} {value:g}, {_words(high)} {over:g}"
        if below < value < over:
            return Judgement("agree", measured)
        return Judgement("differ", measured, f"{middle} does not lie between")

    return judge


def _words(name: str) -> str:
    """Write a number's name."""
    return name.replace("auc_", "area of ").replace("_", " ")
