"""The CSV file reads back to the same numbers and is never half there."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_points import table as table
from run_files import head_of, rows_of

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import COLUMNS, MOST_VALUE, BerTable, Row
from vocc_torch.report.folder import write_rows
from vocc_torch.report.rate_tables import ber_rows, read_tables


def write_table(path, table):
    write_rows(path, ber_rows(table))


def read_table(path):
    (table,) = read_tables(path).values()
    return table


def test_lines_stand_by_receiver_and_ascending_value(tmp_path, table):
    write_table(tmp_path / "ber.csv", table)
    assert tuple(head_of(tmp_path / "ber.csv")) == COLUMNS
    lines = [
        (line["receiver"], line["value"]) for line in rows_of(tmp_path / "ber.csv")
    ]
    assert lines[:3] == [("flda_2", v) for v in ("1000", "8000", "32000")]


NUMBERS = st.floats(-MOST_VALUE, MOST_VALUE)
RATES = st.lists(st.floats(0, 1), min_size=3, max_size=3).map(sorted)
NAMES = st.text(
    st.characters(codec="utf-8", exclude_characters="\r\n\0"), max_size=8
).filter(str.isprintable)
"""What is no printable character is read as an escape."""


@settings(max_examples=25)
@given(value=NUMBERS, rates=RATES, halves=st.integers(0, 10**15), name=NAMES)
def test_any_numbers_and_names_survive_the_file(
    tmp_path_factory, value, rates, halves, name
):
    low, ber, high = rates
    row = Row(
        name,
        "x",
        value,
        name,
        "truth",
        1,
        64,
        halves / 2,
        ber,
        low,
        high,
        10**20,
        0,
        "a, b",
    )
    path = tmp_path_factory.mktemp("csv") / "ber.csv"
    write_table(path, BerTable([row]))
    assert read_table(path).rows == (row,)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"has no column experiment: it needs experiment, axis, "),
        ("experiment,axis\n", r"has no column value: "),
        (
            ",".join(COLUMNS) + "\nd,x,1,r,truth,many,64,0,0,0,0.1,0,0,frames\n",
            r"line 2: frames is 'many': ",
        ),
        (",".join(COLUMNS) + "\nd,x,1,r,truth,1,64,0\n", r"line 2: ber is None: "),
        (
            ",".join(COLUMNS)
            + "\nd,x,1e101,r,truth,1,64,0,0,0,0.1,0,0,frames,1,,,,,,,counting,,,\n",
            r"x is 1e\+101: ",
        ),
    ],
)
def test_a_file_that_is_no_table_is_refused_with_the_place(tmp_path, text, message):
    (tmp_path / "ber.csv").write_text(text)
    with pytest.raises(VoccError, match=message):
        read_table(tmp_path / "ber.csv")


def test_further_columns_are_passed_over(tmp_path, table):
    write_table(tmp_path / "ber.csv", table)
    lines = (tmp_path / "ber.csv").read_text().splitlines()
    (tmp_path / "ber.csv").write_text("\n".join(line + ",more" for line in lines))
    assert set(read_table(tmp_path / "ber.csv").rows) == set(table.rows)
