"""Features of an LED: AGR (Eq. 4), GRI (Eqs 5 to 8), NGR (Eq. 9); grey values for the baselines."""

import math
from collections.abc import Collection
from functools import lru_cache
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError, demand_word
from vocc_torch.types import PanelShape, is_exporting

FEATURE_NAMES = ("agr", "gri", "ngr")
"""The order of the features' last dimension."""

Gradient = Literal["sobel", "central"]

_CONVOLVED_FRAMES = 32

MOST_GREY = 1e9
"""Grey values beyond this are no grey values: sums of them might not fit float32."""


def _samples_per_led(patches: Tensor, shape: PanelShape) -> int:
    """Return K of patches (B,1,(R+2)K,(C+2)K); refuse patches of another ``shape`` or without floats."""
    samples = patches.shape[-1] // (shape.columns + 2)
    expected = ((shape.rows + 2) * samples, (shape.columns + 2) * samples)
    if patches.ndim != 4 or samples < 1 or tuple(patches.shape[-2:]) != expected:
        refusal = f"patches has shape {tuple(patches.shape)}"
        rule = f"(B,1,{shape.rows + 2}K,{shape.columns + 2}K), K at least 1"
        raise VoccError(
            f"{refusal}: for a panel of {shape.rows} x {shape.columns} LEDs it must be {rule}"
        )
    if not patches.is_floating_point():
        raise VoccError(f"patches has dtype {patches.dtype}: it must be floating")
    return samples


def checked_greys(greys: Tensor, name: str) -> Tensor:
    """Return floating grey values, or refuse other values.

    Raises:
        VoccError: a value below 0, above 1e9, NaN, or integers.

    Example:
        >>> checked_greys(torch.tensor([0.0, 255.0]), "greys").tolist()
        [0.0, 255.0]
    """
    if not greys.is_floating_point():
        raise VoccError(f"{name} has dtype {greys.dtype}: it must be floating")
    if not is_exporting() and greys.numel():
        low, high = (float(end) for end in greys.detach().aminmax())
        if not (low >= 0 and high <= MOST_GREY):
            range_text = (
                "NaN" if math.isnan(low + high) else f"values from {low:g} to {high:g}"
            )
            raise VoccError(
                f"{name} holds {range_text}: grey values must be finite, 0 to {MOST_GREY:g}"
            )
    return greys


def cell_means(patches: Tensor, shape: PanelShape) -> Tensor:
    """Mean grey value of every cell, the margin's included: (B,1,(R+2)K,(C+2)K) to (B,R+2,C+2).

    Raises:
        VoccError: patches of another shape.

    Example:
        >>> cell_means(torch.full((1, 1, 12, 12), 7.0), PanelShape(2, 2))[0].unique().tolist()
        [7.0]
    """
    return nn.functional.avg_pool2d(patches, _samples_per_led(patches, shape))[:, 0]


def level_ratios(means: Tensor) -> Tensor:
    """AGR and NGR (B,2,R,C): ratios of grey levels to the panel's mean.

    AGR has each LED's mean grey (Eq. 4), NGR that of its eight neighbouring cells, background included (Eq. 9).
    On an all-black panel every LED equals the mean, so 0/0 is 1, however bright the margin is. What the dtype
    cannot hold, beside a panel that is all but black, is its greatest number.

    Args:
        means: (B,R+2,C+2) cell means with margin, at least 0.

    Example:
        >>> means = torch.zeros(1, 4, 4)
        >>> means[0, 1:3, 1:3] = torch.tensor([[30.0, 10.0], [20.0, 20.0]])
        >>> level_ratios(means)[0, 0].tolist()
        [[1.5, 0.5], [1.0, 1.0]]
    """
    levels = means.unsqueeze(1)
    around = nn.functional.conv2d(levels, _ring(means.dtype, means.device))
    levels = levels[..., 1:-1, 1:-1]
    mean = levels.mean(dim=(2, 3), keepdim=True)
    lit, greys = mean > 0, torch.cat([levels, around], dim=1)
    ratio = torch.where(lit, greys / torch.where(lit, mean, 1.0), 1.0)
    return ratio.clamp(max=torch.finfo(ratio.dtype).max)


