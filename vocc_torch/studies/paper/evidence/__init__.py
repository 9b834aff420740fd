"""The paper's figures other than bit error rates: what such a figure is, rests on, and is drawn with."""

import abc
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure.grid import Bools as Bools
from vocc_torch.measure.grid import Floats as Floats
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.features import FEATURE_NAMES, preamble_threshold
from vocc_torch.report import canvas
from vocc_torch.report.plots import OFF as OFF
from vocc_torch.report.plots import ON as ON
from vocc_torch.report.plots import STATUS as STATUS
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Simulator
from vocc_torch.studies.paper.words import FIGURES
from vocc_torch.types import Frames, PanelShape, Scene

SAMPLE_FRAMES = 100
"""Section III-B: "100 sample LED panel frames simulated at various conditions"."""
MARK = "#009E73"
DASHED: dict[str, Any] = {"color": canvas.INK, "linewidth": 1.3, "linestyle": "--"}
"""How thresholds are drawn."""

Rows = list[tuple[str | int | float, ...]]
"""Lines of a CSV file, its head first."""
Picture = tuple[Floats, tuple[float, float, float, float]]
"""Grey values (h,w), and their extent in LED cells from the panel's corner: left, right, bottom, top."""


@dataclass(frozen=True)
class Sample:
    """The sample frames and what the reader measures in them at the true corners.

    Args:
        scene: B scenes.
        conditions: (B,4) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        bits: (B,R,C).
        greys: (B,R,C) average grey of each LED's cell.
        thresholds: (B,) halfway between the average greys of the all-On and the all-Off frame of the scene.
        features: (B,R,C,3) AGR, GRI, NGR.
        patches: (B,1,(R+2)K,(C+2)K) the rectified panels.
        pictures: B panels with one cell of margin.
    """

    scene: Scene
    conditions: Floats
    bits: Bools
    greys: Floats
    thresholds: Floats
    features: Floats
    patches: Tensor
    pictures: list[Picture]

    def feature(self, name: str) -> Floats:
        """One of the features, (B,R,C)."""
        return self.features[..., FEATURE_NAMES.index(name)]


@dataclass(frozen=True)
class Source:
    """What figures are computed from: a plan, and the sample, which is simulated when first asked for.

    Args:
        plan: the study; its locator is not used for the sample.
        sample_frames: at least 1.
    """

    plan: Plan
    sample_frames: int = SAMPLE_FRAMES

    @cached_property
    def sample(self) -> Sample:
        """The sample frames over the ranges of the plan's scenes."""
        plan, world = self.plan, self.plan.world
        link = Link(world.simulator(), None, plan.receiver.reader, plan.batch_frames)
        keys = block_keys(plan.seed, "figures/sample", self.sample_frames)
        seen = list(link.observe(world.scene, keys, preambles=True, frames=self.sample_frames))
        known = [one.preambles for one in seen if one.preambles is not None]
        pictures = [cut_out(one.frames, one.panels.corners_px, world.panel.shape) for one in seen]
        scene = Scene.cat([one.scene for one in seen]).to("cpu")
        thresholds = [preamble_threshold(one.on.average, one.off.average) for one in known]
        return Sample(
            scene=scene,
            conditions=conditions(scene),
            bits=torch.cat([one.bits for one in seen]).cpu().numpy(),
            greys=torch.cat([one.readings.greys.average for one in seen]).cpu().double().numpy(),
            thresholds=torch.cat(thresholds).cpu().double().flatten().numpy(),
            features=torch.cat([one.readings.features for one in seen]).cpu().numpy(),
            patches=torch.cat([one.readings.patches for one in seen]).cpu(),
            pictures=list(itertools.chain(*pictures)),
        )

    def bits(self, name: str) -> Tensor:
        """(1,R,C) bool, the bits that a figure shows in all its scenes.

        Args:
            name: of the figure's own block of random numbers.
        """
        world = self.plan.world
        return world.scene.draw(BlockKey(self.plan.seed, f"figures/{name}", 0), world.panel.shape)[1][:1]

    def without_blooming(self) -> Simulator:
        """The plan's simulator without the blooming effect.

        Raises:
            VoccError: the scenes have none.
        """
        effects = dict(self.plan.world.effects)
        if effects.pop("blooming", None) is None:
            raise VoccError("scene.effects has no blooming: this figure shows what it does")
        return replace(self.plan.world, effects=effects).simulator()


