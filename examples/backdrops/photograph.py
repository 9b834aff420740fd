"""A backdrop of your own: a photograph behind the panel, stretched over the sensor.

vocc-torch +scene.effects.street._target_=examples/backdrops/photograph.py:Photograph \
        +scene.effects.street.file=street.jpg
"""

import functools
from dataclasses import dataclass

import numpy as np
import torch
from PIL import Image

from vocc_torch.simulation.effects import Backdrop, within


@functools.cache
def light_of(file, gamma):
    """Read the light of a picture, (H,W) with mean 1."""
    with Image.open(file) as picture:
        light = torch.from_numpy(np.asarray(picture.convert("L")) / 255.0) ** gamma
    return light / light.mean()


@dataclass(frozen=True)
class Photograph(Backdrop):
    """Grey values of a file with their gamma undone."""

    file: str
    gamma: float = within(0.1, 10, default=2.2)

    def shade(self, x, y, context):
        """Look up the sensor's columns x (B,1,1,W) and rows y (B,1,H,1)."""
        light, camera = light_of(self.file, self.gamma).to(x.device), context.camera
        height, width = light.shape
        return light[y * height // camera.height_px, x * width // camera.width_px]
