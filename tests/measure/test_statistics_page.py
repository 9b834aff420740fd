"""The page on statistics and the simulation that fills it: same tables, and laws whose truth is true."""

import importlib.util
import sys
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "statistics.md"


@pytest.fixture(scope="module")
def benchmark():
    """The benchmark's module; its name is also that of a well-known package."""
    folder = str(ROOT / "benchmarks")
    sys.path.insert(0, folder)
    spec = importlib.util.spec_from_file_location(
        "coverage_benchmark", ROOT / "benchmarks" / "interval_coverage.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.path.remove(folder)


@pytest.fixture(scope="module")
def laws(benchmark):
    import frame_laws

    return frame_laws


def tables(page, benchmark):
    """The lines of each generated table, without what follows it."""
    blocks = [
        part.split(benchmark.END)[0].strip() for part in page.split(benchmark.BEGIN)[1:]
    ]
    return [
        [line.split(" | ") for line in takewhile(str, block.splitlines())]
        for block in blocks
    ]


def test_the_page_has_every_table_as_the_command_writes_it(benchmark):
    page = PAGE.read_text()
    assert "python benchmarks/interval_coverage.py" in page
    written = tables(page, benchmark)
    assert len(written) == len(benchmark.TABLES)
    for (simulate, _), on_page in zip(benchmark.TABLES, written, strict=True):
        text = benchmark.markdown(simulate(np.random.default_rng(0), 8))
        fresh = [line.split(" | ") for line in text.splitlines()]
        assert fresh[:2] == on_page[:2]
        labels = (
            2
            if simulate.__name__ in ("one_receiver", "two_receivers", "stopped")
            else 1
        )
        assert [row[:labels] for row in fresh] == [row[:labels] for row in on_page]
        assert (
            {len(row) for row in fresh[2:]}
            == {len(row) for row in on_page[2:]}
            == {len(fresh[0])}
        )
        assert not any(cell in ("nan", "") for row in fresh for cell in row)


def test_a_laws_truth_is_that_of_its_closed_form(laws):
    law = laws.clustered(0.01, 0.05)
    wrong = law.halves[:, 0] / 2
    mean = law.share @ wrong
    variance = law.share @ wrong**2 - mean**2
    assert law.ber == pytest.approx(0.01)
    assert variance == pytest.approx(64 * 0.01 * 0.99 * (1 + 63 * 0.05))
    assert law.frame_error_rate == pytest.approx(1 - law.share[0])
    assert laws.with_missed(law, 0.1).ber == pytest.approx(0.1 / 2 + 0.9 * 0.01)
    assert laws.mended(law, 0.24, 0.001).ber == pytest.approx(
        [0.01, 0.0076 + 0.99 * 0.001], rel=1e-4
    )
    assert laws.missed_by_first(laws.alike(law), 0.1).ber == pytest.approx(
        [0.059, 0.01]
    )
    assert laws.apart(law, laws.independent(0.02)).ber == pytest.approx(
        [0.01, 0.02], rel=1e-4
    )
