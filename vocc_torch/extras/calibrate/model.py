"""The simulator's renderer, differentiable in what a recording is fitted by.

LEDs are drawn by the simulator's own exact areas; all is float64. A picture is made in linear light ``x``, in
units of the light that Eq. 1 encodes as the grey value 118: ``G = 118 x^(1/gamma)``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from numpy.polynomial.legendre import leggauss
from torch import Tensor, nn

from vocc_torch.hardware import PanelShape
from vocc_torch.simulation import raster
from vocc_torch.simulation.effects.optics import LEAST_SIGMA_PX, TRUNCATION_SIGMAS
from vocc_torch.simulation.effects.view import CLOCKWISE
from vocc_torch.simulation.photometry import MIDDLE_GREY

PLACED = ("x_px", "y_px", "log_pitch_px")
TURNED = ("yaw", "pitch", "roll")
LEVELS = ("background", "off", "on", "board")
OF_FRAME = (*PLACED, *TURNED, *LEVELS)
"""What each frame has of its own: the panel's centre on the sensor (px, before the lens bends it), the
logarithm of the image of a pitch (px), angles (rad) as of ``pose``, and grey values, not clipped, of the
background, of wide Off and On LEDs and of the board."""

OF_ALL = ("gamma", "blur_xx", "blur_yy", "k1")
"""What all frames share: the encoding, the blur's second moments along rows and columns (px^2), the lens."""

WHITE = 255.0
LEAST_LIGHT = 1e-9
HARMONICS, SHARP = 5, 0.1
"""Of rounding's saw, and the noise, in grey values, below which they do not draw it."""
ROUNDING = 1 / 12
"""Variance of the rounding to whole grey values."""

NODES = 24
"""Points at which a dark pixel's noise is averaged over (Gauss and Legendre)."""
WIDEST = 6.0
"""Standard deviations of noise that are averaged over, either way."""
DARK_SIGMAS = 5.0
"""Light below so many of its standard deviations is dark: the encoding is no straight line there."""


@dataclass(frozen=True)
class Noise:
    """The variance of linear light, ``slope x + floor``: a photon transfer curve.

    Args:
        slope: of light, one over the electrons that make the grey value 118.
        floor: variance in the dark.
    """

    slope: float = 0.0
    floor: float = 0.0


@dataclass(frozen=True)
class Windows:
    """What is known of the frames before anything is fitted.

    Args:
        shape: rows and columns of LEDs.
        radius: of an LED, in pitches.
        focal_px: focal length.
        sensor_px: height and width of the sensor, px.
        origin_px: (B,2) first pixel of each window, x and y.
        size_px: height and width of the windows, px.
        gain: (B,H,W) what the lens lets through; None for all.
        has_board: whether a board stands behind the LEDs.
    """

    shape: PanelShape
    radius: float
    focal_px: float
    sensor_px: tuple[int, int]
    origin_px: Tensor
    size_px: tuple[int, int]
    gain: Tensor | None = None
    has_board: bool = False

    def taken(self, rows: slice) -> "Windows":
        """Take some frames'."""
        gain = None if self.gain is None else self.gain[rows]
        return replace(self, origin_px=self.origin_px[rows], gain=gain)

    def cut(self, planes: Tensor) -> Tensor:
        """Cut each frame's window out of a plane of the sensor (B,H,W)."""
        (height, width), places = self.size_px, self.origin_px.tolist()
        parts = [plane[y : y + height, x : x + width] for plane, (x, y) in zip(planes, places, strict=True)]
        return torch.stack(parts)


def columns(values: Tensor) -> dict[str, Tensor]:
    """Name the columns of frames' values (B,10)."""
    return dict(zip(OF_FRAME, values.unbind(-1), strict=True))


