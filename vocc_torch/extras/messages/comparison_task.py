"""``task=messages``: how far messages carry, by receiver and code; a table and a picture."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from vocc_torch.errors import VoccError, section
from vocc_torch.extras.messages.comparison import (
    Carried,
    Place,
    recorded,
)
from vocc_torch.extras.messages.config import AXES, MessagesConfig
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import payload_bytes
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.measure import executors, timing
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.train import calibrated_receiver, train
from vocc_torch.receiver.deciders import GREYSCALE_RECEIVERS
from vocc_torch.report import folder as run_folder
from vocc_torch.report import plots, terminal
from vocc_torch.report.styles import axis_label, receiver_styles, value_text
from vocc_torch.studies.compare.report import write_report

TOLD = {
    "axis": "",
    "value": "",
    "receiver": "receiver",
    "code": "code",
    "kbit_s": "kbit/s",
    "raw_ber": "raw BER",
    "false_packets": "false",
}
"""Columns of the terminal's table."""

Results = Mapping[Place, Carried]


def run_messages(settings: Settings, config: MessagesConfig, folder: Path) -> None:
    """Measure what arrives, and report it.

    Raises:
        VoccError: a value outside its range, or whatever a stage refuses.
    """
    console = terminal.Console()
    plan = build_plan(settings)
    finder, plan = plan.receiver.finder, plan.locating_with("truth")
    # Refused, as a code that is not installed, before anything is trained.
    for name in plan.receiver.names:
        if name in GREYSCALE_RECEIVERS:
            raise VoccError(
                f"receiver.names has {name}: it needs preambles, which messages do not send"
            )
    for code in config.codes:
        rate = f"messages.codes has {code}, whose code_rate"
        with (
            section("messages.signalling", "transmit"),
            section("messages.codes", "transmit.code"),
            section(rate, before="transmit.code_rate"),
        ):
            layout = Layout(MessagePlan(plan.world.panel.shape, config.options(code)))
            payload_bytes(layout.code.info_bytes)
    with console.status("training"):
        training = train(plan)
    run_folder.say(console, *terminal.trained_lines(training))
    receivers = {}
    for name in plan.receiver.names:
        named = replace(plan, receiver=replace(plan.receiver, save=name))
        receivers[name] = calibrated_receiver(named, training)
        receivers[name].locator = finder or receivers[name].locator
    jobs = [
        (axis, value, number)
        for axis in AXES
        for value in getattr(config, axis)
        for number in range(config.recordings)
    ]
    call = partial(recorded, plan, config, receivers)
    results: dict[Place, Carried] = {}
    pool = executors.Workers.of(settings)
    progress = terminal.ProgressView(len(jobs), console, "recordings")
    with progress as view, pool, timing.threads(1):
        for (axis, value, _), found in zip(jobs, pool.map(call, jobs), strict=True):
            for place, carried in found.items():
                before = results.get(place)
                results[place] = carried if before is None else before + carried
            view.advance(f"{axis} {value_text(value)}", 1)
    run_folder.write_config(settings, folder)
    rows = [row_of(place, results) for place in results]
    best = [row for row in rows if row["best"]] or rows[:1]
    terminal.print_rows(best, TOLD, "the code of most kbit/s of each point")
    write_report(settings, folder, {"messages": rows}, {"messages": figure_of(results)})


def row_of(place: Place, results: Results) -> terminal.TableRow:
    """Give a row of ``messages.csv``."""
    carried = results[place]
    loss, rate = carried.loss, carried.goodput
    goodputs = (
        other.goodput.value for at, other in results.items() if at[:3] == place[:3]
    )
    return {
        **place._asdict(),
        "recordings": carried.lost.frames,
        "packets": carried.lost.bits,
        "lost": carried.lost.bit_errors,
        "packet_error_rate": loss.value,
        "packet_error_low": loss.low,
        "packet_error_high": loss.high,
        "false_packets": carried.false,
        "raw_ber": ber_interval(carried.raw) if carried.raw.bits else terminal.BLANK,
        "kbit_s": rate,
        "best": int(rate.value == max(goodputs) > 0),
        "frames": carried.frames,
    }


def figure_of(results: Results) -> plots.Figure:
    """Draw the share of packets lost: a panel for each receiver and axis, a curve for each code."""
    styles = receiver_styles(place.code for place in results)
    drawn = []
    for receiver, axis in dict.fromkeys((at.receiver, at.axis) for at in results):
        curves = []
        for code, style in styles.items():
            line = {
                at.value: carried.loss
                for at, carried in results.items()
                if (at.axis, *at[2:]) == (axis, receiver, code)
            }
            curves.append(plots.Curve(style, [*line], [*line.values()]))
        label = axis_label(axis)
        drawn.append(
            plots.Panel(curves, receiver, label, "Packets lost", y_scale="linear")
        )
    lost = next(iter(results.values())).lost
    return plots.curve_figure(
        drawn,
        "Packets lost",
        f"{lost.frames} recordings a point, {lost.bits} packets; bars: 95 % intervals over recordings",
    )
