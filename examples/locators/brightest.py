"""A locator of your own: the panel is the box around pixels at least half as bright as the brightest pixel.

vocc-torch receiver.locator=examples/locators/brightest.py:Brightest
"""

import torch

from vocc_torch.types import Panels


class Brightest:
    """Find an upright panel in frames without other lights."""

    def __init__(self, share=0.5):
        self.share = share

    def __call__(self, frames, shape):
        """Give the corners of the grid of LED cells, clockwise from the top left, on the sensor."""
        grey = frames.grey[:, 0].double()
        background = grey.flatten(1).median(dim=1).values
        if frames.surround is not None:  # the grey around a crop
            background = frames.surround.double()
        rise = (grey.flatten(1).amax(dim=1) - background)[:, None, None]
        bright = (grey - background[:, None, None] >= self.share * rise) & (rise > 0)
        left, right = ends(bright.any(dim=1), shape.columns)
        top, bottom = ends(bright.any(dim=2), shape.rows)
        found = bright.flatten(1).any(dim=1)
        x = torch.stack([left, right, right, left], dim=1)
        y = torch.stack([top, top, bottom, bottom], dim=1)
        corners = torch.stack([x, y], dim=2) + frames.origin_px[:, None]
        corners *= found[:, None, None]
        return Panels(corners, found, found.double(), found.long())


def ends(bright, leds):
    """Find the first and last bright pixel of (B,N), extended by half a gap; gaps are as wide as LEDs."""
    first = bright.int().argmax(dim=1).double()
    last = bright.shape[1] - bright.flip(1).int().argmax(dim=1).double()
    gap = (last - first) / (2 * leds - 1)
    return first - gap / 2, last + gap / 2
