"""The scorecard's claims in groups that a reader can find, and its claims on each figure."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from vocc_torch.studies.paper.scorecard import VERDICTS, Claim, Judgement, Scorecard, Verdict

Judged = tuple[Claim, Judgement]
_FIGURE = re.compile(r"Fig\. (\d+)")


@dataclass(frozen=True)
class Group:
    """Claims that stand under one heading.

    Args:
        anchor: the section's name in links.
        title: its heading.
        claims: the claims as judged under the report's own reading, in the paper's order.
    """

    anchor: str
    title: str
    claims: tuple[Judged, ...]


_TITLES = {
    "pictures": "Greys, blooming and location: Figs 4, 6, 17 and 19",
    "features": "Features: section III-B, Figs 8 to 12",
    "setup": "Simulation environment: section IV-C",
    "contrast": "Contrast: section IV-D-1, Figs 20 and 21",
    "ambient": "Ambient light: section IV-D-2, Fig. 22",
    "luminance": "LED luminance: section IV-D-3, Fig. 23",
    "distance": "Distance: section IV-D-4, Fig. 24",
    "time": "Processing time: section IV-D-5, Fig. 25",
    "discussion": "Dimming: section IV-D-5",
}
_OTHERS = "others"


def groups_of(scorecard: Scorecard) -> tuple[Group, ...]:
    """Sort the claims into groups, in the paper's order; claims of another kind come last."""
    held: dict[str, list[Judged]] = {name: [] for name in (*_TITLES, _OTHERS)}
    for claim, judged in scorecard.details():
        held[_group_name(claim)].append((claim, judged))
    titles = _TITLES | {_OTHERS: "Other claims"}
    return tuple(
        Group(f"score-{name}", titles[name], tuple(claims)) for name, claims in held.items() if claims
    )


def _group_name(claim: Claim) -> str:
    """Name the group of a claim."""
    kind = claim.key.partition(".")[0]
    if kind == "figures":
        return "features" if claim.where.startswith("III") else "pictures"
    return kind if kind in _TITLES else _OTHERS


def on_figure(scorecard: Scorecard, figure: str) -> tuple[Judged, ...]:
    """Give the claims that name a figure.

    Args:
        scorecard: the claims.
        figure: the figure's name, such as ``fig05_06``.
    """
    numbers = {int(number) for number in re.findall(r"\d+", figure)}
    return tuple(
        (claim, judged)
        for claim, judged in scorecard.details()
        if numbers & {int(number) for number in _FIGURE.findall(claim.where)}
    )


def counted(claims: Iterable[Judged]) -> dict[Verdict, int]:
    """Count verdicts."""
    found = Counter(judged.verdict for _, judged in claims)
    return {verdict: found[verdict] for verdict in VERDICTS}


def tally_text(claims: Iterable[Judged]) -> str:
    """Say how many claims have which verdict.

    Example:
        >>> rule = lambda reading: Judgement("agree", "")
        >>> tally_text([(Claim("a.b", "IV", "text", "", rule), Judgement("agree", ""))] * 2)
        '2 of 2 claims agree'
    """
    found = counted(claims)
    total = sum(found.values())
    text = f"{found['agree']} of {total} claims agree"
    if total == 1:
        text = f"the claim {'agrees' if found['agree'] else 'does not agree'}"
    rest = [
        f"{count} {word}"
        for count, word in (
            (found["differ"], "differs" if found["differ"] == 1 else "differ"),
            (found["cannot say"], "cannot be decided"),
        )
        if count and total > 1
    ]
    return ", ".join([text, *rest])
