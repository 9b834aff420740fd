"""What the lens does to the light: motion, focus, diffraction and vignetting."""

import itertools
import math

import torch
from kornia.filters import gaussian_blur2d
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera
from vocc_torch.simulation.effects.base import Context, Effect, Quantity, within
from vocc_torch.simulation.effects.kernels import (
    KERNELS,
    airy_quarter,
    checked_reach,
    convolve_symmetric,
    convolve_taps,
    convolved,
    disc_quarters,
    disc_radius_px,
    streak_taps,
)

FASTEST_M_S = 200.0
"""Highest speed on offer along an axis: two vehicles at 360 km/h each."""

MOST_SIGMA_PX = 32.0
"""Widest on offer: its kernel reaches as far as that of the other blurs may, 128 px."""

LEAST_SIGMA_PX = 0.01
"""Narrower kernels are this one, which no type tells from a single pixel; the square of theirs may be 0."""

PLANE_PX = 1 << 17
"""Fewest pixels of a plane. From here on Kornia adds shifted planes instead of convolving."""


class MotionBlur(Effect, on=Quantity.EXPOSURE):
    """Uniform straight motion across the view: a streak of ``v t F / d`` pixels.

    v is the panel's velocity relative to the camera, across the line of sight; t the exposure time, F the
    focal length in pixels and d each frame's distance. The streak is centred where the frame has the panel,
    which is its place in the middle of the exposure, and each pixel gets the exact share of the streak in it.
    The kernel's second moment along each axis is the streak's, ``L^2 / 12`` for its extent L along that axis,
    also where the streak is shorter than a pixel; its slant shows as well as whole pixels can show it. At
    50 m and 1/1500 s 20 m/s make 0.97 px. All of the frame moves as the panel does; motion along the line of
    sight is not in it.

    Linear in the exposure and differentiable in it. Energy is kept to rounding. The work grows with L.

    Source: uniform linear motion, Gonzalez and Woods, Digital Image Processing, section 5.6.

    Args:
        velocity_x_m_s: velocity of the panel to the right, m/s, -200 to 200.
        velocity_y_m_s: velocity downwards, m/s, -200 to 200; at least one of the two is not 0.

    Raises:
        VoccError: a velocity outside its range, or none; when called, a streak over 257 pixels long.

    Example:
        >>> x_px, y_px = MotionBlur(velocity_x_m_s=20.0).shift_px(Camera(), torch.tensor([50.0, 100.0]))
        >>> [round(float(x), 2) for x in x_px], y_px.tolist()
        ([0.97, 0.48], [0.0, 0.0])
    """

    velocity_x_m_s: float = within(-FASTEST_M_S, FASTEST_M_S, default=0.0)
    velocity_y_m_s: float = within(-FASTEST_M_S, FASTEST_M_S, default=0.0)

    def __post_init__(self) -> None:
        """Check the ranges."""
        Effect.__post_init__(self)
        if self.velocity_x_m_s == self.velocity_y_m_s == 0:
            raise VoccError(
                "scene.effects.motion_blur.velocity_x_m_s and velocity_y_m_s are 0: "
                "one of the two must not be 0 (leave the effect out for no motion)"
            )

    def shift_px(self, camera: Camera, distance_m: Tensor) -> tuple[Tensor, Tensor]:
        """Motion in the image during the exposure, right and down, px, shapes of ``distance_m`` (m)."""
        scale = camera.pixels_per_metre(distance_m) * camera.exposure_time_s
        return self.velocity_x_m_s * scale, self.velocity_y_m_s * scale

    def reach_in_px(self, camera: Camera, nearest_m: float) -> int:
        """Half width of the kernel at ``nearest_m``, px; farther panels have shorter streaks.

        Raises:
            VoccError: a half width above 128 px.
        """
        nearest = torch.tensor([nearest_m], dtype=torch.float64)
        shift_x, shift_y = self._checked_shifts(camera, nearest)[0]
        _, taps = streak_taps(shift_x, shift_y)
        return max((max(abs(row), abs(column)) for row, column, _ in taps), default=0)

    def _checked_shifts(
        self, camera: Camera, distance_m: Tensor
    ) -> list[tuple[float, float]]:
        """Each frame's motion as plain numbers, refused where it is too long."""
        x, y = (shift.tolist() for shift in self.shift_px(camera, distance_m))
        longest = max(abs(shift) for shift in (*x, *y))
        checked_reach(
            longest / 2,
            (
                f"scene.effects.motion_blur."
                f"velocity_x_m_s is {self.velocity_x_m_s:g} and velocity_y_m_s {self.velocity_y_m_s:g}"
            ),
        )
        return list(zip(x, y, strict=True))

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Draw out (B,1,H,W) exposure; the light outside the frame is taken to be that at its border."""
        shifts = self._checked_shifts(context.camera, context.scene.distance_m)
        kernels = itertools.starmap(streak_taps, shifts)
        return convolved(value, convolve_taps, kernels)


class Defocus(Effect, on=Quantity.EXPOSURE):
    """The blur disc of a thin lens, of diameter ``c = f^2 / (N (s - f)) |d - s| / d``.

    f is the focal length, N the f-number, s the distance in focus and d each frame's distance to the panel.
    A panel at 50 m has a disc of 0.45 px with the paper's lens focused at infinity, and of 1.8 px with it
    focused at 10 m. Light is spread evenly over the disc; each pixel gets the exact area that the disc covers
    of it. The kernel's second moment along each axis is the disc's, ``c^2 / 16``, also where the disc is
    smaller than a pixel. All of the frame is blurred as at the panel's distance; the image keeps its scale.

    Linear in the exposure and differentiable in it. Energy is kept to rounding. The work grows with ``c^2``.

    Source: the thin lens's circle of confusion, as in Potmesil and Chakravarty, A lens and aperture camera
    model for synthetic image generation (1981).

    Args:
        focus_distance_m: distance in focus, from the lens, m, above 0 and above the camera's focal length;
            ``.inf`` is focus at infinity.

    Raises:
        VoccError: a distance that is not above 0; when called, one not above the focal length, or a disc over
            257 pixels wide.

    Example:
        >>> effect = Defocus(focus_distance_m=10.0)
        >>> diameter_px = effect.diameter_px(Camera(), torch.tensor([10.0, 50.0]))
        >>> [round(float(c), 2) for c in diameter_px]
        [0.0, 1.82]
    """

    focus_distance_m: float

    def __post_init__(self) -> None:
        """Check the range."""
        if not self.focus_distance_m > 0:
            raise self.refusal(
                "focus_distance_m", "above 0 (.inf for focus at infinity)"
            )

    def diameter_px(self, camera: Camera, distance_m: Tensor) -> Tensor:
        """Diameter of the blur disc, px, shape of ``distance_m`` (m, above 0).

        Raises:
            VoccError: a focus distance that is not above the camera's focal length.
        """
        focal_m = camera.focal_length_mm / 1000
        if self.focus_distance_m <= focal_m:
            raise self.refusal(
                "focus_distance_m", f"above the camera's focal length, {focal_m:g} m"
            )
        # Divided through by s, so that s may be infinite.
        inverse = 1 / self.focus_distance_m
        aperture_px = camera.focal_length_px / camera.f_number
        return (
            aperture_px
            * focal_m
            / (1 - focal_m * inverse)
            * (inverse - 1 / distance_m).abs()
        )

    def reach_in_px(self, camera: Camera, nearest_m: float) -> int:
        """Half width of the widest kernel at ``nearest_m`` or farther, px.

        The disc shrinks on the way to the distance in focus and grows beyond it up to a limit, so it is
        widest at one of the two ends.

        Raises:
            VoccError: a half width above 128 px.
        """
        ends = torch.tensor([nearest_m, float("inf")], dtype=torch.float64)
        return max(0, math.ceil(float(self.radii_px(camera, ends).max()) - 0.5))

    def radii_px(self, camera: Camera, distance_m: Tensor) -> Tensor:
        """Radius of each frame's kernel, px, on the CPU, where the frames' kernel sizes are wanted.

        Raises:
            VoccError: a disc over 257 px wide.
        """
        diameter = self.diameter_px(camera, distance_m.cpu())
        checked_reach(
            max(0.0, float(diameter.max()) / 2 - 0.5),
            f"scene.effects.defocus.focus_distance_m is {self.focus_distance_m:g}",
        )
        return disc_radius_px(diameter)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Spread (B,1,H,W) exposure; the light outside the frame is taken to be that at its border."""
        radii = self.radii_px(context.camera, context.scene.distance_m)
        return convolved(value, convolve_symmetric, zip(disc_quarters(radii)))


