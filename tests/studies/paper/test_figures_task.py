"""task=figures at a tiny budget: what it writes, that it goes on, and what it refuses."""

import pytest
import yaml
from paper_runs import contents_of, files_in, head_of, rows_of, run_in

from vocc_torch import Receiver
from vocc_torch.measure.curve import COLUMNS
from vocc_torch.measure.runner import Job
from vocc_torch.studies.paper.judgement import VERDICTS
from vocc_torch.studies.paper.scorecard import CLAIMS
from vocc_torch.studies.paper.scorecard import COLUMNS as SCORE_COLUMNS

TINY = (
    "budget.frames=8",
    "budget.training_frames=64",
    "budget.trainings=2",
    "workers=1",
    "tensorboard=false",
)
VALUES = {"contrast": "[0,0.3,0.36,0.6]", "ambient": "[4000,8000]", "luminance": "[500,4000]"}
VALUES |= {"distance": "[30,60,70]"}
BASE = (
    *("task=figures", *TINY),
    *(f"figures.experiments.{name}.values={values}" for name, values in VALUES.items()),
)
SCORED = ("fig21", "fig22", "fig23", "fig24")
WHOLE = ("figures.focal_lengths_mm=[25,18]", "figures.names=[fig17,fig21,fig22,fig23,fig24]")
GRID = (
    *("task=figures", *TINY, "figures.names=[dimming]", "name=grid"),
    *("figures.experiments.dimming.rows=[1000,32000]", "figures.experiments.dimming.values=[500,8000]"),
)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder for the runs of these tests."""
    return tmp_path_factory.mktemp("figures")


@pytest.fixture(scope="module")
def whole(place):
    """Two lenses, two locators, the four experiments of the scorecard and one other figure."""
    ran = run_in(place, *BASE, *WHOLE, "name=whole")
    assert (ran.status, ran.err) == (0, "")
    return place / "runs" / "whole", ran.out


def test_everything_is_written(whole):
    folder, out = whole
    assert files_in(folder) == {
        *("config.yaml", "receiver.pt", "report.md", "report.html"),
        *("scorecard.csv", "fits.csv", "location.csv", "paired.csv", "figures/location.png"),
        *(f"figures/{name}.{kind}" for name in ("fig17", *SCORED) for kind in ("png", "csv")),
        *(f"figures/{name}_readings.png" for name in SCORED),
        *(f"ledgers/{name}-{mm}mm.sqlite" for name in VALUES for mm in (25, 18)),
    }
    for told in ("training", "contrast-25mm", "distance-18mm", "other figures", "report.html"):
        assert told in out
    assert Receiver.load(folder / "receiver.pt").name == "flda_3"
    settings = yaml.safe_load((folder / "config.yaml").read_text())
    assert settings["figures"]["focal_lengths_mm"] == [25.0, 18.0]
    assert set(settings["figures"]["experiments"]) >= {*VALUES, "dimming"}


def test_rates_are_those_of_the_experiment_alone(whole, place):
    """task=test measures the same frames with the same receivers."""
    ran = run_in(
        place,
        *("experiment=ambient", *TINY, "receiver=every", f"experiment.values={VALUES['ambient']}"),
        *("receiver.locator=paper", "camera.focal_length_mm=18", "name=same"),
    )
    assert ran.status == 0, ran.err
    alone = rows_of(place / "runs" / "same" / "ber.csv")
    folder, _ = whole
    together = [
        {name: row[name] for name in COLUMNS}
        for row in rows_of(folder / "figures" / "fig22.csv")
        if (row["focal_length_mm"], row["locator"]) == ("18", "paper")
    ]
    assert together == alone
    assert any(row["bit_errors"] != "0" for row in alone)


def test_the_scorecard_judges_every_claim_under_every_reading(whole):
    folder, _ = whole
    rows = rows_of(folder / "scorecard.csv")
    assert head_of(folder / "scorecard.csv") == list(SCORE_COLUMNS)
    readings = [(mm, locator) for mm in ("18", "25") for locator in ("paper", "truth")]
    for claim in CLAIMS:
        mine = [row for row in rows if row["claim"] == claim.claim]
        expected = readings if claim.basis == "curves" else [("", "")]
        assert [(row["focal_length_mm"], row["locator"]) for row in mine] == expected
        assert {row["verdict"] for row in mine} <= set(VERDICTS)
        assert all(row["reason"] for row in mine if row["verdict"] == "cannot say")
    verdicts = {row["claim"]: row["verdict"] for row in rows}
    # Figure 17 was made; figure 4 and the map of dimming were not.
    assert verdicts["figures.dull_after_gamma"] == "agree"
    assert verdicts["figures.grey_overlap"] == "cannot say"
    assert verdicts["discussion.dimming.flda_3"] == "cannot say"


# Parts


def test_no_figure_of_error_rates(place):
    """Nothing is trained or counted, and so nothing can be resumed."""
    arguments = (*BASE, "figures.names=[fig17]", "receiver.names=[flda_agr]", "name=alone")
    ran = run_in(place, *arguments)
    assert (ran.status, ran.err) == (0, "")
    pictures = {"figures/fig17.csv", "figures/fig17.png"}
    assert files_in(place / "runs" / "alone") == {"config.yaml", "report.md", "report.html", *pictures}
    assert "training" not in ran.out
    assert "already holds" in run_in(place, *arguments).complaint


@pytest.fixture(scope="module")
def grid(place):
    """The grid alone, with a board."""
    ran = run_in(place, *GRID, "tensorboard=true")
    assert (ran.status, ran.err) == (0, "")
    return place / "runs" / "grid"


def test_the_grid_alone_has_no_scorecard(grid):
    names = {name for name in files_in(grid) if not name.startswith("tensorboard")}
    assert names == {
        *("config.yaml", "receiver.pt", "report.md", "report.html", "paired.csv"),
        *("ledgers/dimming-25mm-1000.sqlite", "ledgers/dimming-25mm-32000.sqlite"),
        *(f"figures/dimming{end}" for end in (".csv", "_best.csv", "_best.png", "_paper.png", "_truth.png")),
    }
    assert head_of(grid / "figures" / "dimming.csv") == ["ambient_lx", *COLUMNS]
    assert {(row["ambient_lx"], row["locator"]) for row in rows_of(grid / "figures" / "dimming.csv")} == {
        (at, locator) for at in ("1000.0", "32000.0") for locator in ("paper", "truth")
    }
    assert list((grid / "tensorboard").rglob("events.out.tfevents.*"))
    assert 'id="dimming"' in (grid / "report.html").read_text(encoding="utf-8")


def test_a_finished_run_counts_nothing_again(grid, place, monkeypatch):
    """Started again, it reads its ledgers: the same bytes, and the report says that it went on."""
    before = contents_of(grid, ".csv", ".sqlite")
    first = (grid / "report.md").read_text(encoding="utf-8")
    monkeypatch.setattr(Job, "count", lambda *_: pytest.fail("counted again"))
    ran = run_in(place, *GRID)
    assert (ran.status, ran.err) == (0, "")
    assert contents_of(grid, ".csv", ".sqlite") == before
    assert "resuming: 2 blocks" in ran.out
    again = (grid / "report.md").read_text(encoding="utf-8")
    told = "going on from what an earlier run had counted"
    assert (told in first, told in again) == (False, True)


# Mistakes


def test_contrast_bins_without_frames_are_refused_by_their_key(tmp_path):
    bins = "figures.experiments.contrast.values=[0.9,0.95]"
    ran = run_in(tmp_path, *BASE, "figures.focal_lengths_mm=[25]", "figures.names=[fig21]", bins)
    told = "figures.experiments.contrast.values: no frame fell into any contrast bin"
    assert ran.complaint.startswith(told)


def test_a_run_of_other_settings_or_figures_is_refused_and_stays_as_it_is(grid, place):
    before = contents_of(grid, ".csv", ".sqlite", ".yaml", ".png", ".md", ".html", ".pt")
    complaint = run_in(place, *GRID, "seed=1").complaint
    assert "dimming-25mm-1000.sqlite" in complaint
    assert "seed" in complaint
    assert "give another name=" in complaint
    complaint = run_in(place, *GRID, "figures.names=[fig17]").complaint
    assert complaint.endswith("holds a report of other figures: give another name=")
    assert contents_of(grid, ".csv", ".sqlite", ".yaml", ".png", ".md", ".html", ".pt") == before
