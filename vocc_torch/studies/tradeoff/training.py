"""Train every receiver of a price list, each with its own locator and settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from vocc_torch.measure.plug_in_training import Making
from vocc_torch.measure.train import Training, train_alone
from vocc_torch.measure.workers import Workers
from vocc_torch.receiver.bank import feature_indices
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.flda import FLDA
from vocc_torch.studies.tradeoff.chain import Chain
from vocc_torch.studies.tradeoff.plan import TradeoffStudy, is_flda, trained_alike
from vocc_torch.studies.tradeoff.price_list import Setting

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
        workers: who does it, each with one thread.

    Raises:
        VoccError: no panel in any training frame, or a classifier that cannot be built or trained.
    """
    wanted = list(dict.fromkeys(trained_alike(setting) for setting in study.settings))
    trained = train_alone([study.plan_of(setting) for setting in wanted], workers)
    return {
        setting: Made(_decider(setting.receiver, training), training.making(setting.receiver))
        for setting, training in zip(wanted, trained, strict=True)
    }


def _decider(name: str, training: Training) -> Decider | None:
    """Give what decides; None for a receiver that learns nothing."""
    if is_flda(name):
        return training.flda.select(feature_indices(name))
    return training.classifiers.get(name)


def chains(study: TradeoffStudy, made: Mapping[Setting, Made]) -> list[Chain]:
    """Put every setting's receiver together."""
    finders = study.plan.receiver.finders(study.locators)
    return [
        Chain(setting, finders[setting.locator], study.reader(setting), made[trained_alike(setting)].decider)
        for setting in study.settings
    ]