class Diffraction(Effect, on=Quantity.EXPOSURE):
    """Diffraction at a circular aperture, the Airy pattern ``(2 J1(v) / v)^2``.

    ``v = pi r / (lambda N)`` at the distance r from the middle, for a wavelength lambda and an f-number N;
    the first dark ring lies at ``1.22 lambda N`` and holds 83.8 % of the light. The f-number and the pixel
    pitch are the camera's: at f/4 with pixels of 6.9 um the ring has a radius of 0.39 px, 88 % of the light
    stays in its pixel and the rest makes a faint halo.

    The halo falls with the third power of r, so the kernel ends where 99.5 % of the light is inside,
    ``40.5 lambda N``, and is scaled to keep all of it. Over the paper's ranges the cut moves a pixel by up to
    0.5 digital numbers, and by 1 between clipped LEDs 30 times as bright as the background. Diffraction of a
    defocused lens is approximated where both are named, as one after the other. Where that circle lies within
    a pixel, ``lambda N`` up to 1/81 px, all the light stays in its pixel and the frame is left as it is.

    Linear and differentiable. Energy is kept to rounding. The work grows with ``(lambda N / pitch)^2``.

    Source: Airy (1835); Born and Wolf, Principles of Optics, 7th ed., section 8.5.2.

    Args:
        wavelength_nm: wavelength of the light, nm, 300 to 1100 (where silicon sees); 555 is the eye's peak.

    Raises:
        VoccError: a wavelength outside its range; when called, a camera whose pattern spans over 257 pixels.

    Example:
        >>> Diffraction().reach_in_px(Camera(), 50.0)
        13
    """

    wavelength_nm: float = within(300, 1100, default=555.0)

    def _lambda_n_px(self, camera: Camera) -> float:
        """Wavelength times f-number in pixels."""
        pitch_nm = camera.sensor_width_mm / camera.width_px * 1e6
        return self.wavelength_nm * camera.f_number / pitch_nm

    def reach_in_px(self, camera: Camera, nearest_m: float) -> int:
        """Half width of the kernel, which holds the circle of 99.5 % of the light; any distance has the same.

        Raises:
            VoccError: a half width above 128 px.
        """
        reach = max(
            0, math.ceil(KERNELS.reach_lambda_n * self._lambda_n_px(camera) - 0.5)
        )
        return checked_reach(
            reach,
            (
                f"scene.effects.diffraction."
                f"wavelength_nm is {self.wavelength_nm:g} at camera.f_number {camera.f_number:g}"
            ),
        )

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Spread (B,1,H,W) exposure; the light outside the frame is taken to be that at its border."""
        reach = self.reach_in_px(context.camera, 1.0)
        if reach == 0:
            return value
        quarter = airy_quarter(self._lambda_n_px(context.camera), reach)
        return convolved(value, convolve_symmetric, [(quarter,)] * len(value))


class Blooming(Effect, on=Quantity.EXPOSURE):
    """Kornia's Gaussian blur of luminous exposure, before gamma (section IV-B-1).

    All weights and all light are positive, so no digits cancel: float32 keeps each pixel within 1e-6 of its
    value beside any lamp. Linear and differentiable; energy is kept to rounding.

    Source: the paper, section IV-B-1, whose "blooming level" is read as a standard deviation.

    Args:
        sigma_px: standard deviation, px, above 0 and at most 32; the paper's "blooming level" is 1.5.
        reach_sigmas: half width of the kernel in standard deviations, 1 to 4; at 4 and 1.5 px the cut tail is
            0.002 digital numbers.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Blooming(sigma_px=1.5).reach_in_px(Camera(), 50.0)
        6
    """

    sigma_px: float = within(
        0, MOST_SIGMA_PX, above=True, hint="leave the effect out for no blooming"
    )
    reach_sigmas: float = within(1.0, 4.0, default=4.0)

    def reach_in_px(self, camera: Camera, nearest_m: float) -> int:
        """Half width of the kernel, px; any distance has the same."""
        return math.ceil(self.reach_sigmas * self.sigma_px)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Blur (B,1,H,W) exposure; the light outside the frame is taken to be that at its border."""
        return blurred(
            value,
            max(self.sigma_px, LEAST_SIGMA_PX),
            self.reach_in_px(context.camera, 1.0),
        )


