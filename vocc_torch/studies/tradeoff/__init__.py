"""The price list: what receivers, and the renderer's knobs, cost in time and give in accuracy."""

from vocc_torch.studies.tradeoff.plan import VARIED as VARIED
from vocc_torch.studies.tradeoff.plan import RendererKnobs as RendererKnobs
from vocc_torch.studies.tradeoff.plan import TradeoffStudy as TradeoffStudy
from vocc_torch.studies.tradeoff.renderer import price_renderer as price_renderer
from vocc_torch.studies.tradeoff.study import price_receivers as price_receivers
