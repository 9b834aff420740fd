"""``paired.csv`` and the lines on the terminal: every two receivers compared, and who differs for certain."""

from itertools import combinations

import numpy as np
import pytest
from made_up_tallies import errors_of
from run_files import rows_of

from vocc_torch.measure.curve import Curves, Point
from vocc_torch.report.rate_tables import PAIRED_COLUMNS as COLUMNS
from vocc_torch.report.rate_tables import write_paired

NAMES = ("average_greyscale", "flda_2", "flda_3")


def made_up(wrong, names=NAMES, experiment="sun", locator="truth"):
    """Curves from the frames in which each receiver has a wrong bit, by value."""
    place, points, errors = (experiment, "ambient_lx"), [], {}
    for value, frames in wrong.items():
        halves = np.zeros((len(names), 2000), dtype=np.int64)
        for row, places in zip(halves, frames, strict=True):
            row[list(places)] = 2
        errors[value] = [errors_of(halves, 64)]
        points += [
            Point(*place, value, name, locator, counts, "frames")
            for name, counts in zip(names, errors[value][0].counts, strict=True)
        ]
    return Curves(points, errors)


@pytest.fixture
def curves():
    """Average greyscale is worse at 1000 lx; flda_2 is better than flda_3 at 2500.5 lx."""
    two, three = {*range(5)}, {*range(5, 9)}
    return made_up(
        {
            1000.0: ({*range(9, 104)} | two | {*range(5, 9)}, two, three),
            2500.5: ((), (), range(100)),
        }
    )


def written(path, *all_curves):
    """The lines of the file, by column."""
    write_paired(path / "paired.csv", all_curves)
    return rows_of(path / "paired.csv")


def test_a_line_for_every_two_receivers_at_every_value(tmp_path, curves):
    other = made_up({4000.0: ((), ())}, NAMES[1:], "moon", "paper")
    rows = written(tmp_path, curves, other)
    assert tuple(rows[0]) == COLUMNS
    names = list(combinations(NAMES, 2))
    assert [(row["experiment"], row["value"], row["a"], row["b"]) for row in rows] == [
        *(("sun", "1000", a, b) for a, b in names),
        *(("sun", "2500.5", a, b) for a, b in names),
        ("moon", "4000", "flda_2", "flda_3"),
    ]
    assert {(row["axis"], row["frames"]) for row in rows} == {("ambient_lx", "2000")}
    assert [row["locator"] for row in rows] == ["truth"] * 6 + ["paper"]


def test_real_says_whether_the_interval_leaves_out_0(tmp_path, curves):
    found = {
        (row["value"], row["a"], row["b"]): row for row in written(tmp_path, curves)
    }
    for row in found.values():
        low, difference, high = (
            float(row[f"difference{end}"]) for end in ("_low", "", "_high")
        )
        assert low <= difference <= high
        assert row["real"] == str(int(low > 0 or high < 0))
    assert [row["real"] for row in found.values()] == ["1", "1", "0", "0", "1", "1"]
    # The difference is that of a less b: 200 half errors of 128000 bits more, or fewer.
    assert (
        float(found["1000", "average_greyscale", "flda_3"]["difference"])
        == 100 / 128_000
    )
    assert float(found["2500.5", "flda_2", "flda_3"]["difference"]) == -100 / 128_000
    barely = found["1000", "flda_2", "flda_3"]
    assert (barely["a_worse"], barely["b_worse"]) == ("5", "4")
    # Nine tosses of a fair coin: 5 and 4 are the likeliest there is.
    assert float(barely["sign_test_p"]) == 1
    swapped = found["2500.5", "flda_2", "flda_3"]
    assert (swapped["a_worse"], swapped["b_worse"]) == ("0", "100")
    assert float(swapped["sign_test_p"]) == pytest.approx(2 * 0.5**100)
