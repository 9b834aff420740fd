"""``task=messages``: how far messages carry, by receiver and code; tables and pictures."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby, takewhile
from pathlib import Path

from vocc_torch.errors import section
from vocc_torch.extras.messages.codes import code_of
from vocc_torch.extras.messages.comparison import (
    Carried,
    SweepPoint,
    Variant,
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
from vocc_torch.measure import timing, workers
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.curve import BerTable, Point
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import paired_interval, sign_test
from vocc_torch.report import canvas, terminal
from vocc_torch.report import drawing as plots
from vocc_torch.report import folder as run_folder
from vocc_torch.report.styles import axis_label, rate_text, receiver_styles, value_text

COLUMNS = (
    *("axis", "value", "receiver", "soft", "interleave", "code", "recordings", "packets", "lost"),
    *(
        "packet_error_rate",
        "packet_error_low",
        "packet_error_high",
        "false_packets",
        "raw_ber",
        "raw_ber_low",
    ),
    *("raw_ber_high", "kbit_s", "kbit_s_low", "kbit_s_high", "best", "frames", "read_ms", "decode_ms"),
)
"""Columns of ``messages.csv``."""

PAIRED_COLUMNS = (
    *("axis", "value", "a", "b", "recordings", "packets", "difference", "difference_low", "difference_high"),
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
    plan, console = build_plan(settings, folder).at_true_corners(), terminal.Console()
    variants_of(plan, config)  # refused, as a code that is not installed, before anything is trained
    for code in config.codes:
        rate = section(f"messages.codes has {code}, whose code_rate", before="transmit.code_rate")
        with section("messages.signalling", "transmit"), section("messages.codes", "transmit.code"), rate:
            code_of(Layout(MessagePlan(plan.world.panel.shape, config.options(code))))
    receivers = receivers_of(build_plan(settings, folder), terminal.train_shown(plan, console))
    jobs = jobs_of(plan, config, receivers)
    results: list[Carried] = []
    pool = workers.Workers.of(settings)
    with terminal.ProgressView(len(jobs), console, "recordings") as view, pool, timing.threads(1):
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
    run_folder.write_rows(folder / "messages_paired.csv", [PAIRED_COLUMNS, *paired_rows(results)])
    run_folder.write_config(settings, folder)
    canvas.save_figure(losses_figure(results), folder / "messages.png")
    canvas.save_figure(goodput_figure(results), folder / "goodput.png")
    for line in told(results):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    places = {"table": "messages.csv", "pairs": "messages_paired.csv"}
    places |= {"losses": "messages.png", "goodput": "goodput.png"}
    run_folder.print_places(console, folder, places.items())


def best(results: Sequence[Carried]) -> set[int]:
    """Say by their number which results have the highest goodput of their place and receiver, if any."""
    chosen: dict[tuple[SweepPoint, str], int] = {}
    for number, one in enumerate(results):
        key = one.place, one.variant.receiver
        if one.goodput.value > (results[chosen[key]].goodput.value if key in chosen else 0.0):
            chosen[key] = number
    return {*chosen.values()}


def rows(results: Sequence[Carried]) -> Iterator[run_folder.Cells]:
    """Give the lines of ``messages.csv``."""
    chosen = best(results)
    for number, one in enumerate(results):
        loss, rate, raw = one.loss, one.goodput, ber_interval(one.raw) if one.raw.bits else None
        yield (
            *(one.place.axis, one.place.value, *one.variant[:2], int(one.variant.interleave)),
            *(one.variant.code, len(one.each), one.lost.bits, sum(one.each)),
            *(f"{x:.4g}" for x in (loss.value, loss.low, loss.high)),
            one.false,
            *(("",) * 3 if raw is None else (f"{x:.4g}" for x in (raw.value, raw.low, raw.high))),
            *(f"{x:.4g}" for x in (rate.value, rate.low, rate.high)),
            *(int(number in chosen), one.frames, f"{one.read_ms:.3f}", f"{one.decode_ms:.3f}"),
        )


def paired_rows(results: Sequence[Carried]) -> Iterator[run_folder.Cells]:
    """Give the lines of ``messages_paired.csv``."""
    for a, b, paired in pairs(results):
        found = paired_interval(paired)
        yield (
            *(*a.place, name_of(a), name_of(b), paired.frames, paired.bits),
            *(f"{x:.4g}" for x in (found.value, found.low, found.high)),
            *(int(found.real), paired.a_worse, paired.b_worse, f"{sign_test(paired):.3g}"),
        )


def name_of(one: Carried) -> str:
    """Name what carried a message."""
    receiver, soft, interleave, code = one.variant
    return f"{receiver} {soft} {code}" + " not interleaved" * (not interleave)


def told(results: Sequence[Carried]) -> Iterator[str]:
    """Say over distance, or what else was varied, what arrives by the best code, and how far it carries."""
    chosen, axis = best(results), results[0].place.axis
    for receiver in dict.fromkeys(one.variant.receiver for one in results):
        mine = [(n, one) for n, one in enumerate(results) if one.variant.receiver == receiver]
        for number, one in mine:
            if number in chosen and one.place.axis == axis:
                ends = f"{one.goodput.low:.2f} to {one.goodput.high:.2f}"
                at = f"{axis} {value_text(one.place.value)}: {one.goodput.value:.2f} kbit/s ({ends})"
                raw = f"raw bit error rate {rate_text(one.raw.ber)}"
                yield f"{receiver}, {at} by {name_of(one).partition(' ')[2]}; {raw}"
        frames, codes = sum(one.frames for _, one in mine), dict.fromkeys(one.variant.code for _, one in mine)
        read = sum(one.read_ms * one.frames for _, one in mine) / max(1, frames)
        each = {code: [one.decode_ms for _, one in mine if one.variant.code == code] for code in codes}
        priced = ", ".join(f"{code} {sum(every) / len(every):.2f}" for code, every in each.items())
        yield f"{receiver} costs {read:.2f} ms of processor time a frame, and ms a packet: {priced}"
        if axis == "distance_m":
            yield f"{receiver} carries {reach(one for _, one in mine)}"
    if false := sum(one.false for one in results):
        yield f"{false} packets were vouched for that nobody sent"


def reach(results: Iterable[Carried]) -> str:
    """Say how far a receiver carries a message with any of its codes."""
    least: dict[float, float] = {}
    for one in results:
        if one.place.axis == "distance_m":
            least[one.place.value] = min(one.loss.value, least.get(one.place.value, 1.0))
    far = [at for at, _ in takewhile(lambda of: of[1] <= MOST_LOST, sorted(least.items()))]
    return f"to {value_text(far[-1])} m" if far else f"not to {value_text(min(least))} m"


def labels_of(results: Sequence[Carried]) -> dict[Variant, str]:
    """Name what is drawn as a line: the code, and what else is compared beside the receivers."""
    every = [one.variant for one in results]
    several = len({one.soft for one in every}) > 1
    words = {
        one: (one.code, one.soft * several, "" if one.interleave else "not interleaved") for one in every
    }
    return {one: " ".join(filter(None, parts)) for one, parts in words.items()}


def losses_figure(results: Sequence[Carried]) -> canvas.Figure:
    """Draw packet error rates: a row a receiver, a column an axis, and the last against raw bit errors."""
    drawn: list[dict[str, BerTable | str]] = []
    labels = labels_of(results)
    for receiver in dict.fromkeys(one.variant.receiver for one in results):
        mine = [one for one in results if one.variant.receiver == receiver]
        tables: dict[str, BerTable | str] = {}
        for axis in (*dict.fromkeys(one.place.axis for one in mine), "raw_ber"):
            points: dict[tuple[str, float], Point] = {}
            for one in mine:
                if axis == one.place.axis or (axis == "raw_ber" and one.raw.bits):
                    value = float(f"{one.raw.ber:.2g}") if axis == "raw_ber" else one.place.value
                    name = labels[one.variant]
                    told = "messages", axis, value, name, receiver, one.lost, "recordings"
                    points.setdefault((name, value), Point(*told))
            tables[f"{receiver}: {axis_label(axis)}"] = (
                BerTable(points.values()) if points else "every frame was lost"
            )
        drawn.append(tables)
    count, packets = len(results[0].each), results[0].lost.bits
    note = f"{count} recordings a point, {packets} packets or as many as a code has; bars: 95 % intervals"
    note += " over recordings"
    return plots.facet_figure(drawn, "Packets lost by code", note, axes_alike=False, rate="Packets lost")


def goodput_figure(results: Sequence[Carried]) -> canvas.Figure:
    """Draw what arrives over the first axis: axes a receiver, a line a code."""
    axis = results[0].place.axis
    names = list(dict.fromkeys(one.variant.receiver for one in results))
    labels = labels_of(results)
    styles = receiver_styles(labels.values())
    above = 0.9 + 0.24 * -(-len(styles) // 3)
    figure, every = canvas.new_grid(
        len(names), min(3, len(names)), (3.6, 2.8), (0.5, 0.8), (0.8, 0.2, above, 0.9)
    )
    for name, axes in zip(names, every, strict=True):
        for code, style in styles.items():
            mine = [one for one in results if one.variant.receiver == name and labels[one.variant] == code]
            mine = [one for one in mine if one.place.axis == axis]
            rates = [one.goodput for one in mine]
            ends = [[one.value - one.low for one in rates], [one.high - one.value for one in rates]]
            x = [one.place.value for one in mine]
            axes.errorbar(x, [one.value for one in rates], ends, fmt="none", ecolor=style.colour, capsize=2)
            axes.add_line(plots.receiver_line(style, x, [one.value for one in rates], 0.8))
        axes.set_ylim(bottom=0)
        axes.set_title(name, loc="left", fontsize=10.5, fontweight="bold")
        axes.set_xlabel(axis_label(axis))
        axes.set_ylabel("kbit/s that arrive" if axes is every[0] else "")
        canvas.quiet_axes(axes, "both")
    canvas.write_title(figure, "What arrives", "Bars: 95 % intervals over recordings")
    lines = [plots.receiver_line(style) for style in styles.values()]
    canvas.write_legend(figure, lines, (0.01, 1 - 0.46 / figure.get_figheight()), 3)
    return figure