@lru_cache(maxsize=16)
@torch.inference_mode(False)
def _ring(dtype: torch.dtype, device: torch.device) -> Tensor:
    """Kernel (1,1,3,3) that takes the mean of a cell's eight neighbours."""
    ring = torch.full((1, 1, 3, 3), 1 / 8, dtype=dtype, device=device)
    ring[..., 1, 1] = 0.0
    return ring


def radial_inward_field(
    samples_per_led: int, dtype: torch.dtype, device: torch.device
) -> Tensor:
    """Unit vectors towards the cell's centre at its K x K samples (Eq. 8), (2,K,K) as (x, y).

    At the centre itself, which is a sample for odd K, the direction is undefined and the vector is zero.

    Example:
        >>> radial_inward_field(3, torch.float32, torch.device("cpu"))[0].round(decimals=3).tolist()[1]
        [1.0, 0.0, -1.0]
    """
    steps = (
        torch.arange(samples_per_led, dtype=dtype, device=device)
        - (samples_per_led - 1) / 2
    )
    inward = -torch.stack(torch.meshgrid(steps, steps, indexing="xy"))
    length = torch.linalg.vector_norm(inward, dim=0)
    return torch.where(length > 0, inward / length.clamp(min=0.5), 0.0)


@lru_cache(maxsize=16)
@torch.inference_mode(False)
def _inward_fields(
    samples: int, shape: PanelShape, dtype: torch.dtype, device: torch.device
) -> Tensor:
    """The inward field repeated for every LED of a panel, (2,R*K,C*K)."""
    return radial_inward_field(samples, dtype, device).repeat(
        1, shape.rows, shape.columns
    )


def image_gradient(patches: Tensor, kernel: Gradient) -> Tensor:
    """Gradient (Eq. 5) in grey values a sample, (B,1,h,w) to (B,2,h,w) as (DX, DY), from dark to bright.

    Args:
        patches: (B,1,h,w).
        kernel: ``sobel`` is Kornia's normalised Sobel filter, the slope a sample; ``central`` is Eq. 6 on the
            samples, ``f(x+1) - f(x-1)``, twice the slope, by Kornia too.

    Raises:
        VoccError: an unknown kernel.

    Example:
        >>> ramp = torch.arange(5.0).expand(1, 1, 5, 5)
        >>> [float(image_gradient(ramp, kernel)[0, 0, 2, 2]) for kernel in ("sobel", "central")]
        [1.0, 2.0]
    """
    demand_word("receiver.gradient", kernel, get_args(Gradient))
    # Loaded here because a classifier of grey levels needs no Kornia.
    from kornia.filters import spatial_gradient

    # Of more than a hundred frames torch's convolution takes five times as long for each.
    parts = (
        [patches]
        if is_exporting() or patches.is_cuda
        else torch.split(patches, _CONVOLVED_FRAMES)
    )
    # Normalised, the difference would be half of that of Eq. 6.
    mode, normalised = {"sobel": ("sobel", True), "central": ("diff", False)}[kernel]
    gradients = [spatial_gradient(part, mode, 1, normalised)[:, 0] for part in parts]
    return torch.cat(gradients)


def gradient_radial_inwardness(
    patches: Tensor,
    shape: PanelShape,
    cell_width_px: Tensor,
    cell_height_px: Tensor,
    kernel: Gradient = "sobel",
) -> Tensor:
    """GRI: the mean over an LED's cell of the gradient's component towards its centre (Eq. 7).

    Args:
        patches: (B,1,(R+2)K,(C+2)K) rectified grey values, finite; with K = 1 each sample is its cell's
            centre, which has no direction, and the GRI is 0.
        shape: rows and columns.
        cell_width_px: (B,) width of a cell in the original image, px; with the height it turns the gradient a
            sample into one an original pixel, as Eq. 7 counts; an image twice as large has half the GRI.
        cell_height_px: (B,) likewise; both finite, and what is below 1e-6 px counts as that.
        kernel: see :func:`image_gradient`.

    Returns:
        (B,R,C), grey values a pixel; positive where light falls off outwards, exactly 0 on a plateau of one
        whole grey value, such as a saturated one. A cell much smaller than a pixel magnifies the samples'
        rounding by K / its size.

    Raises:
        VoccError: patches of another shape.

    Example:
        >>> bump = torch.zeros(1, 1, 9, 9)
        >>> bump[..., 4, 4] = 8.0
        >>> size = torch.tensor([3.0])
        >>> float(gradient_radial_inwardness(bump, PanelShape(1, 1), size, size)) > 0
        True
    """
    samples = _samples_per_led(patches, shape)
    # One sample of margin is all that the gradient kernels need.
    near = slice(samples - 1, (1 - samples) or None)
    gradient = image_gradient(patches[..., near, near], kernel)[:, :, 1:-1, 1:-1]
    field = _inward_fields(samples, shape, patches.dtype, patches.device)
    towards = nn.functional.avg_pool2d(gradient * field, samples)
    per_pixel = samples / torch.stack([cell_width_px, cell_height_px], dim=1).clamp(
        min=1e-6
    )
    return (towards * per_pixel.to(patches.dtype).view(-1, 2, 1, 1)).sum(dim=1)


