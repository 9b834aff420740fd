"""Panels laid into pictures, in batches: what the networks are trained on besides rendered frames."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.studies.train_detector.draws import Draws
from vocc_torch.studies.train_detector.finish import blurred
from vocc_torch.studies.train_detector.geometry import cells_of, pixels, signed_area

SHAPES = (
    ((8, 8),) * 7
    + ((4, 4),) * 6
    + ((4, 8), (8, 4), (16, 16), (16, 16), (8, 16), (16, 8))
    + ((8, 32), (32, 32), (5, 7), (6, 6), (12, 12), (4, 5), (5, 5))
)
"""Rows and columns of the panels, the commoner ones more often."""

PLANES = ((0, 2), (1, 2), (0, 1))
"""Axes x, y and z between which yaw, pitch and roll turn."""

MOST_LEDS = 32
"""Rows and columns of the table of bits."""


@dataclass(frozen=True)
class Looks:
    """Ranges of what panels look like, grey values where nothing else is said."""

    wild: float = 0.5  # share of panels turned by any angle below
    turns_deg: tuple[float, float, float] = (25.0, 6.0, 6.0)  # yaw, pitch, roll
    wild_turns_deg: tuple[float, float, float] = (50.0, 45.0, 45.0)
    flat: float = 0.35  # share of panels whose cells are no squares
    aspect: tuple[float, float] = (0.6, 1.7)  # of such cells, width to height
    distance_sides: tuple[float, float] = (4.0, 60.0)  # of the camera, panel's sides
    fill: tuple[float, float] = (0.15, 0.95)  # width of an LED, cells
    square: float = 0.3  # share of panels with square LEDs
    lit: tuple[float, float] = (0.2, 0.8)  # share of LEDs that are On
    least_lit: float = 6.0  # LEDs of a panel that are On, on average
    pictured: float = 0.25  # share of panels whose On LEDs stand together
    together: float = 0.35  # of their share, in the mean of 3 x 3 random numbers
    unequal: float = 0.3  # share of panels whose LEDs differ
    scatter: tuple[float, float] = (0.05, 0.5)  # of the logarithm of their light
    uneven: float = 0.35  # share of panels that are brighter on one side
    fall: float = 0.8  # of their light from one side to the other, at most
    driven: float = 0.12  # share of panels with groups of rows that are dimmer
    groups: tuple[int, int] = (2, 17)
    unseen: float = 0.22  # share of panels without a board
    bright_board: float = 0.3  # share of boards up to the brighter limit
    board: tuple[float, float] = (70.0, 200.0)
    margin_cells: tuple[float, float] = (1.3, 2.0)  # of a board, most and added most
    wide_margin: float = 0.2  # share of boards with the added margin
    uneven_margin: float = 0.3  # share of boards with another margin on each side
    lip: float = 0.25  # share of boards with a frame of another brightness
    lip_cells: tuple[float, float] = (0.1, 1.5)  # its width
    brightest_lip: float = 230.0
    hidden_off: float = 0.25  # share of panels whose Off LEDs do not show
    dark_off: float = 0.6  # share of panels whose Off LEDs differ from the board
    off: tuple[float, float] = (-30.0, 60.0)
    contrast: tuple[float, float] = (15.0, 500.0)  # of On LEDs
    as_bright: float = 0.75  # share of panels whose small LEDs are brighter
    least_soft_cells: float = 0.06  # of an LED's edge
    cored: float = 0.35  # share of panels whose LEDs are brighter inside
    core: float = 0.8  # of their light that is lost at the edge, at most
    core_off: float = 0.3  # of an LED's width, by which its core is off, at most
    glowing: float = 0.4  # share of panels with light around On LEDs
    glow: tuple[float, float] = (0.05, 0.5)  # of an LED's light
    glow_cells: tuple[float, float] = (0.3, 0.9)  # its standard deviation
    glow_px: tuple[float, float] = (0.5, 3.0)  # the least and the most
    modular: float = 0.4  # share of panels of several modules that lie apart
    module: int = 8  # LEDs
    gap_cells: float = 0.4  # between modules, at most


LOOKS = Looks()


@dataclass(frozen=True)
class Likenesses:
    """What lattices look like that are no panels."""

    ruled: float = 0.5  # share of which a rule lights the LEDs
    periods: tuple[int, ...] = (1, 2, 2, 3, 4)
    defect: float = 0.03  # share of LEDs that break the rule
    scattered: float = 0.45  # share whose LEDs lie off the lattice
    scatter_cells: tuple[float, float] = (0.18, 0.45)  # standard deviation
    bricks: float = 0.3  # share whose rows are shifted by halves
    round: float = 0.3  # share without LEDs beyond a disc
    sparse: float = 0.25  # share with fewer On LEDs than tell a lattice
    sparse_lit: tuple[float, float] = (1.0, 3.5)  # of them, on average


LIKENESSES = Likenesses()


@dataclass(frozen=True)
class Things:
    """Bright and dark polygons beside panels; lengths in halves of a panel's diagonal."""

    beside: float = 0.35  # share of panels with one
    away: tuple[float, float] = (0.7, 2.0)  # its middle from the panel's
    size: tuple[float, float] = (0.15, 1.2)
    sides: int = 5
    uneven: float = 0.5  # of its size, by which a side is nearer, at most
    brightest: float = 400.0


