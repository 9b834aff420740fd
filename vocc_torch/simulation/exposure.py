"""What the camera makes of light by itself: the lens, and the ISO speed that its meter chooses."""

from __future__ import annotations

from torch import Tensor

from vocc_torch.simulation.effects import Context, Quantity
from vocc_torch.simulation.geometry import Camera
from vocc_torch.simulation.photometry import (
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


def auto_iso(context: Context) -> Tensor:
    """ISO speed of each frame, (B,): what gives the background its grey value, within the camera's limits.

    Example:
        >>> from vocc_torch.types import Scene
        >>> [round(float(iso)) for iso in auto_iso(Context(Scene.of(2, ambient_lx=1000.0), Camera()))]
        [3800, 3800]
    """
    scene, camera = context.scene, context.camera
    background = reflected_luminance_cd_m2(scene.ambient_lx, context.panel.background_reflectance)
    exposure = through_lens(as_seen(background, context), camera)
    iso = auto_iso_speed(exposure, scene.background_grey, gamma=camera.gamma)
    return iso if camera.iso_limits is None else iso.clamp(*camera.iso_limits)
