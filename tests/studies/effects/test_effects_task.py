"""task=effects at a tiny budget: what it writes is what was measured, and what it refuses."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra

from vocc_torch.app.config import register_schema
from vocc_torch.app.resolve import resolved
from vocc_torch.errors import VoccError
from vocc_torch.measure.executors import Workers
from vocc_torch.plugins import PlugIn
from vocc_torch.studies.effects import figures, run
from vocc_torch.studies.effects.measured import measure_costs, run_effects
from vocc_torch.studies.effects.plan import build_effect_study
from vocc_torch.studies.effects.results import READINGS

STREAK = f"{Path(__file__).parents[3]}/examples/effects/streak.py:Streak"
Far = type(
    "Far",
    (PlugIn("streak", "streak", STREAK).found(),),
    {"__call__": lambda self, value, _: value * 1},
)
TINY = (
    *("camera.width_px=480", "camera.height_px=272", "camera.sensor_width_mm=3.3"),
    *(
        "scene.offset_x_m=0",
        "scene.offset_y_m=0",
        "budget.frames=24",
        "budget.training_frames=24",
    ),
    *("effects.repeats=1", "effects.located_frames=2", "effects.severity_frames=8"),
    *(
        "effects.names=[defocus,shot_noise,blooming]",
        "effects.severity.blooming.values=[1.0,3.0]",
    ),
    *(
        "effects.severity.shot_noise.values=[0.6,0.006]",
        "receiver.names=[center_greyscale,flda_3]",
    ),
)


def study_of(*overrides):
    register_schema()
    GlobalHydra.instance().clear()  # another module may have left its own
    with initialize_config_module("vocc_torch.conf", version_base="1.3"):
        settings = resolved(compose("config", ["task=effects", *overrides]))
    return build_effect_study(settings, settings.effects, Path("runs"))


@pytest.fixture(scope="module")
def results():
    study = study_of(*TINY)
    with Workers(1) as workers:
        return run_effects(study, measure_costs(study), workers)


def read(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_every_number_is_in_the_file(results, tmp_path):
    run.write_effects(tmp_path / "effects.csv", results)
    rows = read(tmp_path / "effects.csv")
    assert tuple(rows[0]) == run.COLUMNS
    assert [row["row"] for row in rows] == ["scene"] * 2 + ["effect"] * 6 + [
        "sum"
    ] * 2 + ["together"] * 2
    given = {
        (row.pair.name, name): row
        for row in results.every_row
        for name in ("center_greyscale", "flda_3")
    }
    for row in rows:
        if row["row"] not in ("effect", "together"):
            continue
        one = given.pop((row["effect"], row["receiver"]))
        assert row["differs_in"].split(" + ") == list(one.pair.own)
        assert float(row["near_ms"]) == pytest.approx(
            np.median(one.costs["near"]), abs=1e-4
        )
        for reading in READINGS:
            found = one.changes[reading, row["receiver"]]
            assert float(row[f"{reading}_change"]) == found.estimate.value
            assert float(row[f"{reading}_low"]) == found.estimate.low
            difference = float(row[f"{reading}_ber_with"]) - float(
                row[f"{reading}_ber_without"]
            )
            assert difference == pytest.approx(found.estimate.value)
    assert not given
    base = float(rows[1]["true_corners_ber_with"])
    assert base == results.base["truth", "flda_3"].ber
    assert rows[0]["retrained_ber_with"] == ""


def test_pictures_draw_what_was_measured(results):
    axes = figures.effects_figure(results).axes
    defocus = results.rows[0].changes["true_corners", "flda_3"].estimate
    ends = [tuple(line.get_xdata()) for line in axes[1].lines]
    assert (defocus.low, defocus.high) in ends
    assert len(axes) == 3
    names = ["defocus", "blooming", "shot_noise"]
    assert [
        one.get_title("left") for one in figures.severity_figure(results).axes
    ] == names
    pictures = figures.gallery_figure(results.study)
    pictures.canvas.draw()
    assert [one.get_title() for one in pictures.axes] == ["the scene itself", *names]


def test_effects_from_outside_are_priced_and_shown_in_their_places():
    """One in crops and one that is rendered whole, among ours; the first over its severity."""
    streak = f"{{_target_: {STREAK}, share: 0.2, half_px: 9}}"
    study = study_of(
        *TINY,
        "effects.names=[blooming,smear,far]",
        f"+effects.parts.smear={{smear: {streak}}}",
        f"+effects.parts.far={{far: {{_target_: {__name__}.Far, share: 0.1, after: motion_blur}}}}",
        "+effects.severity.smear={parameter: smear.share, values: [0.1, 0.9]}",
    )
    with Workers(1) as workers:
        results = run_effects(study, measure_costs(study), workers)
    rows = [(row.label, row.group, row.fills_sensor) for row in results.rows]
    assert rows == [
        ("far", "optics", True),
        ("blooming", "optics", False),
        ("smear", "optics", False),
    ]
    assert results.together.pair.own == ("far", "smear")
    assert "half_px=9" in results.rows[2].settings
    mild, harsh = (
        results.severities["smear"][at, "true_corners", "flda_3"] for at in (0.1, 0.9)
    )
    assert mild.bit_errors < harsh.bit_errors
    pictures = figures.gallery_pictures(study)
    assert not np.array_equal(pictures["smear"], pictures["the scene itself"])
    assert "| `smear` | optics | " in run.report(results)


MISTAKES = {
    "+effects.parts.mine={mine: {_target_: no.py:Mine}}": "effects.parts.mine.mine: file no.py cannot be",
    "+effects.severity.mine={values: [1]}": "effects.severity.mine is {'values': [1]}: it must be a mapping",
    "+effects.parts.mine={mine: {share: 1}}": "effects.parts has 'mine'",
    "effects.parts.jpeg=3": "effects.parts.jpeg is 3: it must be a mapping of effects",
    "effects.parts.jpeg.jpeg=3": "effects.parts.jpeg.jpeg is 3",
    "effects.parts.jpeg.jpeg=null": "effects.parts.jpeg.jpeg is null",
    "effects.severity.jpeg.values=[90,0]": "effects.severity.jpeg.values has 0",
}


@pytest.mark.parametrize(
    ("override", "complaint"), MISTAKES.items(), ids=MISTAKES.keys()
)
def test_mistakes_are_named(override, complaint):
    with pytest.raises(VoccError) as refused:
        study_of(override)
    assert str(refused.value).startswith(complaint)
    assert "\n" not in str(refused.value)