def turned(yaw: Tensor, pitch: Tensor, roll: Tensor) -> Tensor:
    """Give the panel's two axes in the camera's coordinates, (B,3,2), as the effect ``pose`` turns them."""
    (cy, cp, cr), (sy, sp, sr) = ((f(yaw), f(pitch), f(roll)) for f in (torch.cos, torch.sin))
    right = cy * cr + sy * sp * sr, cp * sr, sy * cr - cy * sp * sr
    down = sy * sp * cr - cy * sr, cp * cr, -sy * sr - cy * sp * cr
    return torch.stack([torch.stack(right, -1), torch.stack(down, -1)], -1)


def seen(windows: Windows, of_frame: Tensor, of_all: Tensor, at: Tensor) -> tuple[Tensor, Tensor]:
    """Place discs of the panel's plane in the windows.

    The formulas are those of :class:`vocc_torch.simulation.effects.view.View`, with the pitch as the unit of
    length and derivatives by angles and lens too.

    Args:
        windows: what is known.
        of_frame: (B,10).
        of_all: (4,).
        at: (N,2) the discs' centres, in pitches from the panel's.

    Returns:
        centres (B,N,2) px and spreads (B,N,2,2) px^2 of their images.
    """
    own, k1 = columns(of_frame), of_all[OF_ALL.index("k1")]
    focal, (height, width) = windows.focal_px, windows.sensor_px
    middle = of_frame.new_tensor([width / 2, height / 2])
    axes = turned(own["yaw"], own["pitch"], own["roll"])
    away = focal * torch.exp(-own["log_pitch_px"])
    place = (torch.stack([own["x_px"], own["y_px"]], -1) - middle) * (away / focal).unsqueeze(-1)
    points = at.to(of_frame) @ axes.mT + torch.cat([place, away.unsqueeze(-1)], -1).unsqueeze(1)
    depth, rise = points[..., 2:], axes[:, 2]
    across = focal * (axes[:, None, :2] - (points[..., :2] / depth).unsqueeze(-1) * rise[:, None, None])
    square = windows.radius**2
    strength = square / (depth.square() - square * rise.square().sum(-1).view(-1, 1, 1))
    shift = -strength * (across * rise[:, None, None]).sum(-1)
    spread = strength.unsqueeze(-1) * (across @ across.mT) + shift.unsqueeze(-1) * shift.unsqueeze(-2)
    arm = points[..., :2] / depth + shift / focal
    radial = arm.square().sum(-1, keepdim=True) * k1
    bend = torch.diag_embed((1 + radial).expand_as(arm)) + 2 * k1 * arm.unsqueeze(-1) * arm.unsqueeze(-2)
    return middle + focal * arm * (1 + radial), bend @ spread @ bend.mT


def grid(shape: PanelShape) -> Tensor:
    """Give the LEDs' centres, (R*C,2) in pitches from the panel's, in raster order."""
    sides = (torch.arange(n, dtype=torch.float64) - (n - 1) / 2 for n in (shape.columns, shape.rows))
    return torch.stack(torch.meshgrid(*sides, indexing="xy"), -1).view(-1, 2)


