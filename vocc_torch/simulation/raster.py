"""Anti-aliased drawing: the exact area that discs, ellipses, rectangles and polygons cover of each pixel.

The area of a disc inside the quadrant left of x and above y has a closed form whose transcendental parts
depend on x or on y alone. The cover of a pixel is the second difference of that quadrant area at its four
corners, so a disc costs one arc sine a pixel edge and a few products a pixel. For an ellipse, the map that
makes it the unit disc makes the quadrant a wedge between two slanted lines, with a closed form as cheap.

The share of a pixel that lies above one edge of a polygon is the second difference of a closed-form
integral. With the sign of the edge's direction, summed over the edges, these shares leave the polygon's own.
The integral is taken column by column and differenced by row, so that no large areas are subtracted.
"""

import math
from collections.abc import Iterator

import torch
from torch import Tensor
from torch.autograd.forward_ad import unpack_dual

Size = tuple[int, int]
"""Height and width, px."""

Patches = Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]
"""Numbers (M,) of shapes among the batch's, their cover (M,h,w), left columns and top rows."""

GROUP_VALUES = 1_000_000
"""Numbers in a working array."""

GROUP_VALUES_ELSEWHERE = 30_000_000
"""The same on an accelerator, where each further array costs a launch."""


def _half_segment(u: Tensor) -> Tensor:
    """Half of the area between the vertical diameter and the chord at u of the unit disc, odd in u.

    At its ends, where root and arc sine have no slope but their sum has, a derivative is asked for apart.
    """
    if u.requires_grad or unpack_dual(u).tangent is not None:  # type: ignore[no-untyped-call]  # torch has no types there
        within = u.abs() < 1
        inner = torch.where(within, u, 0.0)
        half = 0.5 * (inner * torch.sqrt((1 - inner) * (1 + inner)) + torch.asin(inner))
        return torch.where(within, half, u.sign() * (math.pi / 4))
    return 0.5 * (u * torch.sqrt((1 - u) * (1 + u)) + torch.asin(u))


def per_pixel(area: Tensor) -> Tensor:
    """Area in each pixel, (N,h,w), from that left of and above each corner of the pixels, (N,h+1,w+1)."""
    return area[:, 1:, 1:] - area[:, :-1, 1:] - area[:, 1:, :-1] + area[:, :-1, :-1]


def disc_grid_cover(
    columns_x: Tensor,
    rows_y: Tensor,
    radius: Tensor,
    size: int,
    *,
    canvas_px: Size,
) -> tuple[Tensor, Tensor, Tensor]:
    """Share of each pixel that the discs of upright grids cover: :func:`ellipse_cover`, many times faster.

    The discs of a column share their vertical edges and those of a row the horizontal ones, so that all that
    costs is done once for each.

    Args:
        columns_x: (B,C) px, float64, where each grid's columns are.
        rows_y: (B,R) px, float64.
        radius: (B,) px, above 0.
        size: patch side in px, at least ``ceil(2 radius) + 1``.
        canvas_px: height and width of what the discs are drawn on.

    Returns:
        cover (B,R,C,h,w) in 0 to 1, and the patches' left columns (B,C) and top rows (B,R), int64.

    Example:
        >>> x, y = torch.tensor([[2.0, 6.0]]).double(), torch.tensor([[2.5]]).double()
        >>> cover, left, top = disc_grid_cover(x, y, torch.ones(1).double(), 3, canvas_px=(5, 9))
        >>> [round(float(each) / math.pi, 6) for each in cover.sum((-2, -1)).view(-1)], left.tolist()
        ([1.0, 1.0], [[1, 5]])
    """
    frames, columns, rows = *columns_x.shape, rows_y.shape[1]
    left, width = patch(columns_x - radius.view(-1, 1), size, canvas_px[1])
    top, height = patch(rows_y - radius.view(-1, 1), size, canvas_px[0])
    edges = torch.arange(
        max(width, height) + 1, dtype=radius.dtype, device=radius.device
    )
    first = torch.cat([left, top], dim=1).unsqueeze(-1)
    middle = torch.cat([columns_x, rows_y], dim=1).unsqueeze(-1)
    u = ((first + edges - middle) / radius.view(-1, 1, 1)).clamp_(-1, 1)
    half, past = _half_segment(u).add_(math.pi / 8), (u >= 0).to(u.dtype)
    before = 2 * half + (math.pi / 4 - math.pi / 2 * past)
    terms = torch.stack([u, half, u * u, past, before])
    v, half_v, v_squared, past_v, before_v = (
        terms[:, :, columns:, : height + 1].flatten(2).unsqueeze(-1)
    )
    u, half, u_squared, past, before = (
        terms[:, :, :columns, : width + 1].flatten(2).unsqueeze(-2)
    )
    # Beyond the disc the area left of one edge and above another is made of those before each edge alone.
    beyond = (before * past_v).add_(past * before_v)
    inside = (u * v).add_(half).add_(half_v)
    area = torch.where(u_squared + v_squared < 1, inside, beyond)
    area = area.view(frames, rows, height + 1, columns, width + 1).transpose(2, 3)
    area = area[..., 1:, :] - area[..., :-1, :]
    cover = (area[..., 1:] - area[..., :-1]) * (radius * radius).view(-1, 1, 1, 1, 1)
    return cover.clamp_(0, 1), left.long(), top.long()


