"""A comparison's counts are recorded, and taken from the store when it goes on."""

from dataclasses import replace

from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.plan import Budget
from vocc_torch.measure.store import Store
from vocc_torch.studies.run import Case, Run

FRAMES = 70


def test_what_is_recorded_is_not_counted_again(make_plan, tmp_path, monkeypatch):
    """Nor is an equal case; of a shorter one the block that it does not fill is another."""
    plan = make_plan(names=("average_greyscale", "flda_3"), frames=FRAMES)
    short = replace(plan, budget=replace(plan.budget, frames=FRAMES - 50))
    other = replace(plan, budget=Budget(FRAMES, 33))
    asked = [(short, [plan]), *[(plan, [plan])] * 2, (plan, [other, plan])]
    cases = [Case(*case, 66.0) for case in asked]
    path = tmp_path / "ledger.sqlite"
    with Store.open(path, {"seed": 0}) as store, Workers(1) as pool:
        run = Run(pool, store)
        run.train([plan, other])
        first, whole, equal, both = run.count(cases)
        assert len(store) == 5
    with Store.open(path, {"seed": 0}) as store, Workers(1) as pool:
        monkeypatch.setattr(pool, "submit", None)
        run = Run(pool, store)
        run.train([plan, other])
        again = run.count(cases)
    pairs = zip(again, (first, whole, equal, both), strict=True)
    assert all(a.errors.counts == b.errors.counts for a, b in pairs)
    assert [of.errors.counts[0].frames for of in again] == [20, FRAMES, FRAMES, FRAMES]
    assert whole.errors.counts[0].bit_errors > 0
    rows = [both.errors.place(Key("truth", "flda_3", number)) for number in (0, 1)]
    assert both.errors.counts[rows[1]] == whole.errors.counts[1]
    assert rows == [1, 3]
