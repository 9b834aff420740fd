"""task=tradeoff at a tiny budget: what it writes, what the words rest on, and what it refuses."""

import pytest
from paper_runs import files_in, rows_of, run_in, white
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from vocc_torch.studies.tradeoff import plan as plan_module
from vocc_torch.studies.tradeoff import run as task_module

SMALL = (
    *("camera.width_px=480", "camera.height_px=272", "camera.sensor_width_mm=3.3"),
    *("scene.offset_x_m=0", "scene.offset_y_m=0", "scene.distance_m=[uniform,50,70]"),
)
"""The middle of the paper's sensor: whole frames are a sixteenth of the work."""
TINY = (
    *SMALL,
    *("budget.frames=8", "budget.training_frames=16", "tradeoff.repeats=1"),
    *("tradeoff.batch_sizes=[1,24]", "tradeoff.genie_frames=2", "batch_frames=16", "device=cpu"),
)
CHOSEN = (
    *("classifier=[mlp_features,panel_otsu]", "classifiers.mlp_features.training.frames=64"),
    *("classifiers.mlp_features.training.epochs=1", "receiver.names=[average_greyscale,flda_3]"),
    *("tradeoff.varied=[flda_3]", "tradeoff.samples_per_led=[8,4]", "tradeoff.locators=[paper,truth]"),
    "tradeoff.devices=[cpu,cuda:7]",
)
BASE = ("task=tradeoff", *TINY, *CHOSEN)
SETTING = ("receiver", "locator", "samples_per_led", "gradient", "dtype")
RECEIVERS = ("average_greyscale", "flda_3", "mlp_features", "panel_otsu")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder for the runs of these tests."""
    return tmp_path_factory.mktemp("tradeoff")


@pytest.fixture(scope="module", autouse=True)
def hasty():
    """Few timed rounds, and files of pictures that are one white pixel: those of the board are drawn."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan_module, "LEAST_FRAMES", 4)
        patch.setattr(task_module, "save_figure", white)
        yield


@pytest.fixture(scope="module")
def whole(place):
    """Four receivers in this process, with a board."""
    ran = run_in(place, *BASE, "name=whole", "workers=1")
    assert (ran.status, ran.err) == (0, "")
    return place / "runs" / "whole", ran.out


def test_everything_is_written(whole):
    folder, out = whole
    written = {name for name in files_in(folder) if not name.startswith("tensorboard/")}
    pictures = {"tradeoff.png", "tradeoff-crops-mixture.png"}
    pictures |= {f"tradeoff-{frames}-far_and_dim.png" for frames in ("whole", "crops")}
    texts = {"config.yaml", "tradeoff.csv", "recommendation.txt"}
    assert written == texts | pictures
    for name in pictures:
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    for name in ("tradeoff.png", "tradeoff.csv", "recommendation.txt"):
        assert str(folder / name) in out
    for told in (
        *RECEIVERS,
        "Compared: 4 receivers with 2 ways to find the panel, 14 settings in all",
        "on the frontier",
        "Under 1.00",
        "For a BER below",
        "whole frames, 480 x 272 px",
        "knows the scene",
        "Not measured on cuda:7: this machine has",
    ):
        assert told in out


def measured(folder):
    """Lines of the table with numbers."""
    return [row for row in rows_of(folder / "tradeoff.csv") if row["machine"] != "not measured"]


