"""A Dask scheduler with two workers on this machine gives the bytes of one process."""

import pytest
from test_ray import TINY, begun, ended

pytestmark = pytest.mark.slow
distributed = pytest.importorskip("distributed")


def test_two_workers_give_the_bytes_of_one_process(app, tmp_path):
    assert app(*TINY, "workers=1", "name=one").status == 0
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster:
        address = cluster.scheduler_address
        status, _, err = ended(
            begun(tmp_path, address, *TINY, "name=many", kind="dask")
        )
    assert status == 0, err
    for name in ("ber.csv", "paired.csv"):
        one, many = (tmp_path / f"runs/{run}/{name}" for run in ("one", "many"))
        assert one.read_bytes() == many.read_bytes()
