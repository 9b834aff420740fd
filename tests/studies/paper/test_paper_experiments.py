"""What task=figures measures: which figures and readings, how results are sorted, what it refuses."""

from pathlib import Path

import pytest
from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra

from vocc_torch.app.config import register_schema
from vocc_torch.app.resolve import resolved
from vocc_torch.errors import VoccError
from vocc_torch.measure.build import build_plan
from vocc_torch.studies.paper.figures import FIGURES, PAPER_RECEIVERS, paper_plan


def plan_of(*overrides):
    """The plan of task=figures with some settings changed."""
    register_schema()
    words = ("task=figures", "device=cpu", *overrides)
    GlobalHydra.instance().clear()  # another module may have left its own
    with initialize_config_module("vocc_torch.conf", version_base="1.3"):
        settings = resolved(compose("config", list(words)), words)
    return paper_plan(settings.figures, build_plan(settings, Path("unused")))


MISTAKES = {
    "figures.names=[fig22,fig99]": f"figures.names has 'fig99': known are {', '.join(FIGURES)}",
    "figures.focal_lengths_mm=[25,18,25]": "figures.focal_lengths_mm is [25.0, 18.0, 25.0]: it must",
    "figures.focal_lengths_mm=[]": "figures.focal_lengths_mm is []: it must hold at least one, each once",
    "figures.locators=[]": "figures.locators is []: it must hold at least one, each once",
    "figures.locators=[truth,truth]": "figures.locators is ['truth', 'truth']: it must hold at least one",
    "figures.locators=[gps]": "figures.locators is 'gps': it must be truth or paper or refined",
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


ROWS = "figures.experiments.dimming.rows=[1000,32000]"


def test_studies_of_every_lens_and_the_grid_of_the_first():
    plan = plan_of("figures.names=[fig24,fig22,dimming,fig04]", "figures.focal_lengths_mm=[18,25,22.5]", ROWS)
    studies = plan.studies()
    assert plan.figures == ("fig04", "fig22", "fig24", "dimming")
    assert [int(name[3:5]) for name in FIGURES[:-1]] == [4, 5, 8, 9, 10, 12, 13, 17, *range(19, 26)]
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
