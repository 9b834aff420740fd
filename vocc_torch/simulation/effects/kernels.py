"""Kernels of blurs, and convolution with them."""

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.simulation import raster


@dataclass(frozen=True)
class KernelSettings:
    """Sizes of kernels and of working arrays."""

    # Radius of the circle that holds 99.5 % of the light, wavelengths times f-number.
    reach_lambda_n: float = 40.5
    most_reach_px: int = 128  # half the widest kernel; the work grows with its square
    strip_values: int = 2_000_000  # larger frames are convolved in strips of columns


KERNELS = KernelSettings()


Tap = tuple[int, int, float]
"""Row, column and weight of a kernel's tap; its mirror image through the middle has the same weight."""


def checked_reach(reach_px: float, cause: str) -> int:
    """Refuse a kernel that is wider than is on offer.

    Raises:
        VoccError: a half width above 128 px, with ``cause`` saying where it comes from.

    Example:
        >>> checked_reach(3, "scene.effects.defocus.focus_distance_m is 2")
        3
    """
    if not reach_px <= KERNELS.most_reach_px:
        raise VoccError(
            f"{cause}: it spreads light over {reach_px:.0f} px on each side, "
            f"at most {KERNELS.most_reach_px} px is offered"
        )
    return int(reach_px)


def bordered(plane: Tensor, across: int, down: int) -> Tensor:
    """Continue a plane (H,W) beyond its border as it is there."""
    margins = (across, across, down, down)
    return nn.functional.pad(plane[None, None], margins, mode="replicate")[0, 0]


def convolved(
    value: Tensor,
    convolve: Callable[..., Tensor],
    kernels: Iterable[tuple[object, ...]],
) -> Tensor:
    """Convolve frames (B,1,H,W) in float64, each with a kernel of its own, as ``convolve`` takes it.

    Example:
        >>> convolved(torch.ones(1, 1, 1, 2), convolve_taps, [(0.5, [(0, 1, 0.25)])]).tolist()
        [[[[1.0, 1.0]]]]
    """
    frames = zip(value[:, 0].double(), kernels, strict=True)
    planes = [convolve(plane, *kernel) for plane, kernel in frames]
    return torch.stack(planes).unsqueeze(1).to(value.dtype)


