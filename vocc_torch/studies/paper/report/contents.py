"""What the report on the paper is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from vocc_torch.measure.grid import Grid
from vocc_torch.studies.paper.scorecard import LocationSplit, Scorecard


@dataclass(frozen=True)
class Shown:
    """A figure that has been written.

    Args:
        name: its name, such as ``fig22``.
        title: its headline.
        caption: what it shows.
        pictures: PNG files, relative to the report's folder, with a caption each; the figure's own where that
            is empty.
        table: CSV file with its data, relative to the report's folder.
        findings: its numbers by name.
    """

    name: str
    title: str
    caption: str
    pictures: tuple[tuple[Path, str], ...]
    table: Path
    findings: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Facts:
    """How the numbers were made.

    Args:
        command: what makes them again.
        budget: frames in words.
        machine: what they were made on, in words.
        seconds: wall-clock seconds by stage, in order.
        configuration: the resolved configuration, nested.
        resumed: whether an earlier run had counted some of the frames.
    """

    command: str
    budget: str
    machine: str
    seconds: Mapping[str, float]
    configuration: Mapping[str, object]
    resumed: bool = False


@dataclass(frozen=True)
class Contents:
    """Everything that the report shows.

    Args:
        figures: in order.
        scorecard: the claims, or None where an experiment was left out.
        location: what location costs, with the report's own focal length.
        grids: bit error rates over ambient light and luminance by locator; empty where not measured.
        facts: how the numbers were made.
        others: further files by what they hold, relative to the report's folder.
    """

    figures: tuple[Shown, ...]
    scorecard: Scorecard | None
    location: tuple[LocationSplit, ...]
    grids: Mapping[str, Grid]
    facts: Facts
    others: Mapping[str, Path] = field(default_factory=dict)