class PaperFigure(abc.ABC):
    """One figure of the paper: made from a :class:`Source`, what is drawn. ``figures.yaml`` has its words.

    Attributes:
        rows: the lines of its CSV file.
        findings: the numbers that the figure shows, by name, for the report.
    """

    name: ClassVar[str]
    rows: Rows
    findings: dict[str, float]

    @abc.abstractmethod
    def __init__(self, source: Source) -> None:
        """Simulate and measure what the figure shows; the plan's locator is used where the figure says so."""

    @abc.abstractmethod
    def draw_on(self, figure: canvas.Figure) -> Mapping[str, object]:
        """Draw on an empty figure, and return what the footnote says besides the findings, by name."""

    def draw(self) -> canvas.Figure:
        """Draw the picture, with its title and what it rests on."""
        about = FIGURES[self.name]
        figure = canvas.new_figure(10, about["height_in"])
        said = self.draw_on(figure)
        canvas.write_title(figure, about["title"], about["footnote"].format_map({**self.findings, **said}))
        return figure


def led_rows(bits: Bools, values: Mapping[str, Floats]) -> Rows:
    """Lay values of LEDs out as lines, their head first.

    Args:
        bits: (B,R,C).
        values: (B,R,C) each, by name.

    Returns:
        A line an LED. Frames count from 0, rows and columns from 1 as in the paper's text.

    Example:
        >>> led_rows(np.array([[[True]]]), {"grey": np.array([[[150.0]]])})
        [('frame', 'led_row', 'led_column', 'bit', 'grey'), (0, 1, 1, 1, 150.0)]
    """
    lines = [
        (frame, row + 1, column + 1, int(bit), *(float(v[frame, row, column]) for v in values.values()))
        for (frame, row, column), bit in np.ndenumerate(bits)
    ]
    return [("frame", "led_row", "led_column", "bit", *values), *lines]


def pixel_rows(pictures: Mapping[str, Picture]) -> Rows:
    """Lay pictures out as lines, their head first; pixels count from 0 at each picture's top left.

    Example:
        >>> pixel_rows({"a": (np.array([[7.0]]), (0.0, 1.0, 1.0, 0.0))})
        [('picture', 'row_px', 'column_px', 'grey'), ('a', 0, 0, 7.0)]
    """
    lines = [(name, *at, float(v)) for name, (grey, _) in pictures.items() for at, v in np.ndenumerate(grey)]
    return [("picture", "row_px", "column_px", "grey"), *lines]


def conditions(scene: Scene) -> Floats:
    """Ambient light (lx), LED luminance (cd/m2), distance (m) and background grey, (B,4).

    Example:
        >>> conditions(Scene.of(distance_m=40.0)).tolist()
        [[8000.0, 3000.0, 40.0, 102.0]]
    """
    parts = (scene.ambient_lx, scene.led_luminance_cd_m2, scene.distance_m, scene.background_grey)
    return torch.stack(parts, dim=1).double().cpu().numpy()


def paper_scene(ambient_lx: float = 4000.0, led_luminance_cd_m2: float = 3500.0) -> Scene:
    """Scene of section IV-D-1, by default the middle one of its three.

    Distance and background grey, which the paper leaves open there, are in the middle of their ranges.

    Example:
        >>> scene = paper_scene()
        >>> float(scene.distance_m), float(scene.background_grey)
        (50.0, 102.0)
    """
    middle = {"distance_m": 50.0, "background_grey": 102.0}
    return Scene.of(1, ambient_lx=ambient_lx, led_luminance_cd_m2=led_luminance_cd_m2, **middle)


def cut_out(
    frames: Frames, corners_px: Tensor, shape: PanelShape, margin_cells: float = 1.0
) -> list[Picture]:
    """Cut upright panels and their margins out of frames, as whole pixels.

    Args:
        frames: B frames or crops.
        corners_px: (B,4,2) sensor coordinates of the grid of LED cells, clockwise from the top left.
        shape: rows and columns.
        margin_cells: how much to leave around the grid.

    Returns:
        Of each frame the pixels that overlap the margin, and their extent in LED cells.

    Example:
        >>> frame = Frames.whole(torch.zeros(1, 1, 20, 20))
        >>> corners = torch.tensor([[[4.0, 4.0], [12.0, 4.0], [12.0, 12.0], [4.0, 12.0]]])
        >>> [(grey, extent)] = cut_out(frame, corners, PanelShape(4, 4))
        >>> grey.shape, extent
        ((12, 12), (-1.0, 5.0, 5.0, -1.0))
    """
    pictures: list[Picture] = []
    corners = (corners_px - frames.origin_px[:, None]).double().cpu().numpy()
    for grey, first, last in zip(frames.grey[:, 0], corners[:, 0], corners[:, 2], strict=True):
        cell = (last - first) / (shape.columns, shape.rows)
        # A hair of tolerance, so that an edge that rounding moved does not add a line of pixels.
        low = np.floor(first - margin_cells * cell + 1e-6).astype(int).clip(min=0)
        high = np.minimum(np.ceil(last + margin_cells * cell - 1e-6).astype(int), grey.shape[::-1])
        left, top, right, bottom = ((np.stack([low, high]) - first) / cell).round(9).ravel().tolist()
        cut = grey[low[1] : high[1], low[0] : high[0]].double().cpu().numpy()
        pictures.append((cut, (left, right, bottom, top)))
    return pictures