def convolve_symmetric(plane: Tensor, quarter: Tensor) -> Tensor:
    """Convolve one frame with a kernel that is symmetric from left to right and from top to bottom.

    Args:
        plane: (H,W) float64.
        quarter: (p+1,p+1) float64, the kernel from its middle on to the right and down.

    Returns:
        (H,W) float64.

    Example:
        >>> quarter = torch.tensor([[0.6, 0.1], [0.1, 0.0]], dtype=torch.float64)
        >>> dot = torch.zeros(3, 4, dtype=torch.float64)
        >>> dot[1, 1] = 1
        >>> convolve_symmetric(dot, quarter)[1].tolist()
        [0.1, 0.6, 0.1, 0.0]
    """
    quarter, reach = quarter.to(plane.device), quarter.shape[-1] - 1
    if reach == 0:
        return plane * quarter[0, 0]
    padded = bordered(plane, reach, reach)
    step = max(KERNELS.strip_values // ((reach + 1) * len(padded)), reach + 1)
    strips = [
        convolve_strip(padded[:, left : left + step + 2 * reach], quarter, reach)
        for left in range(0, plane.shape[1], step)
    ]
    return torch.cat(strips, dim=1)


def convolve_strip(padded: Tensor, quarter: Tensor, reach: int) -> Tensor:
    """Convolve columns that bring their own border of ``reach`` pixels on every side.

    Mirrored columns are added first, one matrix product makes all rows of the kernel, and mirrored rows are
    added last, each shifted to its place.
    """
    tall, width = padded.shape[0], padded.shape[1] - 2 * reach
    height = tall - 2 * reach
    columns = padded.unfold(1, width, 1).transpose(0, 1)
    pairs = columns[reach:] + columns[: reach + 1].flip(0)
    # The middle is its own mirror image and so is counted twice.
    once = torch.ones(reach + 1, dtype=quarter.dtype, device=quarter.device)
    once[0] = 0.5
    rows = ((quarter * once * once.unsqueeze(-1)) @ pairs.flatten(1)).view(-1, width)
    rows = rows[reach:]
    # Row i of the kernel starts at row i of its own plane, counted up or down from the border's end.
    above = rows.unfold(0, height, tall - 1)[: reach + 1].transpose(1, 2)
    below = rows.unfold(0, height, tall + 1).transpose(1, 2)
    return (above + below).sum(0)


def convolve_taps(plane: Tensor, middle: float, taps: Sequence[Tap]) -> Tensor:
    """Convolve one frame with a kernel of a few taps that is symmetric about its middle.

    Args:
        plane: (H,W) float64.
        middle: weight of the middle.
        taps: half of the others; each also stands for its mirror image through the middle.

    Returns:
        (H,W) float64.

    Example:
        >>> dot = torch.tensor([[0.0, 0.0, 8.0, 0.0, 0.0]], dtype=torch.float64)
        >>> convolve_taps(dot, 0.5, [(0, 1, 0.25)]).tolist()
        [[0.0, 2.0, 4.0, 2.0, 0.0]]
    """
    height, width = plane.shape
    down = max((abs(row) for row, _, _ in taps), default=0)
    across = max((abs(column) for _, column, _ in taps), default=0)
    shifted = bordered(plane, across, down).unfold(0, height, 1).unfold(1, width, 1)
    total = plane * middle
    for row, column, weight in taps:
        ahead = shifted[down + row, across + column]
        behind = shifted[down - row, across - column]
        total = total + (ahead + behind) * weight
    return total


def disc_radius_px(diameter_px: Tensor) -> Tensor:
    """Radius of the disc whose cover of whole pixels has the second moment of the true disc, ``c^2 / 16``.

    The share of the cover that lies in columns beyond the k-th is ``2 (1 - G((k + 1/2) / R))``, with G the
    distribution along an axis of a unit disc, and the second moment is the sum of ``2 k + 1`` times that. It
    grows with R, so R is found by halving.

    Args:
        diameter_px: (B,) float64, diameter c of the true disc, px, at least 0.

    Returns:
        (B,) float64, px, from 0.5, where the whole disc lies in one pixel.

    Example:
        >>> wide = disc_radius_px(torch.tensor([0.0, 40.0], dtype=torch.float64))
        >>> [round(float(r), 2) for r in wide]
        [0.5, 19.99]
    """
    area = diameter_px * diameter_px / 16
    low, high = torch.full_like(diameter_px, 0.5), diameter_px / 2 + 1
    count = math.ceil(high.max()) + 1
    steps = torch.arange(count, dtype=torch.float64, device=diameter_px.device)
    for _ in range(36):
        middle = (low + high) / 2
        u = ((steps + 0.5) / middle.unsqueeze(-1)).clamp(max=1)
        beyond = 1 - (2 / math.pi) * (u * torch.sqrt((1 - u) * (1 + u)) + torch.asin(u))
        # A running sum adds a frame's terms in the same order whatever else is in the batch.
        small = ((2 * steps + 1) * beyond).cumsum(-1)[:, -1] < area
        low = torch.where(small, middle, low)
        high = torch.where(small, high, middle)
    return low


def disc_quarters(radius_px: Tensor) -> list[Tensor]:
    """Share of each disc's area in each pixel of the quarter right of and below its middle pixel.

    Args:
        radius_px: (B,) float64, px, at least 0.5; a disc's middle is that of a pixel.

    Returns:
        B tensors (p+1,p+1) float64, each as large as its disc; mirrored into four quarters it adds up to 1
        within rounding.

    Example:
        >>> quarters = disc_quarters(torch.tensor([0.5, 0.6], dtype=torch.float64))
        >>> [quarter.shape[0] for quarter in quarters], quarters[0].tolist()
        ([1, 2], [[1.0]])
    """
    reaches = torch.ceil(radius_px - 0.5).long().tolist()
    steps = torch.arange(max(reaches) + 2, dtype=torch.float64, device=radius_px.device)
    edges = (steps - 0.5) / radius_px.unsqueeze(-1)
    upright = edges.new_zeros(()), edges.new_ones(())
    area = raster.disc_wedge_area(edges, edges, *upright)
    shares = raster.per_pixel(area).clamp(min=0) / math.pi
    return [
        share[: reach + 1, : reach + 1]
        for share, reach in zip(shares, reaches, strict=True)
    ]


def streak_length_px(length_px: float) -> float:
    """Length of the streak whose cover of whole pixels has the second moment of the true one, ``L^2 / 12``.

    A streak of length M about a pixel's middle, M from 2 n - 1 to 2 n + 1, has the moment
    ``n^2 - n (4 n^2 - 1) / (3 M)``; n is the last pixel that it touches.

    Args:
        length_px: length L of the true streak along an axis, px, at least 0.

    Returns:
        Length M, px.

    Example:
        >>> streak_length_px(0.0), round(streak_length_px(0.3), 6), round(streak_length_px(29.0), 2)
        (0.0, 1.007557, 29.02)
    """
    if length_px == 0:
        return 0.0
    moment = length_px * length_px / 12
    n = max(1, math.ceil((math.sqrt(1 + 12 * moment) - 1) / 2))
    return n * (4 * n * n - 1) / (3 * (n * n - moment))


def streak_taps(shift_x_px: float, shift_y_px: float) -> tuple[float, list[Tap]]:
    """Share of a straight streak in each pixel, exact to rounding.

    Args:
        shift_x_px: motion to the right during the exposure, px.
        shift_y_px: motion down, px.

    Returns:
        The share of the middle pixel and the taps of the half ahead of it. With their mirror images they add
        up to 1, and their second moments along the axes are ``shift^2 / 12``.

    Example:
        >>> middle, taps = streak_taps(0.3, 0.0)
        >>> round(middle, 6), [(row, column, round(weight, 6)) for row, column, weight in taps]
        (0.9925, [(0, 1, 0.00375)])
    """
    reach = [
        math.copysign(streak_length_px(abs(shift)), shift) / 2
        for shift in (shift_x_px, shift_y_px)
    ]
    cuts = {0.0, 1.0}
    for half in reach:
        cuts.update((k + 0.5) / abs(half) for k in range(math.ceil(abs(half) - 0.5)))
    ordered = sorted(cut for cut in cuts if cut <= 1)
    shares: dict[tuple[int, int], float] = {}
    for start, end in itertools.pairwise(ordered):
        # The middle of a piece tells its pixel.
        column, row = (math.floor(half * (start + end) / 2 + 0.5) for half in reach)
        shares[row, column] = shares.get((row, column), 0.0) + (end - start) / 2
    middle = 2 * shares.pop((0, 0))
    return middle, [(row, column, share) for (row, column), share in shares.items()]


def airy_quarter(lambda_n_px: float, reach_px: int) -> Tensor:
    """Share of an Airy pattern's light in each pixel of the quarter right of and below its middle pixel.

    The irradiance ``(2 J1(v) / v)^2``, ``v = pi r / (lambda N)``, is integrated over each pixel by Gauss and
    Legendre's rule, with more points the more rings a pixel holds, to 1e-10 of the whole.

    Args:
        lambda_n_px: wavelength times f-number, px, above 0.
        reach_px: half width p of the kernel, px; the light in it is scaled to 1.

    Returns:
        (p+1,p+1) float64 on the CPU; mirrored into four quarters it adds up to 1 within rounding.

    Example:
        >>> quarter = airy_quarter(0.323, 13)
        >>> round(float(quarter[0, 0]), 3), round(float(quarter[0, 1]), 3)
        (0.882, 0.016)
    """
    points = 8 + math.ceil(0.75 * math.pi / lambda_n_px)
    nodes, weights = map(torch.from_numpy, np.polynomial.legendre.leggauss(points))
    middles = torch.arange(reach_px + 1, dtype=torch.float64)
    at = (middles.unsqueeze(-1) + nodes / 2).flatten() * (math.pi / lambda_n_px)
    v = torch.hypot(at.unsqueeze(-1), at).clamp(min=1e-9)
    irradiance: Tensor = (torch.special.bessel_j1(v) / v).square()
    columns = (irradiance.view(-1, reach_px + 1, points) * weights).sum(-1)
    light = (columns.view(reach_px + 1, points, -1) * weights.view(1, -1, 1)).sum(1)
    mirrors = torch.full((reach_px + 1,), 2.0, dtype=torch.float64)
    mirrors[0] = 1.0
    kernel: Tensor = mirrors @ light @ mirrors
    return light / kernel
