"""task=collect: what a multirun wrote, in one table and one picture, whatever state it is in."""

import io
import os

import pytest
import yaml
from PIL import Image
from rich.console import Console
from run_files import rows_of

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import COLUMNS, BerTable, Point
from vocc_torch.report.folder import write_rows
from vocc_torch.report.rate_tables import ber_rows
from vocc_torch.studies.collect import (
    SweepJob,
    collected_rows,
    differing_keys,
    find_jobs,
    label,
    print_jobs,
)

QUICK = (
    *("budget.frames=16", "budget.training_frames=16", "tensorboard=false"),
    *("receiver.names=[flda_2,flda_3]", "receiver.locator=truth"),
)


def made_up_table(
    axis="distance_m", values=(30.0, 70.0), receivers=("flda_2", "flda_3"), errors=40
):
    """Points of a job; the last receiver's first point has no errors."""
    points = []
    for place, receiver in enumerate(receivers):
        for number, value in enumerate(values):
            wrong = (
                0
                if (place, number) == (len(receivers) - 1, 0)
                else errors * (number + 1)
            )
            counts = Counts(1000, 64_000, 2 * wrong, 8 * wrong, (wrong + 1) // 2)
            points.append(
                Point("made_up", axis, value, receiver, "truth", counts, "frames")
            )
    return BerTable(points)


def write_job(folder, settings=None, table=None, failed=None, ledger=False):
    """What a job leaves in its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    if settings is not None:
        (folder / "config.yaml").write_text(yaml.safe_dump(settings))
    if table is not None:
        write_rows(folder / "ber.csv", ber_rows(table))
    if failed is not None:
        (folder / "failed.txt").write_text(failed)
    if ledger:
        (folder / "ledger.sqlite").write_text("")


# The whole way


def test_a_multirun_is_collected(app, tmp_path):
    """One job and one mistake: every point is there once, beside what tells the jobs apart."""
    assert (
        app(
            *QUICK, "name=two", "-m", "experiment.values=[4000,8000]", "seed=1,-1"
        ).status
        == 2
    )
    folder = tmp_path / "runs" / "two"
    ran = app("task=collect", "input=runs/two")
    assert (ran.status, ran.err) == (0, "")
    *done, failed = rows_of(folder / "collected.csv")
    assert list(failed) == ["job", "status", "seed", *COLUMNS, "complaint"]
    assert [{name: row[name] for name in COLUMNS} for row in done] == rows_of(
        folder / "0" / "ber.csv"
    )
    assert {(row["job"], row["status"], row["seed"]) for row in done} == {
        ("0", "done", "1")
    }
    assert [failed[name] for name in ("job", "status", "seed", "ber")] == [
        "1",
        "failed",
        "-1",
        "",
    ]
    assert failed["complaint"].startswith("seed is -1")
    with Image.open(folder / "collected.png") as picture:
        assert picture.format == "PNG"
    for part in ("seed=1", "job 1 failed: seed is -1", "runs/two/collected.csv"):
        assert part in ran.out
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["two"]


MISTAKES = {
    "no input": ((), ["input is null", "input=runs/NAME"]),
    "missing": (
        ("input=runs/no",),
        ["input runs/no does not exist", "a multirun wrote"],
    ),
    "file": (("input=file",), ["input file is a file", "a multirun wrote"]),
    "no job": (("input=empty",), ["input empty holds no job", "0/ber.csv"]),
    "model": (
        ("input=empty", "model=x.pt"),
        ["model is x.pt", "task=collect does not use it"],
    ),
}


@pytest.mark.parametrize(("arguments", "parts"), MISTAKES.values(), ids=MISTAKES.keys())
def test_mistakes_are_one_line_and_leave_nothing(app, tmp_path, arguments, parts):
    (tmp_path / "file").write_text("")
    (tmp_path / "empty" / "0").mkdir(parents=True)
    (tmp_path / "empty" / "0" / "receiver.pt").write_text("of task=train")
    complaint = app("task=collect", *arguments).complaint
    for part in parts:
        assert part in complaint
    assert {path.name for path in tmp_path.rglob("*")} == {
        "file",
        "empty",
        "0",
        "receiver.pt",
    }


# Finding jobs


def test_every_state_of_a_job_is_told(tmp_path):
    write_job(tmp_path / "10", {"seed": 1}, made_up_table())
    write_job(tmp_path / "2", {"seed": 2}, failed="seed is 2: no\n\nTraceback ...")
    write_job(tmp_path / "3", ledger=True)
    (tmp_path / "4").mkdir()
    write_job(tmp_path / "5", {"seed": 5})
    (tmp_path / "5" / "ber.csv").write_text("experiment,axis\nx,y\n")
    write_job(tmp_path / "6", {"seed": 6}, BerTable())
    write_job(tmp_path / "7", {"seed": 7}, made_up_table(), failed="disk full\n")
    write_job(tmp_path / "8", None, made_up_table())
    write_job(tmp_path / "9", {"seed": 9}, failed="")
    write_job(tmp_path / "night" / "0", {"seed": 11}, made_up_table())
    (tmp_path / "multirun.yaml").write_text("")
    jobs = find_jobs(tmp_path)
    told = [(job.name, job.status) for job in jobs]
    assert told == [
        *(
            ("2", "failed"),
            ("3", "unfinished"),
            ("4", "unfinished"),
            ("5", "unreadable"),
        ),
        *(
            ("6", "unreadable"),
            ("7", "failed"),
            ("8", "done"),
            ("9", "failed"),
            ("10", "done"),
        ),
        ("night/0", "done"),
    ]
    by_name = {job.name: job for job in jobs}
    assert by_name["2"].complaint == "seed is 2: no"
    assert "no ber.csv yet" in by_name["3"].complaint
    assert "has no column value" in by_name["5"].complaint
    assert "has no point" in by_name["6"].complaint
    assert by_name["7"].complaint == "disk full"
    assert by_name["7"].table is not None
    assert "config.yaml" in by_name["8"].complaint
    assert by_name["9"].complaint == "failed.txt is empty"
    assert by_name["10"].complaint == ""
    assert by_name["10"].table.rows == made_up_table().rows


# What differs


def settings_of(**values):
    """A job with these settings."""
    return SweepJob(
        "x",
        "done",
        settings={key.replace("__", "."): value for key, value in values.items()},
    )


def test_keys_of_an_experiment_that_follow_from_its_name_are_left_out():
    jobs = [
        settings_of(
            experiment__name=name,
            experiment__axis=axis,
            experiment__scene__x=x,
            seed=seed,
        )
        for name, axis, x in (("ambient", "lx", 1), ("distance", "m", None))
        for seed in (0, 1)
    ]
    assert differing_keys(jobs) == ["experiment.name", "seed"]
    assert label(jobs[3], ["experiment.name", "seed"]) == "experiment=distance, seed=1"
    other = settings_of(
        experiment__name="distance",
        experiment__axis="m",
        experiment__scene__x=5,
        seed=0,
    )
    assert differing_keys([*jobs, other]) == [
        "experiment.name",
        "experiment.scene.x",
        "seed",
    ]


# Picture and table


def test_escape_codes_in_what_others_wrote_do_not_reach_the_terminal(tmp_path):
    """Nor do they stop the table: names of folders, settings, complaints and cells, with bytes of no text."""
    table = made_up_table(receivers=("\x1b[31mred",), axis="[/b]")
    write_job(
        tmp_path / os.fsdecode(b"\xff\x1b[2J"),
        {"seed": "\x1b]0;x"},
        table,
        failed="\x1b[1m[/b]\n",
    )
    write_job(tmp_path / "1", {"seed": 1}, failed="no")
    jobs, screen = find_jobs(tmp_path), io.StringIO()
    print_jobs(jobs, ["seed"], Console(file=screen, width=120))
    write_rows(tmp_path / "collected.csv", collected_rows(jobs, ["seed"]))
    for text in (screen.getvalue(), (tmp_path / "collected.csv").read_text()):
        assert "\x1b" not in text
        assert "\\x1b[1m[/b]" in text
