"""What task=figures measures: which figures, under which readings, and how results are sorted."""

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vocc_torch.studies.paper.studies import BER_FIGURES, PaperStudies, wanted_figures

from vocc_torch.errors import VoccError
from vocc_torch.measure.curves import Measured
from vocc_torch.measure.plan import Experiment
from vocc_torch.simulation import Distribution
from vocc_torch.studies.paper.evidence import EVIDENCE

KNOWN = wanted_figures([])


def experiments(make_plan, *names):
    """Plans by experiment and row; dimming is a grid."""
    built = {}
    for name in names:
        plan = make_plan(experiment=Experiment(name, "distance_m", (50.0,)))
        rows = (0.0,)
        if name == "dimming":
            plan = make_plan(experiment=Experiment(name, "led_luminance_cd_m2", (500.0, 4000.0)))
            rows = (1000.0, 32000.0)
        built[name] = {row: plan for row in rows}
    return built


# Figures


def test_every_figure_is_known_and_in_the_papers_order():
    assert set(KNOWN) == {*EVIDENCE, *BER_FIGURES}
    numbers = [int(name[3:5]) for name in KNOWN if name.startswith("fig")]
    assert numbers == sorted(numbers) == [4, 5, 8, 9, 10, 12, 13, 17, 19, 20, 21, 22, 23, 24, 25]
    assert KNOWN[-1] == "dimming"


@given(st.lists(st.sampled_from(KNOWN)))
def test_chosen_figures_come_once_each_in_order(names):
    chosen = wanted_figures(names)
    assert set(chosen) == (set(names) or set(KNOWN))
    assert list(chosen) == [name for name in KNOWN if name in chosen]


def test_an_unknown_figure_is_refused_with_the_known_ones():
    with pytest.raises(VoccError) as refused:
        wanted_figures(["fig22", "fig99"])
    assert str(refused.value) == f"figures.names has 'fig99': known are {', '.join(KNOWN)}"


# Readings


@pytest.mark.parametrize(
    ("focal", "locators", "message"),
    [
        ((), ("paper",), "figures.focal_lengths_mm is []: it must hold at least one, each once"),
        ((25.0, 18.0, 25.0), ("paper",), "figures.focal_lengths_mm is [25.0, 18.0, 25.0]: it must hold"),
        ((25.0,), (), "figures.locators is []: it must hold at least one, each once"),
        ((25.0,), ("truth", "truth"), "figures.locators is ['truth', 'truth']: it must hold"),
        ((25.0,), ("paper", "gps"), "figures.locators has 'gps': it must be truth or paper"),
    ],
)
def test_lists_that_make_no_readings_are_refused(focal, locators, message):
    with pytest.raises(VoccError) as refused:
        PaperStudies(focal, locators, {})
    assert str(refused.value).startswith(message)
    assert "\n" not in str(refused.value)


# Studies


def test_studies_of_every_lens_and_the_grid_of_one(make_plan):
    studies = PaperStudies(
        (25.0, 18.0), ("paper", "truth"), experiments(make_plan, "ambient", "dimming")
    ).studies()
    assert [study.key for study in studies] == [
        "ambient-25mm",
        "dimming-25mm-1000",
        "dimming-25mm-32000",
        "ambient-18mm",
    ]
    assert [study.plan.world.camera.focal_length_mm for study in studies] == [25.0, 25.0, 25.0, 18.0]
    assert {study.locators for study in studies} == {("paper", "truth")}


def test_the_reports_own_lens_comes_first_and_has_the_grid(make_plan):
    studies = PaperStudies((18.0, 25.0), ("truth",), experiments(make_plan, "dimming", "distance")).studies()
    assert [study.key for study in studies] == [
        "dimming-18mm-1000",
        "dimming-18mm-32000",
        "distance-18mm",
        "distance-25mm",
    ]


def test_keys_are_names_of_files_and_never_the_same(make_plan):
    built = experiments(make_plan, "contrast", "ambient", "dimming")
    keys = [study.key for study in PaperStudies((25.0, 22.5, 18.0), ("paper",), built).studies()]
    assert len(set(keys)) == len(keys) == 8
    assert all(key.replace("-", "").replace(".", "").isalnum() for key in keys)


def test_no_experiment_no_study():
    assert PaperStudies((25.0,), ("paper",), {}).studies() == []


# Results


class Results(dict):
    """Whatever study is asked for, a result that carries the study's key."""

    def __missing__(self, key):
        return Measured({name: f"{key}/{name}" for name in ("paper", "truth")}, {})


@pytest.fixture
def campaign():
    return SimpleNamespace(measured=Results(), trainings={})


def test_results_are_sorted_by_lens_and_experiment(make_plan, campaign):
    built = experiments(make_plan, "ambient", "distance", "dimming")
    found = PaperStudies((25.0, 18.0), ("paper", "truth"), built).measured(campaign)
    names = {mm: {name: one.curves["paper"] for name, one in by.items()} for mm, by in found.items()}
    assert names == {
        25.0: {"ambient": "ambient-25mm/paper", "distance": "distance-25mm/paper"},
        18.0: {"ambient": "ambient-18mm/paper", "distance": "distance-18mm/paper"},
    }


def test_only_studies_that_were_laid_out_are_asked_for(make_plan):
    """A campaign without the grid of the other lenses is enough."""
    studies = PaperStudies((25.0, 18.0), ("truth",), experiments(make_plan, "ambient", "dimming"))
    keys = {study.key for study in studies.studies()}
    measured = {key: Measured({"truth": key}, {}) for key in keys}
    campaign = SimpleNamespace(measured=measured, trainings={})
    assert studies.measured(campaign)[18.0]["ambient"].curves["truth"] == "ambient-18mm"


def test_the_grid_is_put_together_by_row(make_plan, campaign, monkeypatch):
    monkeypatch.setattr("vocc_torch.studies.paper.studies.Grid", lambda *parts: parts)
    built = experiments(make_plan, "ambient", "dimming")
    grids = PaperStudies((25.0,), ("paper", "truth"), built).grids(campaign, "ambient_lx")
    assert grids == {
        name: (
            "ambient_lx",
            (1000.0, 32000.0),
            (f"dimming-25mm-1000/{name}", f"dimming-25mm-32000/{name}"),
        )
        for name in ("paper", "truth")
    }


def test_no_grid_where_it_was_not_measured(make_plan, campaign):
    studies = PaperStudies((25.0,), ("paper",), experiments(make_plan, "ambient"))
    assert studies.grids(campaign, "ambient_lx") == {}


def test_a_row_holds_one_value_and_has_draws_of_its_own():
    whole = Experiment(
        "dimming", "led_luminance_cd_m2", (500.0,), {"distance_m": Distribution("constant", (5.0,))}
    )
    rows = [whole.at_row("ambient_lx", value) for value in (1000.0, 2000.0)]
    assert len({row.name for row in rows}) == 2
    assert [row.scene["ambient_lx"].bounds for row in rows] == [(1000.0, 1000.0), (2000.0, 2000.0)]
    assert all(row.scene["distance_m"].bounds == (5.0, 5.0) for row in rows)
