"""Panels laid into pictures, in batches: what both networks are trained on besides rendered frames."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

SHAPES = (
    ((8, 8),) * 7
    + ((4, 4),) * 6
    + ((4, 8), (8, 4), (16, 16), (16, 16), (8, 16), (16, 8))
    + ((8, 32), (32, 32), (5, 7), (6, 6), (12, 12), (4, 5), (5, 5))
)
"""Rows and columns of the panels, the commoner ones more often."""

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
    uneven_margin: float = 0.3  # share of boards with another margin on each side
    lip: float = 0.25  # share of boards with a frame of another brightness
    dark_off: float = 0.6  # share of panels whose Off LEDs differ from the board
    off: tuple[float, float] = (-30.0, 60.0)
    contrast: tuple[float, float] = (30.0, 500.0)  # of On LEDs
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
class Finish:
    """Ranges of what a camera does, grey values where nothing else is said."""

    gain: tuple[float, float] = (-0.7, 0.4)  # logarithm
    offset: tuple[float, float] = (-12.0, 25.0)
    grain: tuple[float, float, float] = (0.3, 1.5, 7.0)  # least, usual and most
    gamma: tuple[float, float] = (0.45, 0.9)
    grainy: float = 0.35  # share of pictures with more grain than is usual
    curved: float = 0.35  # share of pictures with a gamma
    cut: float = 0.12  # share of pictures beyond whose margins a frame's edges go on
    margin: float = 0.2  # of a side, at most, that lies beyond a frame
    reach_px: int = 4  # of a blur
    sharp: float = 0.2  # share of pictures that are sharpened
    sharpness: float = 1.0  # at most
    sharp_px: float = 1.0  # standard deviation


FINISH = Finish()


class Draws:
    """Random numbers for a batch of pictures, on the device of their generator.

    Args:
        generator: what draws.
        count: B, of pictures.
    """

    def __init__(self, generator: torch.Generator, count: int) -> None:
        self.generator, self.count, self.device = generator, count, generator.device

    def uniform(self, low: float, high: float, *size: int) -> Tensor:
        """Draw (B,*size) from low to high."""
        places = (self.count, *size)
        drawn = torch.rand(places, generator=self.generator, device=self.device)
        return low + (high - low) * drawn

    def geometric(self, low: float, high: float, *size: int) -> Tensor:
        """Draw (B,*size) whose logarithms are uniform."""
        return self.uniform(math.log(low), math.log(high), *size).exp()

    def normal(self, *size: int) -> Tensor:
        """Draw standard normal numbers (B,*size)."""
        places = (self.count, *size)
        return torch.randn(places, generator=self.generator, device=self.device)

    def coin(self, share: float) -> Tensor:
        """Draw (B,1) bool, true with a probability."""
        return self.uniform(0, 1, 1) < share

    def below(self, count: int, *size: int) -> Tensor:
        """Draw whole numbers (B,*size) from 0 to below a count."""
        places = (self.count, *size)
        return torch.randint(
            count, places, generator=self.generator, device=self.device
        )

    def chosen(self, shares: Tensor) -> Tensor:
        """Draw numbers (B,) of shares (N,)."""
        return torch.multinomial(
            shares, self.count, replacement=True, generator=self.generator
        )

    def shapes(self) -> Tensor:
        """Draw rows and columns (B,2)."""
        shapes = torch.tensor(SHAPES, dtype=torch.float32, device=self.device)
        return shapes[self.below(len(SHAPES))]


def poses(draws: Draws, shapes: Tensor, pitch_px: Tensor, centre_px: Tensor) -> Tensor:
    """Turn panels (B,2) in space: corners (B,4,2) of a mean pitch (B,) about centres (B,2)."""
    wild = draws.coin(LOOKS.wild)[:, 0]
    angles = [
        torch.deg2rad(
            torch.where(wild, draws.uniform(-far, far), draws.uniform(-near, near))
        )
        for near, far in zip(LOOKS.turns_deg, LOOKS.wild_turns_deg, strict=True)
    ]
    high, wide = (shapes[:, None] / 2).unbind(2)
    flat, aspect = draws.coin(LOOKS.flat), draws.geometric(*LOOKS.aspect, 1)
    wide = wide * torch.where(flat, aspect, 1.0)
    x = shapes.new_tensor([-1.0, 1.0, 1.0, -1.0]) * wide
    y = shapes.new_tensor([-1.0, -1.0, 1.0, 1.0]) * high
    z = torch.zeros_like(x)
    (yaw, pitch, roll) = ((one.cos()[:, None], one.sin()[:, None]) for one in angles)
    x, z = x * yaw[0], -x * yaw[1]
    y, z = y * pitch[0] - z * pitch[1], y * pitch[1] + z * pitch[0]
    x, y = x * roll[0] - y * roll[1], x * roll[1] + y * roll[0]
    away = draws.uniform(*LOOKS.distance_sides, 1) * shapes.amax(1, keepdim=True)
    quads = torch.stack([x, y], 2) / (1 + z / away)[..., None]
    after = quads.roll(-1, 1)
    area = (quads[..., 0] * after[..., 1] - quads[..., 1] * after[..., 0]).sum(1) / 2
    scale = pitch_px * (shapes.prod(1) / area.abs()).sqrt()
    return quads * scale[:, None, None] + centre_px[:, None]


def cells_of(quads: Tensor, shapes: Tensor, high: int, wide: int) -> Tensor:
    """Give the place in cells (B,2,H*W), across and down, of each pixel of pictures with panels (B,4,2)."""
    matrix = homography(quads, unit_corners(quads) * shapes.flip(1)[:, None])
    return mapped(matrix, pixels(high, wide, quads.device))


def unit_corners(like: Tensor) -> Tensor:
    """Give the corners (1,4,2) of a square of side 1."""
    return like.new_tensor([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]])


def pixels(high: int, wide: int, device: torch.device) -> Tensor:
    """Give the centres (1,2,H*W) of a picture's pixels."""
    down, across = (torch.arange(side, device=device) + 0.5 for side in (high, wide))
    y, x = torch.meshgrid(down, across, indexing="ij")
    return torch.stack([x.flatten(), y.flatten()])[None]


