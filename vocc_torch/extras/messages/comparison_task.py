"""``task=messages``: how far messages carry, by receiver and code; a table and a picture."""

from collections.abc import Iterator, Sequence
from functools import reduce
from itertools import groupby
from operator import add
from pathlib import Path

from vocc_torch.errors import section
from vocc_torch.extras.messages.comparison import (
    Carried,
    SweepPoint,
    jobs_of,
    receivers_of,
    recorded,
    variants_of,
)
from vocc_torch.extras.messages.config import MessagesConfig
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import payload_bytes
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.measure import executors, timing
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.train import train
from vocc_torch.report import folder as run_folder
from vocc_torch.report import plots, terminal
from vocc_torch.report.styles import axis_label, rate_text, receiver_styles, value_text

COLUMNS = (
    "axis",
    "value",
    "receiver",
    "code",
    "recordings",
    "packets",
    "lost",
    "packet_error_rate",
    "packet_error_low",
    "packet_error_high",
    "false_packets",
    "raw_ber",
    "raw_ber_low",
    "raw_ber_high",
    "kbit_s",
    "kbit_s_low",
    "kbit_s_high",
    "best",
    "frames",
)
"""Columns of ``messages.csv``."""


def run_messages(settings: Settings, config: MessagesConfig, folder: Path) -> None:
    """Measure what arrives, and report it.

    Raises:
        VoccError: a value outside its range, or whatever a stage refuses.
    """
    console = terminal.Console()
    plan = build_plan(settings).locating_with("truth")
    # Refused, as a code that is not installed, before anything is trained.
    variants_of(plan, config)
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
    receivers = receivers_of(build_plan(settings), training)
    jobs = jobs_of(plan, config, receivers)
    results: list[Carried] = []
    pool = executors.Workers.of(settings)
    progress = terminal.ProgressView(len(jobs), console, "recordings")
    with progress as view, pool, timing.threads(1):
        found = zip(jobs, pool.map(recorded, jobs), strict=True)
        for place, same in groupby(found, key=lambda pair: pair[0].place):
            recordings = []
            for _, carried in same:
                recordings.append(carried)
                view.advance(f"{place.axis} {value_text(place.value)}", 1)
            results += [reduce(add, of) for of in zip(*recordings, strict=True)]
    run_folder.write_rows(folder / "messages.csv", [COLUMNS, *rows(results)])
    run_folder.write_config(settings, folder)
    plots.save_figure(figure_of(results), folder / "messages.png")
    run_folder.say(console, *summary(results))
    places = {"table": "messages.csv", "figure": "messages.png"}
    run_folder.print_places(console, folder, places.items())


def best(results: Sequence[Carried]) -> list[Carried]:
    """Give the results with the highest goodput of their place and receiver, if any."""
    groups: dict[tuple[SweepPoint, str], list[Carried]] = {}
    for result in results:
        groups.setdefault((result.place, result.variant.receiver), []).append(result)
    chosen = [
        max(same, key=lambda carry: carry.goodput.value) for same in groups.values()
    ]
    return [result for result in chosen if result.goodput.value > 0]


def cells(estimate: Estimate | None) -> list[str]:
    """Write a value and the ends of its interval."""
    if estimate is None:
        return ["", "", ""]
    return [f"{number:.4g}" for number in (estimate.value, estimate.low, estimate.high)]


def rows(results: Sequence[Carried]) -> Iterator[run_folder.Cells]:
    """Give the rows of ``messages.csv``."""
    chosen = best(results)
    for result in results:
        raw = ber_interval(result.raw) if result.raw.bits else None
        yield [
            result.place.axis,
            result.place.value,
            result.variant.receiver,
            result.variant.code,
            result.lost.frames,
            result.lost.bits,
            int(result.lost.bit_errors),
            *cells(result.loss),
            result.false,
            *cells(raw),
            *cells(result.goodput),
            int(result in chosen),
            result.frames,
        ]


def summary(results: Sequence[Carried]) -> Iterator[str]:
    """Say what arrives by the best code at each point."""
    for result in best(results):
        rate, place = result.goodput, result.place
        yield (
            f"{place.axis} {value_text(place.value)}: {rate.value:.2f} kbit/s ("
            f"{rate.low:.2f} to {rate.high:.2f})"
            f" by {' '.join(result.variant)}; raw bit error rate {rate_text(result.raw.ber)}"
        )
    if false := sum(result.false for result in results):
        yield f"{false} packets with a right checksum were never sent"


def figure_of(results: Sequence[Carried]) -> plots.Figure:
    """Draw the share of packets lost: a panel for each receiver and axis, a curve for each code."""
    styles = receiver_styles(result.variant.code for result in results)
    panels: dict[tuple[str, str], dict[str, list[Carried]]] = {}
    for result in results:
        codes = panels.setdefault((result.variant.receiver, result.place.axis), {})
        codes.setdefault(result.variant.code, []).append(result)
    drawn = []
    for (receiver, axis), codes in panels.items():
        curves = [
            plots.Curve(
                styles[code],
                [result.place.value for result in line],
                [result.loss for result in line],
            )
            for code, line in codes.items()
        ]
        label = axis_label(axis)
        drawn.append(
            plots.Panel(curves, receiver, label, "Packets lost", y_scale="linear")
        )
    count, packets = results[0].lost.frames, results[0].lost.bits
    return plots.curve_figure(
        drawn,
        "Packets lost",
        f"{count} recordings a point, {packets} packets; bars: 95 % intervals over recordings",
    )
