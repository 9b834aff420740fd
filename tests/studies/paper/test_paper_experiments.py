"""What task=figures measures: which figures and readings, how results are sorted, what it refuses."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from hydra import compose, initialize_config_module
from hypothesis import given
from hypothesis import strategies as st

from vocc_torch.app.config import register_schema
from vocc_torch.app.resolve import resolved
from vocc_torch.errors import VoccError
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.curve import Measured
from vocc_torch.studies.paper.experiments import FIGURES, paper_plan, wanted_figures
from vocc_torch.studies.paper.figures import PAPER_RECEIVERS


def plan_of(*overrides):
    """The plan of task=figures with some settings changed."""
    register_schema()
    words = ("task=figures", "device=cpu", *overrides)
    with initialize_config_module("vocc_torch.conf", version_base="1.3"):
        settings = resolved(compose("config", list(words)), words)
    return paper_plan(settings.figures, build_plan(settings, Path("unused")))


def test_every_figure_is_known_and_in_the_papers_order():
    numbers = [int(name[3:5]) for name in FIGURES if name.startswith("fig")]
    assert numbers == [4, 5, 8, 9, 10, 12, 13, 17, 19, 20, 21, 22, 23, 24, 25]
    assert FIGURES[-1] == "dimming"


@given(st.lists(st.sampled_from(FIGURES)))
def test_chosen_figures_come_once_each_in_order(names):
    chosen = wanted_figures(names)
    assert set(chosen) == (set(names) or set(FIGURES))
    assert list(chosen) == [name for name in FIGURES if name in chosen]


MISTAKES = {
    "figures.names=[fig22,fig99]": f"figures.names has 'fig99': known are {', '.join(FIGURES)}",
    "figures.focal_lengths_mm=[25,18,25]": "figures.focal_lengths_mm is [25.0, 18.0, 25.0]: it must",
    "figures.focal_lengths_mm=[]": "figures.focal_lengths_mm is []: it must hold at least one, each once",
    "figures.locators=[]": "figures.locators is []: it must hold at least one, each once",
    "figures.locators=[truth,truth]": "figures.locators is ['truth', 'truth']: it must hold at least one",
    "figures.locators=[gps]": "figures.locators has 'gps': it must be truth or paper or refined",
    "figures.experiments.dimming.rows=[2000,1000]": "figures.experiments.dimming.rows is [2000.0, 1000.0]:",
    "receiver.names=[flda_agr]": "receiver.names is ['flda_agr']: figures of bit error rates need one of "
    f"{', '.join(PAPER_RECEIVERS)}",
    "budget.target_frame_errors=3": "budget.precision is 0.1 and budget.target_frame_errors is 3",
}


@pytest.mark.parametrize(("change", "complaint"), MISTAKES.items(), ids=MISTAKES)
def test_mistakes_are_refused_in_one_line_by_their_key(change, complaint):
    more = ("receiver.save=flda_agr",) if change.startswith("receiver") else ()
    more += ("budget.precision=0.1",) if change.startswith("budget") else ()
    with pytest.raises(VoccError) as refused:
        plan_of(change, *more)
    assert str(refused.value).startswith(complaint)
    assert "\n" not in str(refused.value)


def test_a_lens_of_no_length_is_refused():
    with pytest.raises(VoccError, match=r"camera\.focal_length_mm is 0"):
        plan_of("figures.focal_lengths_mm=[0]").studies()


ROWS = "figures.experiments.dimming.rows=[1000,32000]"


def test_studies_of_every_lens_and_the_grid_of_the_first():
    plan = plan_of("figures.names=[fig24,fig22,dimming,fig04]", "figures.focal_lengths_mm=[18,25,22.5]", ROWS)
    studies = plan.studies()
    assert plan.figures == ("fig04", "fig22", "fig24", "dimming")
    assert plan.own == (18.0, "paper")
    assert [study.key for study in studies] == [
        *("ambient-18mm", "distance-18mm", "dimming-18mm-1000", "dimming-18mm-32000"),
        *("ambient-25mm", "distance-25mm", "ambient-22.5mm", "distance-22.5mm"),
    ]
    focal_mm = [study.plan.world.camera.focal_length_mm for study in studies]
    assert focal_mm == [18.0] * 4 + [25.0] * 2 + [22.5] * 2
    assert {study.locators for study in studies} == {("paper", "truth")}
    assert (
        plan_of("figures.names=[fig04]", "receiver.names=[flda_agr]", "receiver.save=flda_agr").studies()
        == []
    )


def test_results_are_sorted_by_lens_and_experiment(monkeypatch):
    """A campaign of the studies that were laid out is enough."""
    monkeypatch.setattr("vocc_torch.studies.paper.experiments.Grid", lambda *parts: parts)
    plan = plan_of("figures.names=[fig22,dimming]", "figures.focal_lengths_mm=[25,18]", ROWS)
    names = ("paper", "truth")
    campaign = SimpleNamespace(
        measured={s.key: Measured({name: f"{s.key}/{name}" for name in names}, {}) for s in plan.studies()}
    )
    found = {
        mm: {name: one.curves["paper"] for name, one in by.items()}
        for mm, by in plan.measured(campaign).items()
    }
    assert found == {25.0: {"ambient": "ambient-25mm/paper"}, 18.0: {"ambient": "ambient-18mm/paper"}}
    assert plan.grids(campaign) == {
        name: ("ambient_lx", (1000.0, 32000.0), tuple(f"dimming-25mm-{row}/{name}" for row in (1000, 32000)))
        for name in names
    }
    assert plan_of("figures.names=[fig22]").grids(campaign) == {}