def patch(begin: Tensor, size: int, full: int) -> tuple[Tensor, int]:
    """First pixel (N,) and number of pixels of patches along an axis, on a canvas of ``full`` pixels."""
    return torch.floor(begin).clamp(0, max(full - size, 0)), min(size, full)


def by_size(
    low_px: Tensor, high_px: Tensor, canvas_px: Size, chosen: Tensor
) -> Iterator[tuple[Tensor, int]]:
    """Group shapes of about one size, so that each group's patches fit into the processor's memory.

    Args:
        low_px: (N,2) left and upper bound of each shape, px.
        high_px: (N,2) right and lower bound.
        canvas_px: height and width of what they are drawn on; those that do not touch it are left out.
        chosen: (N,) bool, the shapes to draw.

    Yields:
        Numbers (M,) of shapes, int64, in order, and the side of a square that holds what the canvas shows of
        each of them, px. Sizes are told apart by powers of two from 8 px on: one large image among many
        small ones does not make them all large.

    Example:
        >>> low, side = torch.tensor([[1.0, 1], [2, 2], [99, 0]]), torch.tensor([[3.0], [30], [3]])
        >>> [(rows.tolist(), side) for rows, side in by_size(low, low + side, (40, 40), torch.ones(3).bool())]
        [([0], 4), ([1], 31)]
    """
    canvas = low_px.new_tensor(canvas_px[::-1])
    touching = ((high_px > 0) & (low_px < canvas)).all(dim=-1)
    which = (touching & chosen).nonzero().squeeze(1)
    extent = torch.minimum(high_px[which], canvas) - low_px[which].clamp(min=0)
    sides = torch.minimum(torch.ceil(extent.amax(dim=-1)) + 1, canvas.max()).long()
    sizes = torch.ceil(torch.log2(sides.clamp(min=8).double()))
    for size in torch.unique(sizes).tolist():
        group = (sizes == size).nonzero().squeeze(1)
        side = int(sides[group].max())
        pixels = math.prod(min(side, full) for full in canvas_px)
        for rows in torch.split(group, max(1, GROUP_VALUES // pixels)):
            yield which[rows], side


def disc_wedge_area(u: Tensor, v: Tensor, cosine: Tensor, sine: Tensor) -> Tensor:
    """Area of the unit disc in the wedge ``{q: m.q < u and n.q < v}`` of two lines with unit normals m and n.

    Where the lines cross inside the disc, the wedge is a sector of it and two triangles. Elsewhere its area
    is the smaller of the two segments' where one lies in the other, and otherwise what the two have over the
    whole disc's.

    Args:
        u: (...,P) signed distances of lines with the normal m.
        v: (...,Q) signed distances of lines with the normal n.
        cosine: (...) of the angle between m and n.
        sine: (...) of that angle, above 0.

    Returns:
        (...,Q,P) area, 0 to pi.

    Example:
        >>> u, v, cosine = torch.zeros(1, 1), torch.zeros(1, 1), torch.tensor([-0.5])
        >>> area = disc_wedge_area(u, v, cosine, torch.sqrt(1 - cosine**2))
        >>> round(float(area) / math.pi, 6)  # the lines through the centre are 60 degrees apart
        0.166667
    """
    cosine, sine = cosine[..., None, None], sine[..., None, None]
    angle = torch.atan2(sine, -cosine)
    gu, gv = (_half_segment(line.clamp(-1, 1)) for line in (u, v))
    halves = gu.unsqueeze(-2) + gv.unsqueeze(-1)
    u, v = u.unsqueeze(-2), v.unsqueeze(-1)
    product, squares = u * v, u * u + v * v
    inside = halves + (product - cosine * squares / 2) / sine + angle / 2
    # Of two chords that do not cross, one lies in the other's segment where just one has its middle there.
    nested = (1 + cosine * cosine) * product < cosine * squares
    smaller = math.pi / 2 + 2 * torch.minimum(gu.unsqueeze(-2), gv.unsqueeze(-1))
    beyond = torch.where(nested, smaller, (2 * halves).clamp(min=0))
    return torch.where(squares - 2 * cosine * product < sine * sine, inside, beyond)


def ellipse_cover(
    centre_px: Tensor, spread_px2: Tensor, size: int, *, canvas_px: Size
) -> tuple[Tensor, Tensor, Tensor]:
    """Share of each pixel that an ellipse covers, in a patch of pixels around each ellipse.

    Args:
        centre_px: (N,2) ``(x, y)`` in px, float64.
        spread_px2: (N,2,2) px^2, float64, positive definite, of the ellipse
            ``(p - centre)^T spread^-1 (p - centre) <= 1``; the disc's is ``radius^2`` times the unit matrix.
        size: patch side in px, at least the widest ellipse's extent on the canvas and one.
        canvas_px: height and width of what they are drawn on, from the origin on: each patch lies on it.

    Returns:
        cover (N,size,size), or smaller on a smaller canvas, in 0 to 1, exact to rounding (in float64 within
        ``1e-15 / (1 - rho^2)`` of the ellipse's area, rho being the spread's correlation), and the patches'
        left columns (N,) and top rows (N,), int64.

    Example:
        >>> spread = torch.tensor([[[4.0, 1.2], [1.2, 1.0]]], dtype=torch.float64)
        >>> centre = torch.tensor([[5.3, 2.1]], dtype=torch.float64)
        >>> cover, left, top = ellipse_cover(centre, spread, size=5, canvas_px=(9, 9))
        >>> round(float(cover.sum() / math.pi), 9), int(left), int(top)  # the root of the determinant is 1.6
        (1.6, 3, 1)
    """
    half = reach_of(spread_px2)
    bounds = half.prod(dim=-1)
    covariance = spread_px2[:, 0, 1]
    # Seen edge-on an ellipse has no area, and rounding would leave a root of less than none.
    root = (bounds * bounds - covariance * covariance).clamp(min=0).sqrt()
    sine = (root / bounds).clamp(min=1e-9)
    left, width = patch(centre_px[:, 0] - half[:, 0], size, canvas_px[1])
    top, height = patch(centre_px[:, 1] - half[:, 1], size, canvas_px[0])
    edges = torch.arange(size + 1, dtype=centre_px.dtype, device=centre_px.device)
    u = ((left - centre_px[:, 0]).unsqueeze(-1) + edges[: width + 1]) / half[:, :1]
    v = ((top - centre_px[:, 1]).unsqueeze(-1) + edges[: height + 1]) / half[:, 1:]
    cover = per_pixel(disc_wedge_area(u, v, covariance / bounds, sine))
    return (cover * root.view(-1, 1, 1)).clamp_(0, 1), left.long(), top.long()


def reach_of(spread_px2: Tensor) -> Tensor:
    """Half of the width and of the height of ellipses, (...,2,2) px^2 to (...,2) px."""
    return spread_px2.diagonal(dim1=-2, dim2=-1).sqrt()


def ellipse_patches(
    centre_px: Tensor, spread_px2: Tensor, chosen: Tensor, *, canvas_px: Size
) -> Patches:
    """Cover ellipses in groups of about one size.

    Args:
        centre_px: (B,N,2), as in :func:`ellipse_cover`.
        spread_px2: (B,N,2,2).
        chosen: (B*N,) bool, the ellipses to draw.
        canvas_px: height and width of what they are drawn on.
    """
    centre, spread = centre_px.flatten(0, 1), spread_px2.flatten(0, 1)
    reach = reach_of(spread)
    for which, side in by_size(centre - reach, centre + reach, canvas_px, chosen):
        shapes = centre[which], spread[which]
        yield which, *ellipse_cover(*shapes, side, canvas_px=canvas_px)


def interval_cover(low: Tensor, high: Tensor, size: int) -> Tensor:
    """Share of each pixel ``[i, i+1)``, i below ``size``, that [low, high] covers; (B,) to (B,size).

    Example:
        >>> interval_cover(torch.tensor([0.5]), torch.tensor([2.25]), 4).tolist()
        [[0.5, 1.0, 0.25, 0.0]]
    """
    edges = torch.arange(size + 1, dtype=low.dtype, device=low.device)
    return edges.clamp(low.unsqueeze(-1), high.unsqueeze(-1)).diff(dim=1)


def polygon_cover(corners_px: Tensor, height: int, width: int) -> Tensor:
    """Share of each pixel that a simple polygon covers.

    The work is that of the rows and columns in which the batch's polygons lie, once an edge.

    Args:
        corners_px: (B,V,2) ``(x, y)`` in px from the frame's top left corner, V at least 3, in either
            orientation; the polygon may leave the frame, and need not be convex. One that crosses itself is
            outside the function's domain.
        height: rows of the frame.
        width: columns of the frame.

    Returns:
        (B,height,width) float64 in 0 to 1, exact to rounding: within ``1e-15`` of the larger side of what
        holds frame and polygon.

    Example:
        >>> triangle = torch.tensor([[[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]]])
        >>> polygon_cover(triangle, height=2, width=3).tolist()
        [[[1.0, 0.5, 0.0], [0.5, 0.0, 0.0]]]
    """
    start = corners_px.double()
    stop = start.roll(-1, dims=1)
    cover = start.new_zeros(len(start), height, width)
    top, bottom = _range(start[..., 1], height)
    across, down = (
        torch.arange(size + 1, dtype=start.dtype, device=start.device)
        for size in (width, height)
    )
    lines = down[top : bottom + 1].view(-1, 1)
    for ends in zip(start.unbind(1), stop.unbind(1), strict=True):
        (x0, y0), (x1, y1) = (end.unsqueeze(-1).unbind(dim=1) for end in ends)
        left, right = _range(torch.stack([x0, x1]), width)
        x = across[left : right + 1].clamp(torch.minimum(x0, x1), torch.maximum(x0, x1))
        run = torch.where(x1 == x0, 1.0, x1 - x0)
        y = y0 + (x - x0) / run * (y1 - y0)
        low = torch.minimum(y[:, :-1], y[:, 1:]).unsqueeze(1)
        span = y.diff(dim=1).abs().unsqueeze(1)
        # Mean over the column of min(y, line) - low, for y that runs evenly from low to low + span.
        above = lines - low
        within = torch.minimum(above.clamp(min=0), span)
        slack = within.square() / (2 * span.clamp(min=1e-300))
        mean = above.clamp_(max=0) + within - slack
        # The signed area of each pixel above the edge, positive for one that runs to the left.
        step = torch.where(x1 > x0, -1.0, 1.0) * x.diff(dim=1)
        cover[:, top:bottom, left:right] += mean.diff(dim=1) * step.unsqueeze(1)
    # Positive for corners that run clockwise, as the sum above is: y points down.
    x, y = (start - start[:, :1]).unbind(-1)
    twice_area = (x[:, :-1] * y[:, 1:] - y[:, :-1] * x[:, 1:]).sum(dim=-1)
    rows = torch.arange(height, device=start.device)
    # Rounding leaves 1e-16 beyond a polygon's rows, and how far that is computed depends on the batch.
    low, high = start[..., 1].aminmax(dim=1, keepdim=True)
    within = (rows < high) & (rows + 1 > low)
    cover *= (within * twice_area.sign().unsqueeze(-1)).unsqueeze(-1)
    return cover.clamp_(0, 1)


def _range(along: Tensor, size: int) -> tuple[int, int]:
    """First and last-plus-one pixel that values along an axis touch, within 0 to ``size``."""
    low, high = along.detach().clamp(0, size).aminmax()
    return math.floor(low), math.ceil(high)


def add_patches(
    canvas: Tensor, patches: Tensor, frame: Tensor, left: Tensor, top: Tensor
) -> None:
    """Add patches onto a batch of canvases in place.

    Args:
        canvas: (B,H,W), contiguous, changed in place.
        patches: (N,h,w) values to add, each wholly on its canvas.
        frame: (N,) int64, the canvas that each patch belongs to.
        left: (N,) int64 column of each patch's left edge.
        top: (N,) int64 row of each patch's top edge.

    Example:
        >>> canvas, one = torch.zeros(1, 2, 3), torch.ones(1, dtype=torch.int64)
        >>> add_patches(canvas, torch.ones(1, 2, 2), 0 * one, one, 0 * one)
        >>> canvas.tolist()
        [[[0.0, 1.0, 1.0], [0.0, 1.0, 1.0]]]
    """
    height, width = canvas.shape[-2:]
    down, across = (
        torch.arange(side, device=canvas.device) for side in patches.shape[1:]
    )
    first = (frame * height + top) * width + left
    index = first.view(-1, 1, 1) + (down.unsqueeze(-1) * width + across)
    canvas.view(-1).index_add_(0, index.view(-1), patches.to(canvas.dtype).reshape(-1))
