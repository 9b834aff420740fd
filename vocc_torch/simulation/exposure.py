"""What the camera makes of light by itself: the lens, and the ISO speed that its meter chooses."""

from __future__ import annotations

import math

from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects import Context, Quantity
from vocc_torch.simulation.geometry import ISO_RANGE, Camera
from vocc_torch.simulation.photometry import (
    MIDDLE_GREY,
    auto_iso_speed,
    luminous_exposure_lx_s,
    reflected_luminance_cd_m2,
)


def through_lens(luminance_cd_m2: Tensor, camera: Camera) -> Tensor:
    """Luminous exposure of a luminance with the settings of a camera (Eqs 2 and 3), lx s, in any shape.

    Example:
        >>> import torch
        >>> round(float(through_lens(torch.tensor(1000.0), Camera())), 4)
        0.0333
    """
    return luminous_exposure_lx_s(
        luminance_cd_m2,
        exposure_time_s=camera.exposure_time_s,
        f_number=camera.f_number,
        calibration_constant=camera.calibration_constant,
    )


def as_seen(surface_cd_m2: Tensor, context: Context, own_cd_m2: Tensor | None = None) -> Tensor:
    """Luminance of a surface, and of its own light, through the scene's air and veil.

    Args:
        surface_cd_m2: (B,) reflected luminance.
        context: the scenes and the effects; those that are ``metered`` act.
        own_cd_m2: (B,) the surface's own light as it enters the picture, which the air has dimmed already.

    Returns:
        (B,) cd/m2.
    """
    seen = surface_cd_m2.view(-1, 1, 1, 1)
    for quantity in (Quantity.UNLIT, Quantity.LUMINANCE):
        if quantity == Quantity.LUMINANCE and own_cd_m2 is not None:
            seen = seen + own_cd_m2.view(-1, 1, 1, 1)
        for effect in context.effects:
            if effect.takes == quantity and effect.metered:
                seen = effect(seen, context)
    return seen.view(-1)


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
    background = reflected_luminance_cd_m2(scene.ambient_lx, context.panel.background_reflectance)
    exposure = through_lens(as_seen(background, context), camera)
    iso = auto_iso_speed(exposure, scene.background_grey, gamma=camera.gamma)
    if camera.iso_limits is not None:
        iso = iso.clamp(*camera.iso_limits)
    brightest = through_lens(scene.ambient_lx / math.pi + scene.led_luminance_cd_m2, camera)
    most = BRIGHTEST ** min(camera.gamma, 1.0)
    if not any(effect.gives == Quantity.BOUNDED_GREY for effect in context.effects):
        most = min(most, (MOST_GREY / MIDDLE_GREY) ** camera.gamma)
    held = (iso >= ISO_RANGE[0]) & (iso <= ISO_RANGE[1]) & (brightest * iso / 10 <= most)
    if not bool(held.all()):
        _refuse(context, int(held.int().argmin()), iso)
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
        rule = f"it must have scene.effects.saturation, or less light: at most {MOST_GREY:g}"
        raise VoccError(f"scene.effects is without saturation, and grey values reach {most:g}: {rule}")


def _refuse(context: Context, frame: int, iso: Tensor) -> None:
    """Say why a frame has no ISO speed, or no grey values."""
    scene, camera = context.scene, context.camera
    lux, speed = float(scene.ambient_lx[frame]), float(iso[frame])
    ambient = f"scene.ambient_lx is {lux:g}"
    if lux == 0 and camera.iso_limits is None:
        rule = "it must be above 0, or give camera.iso_limits, for auto-ISO without limits meters this light"
        raise VoccError(f"{ambient}: {rule}")
    if not ISO_RANGE[0] <= speed <= ISO_RANGE[1]:
        target = f"scene.background_grey is {float(scene.background_grey[frame]):g}"
        rule = f"it must lead to an ISO speed from {ISO_RANGE[0]:g} to {ISO_RANGE[1]:g}"
        raise VoccError(f"{ambient} and {target}: {rule}, and this is {speed:g} (or give camera.iso_limits)")
    led = f"scene.led_luminance_cd_m2 is {float(scene.led_luminance_cd_m2[frame]):g}"
    rule = f"it must lead to grey values of at most {MOST_GREY:g}, or {BRIGHTEST:g} where saturation is named"
    raise VoccError(f"{led}, with {ambient} and ISO {speed:g}: {rule}")