def stamped(windows: Windows, centre: Tensor, spread: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Cover the pixels of the windows by ellipses (B,N): patches (B*N,h,w), left columns and top rows."""
    centre = centre - windows.origin_px.to(centre).unsqueeze(1)
    widest = spread.detach().diagonal(dim1=-2, dim2=-1).max().sqrt()
    side = min(math.ceil(2 * float(widest)) + 2, *windows.size_px)
    return raster.ellipse_cover(centre.flatten(0, 1), spread.flatten(0, 1), side, canvas_px=windows.size_px)


def light(windows: Windows, of_frame: Tensor, of_all: Tensor, lit: Tensor) -> Tensor:
    """Render the frames in linear light.

    Args:
        windows: what is known.
        of_frame: (B,10) as :data:`OF_FRAME`.
        of_all: (4,) as :data:`OF_ALL`.
        lit: (B,R*C) share of On's own light that each LED shows: bits, or an LED's own factor where it is On.

    Returns:
        (B,H,W) light, at least 0.
    """
    own, gamma = columns(of_frame), of_all[0]
    level = {name: linear(own[name].clamp(min=1e-3), gamma) for name in LEVELS}
    behind = level["board"] if windows.has_board else level["background"]
    frames = len(of_frame)
    canvas = level["background"].view(-1, 1, 1) * of_frame.new_ones(frames, *windows.size_px)
    if windows.has_board:
        half = [windows.shape.columns / 2, windows.shape.rows / 2]
        corners = of_frame.new_tensor(CLOCKWISE) * of_frame.new_tensor(half)
        corners_px = seen(windows, of_frame, of_all, corners)[0] - windows.origin_px.to(of_frame)[:, None]
        cover = raster.polygon_cover(corners_px, *windows.size_px)
        canvas = canvas + cover * (behind - level["background"]).view(-1, 1, 1)
    patches, left, top = stamped(windows, *seen(windows, of_frame, of_all, grid(windows.shape)))
    shown = (level["off"] - behind).unsqueeze(-1) + lit * (level["on"] - level["off"]).unsqueeze(-1)
    which = torch.arange(frames).repeat_interleave(lit.shape[1])
    raster.add_patches(canvas, patches * shown.reshape(-1, 1, 1), which, left, top)
    return through_camera(windows, canvas, of_all)


def through_camera(windows: Windows, canvas: Tensor, of_all: Tensor) -> Tensor:
    """Blur and dim (B,H,W) light as the lens does."""
    blurred = spread_out(canvas, of_all[1:3])
    return (blurred if windows.gain is None else blurred * windows.gain).clamp(min=LEAST_LIGHT)


def spread_out(canvas: Tensor, moments: Tensor) -> Tensor:
    """Blur (B,H,W) by a Gaussian of second moments xx and yy (px^2), sampled at pixels as Kornia's is."""
    across, down = moments.clamp(min=LEAST_SIGMA_PX**2)
    reach = max(1, math.ceil(TRUNCATION_SIGMAS * math.sqrt(max(float(across), float(down)))))
    height, width = canvas.shape[1:]
    padded = nn.functional.pad(canvas.unsqueeze(1), (reach,) * 4, mode="replicate").squeeze(1)
    return mixing(down, height, reach).mT @ padded @ mixing(across, width, reach)


def mixing(moment: Tensor, side: int, reach: int) -> Tensor:
    """Give the matrix (side+2*reach, side) by which pixels along an axis take from their neighbours."""
    apart = torch.arange(side + 2 * reach).unsqueeze(-1) - torch.arange(side) - reach
    weights = torch.where(apart.abs() <= reach, torch.exp(-apart.square() / (2 * moment)), 0.0)
    return weights / weights.sum(0)


def linear(grey: Tensor, gamma: Tensor) -> Tensor:
    """Give the light that is encoded as grey values which no white clips."""
    return (grey / MIDDLE_GREY) ** gamma


def encoded(x: Tensor, gamma: Tensor) -> Tensor:
    """Encode light as grey values, clipped at white (Eq. 1)."""
    return (MIDDLE_GREY * x.clamp(min=LEAST_LIGHT) ** (1 / gamma)).clamp(max=WHITE)


def expected(x: Tensor, gamma: Tensor, noise: Noise) -> tuple[Tensor, Tensor]:
    """Give the mean and the variance of the grey values that noisy light is written as.

    Where light is far above its noise, by the encoding's derivatives; where it is dark, or clipped at white,
    by an average over the noise, because clipping at black and the encoding's steep start move the mean.
    """
    if not (noise.slope or noise.floor):
        return encoded(x, gamma), torch.full_like(x, ROUNDING)
    grey, variance = encoded(x, gamma), noise.slope * x + noise.floor
    steep = torch.where(grey < WHITE, grey / (gamma * x), 0.0)
    mean = grey + steep * (1 / gamma - 1) / x * variance / 2
    spread = steep.square() * variance
    near = x < DARK_SIGMAS * variance.sqrt()
    near = near | ((grey - WHITE).abs() < DARK_SIGMAS * spread.sqrt().clamp(min=0.3))
    if not bool(near.any()):
        return mean, spread + ROUNDING
    # In the root of the light above black, in which the encoding's start is smooth.
    t, w = (torch.from_numpy(part).to(x) for part in leggauss(NODES))
    some, sigma = x[near], variance[near].sqrt()
    level = (some / sigma).unsqueeze(-1)
    clear = level > WIDEST
    low = torch.where(clear, torch.where(clear, level - WIDEST, 1.0).sqrt(), 0.0)
    half = ((level + WIDEST).sqrt() - low) / 2
    root = low + half * (t + 1)
    share = half * w * 2 * root * torch.exp(-(root.square() - level).square() / 2) / math.sqrt(2 * math.pi)
    greys = encoded(sigma.unsqueeze(-1) * root.square(), gamma)
    first = (greys * share).sum(-1)
    second = (greys.square() * share).sum(-1) - first.square()
    place = near.nonzero(as_tuple=True)
    return mean.index_put(place, first), spread.index_put(place, second) + ROUNDING


def written(mean: Tensor, sigma: float) -> Tensor:
    """Give the mean of what is written of grey values with noise: rounding is a saw, which noise dulls.

    Example:
        >>> written(torch.tensor([9.4, 9.5]).double(), 0.0).tolist()
        [9.0, 10.0]
        >>> round(float(written(torch.tensor(9.4), 0.3)), 2)
        9.37
    """
    if sigma < SHARP:
        return mean.round()
    saw = torch.zeros_like(mean)
    for k in range(1, HARMONICS + 1):
        fade = math.exp(-2 * (math.pi * k * sigma) ** 2) / (k * math.pi)
        saw += (-1) ** (k + 1) * fade * torch.sin(2 * math.pi * k * mean)
    return mean - saw


def directions(names: Sequence[str]) -> tuple[Tensor, Tensor]:
    """Give the change by one unit of each value: of a frame's (D,10), and of what all share (D,4).

    ``blur`` changes both axes of the blur alike.
    """
    known = (*OF_FRAME, *OF_ALL)
    whole = torch.zeros(len(names), len(known)).double()
    for row, name in zip(whole, names, strict=True):
        for one in ("blur_xx", "blur_yy") if name == "blur" else (name,):
            row[known.index(one)] = 1
    return whole[:, : len(OF_FRAME)], whole[:, len(OF_FRAME) :]


def slopes(
    windows: Windows,
    of_frame: Tensor,
    of_all: Tensor,
    lit: Tensor,
    noise: Noise,
    along: tuple[Tensor, Tensor],
) -> tuple[Tensor, Tensor]:
    """Expect grey values, and differentiate forward along :func:`directions`.

    Frames do not depend on one another. Noise and encoding change each pixel by itself, so two derivatives of
    them are enough.

    Returns:
        the mean grey values (B,H,W), and their derivatives (D,B,H,W).
    """
    own, shared = along

    def moved(step: Tensor) -> tuple[Tensor, Tensor]:
        x = light(windows, of_frame + step @ own, of_all + step @ shared, lit)
        return x, x

    def greys(x: Tensor, gamma: Tensor) -> Tensor:
        return expected(x, gamma, noise)[0]

    brighter, x = torch.func.jacfwd(moved, has_aux=True)(torch.zeros(len(own)).double())
    at, none = (x, of_all[0]), torch.zeros_like(of_all[0])
    mean, by_light = torch.func.jvp(greys, at, (torch.ones_like(x), none))[:2]
    by_gamma = torch.func.jvp(greys, at, (torch.zeros_like(x), none + 1))[1]
    return mean, by_light * brighter.movedim(-1, 0) + by_gamma * shared[:, :1, None, None]
