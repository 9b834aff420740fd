"""An experiment that is a grid: experiment=dimming at a tiny budget, its files, and what it refuses."""

import pytest
import yaml
from run_files import files_in, head_of, rows_of
from running import run_in

from vocc_torch.measure.curve import COLUMNS

AMBIENT, LUMINANCE = (1000.0, 32000.0), (500.0, 2000.0, 8000.0)
TINY = (
    "budget.frames=8",
    "budget.training_frames=64",
    "workers=1",
    "tensorboard=false",
)
GRID = (
    *("experiment=dimming", *TINY, "receiver.names=[average_greyscale,flda_3]"),
    *("experiment.rows=[1000,32000]", "experiment.values=[500,2000,8000]"),
)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder for the runs of these tests."""
    return tmp_path_factory.mktemp("grid")


@pytest.fixture(scope="module")
def grid(place):
    """A grid of two rows and three columns, two receivers."""
    ran = run_in(place, *GRID, "name=grid", drawn=True)
    assert (ran.status, ran.err) == (0, "")
    return place / "runs" / "grid", ran.out


def test_everything_is_written(grid):
    folder, out = grid
    assert files_in(folder) == {
        *(
            "config.yaml",
            "samples.png",
            "receiver.pt",
            "paired.csv",
            "ledger.sqlite",
        ),
        *(f"ber{end}.csv" for end in ("", "_best")),
        "dimming_paper.png",
    }
    for told in (
        "dimming/ambient_lx=1000",
        "led_luminance_cd_m2=8000: 8 frames",
        "ber.csv",
    ):
        assert told in out
    settings = yaml.safe_load((folder / "config.yaml").read_text())["experiment"]
    assert (settings["row_axis"], settings["rows"]) == ("ambient_lx", list(AMBIENT))


def test_every_cell_of_every_receiver_has_a_row(grid):
    folder, _ = grid
    assert head_of(folder / "ber.csv") == ["ambient_lx", *COLUMNS]
    rows = rows_of(folder / "ber.csv")
    found = sorted(
        (float(row["ambient_lx"]), float(row["value"]), row["receiver"]) for row in rows
    )
    receivers = ("average_greyscale", "flda_3")
    assert found == sorted(
        (at, value, name) for at in AMBIENT for value in LUMINANCE for name in receivers
    )
    for row in rows:
        assert row["experiment"] == f"dimming/ambient_lx={float(row['ambient_lx']):g}"
        assert (row["axis"], row["locator"], row["frames"]) == (
            "led_luminance_cd_m2",
            "paper",
            "8",
        )
    assert len({row["bit_errors"] for row in rows}) > 2