def mapped(matrix: Tensor, points: Tensor) -> Tensor:
    """Map points (B,2,P) by homographies (B,3,3); those beyond the horizon far away."""
    seen = matrix[:, :, :2] @ points + matrix[:, :, 2:]
    return seen[:, :2] / seen[:, 2:].clamp(min=1e-3)


def homography(first: Tensor, second: Tensor) -> Tensor:
    """Give matrices (B,3,3) that take four points (B,4,2) to four others."""
    first, second = first.expand_as(second), second.expand_as(first)
    one, none = torch.ones_like(first[..., :1]), torch.zeros_like(first)
    point = torch.cat([first, one], 2)
    across = torch.cat([point, none, 0 * one, -second[..., :1] * first], 2)
    down = torch.cat([none, 0 * one, point, -second[..., 1:] * first], 2)
    known = torch.cat([second[..., 0], second[..., 1]], 1)
    system = torch.cat([across, down], 1).double()
    # Corners of no area have no homography: numbers without a meaning stand for it.
    found, _ = torch.linalg.solve_ex(system, known.double())
    found = found.nan_to_num()
    return functional.pad(found.float(), (0, 1), value=1.0).view(-1, 3, 3)


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
    behind = pictures.flatten(1)
    rows, columns = shapes[:, :1], shapes[:, 1:]
    across, down = cells_of(quads, shapes, *pictures.shape[1:]).unbind(1)

    def within(margins: Tensor) -> Tensor:
        left, top, right, below = torch.split(margins, 1, 1)
        wide = (across >= -left) & (across < columns + right)
        inside: Tensor = wide & (down >= -top) & (down < rows + below)
        return inside

    inside = within(shapes.new_zeros(len(shapes), 4))
    gap = draws.uniform(0, LOOKS.gap_cells, 1) * draws.coin(LOOKS.modular)
    gap = gap * (likeness is None)
    (column, off_x), (row, off_y) = (
        module_cells(places, leds, gap)
        for places, leds in ((across, columns), (down, rows))
    )
    place = row.clamp(0, MOST_LEDS - 1) * MOST_LEDS + column.clamp(0, MOST_LEDS - 1)
    place = place.long()
    if likeness is not None:
        moved = likeness.off_cells.flatten(2).gather(
            2, place[:, None].expand(-1, 2, -1)
        )
        off_x, off_y = off_x - moved[:, 0], off_y - moved[:, 1]
    radius = torch.where(
        draws.coin(LOOKS.square),
        torch.maximum(off_x.abs(), off_y.abs()),
        (off_x.square() + off_y.square()).sqrt(),
    )
    cell_px = (quads - quads.roll(1, 1)).norm(dim=2).mean(1) / shapes.mean(1)
    soft = (soft_px / cell_px[:, None]).clamp(min=LOOKS.least_soft_cells)
    fill = draws.uniform(*LOOKS.fill, 1) / 2
    spot = ((fill + soft / 2 - radius) / soft).clamp(0, 1) * inside
    lights = bits_of(draws, shapes) if likeness is None else likeness.light
    light = lights.flatten(1).gather(1, place)
    unseen = draws.coin(LOOKS.unseen)
    mean = (behind * inside).sum(1, keepdim=True) / inside.sum(1, keepdim=True).clamp(1)
    dark, bright = (draws.uniform(0, most, 1) for most in LOOKS.board)
    board = torch.where(draws.coin(LOOKS.bright_board), bright, dark)
    margin = draws.uniform(0, LOOKS.margin_cells[0], 1)
    margin = margin + draws.coin(0.2) * draws.uniform(0, LOOKS.margin_cells[1], 1)
    added = draws.uniform(0, LOOKS.margin_cells[1], 4)
    margin = margin + draws.coin(LOOKS.uneven_margin) * added
    lip = draws.coin(LOOKS.lip) & ~unseen & within(margin + draws.uniform(0.1, 0.5, 1))
    flat = torch.where(lip, draws.uniform(0, 230, 1), behind)
    flat = torch.where(within(margin) & ~unseen, board, flat)
    under = torch.where(unseen, mean, board)
    off = under + draws.coin(LOOKS.dark_off) * draws.uniform(*LOOKS.off, 1)
    on = torch.maximum(off, under) + draws.geometric(*LOOKS.contrast, 1)
    # Small LEDs are as bright in all as large ones in most panels.
    bright = torch.where(
        draws.coin(LOOKS.as_bright), (1 + soft / fill / 2).clamp(max=3), 1.0
    )
    shown = off + (on - off) * light
    slope = draws.uniform(-1, 1, 2) * draws.coin(LOOKS.uneven) * LOOKS.fall / 2
    fall = slope[:, :1] * (across / columns - 0.5) + slope[:, 1:] * (down / rows - 0.5)
    shown = under + (shown - under) * (1 + 2 * fall).clamp(min=0.1)
    shown = torch.where(light > 0, shown * bright, shown)
    core = draws.uniform(-1, 1, 2, 1) * (LOOKS.core_off * fill[..., None])
    inner = (off_x - core[:, 0]).square() + (off_y - core[:, 1]).square()
    lost = draws.coin(LOOKS.cored) * draws.uniform(0, LOOKS.core, 1)
    shown = under + (shown - under) * (1 - lost * inner / fill.square()).clamp(0)
    hidden = draws.coin(0.25) & (light == 0)
    laid = torch.where(hidden, flat, flat + (shown - flat) * spot).view_as(pictures)
    excess = ((shown - under) * spot * (light > 0)).clamp(0).view_as(pictures)
    sigma = cell_px[:, None] * draws.uniform(*LOOKS.glow_cells, 1)
    glow = draws.coin(LOOKS.glowing) * draws.geometric(*LOOKS.glow, 1)
    halo = blurred(excess, sigma.clamp(*LOOKS.glow_px)[:, 0])
    return laid + glow[..., None] * halo


