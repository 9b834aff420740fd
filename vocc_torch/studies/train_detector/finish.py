"""What cameras do to pictures, in batches: blur, gain, noise, gamma and the frame's edges."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.studies.train_detector.draws import Draws


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
        place = torch.arange(side, device=draws.device)
        place = place.clamp(ends[:, :1], side - 1 - ends[:, 1:])
        place = place.unsqueeze(3 - axis).expand_as(pictures)
        pictures = pictures.gather(axis, place)
    return pictures
