"""Fig. 25: the time that each step takes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from vocc_torch.measure import stage_times, timing
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.plan import resolve_device
from vocc_torch.receiver.deciders import bank_of
from vocc_torch.report import plots
from vocc_torch.report.styles import Style
from vocc_torch.rng import BlockKey
from vocc_torch.studies.paper.evidence import PaperFigure
from vocc_torch.studies.paper.evidence.sample import Source

PAPER_SHARES = {
    "center_greyscale": 0.05,
    "average_greyscale": 0.07,
    "flda_2": 0.12,
    "flda_3": 0.14,
}
"""Section IV-D-5 and Fig. 25: time of each bit detector over that of panel detection."""


@dataclass(frozen=True)
class TimingBudget:
    """How processing times are measured.

    Args:
        rounds: frames that are timed one at a time.
        most_waited: largest share of the time for which other work may have had the processor; beyond it
            nothing is known of the times.
    """

    rounds: int = 48
    most_waited: float = 0.05


SETTINGS = TimingBudget()


def processing_time(source: Source, title: str) -> PaperFigure:
    """Fig. 25: the time of each bit detector over that of panel detection, one frame at a time.

    Numbers are medians over the rounds with their quartiles. Rendering and preambles are not counted.
    """
    plan, device = source.plan, resolve_device(source.plan.world.device)
    reader, location = plan.receiver.reader, plan.receiver.location
    receivers = {
        name: stage_times.TimedReceiver(decider, reader, location)
        for name, decider in bank_of([*PAPER_SHARES], source.flda).items()
    }
    world = replace(plan.world, framing="filled")
    keys = [BlockKey(plan.seed, "figures/timing", 0)]
    exposure = stage_times.Exposure.of(world, world.scene, keys, preambles=True)
    with timing.watched(device) as waiting:
        timed = stage_times.time_stages(receivers, exposure, 1, SETTINGS.rounds, device)
    numbers = time_numbers(timed, waiting.share)
    shares = [numbers[f"share_{name}"] for name in PAPER_SHARES]
    rows = plots.Rows(
        [(Style("", plots.LOOK.off, "o", "-"), shares)],
        "Time over that of panel detection",
        stars=dict(enumerate(PAPER_SHARES.values())),
    )
    note = timing.describe_machine(device)
    picture = plots.rows_figure([*PAPER_SHARES], [rows], title, note)
    return PaperFigure(numbers, picture)


def time_numbers(
    times: Mapping[str, stage_times.StageTimes], waited: float
) -> dict[str, Estimate]:
    """Times as shares of panel detection's, and what NGR adds, each with its quartiles.

    Args:
        times: round by round, by receiver.
        waited: share of the time for which other work had the processor; where it is above what the budget
            allows, every interval is open.
    """
    panel = times["flda_3"].summed(["locate"])
    spent = {
        name: times[name].summed(stage_times.BIT_DETECTION) for name in PAPER_SHARES
    }
    two, three = spent["flda_2"], spent["flda_3"]
    rounds = {f"share_{name}": value / panel for name, value in spent.items()}
    rounds["cost_of_ngr"] = three / two - 1
    rounds["cost_of_ngr_in_total"] = (three - two) / (panel + two)
    found = {name: timing.median_of(value) for name, value in rounds.items()}
    if waited <= SETTINGS.most_waited:
        return found
    return {name: Estimate(at.value, -np.inf, np.inf) for name, at in found.items()}
