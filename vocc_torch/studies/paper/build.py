"""From the configuration to the studies behind the paper's figures."""

from __future__ import annotations

from dataclasses import replace

from vocc_torch.measure.build import build_experiment, build_rows
from vocc_torch.measure.plan import Plan
from vocc_torch.studies.paper.config import FiguresConfig


def build_experiments(config: FiguresConfig, plan: Plan) -> dict[str, dict[float, Plan]]:
    """Build the plans of all experiments of ``task=figures``, by name and row; where there is no grid, one.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    built: dict[str, dict[float, Plan]] = {}
    for name, one in config.experiments.items():
        section = f"figures.experiments.{name}"
        whole = replace(plan, experiment=build_experiment(one, section))
        built[name] = {0.0: whole} if one.row_axis is None else build_rows(whole, one, section)
    return built
