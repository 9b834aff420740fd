"""A comparison's counts are recorded, and taken from the store when it goes on."""

import pytest

from vocc_torch.measure.config import Budget
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.runner import Banks, Job
from vocc_torch.measure.store import Store
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.receiver.flda import FLDA
from vocc_torch.studies.compare.run import Run

FRAMES = 70


@pytest.fixture
def job(make_plan):
    plan = make_plan(names=("average_greyscale",), frames=FRAMES)
    bank = ReceiverBank(["average_greyscale"], FLDA(3))
    return Job(plan, plan.world.scene, "run", Banks([("truth", bank, 0)]))


def test_what_is_recorded_is_not_counted_again(job, tmp_path, monkeypatch):
    path = tmp_path / "ledger.sqlite"
    with Store.open(path, {"seed": 0}) as store, Workers(1) as pool:
        (first,) = Run(pool, store).count([(job, Budget(FRAMES))])
    with Store.open(path, {"seed": 0}) as store, Workers(1) as pool:
        monkeypatch.setattr(pool, "submit", None)
        (again,) = Run(pool, store).count([(job, Budget(FRAMES))])
    assert again.errors.counts == first.errors.counts
    assert first.errors.counts[0].frames == FRAMES
    assert first.errors.counts[0].bit_errors > 0
