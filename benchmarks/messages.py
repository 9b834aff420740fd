"""Long messages and hard recordings: bytes that arrive, faults, noise, the clock, time and memory.

``python benchmarks/messages.py [PART ...]`` writes docs/results/messages*.csv; parts are long (on two cores
long150 and long240 side by side), faults, noise, clock, load, memory and picture. ``vocc-torch
experiment=messages`` has packets lost over distance, light and ratio.
"""

import csv
import os
import sys
import tempfile
import time
from functools import cache, partial
from itertools import chain, product
from pathlib import Path

import numpy as np
import torch

from vocc_torch import load_scene
from vocc_torch.api import train
from vocc_torch.extras.messages.clock import SymbolClock
from vocc_torch.extras.messages.codes import code_of
from vocc_torch.extras.messages.front import Front
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import Assembly, packed, unpacked
from vocc_torch.extras.messages.receive_task import receive
from vocc_torch.extras.messages.reception import Reception, decoded, film_of
from vocc_torch.extras.messages.signalling import MessagePlan, Signalling
from vocc_torch.hardware import PanelShape
from vocc_torch.receiver.locators import RefinedLocator
from vocc_torch.recordings.reading import read_recording
from vocc_torch.report.video import write_video
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.recording import Shutter, record
from vocc_torch.simulation.scene import narrowed

RESULTS = Path(__file__).parents[1] / "docs" / "results"
SHAPE = PanelShape(8, 8)
MESSAGE = np.random.default_rng(16).bytes(2000)
NOISE = 10_000
SYMBOL_S, DRIFT = 0.01, 0.005
COLUMNS = ("scene", "distance_m", "fps", "fault", "bytes", "seconds", "frames", "raw_ber", "sent", "arrived")
COLUMNS += ("equal", "false", "kbit_s", "process_s", "lost")


@cache
def learned(scene):
    """A receiver of a scene as task=receive trains one, but on fewer frames."""
    receiver = train(scene, locator="truth", classifier="flda_3", frames=256)
    receiver.locator = RefinedLocator()
    return receiver