def test_the_table_has_every_configuration_everywhere(whole):
    every = rows_of(whole[0] / "tradeoff.csv")
    rows = measured(whole[0])
    absent = [row for row in every if row not in rows]
    assert {row["device"] for row in absent} == {"cuda:7"}
    assert len(absent) == len(rows)
    at = {(row["frames"], row["batch"], row["device"]) for row in rows}
    assert at == {(frames, batch, "cpu") for frames in ("whole", "crops") for batch in ("1", "24")}
    settings = {tuple(row[name] for name in SETTING) for row in rows}
    base = {(name, where, "8", "sobel", "float32") for name in RECEIVERS for where in ("paper", "truth")}
    varied = {
        ("flda_3", where, *values)
        for where in ("paper", "truth")
        for values in (("4", "sobel", "float32"), ("8", "central", "float32"), ("8", "sobel", "float64"))
    }
    assert settings == base | varied
    assert len(rows) == 4 * len(settings)
    for row in rows:
        assert float(row["total_ms"]) > 0
        assert (row["locate_ms"] == "0") == (row["locator"] == "truth")
        assert row["mixture_test_frames"] == row["far_and_dim_test_frames"] == "8"
        assert (float(row["preambles_ms"]) > 0) == (row["receiver"] == "average_greyscale")
        assert row["mixture_possible_test_frames"] == "2"
        assert float(row["mixture_possible_ber"]) <= float(row["mixture_possible_ber_high"]) < 1


def test_the_words_are_the_tables(whole):
    folder, _ = whole
    words = " ".join((folder / "recommendation.txt").read_text().split())
    rows = [row for row in measured(folder) if row["frames"] == "whole" and row["best_batch"] == "1"]
    within = [row for row in rows if float(row["total_high_ms"]) <= 1e3 / 30]
    assert within, "no receiver of small frames takes 33 ms"
    best = min(within, key=lambda row: (float(row["mixture_ber"]), float(row["total_ms"])))
    assert f"take {best['receiver']}" in words
    assert "8 frames of each kind of scenes" in words


def test_the_board_has_pictures_and_rows_of_the_hparams_tab(whole):
    board = whole[0] / "tensorboard"
    summary = EventAccumulator(str(board / "_summary")).Reload()
    pictures = summary.Tags()["images"]
    assert len(pictures) == 4
    (main,) = (tag for tag in pictures if tag.rpartition("/")[2] == "tradeoff")
    (image,) = summary.Images(main)
    assert (image.width, image.height) == (1488, 1008)
    own = EventAccumulator(str(board / "flda_3-truth-K4-sobel-float32")).Reload()
    assert {"_hparams_/experiment", "_hparams_/session_start_info"} & set(own.summary_metadata)
    (row,) = (
        row
        for row in measured(whole[0])
        if tuple(row[name] for name in SETTING) == ("flda_3", "truth", "4", "sobel", "float32")
        and (row["frames"], row["best_batch"]) == ("whole", "1")
    )
    numbers = {tag: own.Scalars(tag)[0].value for tag in own.Tags()["scalars"]}
    assert numbers["ber/mixture"] == pytest.approx(float(row["mixture_ber"]), rel=1e-4)
    assert numbers["ms/whole"] == pytest.approx(float(row["total_ms"]), rel=1e-4)


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("tradeoff.devices=[tpu]", "tradeoff.devices has 'tpu': it must be auto, cpu or cuda"),
        ("tradeoff.devices=[cuda:7]", "tradeoff.devices has 'cuda:7', and this machine has"),
        ("device=cuda:7", "device is 'cuda:7', and this machine has"),
        ("+tradeoff.scenes.odd={distance: 5}", "tradeoff.scenes.odd.distance is not a value of a scene"),
        ("+tradeoff.scenes.odd=5", "tradeoff.scenes.odd is 5: it must be"),
        ("tradeoff.simulation.frames=0", "tradeoff.simulation is not a known key"),
        ("tradeoff.repeat=3", "tradeoff.repeat is not a known key: did you mean tradeoff.repeats?"),
        ("budget.precision=0.1", "budget.precision is 0.1: it must be null for task=tradeoff"),
        ("input=a.png", "input is 'a.png': it must be null for task=tradeoff"),
    ],
)
def test_mistakes_are_told_in_one_line(place, word, said):
    ran = run_in(place, *BASE, "name=refused", "workers=1", word)
    assert ran.complaint.startswith(said)
    assert not (place / "runs" / "refused").exists()


def test_a_folder_with_results_is_refused(place, whole):
    ran = run_in(place, *BASE, "name=whole", "workers=1")
    assert ran.complaint.startswith(f"name: {whole[0]} already holds")
