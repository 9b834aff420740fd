"""From light to grey value: the paper's Eqs 1, 2, 3 and 20 as pure functions of tensors.

A surface under ambient light sends out the luminance ``E R / pi`` (cd/m2); an On LED adds its own light.
Eqs 2 and 3 are one map, ``10 L t / (K N^2)``, applied to those two luminances, so the map stands here once.
"""

import math

import torch
from torch import Tensor
from torch.autograd.forward_ad import unpack_dual

from vocc_torch.errors import VoccError
from vocc_torch.hardware import ISO_RANGE, Camera
from vocc_torch.simulation.effects.base import Context, Quantity

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


def auto_iso_speed(
    background_exposure_lx_s: Tensor, target_grey: Tensor, *, gamma: float
) -> Tensor:
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
        flat = base.reshape(-1)
        parts = torch.split(flat, BLOCK_VALUES) if base.is_cpu else [flat]
        powers = [
            part.double().log().mul_(exponent).exp_().to(base.dtype) for part in parts
        ]
        return torch.cat(powers).view(base.shape)
    lit = base >= torch.finfo(base.dtype).tiny
    smooth = torch.exp(torch.log(torch.where(lit, base, 1.0).double()) * exponent).to(
        base.dtype
    )
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


def through_lens(luminance_cd_m2: Tensor, camera: Camera) -> Tensor:
    """Luminous exposure of a pixel that sees a luminance, ``H = 10 L t / (K N^2)`` (Eqs 2 and 3).

    Linear: no luminance gives no exposure.

    Args:
        luminance_cd_m2: any shape, cd/m2, at least 0.
        camera: its exposure time t, s, its f-number N and its meter constant K (ISO 2720 has 10.6 to 13.4).

    Returns:
        Luminous exposure in lx s, shape of ``luminance_cd_m2``.

    Example:
        >>> round(float(through_lens(torch.tensor(60.0), Camera())), 6)
        0.002
    """
    per_cd_m2 = (
        10.0
        * camera.exposure_time_s
        / (camera.calibration_constant * camera.f_number**2)
    )
    return luminance_cd_m2 * per_cd_m2


def as_seen(
    surface_cd_m2: Tensor, context: Context, own_cd_m2: Tensor | float = 0.0
) -> Tensor:
    """Luminance of a surface, and of its own light, through the scene's air and veil.

    Args:
        surface_cd_m2: (B,) reflected luminance.
        context: the scenes and the effects; those that are ``metered`` act.
        own_cd_m2: (B,) the surface's own light as it enters the picture, which the air has dimmed already.

    Returns:
        (B,) cd/m2.
    """
    luminance = surface_cd_m2
    for quantity, light in ((Quantity.UNLIT, 0.0), (Quantity.LUMINANCE, own_cd_m2)):
        luminance = (luminance.flatten() + light).view(-1, 1, 1, 1)
        for effect in context.effects:
            if effect.takes == quantity and effect.metered:
                luminance = effect.applied(luminance, context)
    return luminance.flatten()


BRIGHTEST = 1e30
"""Most light, in units of that of middle grey, and most grey before it is clipped at white."""

MOST_GREY = 1e9
"""Most grey where nothing clips it at white."""


def auto_iso(context: Context) -> Tensor:
    """ISO speed of each frame, (B,): what gives the background its grey value, within the camera's limits.

    A background without light has the highest of the camera's limits.

    Raises:
        VoccError: no light and no limits, or light beyond what float32 holds: a speed outside 1e-30 to 1e20,
            light of more than 1e30 times that of middle grey, or grey values above 1e30, and above 1e9 where
            no saturation is named.

    Example:
        >>> from vocc_torch.types import Scene
        >>> [round(float(iso)) for iso in auto_iso(Context(Scene.of(2, ambient_lx=1000.0), Camera()))]
        [3800, 3800]
    """
    if context.iso is not None:
        return context.iso
    scene, camera = context.scene, context.camera
    background = reflected_luminance_cd_m2(
        scene.ambient_lx, context.panel.background_reflectance
    )
    exposure = through_lens(as_seen(background, context), camera)
    iso = auto_iso_speed(exposure, scene.background_grey, gamma=camera.gamma)
    if camera.iso_limits is not None:
        iso = iso.clamp(*camera.iso_limits)
    brightest = through_lens(
        scene.ambient_lx / math.pi + scene.led_luminance_cd_m2, camera
    )
    most = BRIGHTEST ** min(camera.gamma, 1.0)
    if not any(effect.gives == Quantity.BOUNDED_GREY for effect in context.effects):
        most = min(most, (MOST_GREY / MIDDLE_GREY) ** camera.gamma)
    possible = (iso == iso.clamp(*ISO_RANGE)) & (brightest * iso / 10 <= most)
    if not bool(possible.all()):
        raise light_refusal(context, int(possible.int().argmin()), iso)
    return iso


def demand_greys(grey: Tensor) -> None:
    """Refuse grey values that nothing clips at white and that effects have made too large.

    Raises:
        VoccError: a value above 1e9, or NaN.

    Example:
        >>> import torch
        >>> demand_greys(torch.tensor([0.0, 300.0]))
    """
    most = float(grey.detach().max())
    if not most <= MOST_GREY:
        raise VoccError(
            f"scene.effects is without saturation, and grey values reach {most:g}: "
            f"it must have scene.effects.saturation, or less light: at most {MOST_GREY:g}"
        )


def light_refusal(context: Context, frame: int, iso: Tensor) -> VoccError:
    """The error that says why a frame has no ISO speed, or no grey values."""
    scene, camera = context.scene, context.camera
    lux, speed = float(scene.ambient_lx[frame]), float(iso[frame])
    ambient = f"scene.ambient_lx is {lux:g}"
    if lux == 0 and camera.iso_limits is None:
        rule = "it must be above 0, or give camera.iso_limits, for auto-ISO without limits meters this light"
        return VoccError(f"{ambient}: {rule}")
    low, high = ISO_RANGE
    if not low <= speed <= high:
        target = f"scene.background_grey is {float(scene.background_grey[frame]):g}"
        rule = f"it must lead to an ISO speed from {low:g} to {high:g}"
        return VoccError(
            f"{ambient} and {target}: {rule}, and this is {speed:g} (or give camera.iso_limits)"
        )
    led = f"scene.led_luminance_cd_m2 is {float(scene.led_luminance_cd_m2[frame]):g}"
    rule = f"it must lead to grey values of at most {MOST_GREY:g}, or {BRIGHTEST:g} where saturation is named"
    return VoccError(f"{led}, with {ambient} and ISO {speed:g}: {rule}")
