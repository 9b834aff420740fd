"""task=tradeoff at a tiny budget: what it writes, what the words rest on, and what it refuses."""

import pytest
from paper_runs import files_in, rows_of, run_in, white

from vocc_torch.studies.tradeoff import plan as plan_module

SMALL = (
    *("camera.width_px=480", "camera.height_px=272", "camera.sensor_width_mm=3.3"),
    *("scene.offset_x_m=0", "scene.offset_y_m=0", "scene.distance_m=[uniform,50,70]"),
)
"""The middle of the paper's sensor: whole frames are a sixteenth of the work."""
TINY = (
    *SMALL,
    *("budget.frames=8", "budget.training_frames=16", "tradeoff.repeats=1"),
    *(
        "tradeoff.batch_sizes=[8,24]",
        "tradeoff.genie_frames=2",
        "batch_frames=16",
        "device=cpu",
    ),
)
CHOSEN = (
    *(
        "classifier=panel_otsu",
        "receiver.names=[average_greyscale,flda_3]",
        "~tradeoff.scenes.far_and_dim",
    ),
    *(
        "tradeoff.varied=[flda_3]",
        "tradeoff.samples_per_led=[8,4]",
        "tradeoff.locators=[paper,truth]",
    ),
    "tradeoff.devices=[cpu,cuda:7]",
)
BASE = ("task=tradeoff", *TINY, *CHOSEN)
SETTING = ("receiver", "locator", "samples_per_led", "gradient", "dtype")
RECEIVERS = ("average_greyscale", "flda_3", "panel_otsu")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Three receivers in this process, with a board, but few timed rounds and no pictures in files."""
    place = tmp_path_factory.mktemp("tradeoff")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan_module, "LEAST_FRAMES", 4)
        patch.setattr("vocc_torch.report.canvas.save_figure", white)
        ran = run_in(place, *BASE, "name=whole", "workers=1")
    assert (ran.status, ran.err) == (0, "")
    return place / "runs" / "whole", ran.out


def test_everything_is_written(whole):
    folder, out = whole
    written = {name for name in files_in(folder) if not name.startswith("tensorboard/")}
    pictures = {"tradeoff.png", "tradeoff-crops-mixture.png"}
    texts = {"config.yaml", "ledger.sqlite", "tradeoff.csv", "recommendation.txt"}
    assert written == texts | pictures
    for name in pictures:
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    for name in ("tradeoff.png", "tradeoff.csv", "recommendation.txt"):
        assert str(folder / name) in out
    for told in (
        *RECEIVERS,
        "Compared: 3 receivers with 2 ways to find the panel, 12 settings in all",
        "on the frontier",
        "Under 1.00",
        "For a BER below",
        "whole frames, 480 x 272 px",
        "knows the scene",
        "Not measured on cuda:7: this machine has",
    ):
        assert told in out


def test_the_table_has_every_configuration_everywhere(whole):
    every = rows_of(whole[0] / "tradeoff.csv")
    rows = [row for row in every if row["machine"] != "not measured"]
    absent = [row for row in every if row not in rows]
    assert {row["device"] for row in absent} == {"cuda:7"}
    at = {(row["frames"], row["batch"], row["device"]) for row in rows}
    assert at == {
        (frames, batch, "cpu") for frames in ("whole", "crops") for batch in ("8", "24")
    }
    base = [(name, "8", "sobel", "float32") for name in RECEIVERS]
    base += [("flda_3", "4", "sobel", "float32"), ("flda_3", "8", "central", "float32")]
    base += [("flda_3", "8", "sobel", "float64")]
    settings = {tuple(row[name] for name in SETTING) for row in rows}
    assert settings == {
        (name, where, *more) for name, *more in base for where in ("paper", "truth")
    }
    assert len(rows) == len(absent) == 4 * len(settings)
    for row in rows:
        assert float(row["total_ms"]) > 0
        assert (row["locate_ms"] == "0") == (row["locator"] == "truth")
        assert row["mixture_test_frames"] == "8"
        assert (float(row["preambles_ms"]) > 0) == (
            row["receiver"] == "average_greyscale"
        )
        assert row["mixture_possible_test_frames"] == "2"
        assert (
            float(row["mixture_possible_ber"])
            <= float(row["mixture_possible_ber_high"])
            < 1
        )