THINGS = Things()


def shapes_of(draws: Draws) -> Tensor:
    """Draw rows and columns (B,2) of panels."""
    shapes = torch.tensor(SHAPES, dtype=torch.float32, device=draws.device)
    return shapes[draws.below(len(SHAPES))]


def poses(draws: Draws, shapes: Tensor, pitch_px: Tensor, centre_px: Tensor) -> Tensor:
    """Turn panels (B,2) in space: corners (B,4,2) of a mean pitch (B,) about centres (B,2)."""
    wild = draws.coin(LOOKS.wild)
    flat, aspect = draws.coin(LOOKS.flat), draws.geometric(*LOOKS.aspect, 1)
    half = shapes / 2
    x = shapes.new_tensor([-1.0, 1.0, 1.0, -1.0]) * half[:, 1:]
    y = shapes.new_tensor([-1.0, -1.0, 1.0, 1.0]) * half[:, :1]
    places = [x * torch.where(flat, aspect, 1.0), y, torch.zeros_like(x)]
    for (first, second), near, far in zip(
        PLANES, LOOKS.turns_deg, LOOKS.wild_turns_deg, strict=True
    ):
        angle = draws.uniform(-1, 1, 1) * torch.where(wild, far, near)
        cosine, sine = angle.deg2rad().cos(), angle.deg2rad().sin()
        a, b = places[first], places[second]
        places[first], places[second] = a * cosine - b * sine, a * sine + b * cosine
    away = draws.uniform(*LOOKS.distance_sides, 1) * shapes.amax(1, keepdim=True)
    quads = torch.stack(places[:2], 2) / (1 + places[2] / away)[..., None]
    scale = pitch_px * (shapes.prod(1) / signed_area(quads).abs()).sqrt()
    return quads * scale[:, None, None] + centre_px[:, None]


def bits_of(draws: Draws, shapes: Tensor) -> Tensor:
    """Draw how bright LEDs of panels (B,2) are, (B,N,N): 0 for Off ones, about 1 for On ones."""
    size = MOST_LEDS
    least, most = LOOKS.lit
    low = (LOOKS.least_lit / shapes.prod(1)).clamp(min=least)[:, None, None]
    lit = low + (most - low) * draws.uniform(0, 1, 1, 1)
    noise = draws.uniform(0, 1, size, size)
    mean = functional.avg_pool2d(noise, 3, 1, 1, count_include_pad=False)
    together = mean < 0.5 + LOOKS.together * (lit - 0.5)
    pictured = draws.coin(LOOKS.pictured)[..., None]
    light = torch.where(pictured, together, noise < lit).float()
    spread = draws.coin(LOOKS.unequal) * draws.uniform(*LOOKS.scatter, 1)
    light = light * (spread[..., None] * draws.normal(size, size)).exp()
    few, many = LOOKS.groups
    groups = few + draws.below(many - few, 1)
    group = torch.arange(size, device=draws.device) % groups
    dim = draws.uniform(0.1, 1, size).gather(1, group) < 0.5
    return light * torch.where(dim & draws.coin(LOOKS.driven), 0.3, 1.0)[..., None]


