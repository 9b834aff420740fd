"""A Ray cluster of local nodes of one CPU: the bytes of one process, and what goes wrong in one line."""

import os
import shutil
import sqlite3
import subprocess
import sys
import time
from contextlib import closing, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("ray") is None, reason="ray is not installed"),
]

NODES = """
import sys, ray
from ray.cluster_utils import Cluster

small = {"num_cpus": 1, "object_store_memory": 80 << 20}
cluster = Cluster(initialize_head=True, head_node_args={**small, "include_dashboard": False})
nodes = [cluster.head_node] + [cluster.add_node(**small) for _ in range(int(sys.argv[1]) - 1)]
print(cluster.address, flush=True)
for line in sys.stdin:
    if line == "kill\\n":
        cluster.remove_node(nodes.pop(), allow_graceful=False)
    else:
        nodes.append(cluster.add_node(**small))
    print("done", flush=True)
cluster.shutdown()
"""
"""Starts a cluster, tells its address, and for each line kills or adds a node."""

AMBIENT = (
    *(
        "experiment=ambient",
        "budget.frames=1536",
        "budget.training_frames=256",
        "tensorboard=false",
    ),
    *("receiver=paper", "device=cpu"),
)
TINY = (
    *AMBIENT,
    "budget.frames=128",
    "experiment.values=[1000]",
    "receiver.names=[flda_3]",
)


@contextmanager
def cluster(nodes):
    """A cluster: its address, and what kills or adds a node."""
    with subprocess.Popen(
        [sys.executable, "-c", NODES, str(nodes)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    ) as process:

        def told(what):
            process.stdin.write(f"{what}\n")
            process.stdin.flush()
            assert process.stdout.readline() == "done\n"

        try:
            yield process.stdout.readline().strip(), told
        finally:
            process.stdin.close()
            with suppress(subprocess.TimeoutExpired):
                process.wait(60)
            process.kill()


def begun(cwd, address, *words, kind="ray"):
    """The command on a cluster, under way."""
    command = [
        sys.executable,
        "-m",
        "vocc_torch",
        *words,
        f"executor={kind}",
        f"executor.address={address}",
    ]
    there = {**os.environ, "OMP_NUM_THREADS": "1"}
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, cwd=cwd, env=there, text=True, **piped)


def ended(process):
    out, err = process.communicate(timeout=300)
    return process.returncode, out, err


def blocks(cwd, name):
    """How many blocks a run has counted."""
    where = f"file:{cwd}/runs/{name}/ledger.sqlite?mode=ro&immutable=1"
    try:
        with closing(sqlite3.connect(where, uri=True)) as connection:
            return connection.execute("SELECT count(*) FROM blocks").fetchone()[0]
    except sqlite3.Error:
        return 0


def test_three_nodes_one_killed_and_one_late_give_the_bytes_of_one_process(
    app, tmp_path
):
    assert app(*AMBIENT, "workers=1", "name=one").status == 0
    with cluster(3) as (address, told):
        run = begun(tmp_path, address, *AMBIENT, "name=many")
        for most, what in ((20, "kill"), (60, "add")):
            while blocks(tmp_path, "many") < most:
                assert run.poll() is None, run.communicate()
                time.sleep(0.1)
            told(what)
            assert blocks(tmp_path, "many") < 144
        status, _, err = ended(run)
    assert status == 0, err
    for name in ("ber.csv", "paired.csv"):
        assert (tmp_path / "runs/one" / name).read_bytes() == (
            tmp_path / "runs/many" / name
        ).read_bytes()


def test_a_users_files_travel(app, tmp_path):
    """Named relative to where the run is started, which no node knows."""
    shutil.copy(
        Path(__file__).parents[2] / "examples/classifiers/nearest_mean.py",
        tmp_path / "mine.py",
    )
    words = (*TINY, "+classifiers.mean.build._target_=mine.py:NearestMean")
    with cluster(2) as (address, _):
        status, _, err = ended(begun(tmp_path, address, *words, "name=many"))
    assert (status, err) == (0, "")
    assert app(*words, "workers=1", "name=one").status == 0
    files = [tmp_path / f"runs/{name}/ber.csv" for name in ("one", "many")]
    assert files[0].read_bytes() == files[1].read_bytes()
