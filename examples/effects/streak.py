"""An effect of your own: a wiped windscreen smears a share of all light along the rows.

vocc-torch +scene.effects.streak._target_=examples/effects/streak.py:Streak +scene.effects.streak.share=0.2
"""

from dataclasses import dataclass

from torch.nn import functional

from vocc_torch.simulation.effects import Effect, Quantity, within


@dataclass(frozen=True)
class Streak(Effect, on=Quantity.EXPOSURE):
    """Spread a share of each pixel's light evenly over the pixels to its left and right."""

    share: float = within(0, 1, above=True)
    half_px: int = within(1, 512, default=40, whole=True)

    def reach_in_px(self, camera, nearest_m):
        """State how far the effect spreads light, px; crops are larger by this distance."""
        return self.half_px

    def __call__(self, value, context):
        """Smear (B,1,H,W) exposure; pixels beyond the border equal the pixel at the border."""
        wide = functional.pad(
            value, (self.half_px, self.half_px, 0, 0), mode="replicate"
        )
        smeared = functional.avg_pool2d(wide, (1, 2 * self.half_px + 1), stride=1)
        return (1 - self.share) * value + self.share * smeared