@dataclass(frozen=True)
class Likeness:
    """Lattices that are no panels.

    Args:
        light: (B,N,N) of LEDs.
        off_cells: (B,2,N,N) by which LEDs lie off the lattice, across and down.
    """

    light: Tensor
    off_cells: Tensor


def likenesses(draws: Draws, shapes: Tensor) -> Likeness:
    """Draw lattices with a rule, off a lattice, in bricks, in a disc or sparse; each at least one of these."""
    options, size = LIKENESSES, MOST_LEDS
    ruled, scattered, bricks, disc, sparse = (
        draws.coin(share)[..., None]
        for share in (
            options.ruled,
            options.scattered,
            options.bricks,
            options.round,
            options.sparse,
        )
    )
    ruled = ruled | ~(scattered | bricks)
    row = torch.arange(size, device=draws.device)[:, None]
    column = row.mT
    steps = draws.below(3, 2, 1)
    periods = torch.tensor(options.periods, device=draws.device)
    period = periods[draws.below(len(periods), 1)][..., None]
    lit = (steps[:, :1] * row + steps[:, 1:] * column) % period == 0
    lit = lit ^ (draws.uniform(0, 1, size, size) < options.defect)
    light = torch.where(ruled, lit.float(), bits_of(draws, shapes))
    share = draws.uniform(*options.sparse_lit, 1, 1) / shapes.prod(1)[:, None, None]
    spots = draws.uniform(0, 1, size, size) < share
    light = torch.where(sparse, spots.float(), light)
    middle = (shapes[..., None, None] - 1) / 2
    far = ((row - middle[:, 0]) / middle[:, 0]).square()
    far = far + ((column - middle[:, 1]) / middle[:, 1]).square()
    light = light * torch.where(disc, far < draws.uniform(0.8, 1.4, 1, 1), True)
    spread = draws.uniform(*options.scatter_cells, 1, 1, 1) * scattered[..., None]
    off = (spread * draws.normal(2, size, size)).clamp(-0.45, 0.45)
    shift = torch.stack([(row % 2).expand(size, size), torch.zeros_like(row + column)])
    off = off + (0.5 * bricks[..., None]) * (shift - 0.5 * shift.amax((1, 2), True))
    return Likeness(light, off)


@dataclass(frozen=True)
class PanelPixels:
    """Where the pixels of pictures lie on panels.

    Args:
        cells: (B,2,P) places in cells, across and down.
        leds: (B,2) columns and rows.
        number: (B,P) int64 of the LED in the table of bits.
        off_cells: (B,2,P) from the LED's middle.
        cell_px: (B,1) side of a cell.
    """

    cells: Tensor
    leds: Tensor
    number: Tensor
    off_cells: Tensor
    cell_px: Tensor

    def within(self, margins: Tensor) -> Tensor:
        """Say which pixels (B,P) lie on the panel or its margins: (B,4) cells, left, top, right, below."""
        least, most = -margins[:, :2], self.leds + margins[:, 2:]
        inside = (self.cells >= least[..., None]) & (self.cells < most[..., None])
        return inside.all(1)


