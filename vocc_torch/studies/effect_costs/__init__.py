"""What each effect costs and does, one at a time and all together, and over its severity."""

from vocc_torch.studies.effect_costs.catalogue import Catalogue, Comparison, Severity
from vocc_torch.studies.effect_costs.costs import measure_costs
from vocc_torch.studies.effect_costs.plan import EffectStudy
from vocc_torch.studies.effect_costs.study import EffectResults, run_effects

__all__ = [
    "Catalogue",
    "Comparison",
    "EffectResults",
    "EffectStudy",
    "Severity",
    "measure_costs",
    "run_effects",
]
