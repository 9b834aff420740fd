"""Train each receiver by itself, so that many are trained at the same time and each has a price."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from vocc_torch.measure.plan import Plan
from vocc_torch.measure.train import Making, Training, train_alone
from vocc_torch.measure.workers import Workers
from vocc_torch.receiver.bank import FLDA_FEATURES


def train_rivals(plans: Sequence[Plan], workers: Workers) -> list[tuple[Training, dict[str, Making]]]:
    """Train every plan's receivers; plans that train on the same scenes share them.

    Args:
        plans: plans of the same receivers.
        workers: who does it; each receiver is trained on one thread, here too.

    Returns:
        For each plan what was trained, and what it took by receiver.

    Raises:
        VoccError: no panel in any training frame, or a classifier that cannot be built or trained.
    """
    # FLDA is always among them: the receiver that is kept is one.
    names = tuple(FLDA_FEATURES)
    widened = [
        replace(
            plan, receiver=replace(plan.receiver, names=tuple(dict.fromkeys((*plan.receiver.names, *names))))
        )
        for plan in plans
    ]
    trained = train_alone(widened, workers)
    return [
        (training, {name: training.making(name) for name in plan.receiver.names})
        for plan, training in zip(plans, trained, strict=True)
    ]
