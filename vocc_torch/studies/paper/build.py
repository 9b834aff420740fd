"""From the configuration to the studies behind the paper's figures."""

from __future__ import annotations

from dataclasses import replace

from vocc_torch.errors import section
from vocc_torch.measure.plan import Plan
from vocc_torch.studies.paper.config import FiguresConfig


def build_experiments(config: FiguresConfig, plan: Plan) -> dict[str, dict[float, Plan]]:
    """Build the plans of all experiments of ``task=figures``, by name and row; where there is no grid, one.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    built: dict[str, dict[float, Plan]] = {}
    for name, one in config.experiments.items():
        with section(f"figures.experiments.{name}", before="experiment"):
            built[name] = replace(plan, experiment=one).rows()
    return built
