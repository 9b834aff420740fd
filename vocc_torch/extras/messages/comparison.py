"""``task=messages``: how far messages carry, by receiver and code; a table and a picture."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from vocc_torch.arrays import Bools
from vocc_torch.errors import VoccError, section
from vocc_torch.extras.messages.clock import SoftFrames
from vocc_torch.extras.messages.config import AXES, MessagesConfig
from vocc_torch.extras.messages.front import Front
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import packed, payload_bytes
from vocc_torch.extras.messages.reception import Block, blocks_of, decoded
from vocc_torch.extras.messages.record_task import shutter_of
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.measure import executors, timing
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.config import Settings
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.train import calibrated_receiver, train
from vocc_torch.receiver.deciders import GREYSCALE_RECEIVERS
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.report import folder as run_folder
from vocc_torch.report import plots, terminal
from vocc_torch.report.styles import axis_label, receiver_styles, value_text
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.recording import NoFrameLeftError, record
from vocc_torch.simulation.scene import narrowed
from vocc_torch.studies.compare.report import write_report

HEADS = {
    "axis": "",
    "value": "",
    "receiver": "receiver",
    "code": "code",
    "kbit_s": "kbit/s",
    "raw_ber": "raw BER",
    "false_packets": "false",
}
"""Columns of the terminal's table."""


LOSS = "packet_error_rate", "packet_error_low", "packet_error_high"
"""Columns of the share of packets lost."""


class Place(NamedTuple):
    """A point of one receiver and one code: the quantity that varies, its value, and what carries messages."""

    axis: str
    value: float
    receiver: str
    code: str


class Carried(NamedTuple):
    """What one code carried to one receiver in one recording.

    Args:
        lost: packets lost, of those sent: the counts' frames are recordings, its bits packets.
        raw: wrong bits of single frames, likewise by recording.
        false: packets whose checksum is right and which nobody sent.
        frames: of the camera.
        kbit_s: of packets sent.
    """

    lost: Counts
    raw: Counts
    false: int
    frames: int
    kbit_s: float


Results = dict[Place, list[Carried]]
"""The recordings of each place."""


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
    results: Results = defaultdict(list)
    pool = executors.Workers.of(settings)
    progress = terminal.ProgressView(len(jobs), console, "recordings")
    with progress as view, pool, timing.threads(1):
        for (axis, value, _), found in zip(jobs, pool.map(call, jobs), strict=True):
            for place, carried in found.items():
                results[place].append(carried)
            view.advance(f"{axis} {value_text(value)}", 1)
    run_folder.write_config(settings, folder)
    rows = rows_of(results)
    best = [row for row in rows if row["best"]] or rows[:1]
    terminal.print_rows(best, HEADS, "the code of most kbit/s of each point")
    write_report(settings, folder, {"messages": rows}, {"messages": figure_of(rows)})


def recorded(
    plan: Plan,
    config: MessagesConfig,
    receivers: Mapping[str, Receiver],
    job: tuple[str, float, int],
) -> dict[Place, Carried]:
    """Take a recording, read it with every receiver and decode it as every code.

    One random block is shown over and over. For each code the scrambling is the one by which that block holds
    its packets, so all of them are compared on the same frames.

    Args:
        plan: world, seed and batch size.
        config: what is sent.
        receivers: by name; the first one's locator follows the panel for all.
        job: the quantity that varies, its value, and the number of the recording at that point.
    """
    axis, value, number = job
    varied = {"distance_m": config.at_distance_m, "ratio": config.at_ratio, axis: value}
    rate_hz = config.signalling.symbol_rate_hz
    fps = varied.pop("ratio") * rate_hz
    changes = {**plan.experiment.scene, **varied}
    model = narrowed(plan.world.scene, changes, "messages")
    shape = plan.world.panel.shape
    key = BlockKey(plan.seed, f"messages/{axis}={value:g}", number)
    base = Layout(MessagePlan(shape, config.options("none")))
    words = key.generator("bits").integers(2, size=base.places.shape, dtype=np.uint8)
    shown = base.write(words)
    film = np.tile(shown, (config.blocks, 1, 1))
    fronts = {name: Front(receiver) for name, receiver in receivers.items()}
    leader, *_ = fronts.values()
    read: dict[str, list[SoftFrames]] = {name: [] for name in fronts}
    wrong, frames = dict.fromkeys(fronts, 0), 0
    symbol_s = config.record.symbol_s(rate_hz)
    parts = record(
        plan.world.simulator(),
        model.draw(key, shape)[0][:1],
        torch.from_numpy(film),
        symbol_s,
        shutter_of(config.record, fps, symbol_s, key),
        key,
        speed_m_s=config.record.speed_m_s,
        window=config.record.margin,
        batch=plan.batch_frames,
    )
    with suppress(NoFrameLeftError):  # all its packets are lost
        for part in parts:
            stamps = [(frames + i) / fps for i in range(len(part.symbols))]
            frames += len(stamps)
            symbols = [symbol or 0 for symbol in part.symbols]
            truth = film[np.clip(symbols, 0, len(film) - 1)]
            with torch.inference_mode():
                located = leader.locate([*part.frames.grey[:, 0].cpu().numpy()])
                for name, front in fronts.items():
                    values = front.read(*located)
                    wrong[name] += int(((values >= 0) != truth).sum())
                    read[name].append((values, stamps))
    blocks = {name: [*blocks_of(base, values)] for name, values in read.items()}
    results = {}
    for name, code in product(read, config.codes):
        layout = Layout(MessagePlan(shape, config.options(code)))
        sent = config.blocks * layout.packets
        payload = payload_bytes(layout.code.info_bytes)
        arrived, false = packets_of(blocks[name], layout, shown, key)
        results[Place(axis, value, name, code)] = Carried(
            counted(max(0, sent - arrived), sent),
            counted(wrong[name], frames * shape.leds),
            false,
            frames,
            8e-3 * payload * sent / (len(film) / rate_hz),
        )
    return results


