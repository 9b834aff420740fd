"""The board, read back with TensorBoard's own reader."""

import io

import numpy as np
import pytest
from made_up_points import made_up_point
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar import layout_pb2
from tensorboard.plugins.hparams import plugin_data_pb2

from vocc_torch.errors import VoccError
from vocc_torch.evaluation.curve import BerTable
from vocc_torch.reporting.canvas import figure_pixels
from vocc_torch.reporting.plots import ber_figure
from vocc_torch.reporting.tensorboard import SUMMARY_RUN, axis_steps, board_hint, write_board


def read(folder, run):
    return EventAccumulator(
        str(folder / run), size_guidance={"scalars": 0, "images": 0, "tensors": 0}
    ).Reload()


def series(events, tag):
    return [(event.step, event.value) for event in events.Scalars(tag)]


def test_each_receiver_is_a_run_with_the_curve_in_ascending_steps(tmp_path, table):
    write_board(tmp_path, table)
    assert {path.name for path in tmp_path.iterdir()} == {"flda_2", "flda_3", SUMMARY_RUN}
    for receiver in table.receivers:
        events, rows = read(tmp_path, receiver), table.of(receiver)
        wrong = [row for row in rows if not row.error_free]
        clean = [row for row in rows if row.error_free]
        wanted = {
            "BER": [(row.value, row.ber) for row in rows],
            "log10_BER": [(row.value, np.log10(row.ber)) for row in wrong],
            "log10_BER_lo": [(row.value, np.log10(row.ber_low)) for row in wrong],
            "log10_BER_hi": [(row.value, np.log10(row.ber_high)) for row in wrong],
            "log10_BER_upper95": [(row.value, np.log10(row.ber_high)) for row in clean],
        }
        for name, points in wanted.items():
            tag = f"{name}/ambient_lx"
            assert (tag in events.Tags()["scalars"]) == bool(points)
            if points:
                np.testing.assert_allclose(series(events, tag), points, rtol=1e-6)


def test_each_receiver_is_one_hparams_row(tmp_path, table):
    write_board(tmp_path, table)
    for receiver in table.receivers:
        events = read(tmp_path, receiver)
        metadata = events.SummaryMetadata("_hparams_/session_start_info")
        start = plugin_data_pb2.HParamsPluginData.FromString(metadata.plugin_data.content).session_start_info
        assert start.hparams["receiver"].string_value == receiver
        assert start.hparams["locator"].string_value == "truth"
        rows = table.of(receiver)
        pooled = sum(row.bit_errors for row in rows) / sum(row.bits for row in rows)
        assert events.Scalars("all_points/BER")[0].value == pytest.approx(pooled)


def test_the_summary_run_lays_the_charts_out(tmp_path, table):
    write_board(tmp_path, table)
    events = read(tmp_path, SUMMARY_RUN)
    tensor = events.Tensors("custom_scalars__config__")[0].tensor_proto
    (category,) = layout_pb2.Layout.FromString(tensor.string_val[0]).category
    curves, intervals, limits = category.chart
    assert "sun" in category.title
    assert list(curves.multiline.tag) == ["^log10_BER/ambient_lx$"]
    margin = intervals.margin.series[0]
    tags = ("log10_BER/ambient_lx", "log10_BER_lo/ambient_lx", "log10_BER_hi/ambient_lx")
    assert (margin.value, margin.lower, margin.upper) == tags
    assert list(limits.multiline.tag) == ["^log10_BER_upper95/ambient_lx$"]


def test_figures_pictures_and_texts_arrive_as_they_were(tmp_path, table):
    figure = ber_figure(table, "Ambient light (lx)", "Sun")
    picture = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    write_board(tmp_path, table, {"ber": figure}, {"frame": picture}, {"config": "seed: 0"})
    events = read(tmp_path, SUMMARY_RUN)
    for tag, pixels in (("figures/ber", figure_pixels(figure)), ("images/frame", picture)):
        encoded = events.Images(tag)[0].encoded_image_string
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(encoded)).convert("RGB")), pixels)
    text = events.Tensors("config/text_summary")[0].tensor_proto.string_val[0]
    assert text.decode() == "seed: 0"


def test_writing_again_replaces_the_curve_and_leaves_other_files(tmp_path, table):
    write_board(tmp_path, BerTable([made_up_point(500, "flda_3", 9), made_up_point(99000, "flda_3", 9)]))
    (tmp_path / "flda_3" / "notes.txt").write_text("mine")
    write_board(tmp_path, table)
    steps = [step for step, _ in series(read(tmp_path, "flda_3"), "BER/ambient_lx")]
    assert steps == [1000, 8000, 32000]
    assert (tmp_path / "flda_3" / "notes.txt").read_text() == "mine"


def test_steps_are_whole_in_the_axis_own_unit():
    assert axis_steps("distance_m", [70.0, 30.0]) == {30.0: 300, 70.0: 700}
    assert axis_steps("contrast", [0.06, 0.115]) == {0.06: 60, 0.115: 115}
    assert axis_steps("led_luminance_cd_m2", [500.0]) == {500.0: 500}


def test_values_that_would_hide_each_other_are_refused(tmp_path):
    table = BerTable([made_up_point(value, "flda_3", 9) for value in (1.1, 5, 0.9)])
    with pytest.raises(VoccError, match=r"^ambient_lx is 0.9 and 1.1: .* both give 1$"):
        write_board(tmp_path, table)


@pytest.mark.parametrize("picture", [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 3), np.float32)])
def test_a_picture_of_another_kind_is_refused(tmp_path, table, picture):
    with pytest.raises(VoccError, match=r"^images\['frame'\] is "):
        write_board(tmp_path, table, images={"frame": picture})


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path, table):
    (tmp_path / "file").write_text("")
    with pytest.raises(VoccError, match=r"^cannot write "):
        write_board(tmp_path / "file", table)


def test_the_hint_quotes_the_folder_and_turns_smoothing_off():
    command, link = board_hint("my runs/board").splitlines()
    assert command == "tensorboard --logdir 'my runs/board'"
    assert link == "http://127.0.0.1:6006/?smoothing=0#custom_scalars&_smoothingWeight=0"