def module_cells(places: Tensor, leds: Tensor, gap: Tensor) -> tuple[Tensor, Tensor]:
    """Give the numbers of cells at places (B,P), 0 to the count of LEDs (B,1), and the way from their middles.

    Modules lie apart by gaps (B,1), cells.
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


def blurred(pictures: Tensor, sigma_px: Tensor) -> Tensor:
    """Blur pictures (B,H,W), each by a Gaussian of its deviation (B,)."""
    reach = FINISH.reach_px
    at = torch.arange(-reach, reach + 1, device=sigma_px.device) / sigma_px[:, None]
    kernel = (-at.square() / 2).exp()
    kernel = (kernel / kernel.sum(1, keepdim=True))[:, None]
    planes = functional.pad(pictures[None], (reach,) * 4, mode="replicate")
    planes = functional.conv2d(planes, kernel[:, :, None], groups=len(pictures))
    return functional.conv2d(planes, kernel[..., None], groups=len(pictures))[0]


def finished(
    pictures: Tensor,
    draws: Draws,
    blur_px: tuple[float, float] | None = None,
    edges: bool = True,
) -> Tensor:
    """Do to pictures (B,H,W) what cameras do: blur, gain, noise, white, gamma, and the frame's edges."""
    if blur_px is not None:
        pictures = blurred(pictures, draws.uniform(*blur_px))
    gain = draws.uniform(*FINISH.gain, 1, 1).exp()
    least, usual, most = FINISH.grain
    low, high = draws.uniform(least, usual, 1), draws.uniform(usual, most, 1)
    grain = torch.where(draws.coin(FINISH.grainy), high, low)
    noise = grain[..., None] * draws.normal(*pictures.shape[1:])
    edge = pictures - blurred(pictures, noise.new_full((draws.count,), FINISH.sharp_px))
    sharp = draws.coin(FINISH.sharp) * draws.uniform(0, FINISH.sharpness, 1)
    pictures = pictures + sharp[..., None] * edge
    light = pictures * gain + draws.uniform(*FINISH.offset, 1, 1) + noise
    light = light.clamp(0, 255)
    if edges:
        light = with_edges(light, draws)
    curved, power = draws.coin(FINISH.curved), draws.uniform(*FINISH.gamma, 1)
    power = torch.where(curved, power, 1.0)
    return 255 * (light / 255) ** power[..., None]


def with_edges(pictures: Tensor, draws: Draws) -> Tensor:
    """Let a frame's edges go on in the margins of some pictures (B,H,W)."""
    cut = draws.coin(FINISH.cut)
    for axis in (1, 2):
        side = pictures.shape[axis]
        ends = (draws.uniform(0, FINISH.margin, 2) * cut * side).long()
        place = torch.arange(side, device=draws.device).expand(draws.count, side)
        place = torch.maximum(place, ends[:, :1])
        place = torch.minimum(place, side - 1 - ends[:, 1:])
        place = place.unsqueeze(3 - axis).expand_as(pictures)
        pictures = pictures.gather(axis, place)
    return pictures