def add_panel(
    figure: canvas.Figure, corner: tuple[float, float], width: float, picture: Picture, *words: str
) -> canvas.Axes:
    """Show a panel's pixels as the camera wrote them, black at 0 and white at 255, in a square.

    Args:
        figure: the figure.
        corner: the square's left and bottom, as shares of the figure's width and height.
        width: as a share of the figure's width.
        picture: the pixels and where they lie.
        words: see :func:`heading`; a panel without any is not outlined.

    Returns:
        Axes without ticks; their coordinates are LED columns and rows, from 0.
    """
    axes = figure.add_axes((*corner, width, width * figure.get_figwidth() / figure.get_figheight()))
    grey, extent = picture
    axes.imshow(grey, cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="nearest")
    axes.set_anchor("NW")
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(bool(words))
    axes.spines[:].set_color(canvas.GRID)
    heading(axes, *words)
    return axes


def heading(axes: canvas.Axes, text: str = "", below: str = "", colour: str = canvas.INK) -> None:
    """Write above the axes, in bold, and a line in grey between the two."""
    axes.set_title(text, fontsize=11.5, color=colour, loc="left", pad=20 if below else 5, fontweight="bold")
    axes.text(0, 1.025, below, transform=axes.transAxes, fontsize=9, color=canvas.QUIET)


def note(
    axes: canvas.Axes, text: str, at: tuple[float, float], aside_pt: tuple[float, float] = (0, 0), **look: Any
) -> None:
    """Write beside a place of the axes.

    Args:
        axes: where to write.
        text: what to write.
        at: the place.
        aside_pt: how far beside it, to the right and up, points.
        look: what else Matplotlib's annotation takes.
    """
    axes.annotate(text, at, aside_pt, textcoords="offset points", **{"color": canvas.INK, **look})


def plain_axes(axes: canvas.Axes, x_label: str, y_label: str, grid: Literal["x", "y", "both"] = "y") -> None:
    """Label axes, with a grid behind the data."""
    canvas.quiet_axes(axes, grid)
    axes.set(xlabel=x_label, ylabel=y_label)


def status_legend(figure: canvas.Figure) -> None:
    """Name the statuses at the figure's top right."""
    look: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 7}
    dots = [canvas.Line2D([], [], color=colour, label=f"{name} LEDs", **look) for _, name, colour in STATUS]
    place: dict[str, Any] = {"loc": "upper right", "handlelength": 2.0, "handletextpad": 0.1}
    at = (0.99, 1 - 0.06 / figure.get_figheight())
    canvas.write_legend(figure, dots, at, columns=2, fontsize=10.5, columnspacing=1.4, **place)


def legend_above(axes: canvas.Axes, columns: int) -> None:
    """Explain what is drawn, in rows above the axes."""
    place: dict[str, Any] = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "handlelength": 1.2}
    axes.legend(columnspacing=1.0, ncols=columns, frameon=False, fontsize=10, **place)


def percent_text(share: float) -> str:
    """Write a share in percent with three digits.

    Example:
        >>> percent_text(0.27469), percent_text(0.00015625)
        ('27.5 %', '0.0156 %')
    """
    return f"{100 * share:.3g} %"


def signed(value: float) -> str:
    r"""Write a number with its sign, a minus as typographers want it.

    Example:
        >>> signed(22.14), signed(-6.99).replace("\N{MINUS SIGN}", "minus ")
        ('+22.1', 'minus 7.0')
    """
    return f"{value:+.1f}".replace("-", "\N{MINUS SIGN}")


def condition_text(condition: Floats, *, background: bool = False) -> str:
    """Write ambient light, LED luminance and distance, and, if it is wanted, the background's grey.

    Example:
        >>> condition_text(np.array([31240.0, 2013.0, 68.2, 86.0]))
        '31\N{THIN SPACE}240 lx · 2\N{THIN SPACE}013 cd/m² · 68 m'
    """
    ambient, luminance, distance_m, grey = condition
    text = f"{ambient:,.0f} lx \N{MIDDLE DOT} {luminance:,.0f} cd/m² \N{MIDDLE DOT} {distance_m:.0f} m"
    return text.replace(",", "\N{THIN SPACE}") + (f", background {grey:.0f}" if background else "")
