"""task=figures at a tiny budget: what it writes, what it judges, that it goes on, and what it refuses."""

import sqlite3
from contextlib import closing

import pytest
from run_files import contents_of, files_in, rows_of
from running import run_in

from vocc_torch import Receiver
from vocc_torch.measure.curve import COLUMNS

TINY = (
    "budget.frames=8",
    "budget.training_frames=64",
    "budget.trainings=2",
    "workers=1",
    "tensorboard=false",
)
AMBIENT = ("figures.names=[fig22]", "figures.experiments.ambient.values=[4000,8000]")
OWN = "near: {why: a lens of one's own, set: {camera.focal_length_mm: 50, receiver.locator: paper}}\n"
ASK = (
    "task=figures",
    *TINY,
    *AMBIENT,
    "figures.readings=[board,board_true,mine.yaml]",
    "name=some",
)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("figures")
    (folder / "mine.yaml").write_text(OWN)
    return folder


@pytest.fixture(scope="module")
def some(place):
    """Fig. 22 under two readings that ship and one of a file."""
    ran = run_in(place, *ASK)
    assert (ran.status, ran.err) == (0, "")
    return place / "runs" / "some"


def test_what_is_written(some):
    assert files_in(some) == {
        *("config.yaml", "receiver.pt", "report.md", "report.html", "paired.csv"),
        *("scorecard.csv", "readings.csv"),
        *("figures/fig22.csv", "figures/fig22.png", "figures/fig22_readings.png"),
        "ledger.sqlite",
    }
    # True corners are measured on the same frames as located ones: two studies of two points.
    with closing(sqlite3.connect(some / "ledger.sqlite")) as ledger:
        assert ledger.execute(
            "SELECT count(*) FROM blocks WHERE frames"
        ).fetchone() == (4,)
    assert Receiver.load(some / "receiver.pt").name == "flda_3"


def test_a_figure_has_the_verdicts_of_what_it_drew_and_the_title_says_so(some):
    rows = rows_of(some / "scorecard.csv")
    assert {row["reading"] for row in rows} == {"board", "board_true", "near"}
    assert {row["claim"].partition(".")[0] for row in rows} == {"ambient"}
    count = len({row["claim"] for row in rows})
    title = (some / "report.md").read_text().splitlines()[0]
    assert title == f"# Do and Yoo (2019), fig22; claims: {count}, readings: 3"
    assert "The assumption that matters most" in (some / "report.md").read_text()


def test_rates_are_those_of_the_experiment_alone(some, place):
    """task=test measures the same frames with the same receivers."""
    ran = run_in(
        place,
        *(
            "experiment=ambient",
            *TINY,
            "receiver=every",
            "experiment.values=[4000,8000]",
        ),
        *("receiver.locator=paper", "camera.focal_length_mm=50", "name=same"),
    )
    assert ran.status == 0, ran.err
    rows = rows_of(some / "figures" / "fig22.csv")
    together = [
        {name: row[name] for name in COLUMNS}
        for row in rows
        if row["reading"] == "near"
    ]
    assert together == rows_of(place / "runs" / "same" / "ber.csv")


def test_quoted_rates_are_drawn_as_stars(place):
    from vocc_torch.studies.paper import run

    drawn = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            run.tensorboard,
            "write_figures",
            lambda _, __, figures, ___: drawn.update(figures),
        )
        patch.setattr(run.page, "html", lambda *_: "")
        ended = run_in(place, *ASK[:-1], "name=stars", drawn=True)
    assert ended.status == 0, ended.err
    stars = [
        line
        for line in drawn["figures/fig22"].axes[0].lines
        if line.get_marker() == "*"
    ]
    assert sorted(float(y) for line in stars for y in line.get_ydata()) == [
        5.0e-4,
        6.6e-4,
    ]


def test_a_report_of_other_figures_or_readings_stays_as_it_is(some, place):
    before = contents_of(some, ".csv", ".md")
    other = run_in(place, *ASK[:-2], "figures.readings=[board]", "name=some")
    assert (
        "holds a report of other figures.readings: give another name="
        in other.complaint
    )
    assert contents_of(some, ".csv", ".md") == before


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (
            ("figures.names=[fig99]",),
            "figures.names is 'fig99': it must be one of fig04, fig08",
        ),
        (
            ("figures.names=[fig22]", "figures.experiments.ambient.values=[-1]"),
            "figures.experiments.ambient.values",
        ),
        (
            (
                "figures.names=[fig22]",
                "figures.experiments.ambient.row_axis=led_luminance_cd_m2",
                "figures.experiments.ambient.rows=[2000,4000]",
            ),
            "figures.experiments.ambient.row_axis is led_luminance_cd_m2: it must be null but for dimming",
        ),
        (
            (
                "figures.names=[fig21]",
                "figures.experiments.contrast.values=[0.98,0.99]",
            ),
            "figures.experiments.contrast.values is (0.98, 0.99): it must be bins that hold frames",
        ),
    ],
)
def test_what_cannot_be_made_is_refused_in_one_line(place, words, complaint):
    ended = run_in(
        place, "task=figures", *TINY, "figures.readings=[board]", *words, "name=refused"
    )
    assert complaint in ended.complaint.replace("[0.98, 0.99]", "(0.98, 0.99)")
