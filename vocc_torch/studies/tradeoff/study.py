"""The price list of receivers: trained, counted on the same frames, and timed when nothing else runs."""

from __future__ import annotations

from collections.abc import Callable

from vocc_torch.measure.genie.genie_likelihood import UnknownLikelihoodError
from vocc_torch.measure.genie.genie_mark import genie_mark
from vocc_torch.measure.plan import resolve_device
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.studies.tradeoff.errors import count_errors
from vocc_torch.studies.tradeoff.plan import TradeoffStudy, trained_alike
from vocc_torch.studies.tradeoff.price_list import Mark, PriceList
from vocc_torch.studies.tradeoff.times import measure_times
from vocc_torch.studies.tradeoff.training import chains, train_receivers

Told = Callable[[str], None]
"""Hears what is begun."""


def price_receivers(study: TradeoffStudy, workers: Workers, told: Told = lambda stage: None) -> PriceList:
    """Train every receiver, count errors, and take times once the workers have ended.

    Args:
        study: the study.
        workers: who trains and counts.
        told: hears what is begun.

    Raises:
        VoccError: what training refuses, or a worker that was ended from outside.
    """
    with worker_losses_told(), workers:
        told("training")
        made = train_receivers(study, workers)
        receivers = chains(study, made)
        told("bit errors")
        errors = count_errors(study, receivers, workers)
        told("what is possible")
        marks, no_marks = _marks(study, workers)
    told("times")
    times = measure_times(study, receivers)
    return PriceList(
        settings=study.settings,
        making={setting: made[trained_alike(setting)].making for setting in study.settings},
        errors=errors,
        spent=times.spent,
        end_to_end=times.end_to_end,
        machines=times.machines,
        error_device=str(resolve_device(study.plan.world.device)),
        threads=times.threads,
        waited_share=times.waited_share,
        sensor_px=study.plan.world.camera.sensor_px,
        crop_px=times.crop_px,
        in_one_go=times.in_one_go,
        scene=study.scene_name,
        frames_a_preamble=study.frames_a_preamble,
        marks=marks,
        no_marks=no_marks,
        missing=study.missing,
        left_out=study.left_out,
    )


def _marks(study: TradeoffStudy, workers: Workers) -> tuple[dict[str, Mark], dict[str, str]]:
    """Let a decoder that knows the scene have the first of each kind's frames, or say why it has none."""
    marks: dict[str, Mark] = {}
    if not study.genie_frames:
        return marks, dict.fromkeys(study.scenes, "tradeoff.genie_frames is 0")
    plan, refused = study.plan, {}
    frames = min(study.genie_frames, plan.budget.frames)
    for name in study.scenes:
        try:
            mark = genie_mark(plan.world, study.model(name), plan.seed, study.point(name), frames, workers)
        except UnknownLikelihoodError as error:
            # Pixels full before they are white show only once scenes are drawn, and perhaps in one kind.
            refused[name] = str(error)
        else:
            marks[name] = Mark(mark.counts, mark.proven, mark.seconds_a_frame)
    return marks, refused