def carried(
    scene, distance, fps, message, fault="", effects=(), cut=None, window=1.5, code="rs", repeats=1, **faults
):
    """A row: a message through a recording that is received as it is rendered."""
    options, world, key = Signalling(code=code), load_scene(scene, *effects), BlockKey(16, "messages", 0)
    plan = MessagePlan(SHAPE, options)
    film = np.tile(film_of(message, plan), (repeats, 1, 1))
    drawn = narrowed(world.scene, {"distance_m": distance}).draw(key, SHAPE)[0][:1]
    front, reception = Front(learned(scene)), Reception(plan)
    assembly = Assembly(reception.code.info_bytes - 16)
    shutter = Shutter(fps, 0.0037, 0.004, **faults)
    told = drawn, torch.from_numpy(film), SYMBOL_S * (1 + DRIFT), shutter, key
    parts = record(world.simulator(), *told, window=window)
    wrong = frames = spent = 0

    def took(packets):
        for one in packets:
            if one.packet:
                assembly.add(one.packet)

    for part in parts:
        greys = [*part.frames.grey[:, 0].numpy()]
        kept = slice(*[max(0, at - frames) for at in cut or (0, 1 << 40)])
        greys, symbols = greys[kept], part.symbols[kept]
        stamps = [(frames + i) / fps for i in range(len(part.symbols))][kept]
        frames += len(part.symbols)
        if not greys:
            continue
        begun = time.process_time()
        values = front(greys)
        took(reception.push(values, stamps))
        spent += time.process_time() - begun
        shown = film[[min(one or 0, len(film) - 1) for one in symbols]]
        wrong += int(((values >= 0) != shown).sum())
    took(reception.finish())
    size = reception.code.info_bytes
    count, found = -(-len(message) // (size - 16)), assembly.messages
    missing = sorted({*range(count)} - {*found[0].parts}) if found else range(count)
    sent = {n: message[n * (size - 16) : (n + 1) * (size - 16)] for n in range(count)}
    false = sum(sent.get(n) != part for one in found for n, part in one.parts.items())
    seconds = len(film) * SYMBOL_S
    arrived = count - len(missing)
    return (
        *(scene, distance, fps, fault, len(message), f"{seconds:.1f}", frames),
        *(
            "" if cut else f"{wrong / max(1, frames) / SHAPE.leds:.3g}",
            count,
            arrived,
            int(any(one.complete and one.content == message for one in found)),
            false,
        ),
        *(f"{8e-3 * len(message) * arrived / count / seconds:.2f}", f"{spent:.1f}"),
        " ".join(map(str, missing)) if len(missing) < 40 else f"{len(missing)} packets",
    )


def long(done, rates=(150, 240)):
    """100 kB through both scenes at 30 to 70 m, and 2 kB where it must fail, but for rows that are done."""
    text = np.random.default_rng(16).bytes(100_000)
    far = [(150, scene, 130, 2_000) for scene in ("night", "dashcam") if 150 in rates]
    cells = product(rates, ("night", "dashcam"), (70, 50, 30), (100_000,))
    rows = [(*one, "", {}) for one in (*far, *cells)]
    if 150 in rates:  # what is meant for the cell that loses packets
        more = (("ldpc", {"code": "ldpc"}), ("shown twice", {"repeats": 2}))
        rows += [(150, "dashcam", 70, 100_000, *one) for one in more]
    for fps, scene, distance, size, told, options in rows:
        if (scene, str(distance), str(fps), told, str(size)) not in done:
            yield carried(scene, distance, fps, text[:size], told, window=1.0, **options)


def faults():
    """What recordings suffer, at night at 50 m, 240 frames a second."""
    scene, distance, fps = "night", 50, 240
    for name, chance in product(("dropped", "repeated", "black"), (0.1, 0.3)):
        yield carried(scene, distance, fps, MESSAGE, f"{name} {chance:.0%}", **{name: chance})
        if chance == 0.3:
            told = f"{name} {chance:.0%}, ldpc"
            yield carried(scene, distance, fps, MESSAGE, told, code="ldpc", **{name: chance})
    for width in (0.1, 0.2, 0.4, 0.8):
        effects = (f"+scene.effects.occlusion={{width_share: {width}, height_share: 2.0}}",)
        yield carried(scene, distance, fps, MESSAGE, f"a post over {width:.0%} of the panel", effects)
    for cut in ((0, 700), (333, 5000), (100, 400), (1000, 1001)):
        yield carried(scene, distance, fps, MESSAGE, f"only frames {cut[0]} to {cut[1]}", cut=cut)


def noise():
    """Packets of noise: words of random soft values, and bits of the checksum."""
    draws = np.random.default_rng(16)
    for code in ("none", "ldpc", "rs"):
        layout = Layout(MessagePlan(SHAPE, Signalling(code=code)))
        coder, accepted, begun = code_of(layout), 0, time.process_time()
        for _ in range(NOISE // 100):
            llr = (3 * draws.standard_normal((100, layout.word_bits))).astype(np.float32)
            infos = [one for one in coder.decode(llr) if one is not None]
            accepted += sum(unpacked(one) is not None for one in infos)
        yield code, NOISE, accepted, f"{1e3 * (time.process_time() - begun) / NOISE:.2f}"


def clock():
    """Share of symbols found, over ratio, drift and phase, at 5 % of raw bits wrong."""
    draws, layout = np.random.default_rng(16), Layout(MessagePlan(SHAPE, Signalling()))
    blocks, sigma = 4, 1 / 1.645
    shown = np.tile(np.where(layout.known == 0, 1, layout.known), (blocks, 1, 1)).astype(np.float32)
    for ratio, drift in product((1.5, 1.7, 2.0, 2.4, 3.0, 4.0, 6.0), (-0.01, 0.0, 0.01)):
        found = twice = total = right = frames = 0
        for _ in range(4):
            times = draws.random() + np.arange(int(len(shown) * ratio)) / ratio * (1 + drift)
            times = times[times < len(shown) - 1]
            light, first = mixed(shown, times)
            y = light + sigma * draws.standard_normal(light.shape)
            follower, symbols = SymbolClock(layout), []
            for at in range(0, len(y), 256):
                stamps = [i / ratio / 100 for i in range(at, min(at + 256, len(y)))]
                ticks = follower.push((2 * y[at : at + 256] / sigma**2).astype(np.float32), stamps)
                symbols += [] if ticks is None else [ticks.symbol]
            symbols.append(follower.finish().symbol)
            said = np.concatenate(symbols)[:, 0]
            said = said - layout.symbols * round(float(np.median(said - first)) / layout.symbols)
            middle = np.floor(times + 0.05).astype(int)
            shows = {int(s) for s in middle}
            agree = (said == middle) | (said == first)
            right, frames = right + int(agree.sum()), frames + len(said)
            found += len(shows & {int(s) for s in said[agree]})
            total += len(shows)
            # A symbol taken for two, or two for one, moves the count.
            twice += int(abs((said[-1] - said[0]) - (middle[-1] - middle[0])) > 1)
        yield ratio, drift, 4, total, f"{found / total:.5f}", f"{right / frames:.5f}", twice


def mixed(shown, times, exposure=0.07, readout=0.03):
    """Light of exposures that catch two symbols, row by row; and the symbols that they begin with."""
    rows = shown.shape[1]
    begins = times[:, None] + np.arange(rows) / rows * readout
    first, last = np.floor(begins).astype(int), np.floor(begins + exposure).astype(int)
    share = np.where(last > first, (last - begins) / exposure, 1.0)[..., None]
    at, most = np.arange(rows), len(shown) - 1
    light = shown[np.minimum(first, most), at] * share + shown[np.minimum(last, most), at] * (1 - share)
    return light, first[:, 0]


def panels(axis, picture, title, **look):
    """Draw a plane of cells or pixels."""
    axis.imshow(picture, **({"cmap": "gray"} | look))
    axis.set_title(title, fontsize=10)


def picture():
    """docs/images/messages_*.png: what is sent, what a camera saw of it, and what was read of that."""
    from matplotlib import pyplot

    text = Path(__file__).parents[1].joinpath("LICENSE").read_bytes()[:600]
    plan, first = MessagePlan(SHAPE, Signalling()), 48
    layout, film, world, receiver = Layout(plan), film_of(text, plan), load_scene("night"), learned("night")
    key, front, reception, assembly = (
        BlockKey(2, "messages", 0),
        Front(receiver),
        Reception(plan),
        Assembly(0),
    )
    scene = narrowed(world.scene, {"distance_m": 40}).draw(key, SHAPE)[0][:1]
    seen, values, symbols, blocks, got = [], [], [], [], []
    shutter = Shutter(240.0, 0.0011, 0.03)
    for part in record(world.simulator(), scene, torch.from_numpy(film), SYMBOL_S, shutter, key):
        seen += [*part.frames.grey[:, 0].numpy()]
        values += [*front([*part.frames.grey[:, 0].numpy()])]
        symbols += part.symbols
        blocks += reception.combiner.push(np.stack(values[-len(part.symbols) :]), part.taken_s.tolist())
    blocks += reception.combiner.finish()
    for block in blocks:
        got += decoded(block, layout, reception.code)
    for one in got:
        if one.packet:
            assembly.add(one.packet)
    assert assembly.messages[0].content == text

    def figure_of(columns, width):
        figure, axes = pyplot.subplots(1, columns, figsize=(width, 2.5), layout="constrained")
        for axis in axes:
            axis.set(xticks=[], yticks=[])
        return figure, axes

    def saved(figure, name):
        figure.savefig(RESULTS.parent / "images" / f"messages_{name}.png", dpi=80)

    figure, axes = figure_of(5, 12)
    axes[0].text(0, 0.98, "\n".join(text.decode().split("\n")[:9]), va="top", fontsize=6, family="monospace")
    axes[0].set_title("the file", fontsize=10)
    axes[0].axis("off")
    word = np.packbits(film_words(text, layout)[0])
    parts = np.repeat(
        [0, 1, 2, 3], [12, reception.code.info_bytes - 16, 4, len(word) - reception.code.info_bytes]
    )
    panels(
        axes[1], parts.reshape(-1, 12), "packet 0: header, text,\nchecksum, check bytes", cmap="Set2", vmax=7
    )
    kinds = ["data", "anchor", "clock", "sync"]
    panels(
        axes[2], np.vectorize(kinds.index)(layout.kind), "data, anchors,\nclock, sync", cmap="Set2", vmax=7
    )
    for axis, number in zip(axes[3:], (20, 21), strict=True):
        panels(axis, film[number], f"symbol {number}")
        assert (axis.images[0].get_array() == film[number]).all()
    saved(figure, "sent")
    figure, axes = figure_of(5, 12)
    corners = front.corners_px.numpy()
    panels(axes[0], seen[first], f"frame {first}, and where\nthe panel was found")
    axes[0].plot(*corners[[0, 1, 2, 3, 0]].T, color="#E69F00")
    pitch = np.linalg.norm(corners[1] - corners[0]) / 8
    left, top = np.rint(corners[0] - pitch).astype(int)
    side = int(10 * pitch)
    for axis, frame in zip(axes[1:], range(first, first + 4), strict=True):
        panels(
            axis, seen[frame][top : top + side, left : left + side], f"frame {frame}: symbol {symbols[frame]}"
        )
    saved(figure, "seen")
    figure, axes = figure_of(6, 12)
    for axis, frame in zip(axes, range(first, first + 4), strict=False):
        panels(axis, values[frame], f"soft values of\nframe {frame}", cmap="RdBu_r", vmin=-12, vmax=12)
        whole = symbols[frame - 1] == symbols[frame] == symbols[frame + 1]
        assert not whole or ((values[frame] >= 0) == film[symbols[frame]]).all()
    total = blocks[0].sums[20]
    panels(axes[4], total, "symbol 20: the\nframes' sum", cmap="RdBu_r", vmin=-24, vmax=24)
    assert ((total >= 0) == film[20]).all()
    words = text.decode().split()
    corrected = sum(one.corrected or 0 for one in got)
    told = f"{len(text)} bytes again:\n“{' '.join(words[:2])}\n{' '.join(words[2:6])} ...”"
    told += f"\n{corrected} bits corrected"
    axes[5].text(0.5, 0.5, told, ha="center", va="center", fontsize=9)
    axes[5].axis("off")
    saved(figure, "read")
    return []


def film_words(text, layout):
    """The words of a message's packets, as bits."""
    code = code_of(layout)
    return code.encode(np.stack([np.frombuffer(one, np.uint8) for one in packed(text, code.info_bytes)]))


def load(turns=5):
    """Full-HD recordings of 100 frames a second by the film's rate of bits: time of processor and clock.

    The films, of 1.3 s that come again and again, stay in the folder for temporary files for another call.
    """
    world, receiver = load_scene("night", "framing=full"), learned("night")
    plan = MessagePlan(SHAPE, Signalling(symbol_rate_hz=40.0))
    film, key = film_of(MESSAGE, plan)[:52], BlockKey(3, "messages", 0)
    scene = narrowed(world.scene, {"distance_m": 50}).draw(key, SHAPE)[0][:1]
    told = scene, torch.from_numpy(film), 1 / 40, Shutter(100.0, 0.0011, 0.004), key
    paths = {quality: Path(tempfile.gettempdir()) / f"vocc_torch_load_{quality}.mp4" for quality in (20, 12)}
    if missing := [quality for quality, path in paths.items() if not path.exists()]:
        parts = record(world.simulator(), *told, window=None, batch=16)
        seen = [grey for part in parts for grey in part.frames.grey[:, 0].numpy()]
        for quality in missing:
            write_video(paths[quality], seen, 100.0, quality)
    for quality, path in paths.items():
        spent = [time.process_time()]
        greys = [one.grey for one in read_recording(path, "luma", grey_only=True)]
        spent.append(time.process_time())
        count, front, reception = len(greys), Front(receiver), Reception(plan)
        llr = np.concatenate([front(greys[at : at + 30]) for at in range(0, count, 30)])
        spent.append(time.process_time())
        list(reception.push(llr, [i / 100 for i in range(count)]))
        spent.append(time.process_time())
        shown = film[[int((0.0011 + i / 100) * 40) for i in range(count)]]
        wrong = float((((llr >= 0) != shown).mean(axis=(1, 2)) > 0.02).mean())
        mbit, parts = (
            path.stat().st_size * 8 * 100 / count / 1e6,
            [1e3 * one / count for one in np.diff(spent)],
        )
        del greys
        begun = time.perf_counter(), time.process_time()
        frames = chain.from_iterable(read_recording(path, "luma", grey_only=True) for _ in range(turns))
        list(receive(receiver, Reception(plan), Front(receiver), frames, 100.0))
        clock, whole = time.perf_counter() - begun[0], time.process_time() - begun[1]
        parts.append(1e3 * whole / (count := turns * count))
        rates = f"{count / clock:.1f}", f"{os.getloadavg()[0]:.1f}", f"{wrong:.3f}"
        yield quality, f"{mbit:.1f}", count, *(f"{one:.2f}" for one in parts), *rates


def memory():
    """Memory over 100,000 frames, from grey values to packets; two blocks of frames come again and again."""
    world, plan, key = load_scene("night"), MessagePlan(SHAPE, Signalling()), BlockKey(3, "messages", 0)
    film = film_of(MESSAGE, plan)[:256]
    scene = narrowed(world.scene, {"distance_m": 70}).draw(key, SHAPE)[0][:1]
    told = scene, torch.from_numpy(film), SYMBOL_S, Shutter(150.0, 0.0037, 0.004), key
    greys = np.concatenate([part.frames.grey[:, 0].numpy() for part in record(world.simulator(), *told)])
    front, reception, done, arrived = Front(learned("night"), 32), Reception(plan), 0, 0
    while done < 100_000:
        for at in range(0, len(greys), 64):
            part = [*greys[at : at + 64]]
            times = [(done + i) / 150 for i in range(len(part))]
            arrived += sum(one.packet is not None for one in reception.push(front(part), times))
            done += len(part)
            if done % 10_000 < len(part):
                pages = int(Path("/proc/self/statm").read_text().split()[1])
                yield done, arrived, f"{pages * 4096 / 1e6:.0f}"


PARTS = {
    "long": (long, "messages_long.csv", COLUMNS),
    "long150": (partial(long, rates=(150,)), "messages_long.csv", COLUMNS),  # beside the next on another core
    "long240": (partial(long, rates=(240,)), "messages_long.csv", COLUMNS),
    "faults": (faults, "messages_faults.csv", COLUMNS),
    "picture": (picture, None, ()),
    "load": (
        load,
        "messages_load.csv",
        (
            *("crf", "mbit_s", "frames", "read_ms", "follow_ms", "clock_ms", "whole_ms"),
            *("fps_by_the_clock", "load_average", "frames_with_errors"),
        ),
    ),
    "memory": (memory, "messages_memory.csv", ("frames", "packets", "mb")),
    "noise": (noise, "messages_noise.csv", ("code", "packets", "accepted", "decode_ms")),
    "clock": (
        clock,
        "messages_clock.csv",
        ("ratio", "drift", "recordings", "symbols", "found", "frames_right", "slips"),
    ),
}


if __name__ == "__main__":
    torch.set_num_threads(1)
    for name in sys.argv[1:] or PARTS:
        rows, file, head = PARTS[name]
        if file is None:
            rows()
            continue
        path, done = RESULTS / file, []
        if "long" in name and path.exists():  # goes on where it was stopped; without the file it begins anew
            done = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
        with path.open("a" if done else "w", newline="", encoding="utf-8") as out:
            writer = csv.writer(out, lineterminator="\n")
            if not done:
                writer.writerow(head)
            for row in rows({(*one[:5],) for one in done}) if "long" in name else rows():
                writer.writerow(row)
                out.flush()
                print(*row, flush=True)
