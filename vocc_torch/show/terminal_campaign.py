"""The view's former place."""

from vocc_torch.show.terminal import ProgressView as CampaignView

__all__ = ["CampaignView"]