def lattice_of(
    draws: Draws,
    quads: Tensor,
    shapes: Tensor,
    size: tuple[int, int],
    likeness: Likeness | None,
) -> PanelPixels:
    """Place the pixels of pictures of a size on panels; real ones may have gaps between modules."""
    cells, leds = cells_of(quads, shapes, *size), shapes.flip(1)
    gap = draws.uniform(0, LOOKS.gap_cells, 1) * draws.coin(LOOKS.modular)
    gap = gap * (likeness is None)
    number, off = module_cells(cells, leds[..., None], gap[..., None])
    column, row = number.clamp(0, MOST_LEDS - 1).unbind(1)
    place = (row * MOST_LEDS + column).long()
    if likeness is not None:
        places = place[:, None].expand(-1, 2, -1)
        off = off - likeness.off_cells.flatten(2).gather(2, places)
    cell_px = (quads - quads.roll(1, 1)).norm(dim=2).mean(1) / shapes.mean(1)
    return PanelPixels(cells, leds, place, off, cell_px[:, None])


@dataclass(frozen=True)
class Leds:
    """The LEDs of panels.

    Args:
        cover: (B,P) share of a pixel on an LED.
        light: (B,P) 0 for Off LEDs, about 1 for On ones.
        radius: (B,1) of an LED, cells.
        soft: (B,1) width of its edge, cells.
    """

    cover: Tensor
    light: Tensor
    radius: Tensor
    soft: Tensor


def spots_of(
    draws: Draws, lattice: PanelPixels, soft_px: float, likeness: Likeness | None
) -> Leds:
    """Draw square or round LEDs, and which are On."""
    off = lattice.off_cells
    square = draws.coin(LOOKS.square)
    away = torch.where(square, off.abs().amax(1), off.norm(dim=1))
    soft = (soft_px / lattice.cell_px).clamp(min=LOOKS.least_soft_cells)
    radius = draws.uniform(*LOOKS.fill, 1) / 2
    inside = lattice.within(lattice.leds.new_zeros(draws.count, 4))
    cover = ((radius + soft / 2 - away) / soft).clamp(0, 1) * inside
    lights = likeness.light if likeness else bits_of(draws, lattice.leds)
    light = lights.flatten(1).gather(1, lattice.number)
    return Leds(cover, light, radius, soft)


def boards(draws: Draws, lattice: PanelPixels, behind: Tensor) -> tuple[Tensor, Tensor]:
    """Lay boards on pictures (B,P); give them, and the grey values (B,1) beneath the LEDs."""
    unseen = draws.coin(LOOKS.unseen)
    dark, bright = (draws.uniform(0, most, 1) for most in LOOKS.board)
    board = torch.where(draws.coin(LOOKS.bright_board), bright, dark)
    usual, most = LOOKS.margin_cells
    margin = draws.uniform(0, usual, 1)
    margin = margin + draws.coin(LOOKS.wide_margin) * draws.uniform(0, most, 1)
    added = draws.coin(LOOKS.uneven_margin) * draws.uniform(0, most, 4)
    margin = margin + added
    lip = draws.coin(LOOKS.lip) & ~unseen
    lip = lip & lattice.within(margin + draws.uniform(*LOOKS.lip_cells, 1))
    flat = torch.where(lip, draws.uniform(0, LOOKS.brightest_lip, 1), behind)
    flat = torch.where(lattice.within(margin) & ~unseen, board, flat)
    inside = lattice.within(torch.zeros_like(margin))
    mean = (behind * inside).sum(1, True) / inside.sum(1, True).clamp(1)
    return flat, torch.where(unseen, mean, board)


def shades(draws: Draws, lattice: PanelPixels, spots: Leds, under: Tensor) -> Tensor:
    """Draw the grey values (B,P) of LEDs: On and Off, uneven over the panel, brighter inside."""
    off = under + draws.coin(LOOKS.dark_off) * draws.uniform(*LOOKS.off, 1)
    on = torch.maximum(off, under) + draws.geometric(*LOOKS.contrast, 1)
    # Small LEDs are as bright in all as large ones in most panels.
    small = (1 + spots.soft / spots.radius / 2).clamp(max=3)
    bright = torch.where(draws.coin(LOOKS.as_bright), small, 1.0)
    shown = off + (on - off) * spots.light
    slope = draws.uniform(-1, 1, 2) * draws.coin(LOOKS.uneven) * LOOKS.fall
    places = lattice.cells / lattice.leds[..., None] - 0.5
    fall = (slope[..., None] * places).sum(1)
    shown = under + (shown - under) * (1 + fall).clamp(min=0.1)
    shown = torch.where(spots.light > 0, shown * bright, shown)
    core = draws.uniform(-1, 1, 2, 1) * (LOOKS.core_off * spots.radius[..., None])
    inner = (lattice.off_cells - core).square().sum(1) / spots.radius.square()
    lost = draws.coin(LOOKS.cored) * draws.uniform(0, LOOKS.core, 1)
    return under + (shown - under) * (1 - lost * inner).clamp(0)