def led_measures(
    patches: Tensor,
    shape: PanelShape,
    cell_width_px: Tensor,
    cell_height_px: Tensor,
    kernel: Gradient,
    needed: Collection[str],
) -> dict[str, Tensor]:
    """Measure each LED of rectified panels: features and mean grey value, (B,R,C) each.

    Args:
        patches: see :func:`gradient_radial_inwardness`; grey values, as rectified.
        shape: rows and columns.
        cell_width_px: see :func:`gradient_radial_inwardness`.
        cell_height_px: likewise.
        kernel: see :func:`image_gradient`.
        needed: some of ``FEATURE_NAMES`` and ``average``; more may be measured.

    Example:
        >>> patches, size = torch.full((1, 1, 6, 6), 7.0), torch.tensor([3.0])
        >>> measures = led_measures(patches, PanelShape(1, 1), size, size, "sobel", ["agr"])
        >>> {name: value.item() for name, value in measures.items()}
        {'agr': 1.0, 'ngr': 1.0, 'average': 7.0}
    """
    measures = {}
    if "gri" in needed:
        measures["gri"] = gradient_radial_inwardness(
            patches, shape, cell_width_px, cell_height_px, kernel
        )
    if {*needed} - {"gri"}:
        means = cell_means(patches, shape)
        measures["agr"], measures["ngr"] = level_ratios(means).unbind(1)
        measures["average"] = means[:, 1:-1, 1:-1]
    return measures


def preamble_threshold(on_greys: Tensor, off_greys: Tensor) -> Tensor:
    """Threshold halfway between the mean grey of an all-On and of an all-Off preamble.

    Args:
        on_greys: (B,R,C) grey value of each LED in the all-On preamble of the same scene, finite.
        off_greys: (B,R,C) likewise, all Off.

    Returns:
        (B,1,1) float64 threshold. Where both preambles are equal it is that level: an LED at it reads On.
        It has no sign: with preambles that are swapped an LED still reads On where it is the brighter.

    Raises:
        VoccError: a grey value that is not finite.

    Example:
        >>> float(preamble_threshold(torch.full((1, 2, 2), 200.0), torch.full((1, 2, 2), 100.0)))
        150.0
    """
    # In float64 the mean of equal float32 values is that value, whatever their number.
    on, off = (
        greys.mean(dim=(1, 2), keepdim=True, dtype=torch.float64)
        for greys in (on_greys, off_greys)
    )
    threshold = (on + off) / 2
    if not bool(threshold.isfinite().all()):
        raise VoccError(
            "preambles hold grey values that are not finite: each must be finite"
        )
    return threshold


def greyscale_scores(greys: Tensor, threshold: Tensor) -> Tensor:
    """Grey values above the threshold, (B,R,C) and (B,1,1) to (B,R,C) float64; at least 0, so 0 too, is On.

    Raises:
        VoccError: a grey value or threshold that is not finite.

    Example:
        >>> greyscale_scores(torch.tensor([[[160.0, 140.0]]]), torch.tensor([[[150.0]]])).tolist()
        [[[10.0, -10.0]]]
    """
    scores = greys.double() - threshold
    if not bool(scores.isfinite().all()):
        raise VoccError(
            "grey values or thresholds give a score that is not finite: both must be finite"
        )
    return scores
