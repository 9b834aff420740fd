"""Train every receiver of a price list, each with its own locator and settings."""

from __future__ import annotations

import pickle
import time
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass

from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.plug_in_training import train_classifiers
from vocc_torch.measure.train import train
from vocc_torch.measure.workers import Workers
from vocc_torch.receiver.bank import FLDA_FEATURES, feature_indices
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.flda import FLDA
from vocc_torch.studies.tradeoff.chain import Chain
from vocc_torch.studies.tradeoff.plan import TradeoffStudy, is_flda, trained_alike
from vocc_torch.studies.tradeoff.price_list import Making, Setting

Decider = FLDA | Guarded


@dataclass(frozen=True)
class Made:
    """A trained receiver and what it took."""

    decider: Decider | None
    making: Making


def train_receivers(study: TradeoffStudy, workers: Workers) -> dict[Setting, Made]:
    """Train the receiver of every setting; settings that differ in precision alone share their training.

    Args:
        study: the study.
        workers: who does it; in another process with one thread.

    Raises:
        VoccError: no panel in any training frame, or a classifier that cannot be built or trained.
    """
    wanted = dict.fromkeys(trained_alike(setting) for setting in study.settings)
    waiting: dict[Setting, Future[Made]] = {}
    # One pass over the training frames has the statistics of all FLDA receivers.
    passes: dict[tuple[str, int, str], Future[tuple[FLDA, float]]] = {}
    for setting in sorted(wanted, key=lambda one: _panels(study, one), reverse=True):
        if is_flda(setting.receiver):
            key = setting.locator, setting.samples_per_led, setting.gradient
            if key not in passes:
                passes[key] = workers.submit(_gathered, study.plan_of(setting))
        elif any(setting.receiver == one.name for one in study.plan.receiver.classifiers):
            waiting[setting] = workers.submit(_plugged_in, study.plan_of(setting))
    made: dict[Setting, Made] = {}
    for setting in wanted:
        if setting in waiting:
            made[setting] = waiting[setting].result()
        elif is_flda(setting.receiver):
            flda, seconds = passes[setting.locator, setting.samples_per_led, setting.gradient].result()
            made[setting] = _selected(setting.receiver, flda, seconds, study.plan.budget.training_frames)
        else:
            made[setting] = Made(None, Making(parameters=0))
    return made


def chains(study: TradeoffStudy, made: Mapping[Setting, Made]) -> list[Chain]:
    """Put every setting's receiver together."""
    finders = study.plan.receiver.finders(study.locators)
    return [
        Chain(setting, finders[setting.locator], study.reader(setting), made[trained_alike(setting)].decider)
        for setting in study.settings
    ]


def _panels(study: TradeoffStudy, setting: Setting) -> int:
    """How many panels a receiver learns from: the longest training begins first."""
    for one in study.plan.receiver.classifiers:
        if one.name == setting.receiver:
            return one.frames or one.training.frames
    return 0


def _gathered(plan: Plan) -> tuple[FLDA, float]:
    """Train FLDA on all features, in a worker."""
    begun = time.perf_counter()
    flda = train(plan).flda
    return flda, time.perf_counter() - begun


def _selected(name: str, flda: FLDA, seconds: float, frames: int) -> Made:
    """Give an FLDA receiver from the statistics of all features."""
    decider = flda.select(feature_indices(name))
    size = len(pickle.dumps(decider))
    return Made(decider, Making(seconds, None, frames, len(FLDA_FEATURES[name]) + 1, size))


def _plugged_in(plan: Plan) -> Made:
    """Train the only classifier of a plan, in a worker."""
    (name,), link = plan.receiver.names, Link.of(plan)
    trained = train_classifiers(plan, link, {"": link.locator})[""][name]
    making = Making(
        trained.seconds, trained.simulated_s, trained.frames, trained.parameters, trained.size_bytes
    )
    return Made(trained.guarded, making)