def blurred(value: Tensor, sigma_px: float, reach_px: int) -> Tensor:
    """Blur frames by Kornia's Gaussian filter, laid side by side in one plane.

    Each frame brings its border's columns as a margin, so that no frame reaches into another. A plane of at
    least ``PLANE_PX`` is summed alike at every place: a frame's pixels do not depend on the batch that it
    came in. So 64 crops take a tenth of the time that they take as a batch.

    Args:
        value: (B,1,H,W), at least 0.
        sigma_px: standard deviation, px.
        reach_px: half width of the kernel.

    Returns:
        (B,1,H,W); the light outside a frame is taken to be that at its border.

    Example:
        >>> dot = torch.tensor([0.0, 0.0, 1.0, 0.0]).view(1, 1, 1, 4)
        >>> [round(v, 3) for v in blurred(dot, 1.0, 2).flatten().tolist()]
        [0.054, 0.244, 0.403, 0.244]
    """
    height, width = value.shape[-2:]
    wide = width + 2 * reach_px
    missing = max(0, -(-PLANE_PX // (height * wide)) - len(value))
    # cuDNN would round the factors of float32 convolutions to 10 bits.
    working = value if value.device.type == "cpu" else value.double()
    margined = nn.functional.pad(
        working.squeeze(1), (reach_px, reach_px, 0, 0), mode="replicate"
    )
    plane = (
        nn.functional.pad(margined, (0, 0, 0, 0, 0, missing))
        .transpose(0, 1)
        .reshape(1, 1, height, -1)
    )
    with torch.autocast(value.device.type, enabled=False):
        done = gaussian_blur2d(
            plane, 2 * reach_px + 1, (sigma_px, sigma_px), "replicate"
        )
    frames = done.view(height, -1, 1, wide)[
        :, : len(value), :, reach_px : reach_px + width
    ]
    return frames.permute(1, 2, 0, 3).to(value.dtype).contiguous()


class Vignetting(Effect, on=Quantity.EXPOSURE):
    """Natural vignetting, ``cos^4`` of the field angle, and optionally that of the lens barrel.

    A pixel at the distance r from the optical axis, for a focal length F in pixels, sees the field angle
    ``atan(r / F)``: it gets ``1 / (1 + (r / F)^2)^2`` of the light on the axis. The barrel of a real lens
    takes more; ``corner_loss`` says how much, by Kang and Weiss's geometric factor, which falls linearly with
    r. The angle is that of the pixel's middle; the axis meets the middle of the sensor. In the corner of the
    paper's camera cos^4 leaves 83.9 %.

    Linear and differentiable. It fills the sensor: no two rings about the axis have the same background.

    Source: Horn, Robot Vision (1986), section 10.3; Kang and Weiss, Can we calibrate a camera using an image
    of a flat, textureless Lambertian surface? (ECCV 2000).

    Args:
        corner_loss: share of the light that the lens barrel takes in the sensor's corner, 0 to below 1, on
            top of cos^4; 0 is natural vignetting alone.

    Raises:
        VoccError: a loss outside its range.

    Example:
        >>> from vocc_torch.hardware import Camera
        >>> from vocc_torch.types import Scene
        >>> frame = torch.ones(1, 1, 1080, 1920, dtype=torch.float64)
        >>> round(float(Vignetting()(frame, Context(Scene.of(), Camera()))[0, 0, 0, 0]), 4)
        0.8392
    """

    corner_loss: float = 0.0
    fills_sensor = True

    def __post_init__(self) -> None:
        """Check the range."""
        if not 0 <= self.corner_loss < 1:
            raise self.refusal("corner_loss", "from 0 to below 1")

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Dim (B,1,H,W) exposure by each pixel's place on the sensor."""
        camera = context.camera
        focal_px = camera.focal_length_px
        x, y = (
            ((pixels.to(value.device).double() + 0.5 - side / 2) / focal_px).square()
            for pixels, side in zip(
                context.pixels((value.shape[2], value.shape[3])),
                reversed(camera.sensor_px),
                strict=True,
            )
        )
        # (r / F)^2 of each pixel; only the sum over the two axes runs at the frame's own precision.
        square = (y + x).to(value.dtype)
        gain = 1 / (1 + square).square()
        if self.corner_loss > 0:
            corner = math.hypot(*camera.sensor_px) / 2 / focal_px
            gain = gain * (1 - square.sqrt() * (self.corner_loss / corner))
        return value * gain


EFFECTS = (MotionBlur, Defocus, Diffraction, Blooming, Vignetting)
"""In physical order."""