def packets_of(
    blocks: Sequence[Block], layout: Layout, shown: Bools, key: BlockKey
) -> tuple[int, int]:
    """Count the packets that arrive where every block shows ``shown``, and those that nobody sent."""
    info_bytes = layout.code.info_bytes
    text = key.generator("text").bytes(layout.packets * payload_bytes(info_bytes))
    words = layout.code.encode([*packed(text, info_bytes)])
    layout, arrived, false = layout.rescrambled(words, shown), set(), 0
    for block in blocks:
        for received in decoded(block, layout):
            if (packet := received.packet) is not None:
                size = len(packet.payload)
                if packet.payload == text[packet.sequence * size :][:size]:
                    arrived.add((block.number, received.place))
                else:
                    false += 1
    return len(arrived), false


def counted(errors: int, of: int) -> Counts:
    """Count the errors of one recording; where there was nothing that could err, nothing is known.

    Example:
        >>> (counted(0, 4) + counted(3, 4) + counted(0, 0)).ber
        0.375
    """
    if not of:
        return Counts()
    return Counts(1, of, 2 * errors, 4 * errors * errors, int(errors > 0))


def rows_of(results: Results) -> list[terminal.TableRow]:
    """Give the rows of ``messages.csv``; a recording's packets err together."""
    rows = []
    for place, recordings in results.items():
        raw = sum((part.raw for part in recordings), Counts())
        lost = sum((part.lost for part in recordings), Counts())
        loss, full = ber_interval(lost), recordings[0].kbit_s
        ends = (full * (1 - share) for share in (loss.value, loss.high, loss.low))
        row: terminal.TableRow = {
            **place._asdict(),
            "recordings": lost.frames,
            "packets": lost.bits,
            "lost": lost.bit_errors,
            **dict(zip(LOSS, astuple(loss), strict=True)),
            "false_packets": sum(part.false for part in recordings),
            "raw_ber": ber_interval(raw) if raw.bits else terminal.BLANK,
            "kbit_s": Estimate(*ends),
            "best": 0,
            "frames": sum(part.frames for part in recordings),
        }
        rows.append(row)
    goodputs = {at: row["kbit_s"].value for at, row in zip(results, rows, strict=True)}
    for place, row in zip(results, rows, strict=True):
        most = max(goodputs[at] for at in results if at[:3] == place[:3])
        row["best"] = int(goodputs[place] == most > 0)
    return rows


def figure_of(rows: Sequence[terminal.TableRow]) -> plots.Figure:
    """Draw the share of packets lost: a panel for each receiver and axis, a curve for each code."""
    styles = receiver_styles(row["code"] for row in rows)
    drawn = []
    for lines in dict.fromkeys((row["receiver"], row["axis"]) for row in rows):
        curves = []
        for code, style in styles.items():
            line = {
                row["value"]: Estimate(*map(row.__getitem__, LOSS))
                for row in rows
                if (row["receiver"], row["axis"], row["code"]) == (*lines, code)
            }
            curves.append(plots.Curve(style, [*line], [*line.values()]))
        receiver, axis = lines
        label = axis_label(axis)
        drawn.append(
            plots.Panel(curves, receiver, label, "Packets lost", y_scale="linear")
        )
    return plots.curve_figure(
        drawn,
        "Packets lost",
        f"{rows[0]['recordings']} recordings a point, {rows[0]['packets']} packets; "
        "bars: 95 % intervals over recordings",
    )
