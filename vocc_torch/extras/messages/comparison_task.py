"""``task=messages``: how far messages carry, by receiver and code; tables and pictures."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby, takewhile
from pathlib import Path

from vocc_torch.errors import section
from vocc_torch.extras.messages.codes import code_of
from vocc_torch.extras.messages.comparison import (
    Carried,
    SweepPoint,
    carried,
    jobs_of,
    pairs,
    receivers_of,
    recorded,
    variants_of,
)
from vocc_torch.extras.messages.config import MessagesConfig
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.measure import executors, timing
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import paired_interval, sign_test
from vocc_torch.report import folder as run_folder
from vocc_torch.report import plots, terminal
from vocc_torch.report.styles import axis_label, rate_text, receiver_styles, value_text

COLUMNS = (
    *(
        "axis",
        "value",
        "receiver",
        "soft",
        "interleave",
        "code",
        "recordings",
        "packets",
        "lost",
    ),
    *("packet_error_rate", "packet_error_low", "packet_error_high", "false_packets"),
    *(
        "raw_ber",
        "raw_ber_low",
        "raw_ber_high",
        "kbit_s",
        "kbit_s_low",
        "kbit_s_high",
        "best",
        "frames",
    ),
)
"""Columns of ``messages.csv``."""

PAIRED_COLUMNS = (
    *(
        "axis",
        "value",
        "a",
        "b",
        "recordings",
        "packets",
        "difference",
        "difference_low",
        "difference_high",
    ),
    *("real", "a_worse", "b_worse", "sign_test_p"),
)
"""Columns of ``messages_paired.csv``: the packet error rate of a less that of b on the same recordings."""

MOST_LOST = 0.1
"""A message is said to carry as far as no more than this share of packets is lost, there and nearer."""


def run_messages(settings: Settings, config: MessagesConfig, folder: Path) -> None:
    """Measure what arrives, and report it.

    Raises:
        VoccError: a value outside its range, or whatever a stage refuses.
    """
    run_folder.refuse_results(folder)
    plan, console = (
        build_plan(settings, folder).locating_with("truth"),
        terminal.Console(),
    )
    # Refused, as a code that is not installed, before anything is trained.
    variants_of(plan, config)
    for code in config.codes:
        rate = section(
            f"messages.codes has {code}, whose code_rate", before="transmit.code_rate"
        )
        with (
            section("messages.signalling", "transmit"),
            section("messages.codes", "transmit.code"),
            rate,
        ):
            code_of(Layout(MessagePlan(plan.world.panel.shape, config.options(code))))
    receivers = receivers_of(
        build_plan(settings, folder), terminal.train_shown(plan, console)
    )
    jobs = jobs_of(plan, config, receivers)
    results: list[Carried] = []
    pool = executors.Workers.of(settings)
    with (
        terminal.ProgressView(len(jobs), console, "recordings") as view,
        pool,
        timing.threads(1),
    ):
        # Handed out as they are wanted: in this process a call is made at once.
        calls = ((job.place, pool.submit(recorded, job)) for job in jobs)
        ahead = iter(calls) if pool.count == 1 else iter([*calls])
        for place, same in groupby(ahead, key=lambda one: one[0]):
            outcomes = []
            for _, call in same:
                outcomes.append(call.result())
                view.advance(f"{place.axis} {value_text(place.value)}", 1)
            results += carried(plan, config, place, outcomes)
    run_folder.write_rows(folder / "messages.csv", [COLUMNS, *rows(results)])
    run_folder.write_rows(
        folder / "messages_paired.csv", [PAIRED_COLUMNS, *paired_rows(results)]
    )
    run_folder.write_config(settings, folder)
    losses = panels(results, "Packets lost", lambda result: result.loss)
    arriving = panels(results, "kbit/s that arrive", lambda result: result.goodput)
    count, packets = len(results[0].lost_each), results[0].lost.bits
    note = f"{count} recordings a point, {packets} packets; bars: 95 % intervals over recordings"
    for name, title, drawn in (
        ("messages", "Packets lost", losses),
        ("goodput", "What arrives", arriving),
    ):
        figure = plots.curve_figure(drawn, title, note, alike=False)
        plots.save_figure(figure, folder / f"{name}.png")
    for line in told(results):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    places = {"table": "messages.csv", "pairs": "messages_paired.csv"}
    places |= {"losses": "messages.png", "goodput": "goodput.png"}
    run_folder.print_places(console, folder, places.items())


def best(results: Sequence[Carried]) -> list[Carried]:
    """Give the results with the highest goodput of their place and receiver, if any."""
    chosen: dict[tuple[SweepPoint, str], Carried] = {}
    for result in results:
        key = result.place, result.variant.receiver
        most = chosen[key].goodput.value if key in chosen else 0.0
        if result.goodput.value > most:
            chosen[key] = result
    return [*chosen.values()]


def cells(estimate: Estimate | None) -> list[str]:
    """Write a value and the ends of its interval."""
    if estimate is None:
        return ["", "", ""]
    return [f"{number:.4g}" for number in (estimate.value, estimate.low, estimate.high)]


def rows(results: Sequence[Carried]) -> Iterator[run_folder.Cells]:
    """Give the lines of ``messages.csv``."""
    chosen = best(results)
    for result in results:
        receiver, soft, interleave, code = result.variant
        raw = ber_interval(result.raw) if result.raw.bits else None
        line: list[str | int | float | None] = [
            *result.place,
            receiver,
            soft,
            int(interleave),
            code,
        ]
        line += [
            len(result.lost_each),
            result.lost.bits,
            sum(result.lost_each),
            *cells(result.loss),
            result.false,
        ]
        line += [
            *cells(raw),
            *cells(result.goodput),
            int(result in chosen),
            result.frames,
        ]
        yield line


def paired_rows(results: Sequence[Carried]) -> Iterator[run_folder.Cells]:
    """Give the lines of ``messages_paired.csv``."""
    for a, b, paired in pairs(results):
        found = paired_interval(paired)
        line: list[str | int | float | None] = [
            *a.place,
            a.name,
            b.name,
            paired.frames,
            paired.bits,
        ]
        line += [
            *cells(found),
            int(found.real),
            paired.a_worse,
            paired.b_worse,
            f"{sign_test(paired):.3g}",
        ]
        yield line


def told(results: Sequence[Carried]) -> Iterator[str]:
    """Say over distance, or what else was varied, what arrives by the best code, and how far it carries."""
    axis = results[0].place.axis
    for result in best(results):
        if result.place.axis == axis:
            rate = result.goodput
            ends = f"{rate.low:.2f} to {rate.high:.2f}"
            at = f"{axis} {value_text(result.place.value)}: {rate.value:.2f} kbit/s ({ends})"
            yield f"{at} by {result.name}; raw bit error rate {rate_text(result.raw.ber)}"
    for receiver in dict.fromkeys(result.variant.receiver for result in results):
        if axis == "distance_m":
            yield f"{receiver} carries {reach(result for result in results if result.variant.receiver == receiver)}"
    if false := sum(result.false for result in results):
        yield f"{false} packets have a right checksum and nobody sent them"


def reach(results: Iterable[Carried]) -> str:
    """Say how far a receiver carries a message with any of its codes."""
    least: dict[float, float] = {}
    for result in results:
        if result.place.axis == "distance_m":
            at = result.place.value
            least[at] = min(result.loss.value, least.get(at, 1.0))
    far = [
        at for at, _ in takewhile(lambda of: of[1] <= MOST_LOST, sorted(least.items()))
    ]
    return (
        f"to {value_text(far[-1])} m" if far else f"not to {value_text(min(least))} m"
    )


def panels(
    results: Sequence[Carried], y_label: str, rate: Callable[[Carried], Estimate]
) -> list[plots.Panel]:
    """Draw a value of each receiver over each axis, a curve for all else that is compared."""
    labels = {result: result.name.partition(" ")[2] for result in results}
    styles = receiver_styles(labels.values())
    drawn: list[plots.Panel] = []
    for receiver, axis in dict.fromkeys(
        (result.variant.receiver, result.place.axis) for result in results
    ):
        curves = []
        for label, style in styles.items():
            line = [
                result
                for result in results
                if (result.variant.receiver, labels[result]) == (receiver, label)
            ]
            line = [result for result in line if result.place.axis == axis]
            values = [result.place.value for result in line]
            if line:
                curves.append(
                    plots.Curve(style, values, [rate(result) for result in line])
                )
        drawn.append(
            plots.Panel(curves, receiver, axis_label(axis), y_label, y_scale="linear")
        )
    return drawn