def with_panels(
    pictures: Tensor,
    quads: Tensor,
    shapes: Tensor,
    draws: Draws,
    soft_px: float,
    likeness: Likeness | None = None,
) -> Tensor:
    """Lay panels (B,4,2) px of rows and columns (B,2) into pictures (B,H,W).

    Args:
        pictures: grey values.
        quads: corners.
        shapes: rows and columns.
        draws: the looks.
        soft_px: width of an LED's edge.
        likeness: lattices that are no panels, in place of panels.
    """
    pictures = with_things(pictures, quads, draws)
    size = pictures.shape[1], pictures.shape[2]
    lattice = lattice_of(draws, quads, shapes, size, likeness)
    spots = spots_of(draws, lattice, soft_px, likeness)
    flat, under = boards(draws, lattice, pictures.flatten(1))
    shown = shades(draws, lattice, spots, under)
    hidden = draws.coin(LOOKS.hidden_off) & (spots.light == 0)
    laid = flat + (shown - flat) * (spots.cover * ~hidden)
    excess = ((shown - under) * spots.cover * (spots.light > 0)).clamp(0)
    sigma = lattice.cell_px * draws.uniform(*LOOKS.glow_cells, 1)
    glow = draws.coin(LOOKS.glowing) * draws.geometric(*LOOKS.glow, 1)
    halo = blurred(excess.view_as(pictures), sigma.clamp(*LOOKS.glow_px)[:, 0])
    return laid.view_as(pictures) + glow[..., None] * halo


def with_things(pictures: Tensor, quads: Tensor, draws: Draws) -> Tensor:
    """Draw a polygon into some of the pictures (B,H,W), beside the places (B,4,2) px of panels."""
    options, (high, wide) = THINGS, pictures.shape[1:]
    centre = quads.mean(1)
    half = (quads - centre[:, None]).norm(dim=2).mean(1, keepdim=True)
    angle, turns = (
        draws.uniform(0, 2 * math.pi, count) for count in (1, options.sides)
    )
    away = half * draws.uniform(*options.away, 1)
    middle = centre + away * torch.cat([angle.cos(), angle.sin()], 1)
    far = half * draws.geometric(*options.size, 1)
    far = far * draws.uniform(1 - options.uneven, 1, options.sides)
    at = pixels(high, wide, draws.device) - middle[..., None]
    beyond = torch.stack([turns.cos(), turns.sin()], 2) @ at > far[..., None]
    inside = ~beyond.any(1) & draws.coin(options.beside)
    shade = draws.uniform(0, options.brightest, 1)
    return torch.where(inside, shade, pictures.flatten(1)).view_as(pictures)


def module_cells(places: Tensor, leds: Tensor, gap: Tensor) -> tuple[Tensor, Tensor]:
    """Give the numbers of cells at places (B,2,P), 0 to the count of LEDs (B,2,1), and the way from their middles.

    Modules lie apart by gaps (B,1,1), cells.
    """
    side = LOOKS.module
    modules = (leds / side).floor().clamp(min=1)
    gap = torch.where(leds % side == 0, gap, 0.0)
    at = places * (1 + gap * (modules - 1) / leds)
    module = (at / (side + gap)).floor().clamp(min=0).minimum(modules - 1)
    at = at - module * gap
    last = torch.where(module == modules - 1, torch.inf, side * module + side - 1)
    number = at.floor().minimum(last)
    return number, at - number - 0.5
