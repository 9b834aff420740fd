"""From light to grey value: the paper's Eqs 1, 2, 3 and 20 as pure functions of tensors.

A surface under ambient light sends out the luminance ``E R / pi`` (cd/m2); an On LED adds its own light.
Eqs 2 and 3 are one map, ``10 L t / (K N^2)``, applied to those two luminances, so the map stands here once.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.autograd.forward_ad import unpack_dual

MIDDLE_GREY = 118.0
"""Grey value at the indicated exposure, Eq. 1."""

BLOCK_VALUES = 1 << 16
"""Numbers in a working array in float64, on the CPU: larger ones leave the cache and are fresh pages."""


def reflected_luminance_cd_m2(illuminance_lx: Tensor, reflectance: float) -> Tensor:
    """Luminance of a matt surface under ambient light, ``E_v R / pi``: the reflected part of Eqs 2 and 3.

    No light, or a black surface, gives 0.

    Args:
        illuminance_lx: any shape, lx, at least 0.
        reflectance: 0 to 1.

    Returns:
        Luminance in cd/m2, shape of ``illuminance_lx``.

    Example:
        >>> round(float(reflected_luminance_cd_m2(torch.tensor(1000.0), 0.18)), 3)
        57.296
    """
    return illuminance_lx * (reflectance / math.pi)


def luminous_exposure_lx_s(
    luminance_cd_m2: Tensor, *, exposure_time_s: float, f_number: float, calibration_constant: float
) -> Tensor:
    """Luminous exposure of a pixel that sees a luminance, ``H = 10 L t / (K N^2)`` (Eqs 2 and 3).

    Linear: no luminance gives no exposure.

    Args:
        luminance_cd_m2: any shape, cd/m2, at least 0.
        exposure_time_s: exposure time t, s, above 0.
        f_number: f-number N of the lens, above 0.
        calibration_constant: reflected-light meter constant K, above 0 (ISO 2720 has 10.6 to 13.4).

    Returns:
        Luminous exposure in lx s, shape of ``luminance_cd_m2``.

    Example:
        >>> h = luminous_exposure_lx_s(
        ...     torch.tensor(60.0), exposure_time_s=1 / 1500, f_number=4.0, calibration_constant=12.5
        ... )
        >>> round(float(h), 6)
        0.002
    """
    return luminance_cd_m2 * (10.0 * exposure_time_s / (calibration_constant * f_number**2))


def auto_iso_speed(background_exposure_lx_s: Tensor, target_grey: Tensor, *, gamma: float) -> Tensor:
    """ISO speed S at which the background gets the grey value asked for: Eq. 1 solved for ``S = 10 / H_SOS``.

    A background without light has no such speed: 0 lx s gives infinity, which a camera's limits bring back.

    Args:
        background_exposure_lx_s: (B,) lx s, at least 0.
        target_grey: (B,) digital numbers, above 0 (the paper draws 86 to 118).
        gamma: encoding gamma, above 0.

    Returns:
        (B,) ISO speed, without limits.

    Example:
        >>> float(auto_iso_speed(torch.tensor([0.1]), torch.tensor([118.0]), gamma=2.2))
        100.0
    """
    return 10.0 / background_exposure_lx_s * (target_grey / MIDDLE_GREY) ** gamma


def grey_value(exposure_lx_s: Tensor, iso_speed: Tensor, *, gamma: float) -> Tensor:
    """Gamma-encoded grey value ``G = 118 (H / H_SOS)^(1/gamma)``, ``H_SOS = 10 / S`` (Eq. 1), not clipped.

    No exposure gives 0. Where gamma is above 1 the slope there is infinite: the gradients where
    ``H / H_SOS`` is 0 or subnormal are defined as 0, and everywhere else they are the slope itself, in
    reverse and in forward mode.

    Args:
        exposure_lx_s: luminous exposure H, lx s, at least 0.
        iso_speed: ISO speed S, broadcast against the exposure, above 0.
        gamma: encoding gamma, above 0.

    Returns:
        Grey value in digital numbers, unbounded above.

    Example:
        >>> round(float(grey_value(torch.tensor(0.1), torch.tensor(100.0), gamma=2.2)), 4)
        118.0
    """
    return _power(exposure_lx_s * (iso_speed / 10.0), 1.0 / gamma).mul_(MIDDLE_GREY)


def _power(base: Tensor, exponent: float) -> Tensor:
    """Raise to a power, with gradient 0 where the base is 0 or subnormal and the slope is beyond bounds.

    Computed by logarithm in float64: the power of float32 numbers depends on their place in the tensor, so a
    pixel's on the frames that it came with, and takes as long.
    """
    if exponent == 1:
        return base
    if not base.requires_grad and _dual(base)[1] is None:
        if base.device.type != "cpu":
            return base.to(torch.float64, copy=True).log_().mul_(exponent).exp_().to(base.dtype)
        power = torch.empty_like(base, memory_format=torch.contiguous_format)
        given, taken = base.reshape(-1), power.view(-1)
        for start in range(0, given.numel(), BLOCK_VALUES):
            part = slice(start, start + BLOCK_VALUES)
            taken[part] = given[part].to(torch.float64, copy=True).log_().mul_(exponent).exp_()
        return power
    lit = base >= torch.finfo(base.dtype).tiny
    smooth = torch.exp(torch.log(torch.where(lit, base, 1.0).to(torch.float64)) * exponent).to(base.dtype)
    # A detached tensor has its tangent still.
    return torch.where(lit, smooth, _power(_dual(base.detach())[0], exponent))


def _dual(value: Tensor) -> tuple[Tensor, Tensor | None]:
    """Value and tangent; a tensor has a tangent in forward-mode differentiation only."""
    return unpack_dual(value)  # type: ignore[no-untyped-call, no-any-return]  # torch has no types there


def transmission(distance_m: Tensor, visibility_m: float) -> Tensor:
    """Transmission coefficient of the air, ``T(L) = exp(-3.91 L / L_vis)`` (Eq. 20).

    No way gives 1, and from 191 visibility distances on the share is below what float64 holds and is 0.

    Args:
        distance_m: any shape, m, at least 0.
        visibility_m: meteorological visibility distance, m, above 0.

    Returns:
        Share of the light that arrives, 0 to 1.

    Example:
        >>> round(float(transmission(torch.tensor(70.0, dtype=torch.float64), 40_000.0)), 4)
        0.9932
    """
    return torch.exp(distance_m * (-3.91 / visibility_m))
