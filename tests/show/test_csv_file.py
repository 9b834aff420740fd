"""The CSV file reads back to the same numbers and is never half there."""

import csv
import errno

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_points import table as table

from vocc_torch.errors import VoccError
from vocc_torch.files import atomic_file
from vocc_torch.measure.curve import COLUMNS, BerTable, Row
from vocc_torch.show.folder import ber_rows, read_tables, write_rows


def write_table(path, table):
    write_rows(path, ber_rows(table))


def read_table(path):
    (table,) = read_tables(path).values()
    return table


def test_a_table_reads_back_to_the_same_rows(tmp_path, table):
    write_table(tmp_path / "ber.csv", table)
    again = read_table(tmp_path / "ber.csv")
    assert set(again.rows) == set(table.rows)
    assert again.receivers == table.receivers


def test_lines_stand_by_receiver_and_ascending_value(tmp_path, table):
    write_table(tmp_path / "ber.csv", table)
    with (tmp_path / "ber.csv").open(newline="") as file:
        lines = list(csv.reader(file))
    assert tuple(lines[0]) == COLUMNS
    assert [(line[3], line[2]) for line in lines[1:4]] == [("flda_2", v) for v in ("1000", "8000", "32000")]


NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
RATES = st.lists(st.floats(0, 1), min_size=3, max_size=3).map(sorted)
NAMES = st.text(st.characters(codec="utf-8", exclude_characters="\r\n\0"), max_size=8)


@given(value=NUMBERS, rates=RATES, halves=st.integers(0, 10**15), name=NAMES)
def test_any_numbers_and_names_survive_the_file(tmp_path_factory, value, rates, halves, name):
    low, ber, high = rates
    row = Row(name, "x", value, name, "truth", 1, 64, halves / 2, ber, low, high, 10**20, 0, "a, b")
    path = tmp_path_factory.mktemp("csv") / "ber.csv"
    write_table(path, BerTable([row]))
    assert read_table(path).rows == (row,)


def test_missing_folders_are_made_and_nothing_else_is_left(tmp_path, table):
    write_table(tmp_path / "a" / "b" / "ber.csv", table)
    assert [path.name for path in (tmp_path / "a" / "b").iterdir()] == ["ber.csv"]


def test_a_failed_write_leaves_the_old_file_and_no_temporary_one(tmp_path):
    path = tmp_path / "ber.csv"
    path.write_text("old")

    def write_half(temporary):
        temporary.write_text("half")
        raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"), atomic_file(path) as temporary:
        write_half(temporary)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_one_line(tmp_path, table, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("vocc_torch.files.os.fsync", full)
    with pytest.raises(VoccError, match=r"^cannot write .*ber\.csv: No space left on device$"):
        write_table(tmp_path / "ber.csv", table)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path, table):
    (tmp_path / "file").write_text("")
    with pytest.raises(VoccError, match=r"^cannot write .*ber\.csv: "):
        write_table(tmp_path / "file" / "ber.csv", table)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"has no column experiment: it needs experiment, axis, "),
        ("experiment,axis\n", r"has no column value: "),
        (",".join(COLUMNS) + "\nd,x,1,r,truth,many,64,0,0,0,0.1,0,0,frames\n", r"line 2: frames is 'many': "),
        (",".join(COLUMNS) + "\nd,x,1,r,truth,1,64,0\n", r"line 2: ber is None: "),
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
