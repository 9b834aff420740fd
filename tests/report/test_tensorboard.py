"""The board, read back with TensorBoard's own reader."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hydra.types import RunMode
from made_up_points import made_up_point
from made_up_points import table as table
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar import layout_pb2
from tensorboard.plugins.hparams import plugin_data_pb2

from vocc_torch.measure.curve import BerTable
from vocc_torch.report import tensorboard
from vocc_torch.report.tensorboard import (
    OUTLIERS,
    SUMMARY_RUN,
    axis_steps,
    swept_keys,
    write_boards,
)

RECEIVERS = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
AXES = {
    "ambient_lx": (1000, 32000),
    "led_luminance_cd_m2": (500, 16000),
    "distance_m": (30, 70),
    "contrast": (0.06, 0.54),
}


def write_board(folder, table, *more, **named):
    write_boards(folder, {"": [table]}, *more, **named)


def read(folder, run):
    return EventAccumulator(
        str(folder / run), size_guidance={"scalars": 0, "images": 0, "tensors": 0}
    ).Reload()


def series(events, tag):
    return [(event.step, event.value) for event in events.Scalars(tag)]


def campaign(receivers=RECEIVERS):
    """Two groups, four tables each; every number of wrong frames is another, and one is 0."""
    tables, wrong = {}, 0
    for locator in ("paper", "truth"):
        group = tables.setdefault(f"25mm-{locator}", [])
        for axis, values in AXES.items():
            points = []
            for value in values:
                for receiver in receivers:
                    point = made_up_point(value, receiver, wrong, axis)
                    points.append(
                        replace(point, experiment=f"{axis} study", locator=locator)
                    )
                    wrong += 1
            group.append(BerTable(points))
    return tables


def start_of(events):
    content = events.SummaryMetadata("_hparams_/session_start_info").plugin_data.content
    return plugin_data_pb2.HParamsPluginData.FromString(content).session_start_info


def categories(events):
    tensor = events.Tensors("custom_scalars__config__")[0].tensor_proto
    return layout_pb2.Layout.FromString(tensor.string_val[0]).category


def test_each_receiver_is_a_run_with_the_curve_in_ascending_steps(tmp_path, table):
    write_board(tmp_path, table)
    assert {path.name for path in tmp_path.iterdir()} == {
        "flda_2",
        "flda_3",
        SUMMARY_RUN,
    }
    for receiver in table.receivers:
        events, rows = read(tmp_path, receiver), table.of(receiver)
        wrong = [row for row in rows if not row.error_free]
        clean = [row for row in rows if row.error_free]
        steps = axis_steps(table.axis, table.values)
        assert steps == {1000: 3000, 8000: 3903, 32000: 4505}
        expected = {
            "BER": [(row.value, row.ber) for row in rows],
            "log10_BER": [(row.value, np.log10(row.ber)) for row in wrong],
            "log10_BER_lo": [(row.value, np.log10(row.ber_low)) for row in wrong],
            "log10_BER_hi": [(row.value, np.log10(row.ber_high)) for row in wrong],
            "log10_BER_upper95": [(row.value, np.log10(row.ber_high)) for row in clean],
        }
        rates = [row.ber for row in rows]
        pooled = sum(row.bit_errors for row in rows) / sum(row.bits for row in rows)
        ends = (
            ("BER", pooled),
            ("lowest_BER", min(rates)),
            ("highest_BER", max(rates)),
        )
        for name, rate in ends:
            assert events.Scalars(f"all_points/{name}")[0].value == pytest.approx(rate)
        for name, points in expected.items():
            tag = f"{name}/ambient_lx"
            assert (tag in events.Tags()["scalars"]) == bool(points)
            if points:
                found = [
                    (step, value)
                    for step, value in series(events, tag)
                    if step in steps.values()
                ]
                placed = [(steps[value], rate) for value, rate in points]
                np.testing.assert_allclose(found, placed, rtol=1e-6)


def test_no_end_of_a_chart_is_taken_for_an_outlier(tmp_path):
    """By the rule of TensorBoard's charts: the 5 % and 95 % quantiles of all values."""
    names = ("flda_agr", "flda_gri", "flda_2", "average_greyscale")
    points = [
        made_up_point(value, name, 900)
        for name in names
        for value in range(1000, 33000, 1000)
    ]
    points += [
        made_up_point(2000, "flda_3", 1),
        made_up_point(3000, "center_greyscale", 1999),
    ]
    write_board(tmp_path, BerTable(points))
    values = [
        value
        for run in tmp_path.iterdir()
        if "log10_BER/ambient_lx"
        in (events := read(tmp_path, run.name)).Tags()["scalars"]
        for _, value in series(events, "log10_BER/ambient_lx")
    ]
    assert np.quantile(values, OUTLIERS) == min(values)
    assert np.quantile(values, 1 - OUTLIERS) == max(values)


def test_the_keys_of_a_sweep_are_hyperparameters(tmp_path, table, monkeypatch):
    overrides = SimpleNamespace(
        task=["task=test", "seed=3", "+scene.distance_m=50", "name=x"]
    )
    job = SimpleNamespace(mode=RunMode.MULTIRUN, overrides=overrides)
    monkeypatch.setattr(tensorboard.HydraConfig, "initialized", lambda: True)
    monkeypatch.setattr(tensorboard.HydraConfig, "get", lambda: job)
    write_board(tmp_path, table)
    hparams = start_of(read(tmp_path, "flda_3")).hparams
    assert (hparams["seed"].string_value, hparams["scene.distance_m"].string_value) == (
        "3",
        "50",
    )
    assert not {"name", "task"} & {*hparams}
    job.mode = RunMode.RUN
    assert swept_keys() == {}


def test_every_group_and_experiment_has_charts_of_its_own_curves_only(tmp_path):
    tables = campaign()
    write_boards(tmp_path, tables)
    tags = {
        tag
        for receiver in RECEIVERS
        for tag in read(tmp_path, receiver).Tags()["scalars"]
    }
    laid_out = categories(read(tmp_path, SUMMARY_RUN))
    sections = [
        (group, table_of_axis)
        for group, members in tables.items()
        for table_of_axis in members
    ]
    assert len(laid_out) == len(sections) == 8
    for category, (group, table_of_axis) in zip(laid_out, sections, strict=True):
        assert category.title.startswith(f"{group} {table_of_axis.experiment}: ")
        curves, intervals, *limits = category.chart
        # As TensorBoard matches: lines by regular expression, bands by name.
        (pattern,) = curves.multiline.tag
        assert [tag for tag in tags if re.match(pattern, tag)] == [
            f"{group}/log10_BER/{table_of_axis.axis}"
        ]
        band = intervals.margin.series[0]
        names = ("log10_BER", "log10_BER_lo", "log10_BER_hi")
        assert [band.value, band.lower, band.upper] == [
            f"{group}/{name}/{table_of_axis.axis}" for name in names
        ]
        assert {band.value, band.lower, band.upper} <= tags
        assert len(limits) == any(row.error_free for row in table_of_axis)
