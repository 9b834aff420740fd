"""How far messages carry: packets of recordings over scenes, distances and camera rates, soft against hard.

``python benchmarks/messages.py [PART ...]`` writes docs/results/messages.csv, messages_noise.csv and
messages_clock.csv; parts are links, options, noise and clock.
"""

import csv
import sys
import tempfile
import time
from itertools import product
from pathlib import Path

import numpy as np
import torch

from vocc_torch import load_scene
from vocc_torch.api import train
from vocc_torch.hardware import PanelShape
from vocc_torch.messages.clock import SymbolClock
from vocc_torch.messages.codes import code_of
from vocc_torch.messages.front import TYPICAL, Front
from vocc_torch.messages.layout import Layout
from vocc_torch.messages.packets import Assembly, unpacked
from vocc_torch.messages.reception import Reception, film_of
from vocc_torch.messages.signalling import MessagePlan, Signalling
from vocc_torch.receiver.locators import RefinedLocator
from vocc_torch.receiver.recording import read_recording
from vocc_torch.rng import BlockKey
from vocc_torch.show.video import write_video
from vocc_torch.simulation.recording import Shutter, record
from vocc_torch.simulation.scene import narrowed

RESULTS = Path(__file__).parents[1] / "docs" / "results"
SHAPE = PanelShape(8, 8)
MESSAGE = np.random.default_rng(16).bytes(2000)
NOISE = {"ldpc": 2_000, "rs": 1_000, "none": 10_000}
SYMBOL_S, DRIFT = 0.01, 0.005
COLUMNS = ("part", "scene", "distance_m", "fps", "dropped", "code", "interleave", "soft", "frames")
COLUMNS += ("raw_ber", "sent", "arrived", "equal", "kbit_s", "process_s", "lost")


def recorded(receiver, world, distance, fps, options, dropped=0.0):
    """Scores (F,R,C) of a recording, as the receiver's front reads them, and its raw bit error rate."""
    film = film_of(MESSAGE, MessagePlan(SHAPE, options))
    key, front = BlockKey(16, "messages", 0), Front(receiver, soft="scores")
    front._size = TYPICAL  # the scores as they are
    scene = narrowed(world.scene, {"distance_m": distance}).draw(key, SHAPE)[0][:1]
    shutter = Shutter(fps, 0.0037, 0.004, dropped=dropped)
    scores, wrong, bits, spent = [], 0, 0, 0.0
    simulator = world.simulator()
    for part in record(simulator, scene, torch.from_numpy(film), SYMBOL_S * (1 + DRIFT), shutter, key):
        begun = time.process_time()
        one = front(part.frames.grey[:, 0].numpy())
        spent += time.process_time() - begun
        truth = film[np.clip(part.symbols, 0, len(film) - 1)]
        wrong, bits = wrong + int(((one >= 0) != truth).sum()), bits + truth.size
        scores.append(one)
    return np.concatenate(scores), wrong / bits, spent, len(film) * SYMBOL_S


def received(receiver, scores, fps, options, soft):
    """What arrives of soft values, and the time that takes."""
    llr = scores * (TYPICAL / np.median(np.abs(scores)))
    if soft == "calibrated":
        llr = receiver.calibration(torch.from_numpy(scores)).float().numpy()
    elif soft == "hard":
        llr = TYPICAL * np.sign(scores)
    reception, assembly = Reception(MessagePlan(SHAPE, options)), Assembly()
    begun, got = time.process_time(), []
    times = [i / fps for i in range(len(llr))]
    for first in range(0, len(llr), 64):
        got += reception.push(llr[first : first + 64], times[first : first + 64])
    got += reception.finish()
    for one in got:
        if one.packet:
            assembly.add(one.packet)
    return assembly, reception.code.info_bytes, time.process_time() - begun


def rows_of(part, receivers, scene, distance, fps, options, softs, dropped=0.0, hidden=0):
    """Rows of one recording."""
    if scene not in receivers:
        learned = train(scene, locator="truth", classifier="flda_3", frames=256)
        learned.locator = RefinedLocator()
        receivers[scene] = learned, load_scene(scene)
    receiver, world = receivers[scene]
    scores, ber, spent, seconds = recorded(receiver, world, distance, fps, options, dropped)
    shown = (np.arange(len(scores)) / fps / SYMBOL_S).astype(int) % 128
    scores[(shown >= 60) & (shown < 60 + hidden)] = 0  # as the front gives black frames
    for soft in softs:
        assembly, info, more = received(receiver, scores, fps, options, soft)
        whole = assembly.whole(info)
        count = -(-len(MESSAGE) // (info - 16))
        arrived = count - len(assembly.missing(info)) if assembly.message else 0
        if whole is not None and whole != MESSAGE:
            raise AssertionError("a message that is not the one that was sent was vouched for")
        missing = assembly.missing(info) if assembly.message else range(count)
        kbit = 8e-3 * len(MESSAGE) * arrived / count / seconds
        yield (
            *(part, scene, distance, fps, dropped, options.code, int(options.interleave), soft, len(scores)),
            *(f"{ber:.3g}", count, arrived, int(whole == MESSAGE), f"{kbit:.2f}", f"{spent + more:.1f}"),
            " ".join(map(str, missing)),
        )


def links():
    """Scenes, distances and camera rates, both codes."""
    receivers = {}
    slow, fast = product((150,), (30, 50, 70, 110)), product((240,), (50,))
    for scene, (fps, distance) in product(("night", "dashcam"), (*slow, *fast)):
        for code in ("ldpc", "rs") if fps == 150 else ("ldpc",):
            softs = ("calibrated", "scores", "hard") if code == "ldpc" else ("calibrated",)
            yield from rows_of("links", receivers, scene, distance, fps, Signalling(code=code), softs)


def options():
    """With and without interleaving: frames lost here and there, and ten symbols hidden in a row."""
    receivers = {}
    for dropped, hidden in ((0.2, 0), (0.0, 10)):
        for code, interleave in product(("ldpc", "rs"), (True, False)):
            own = Signalling(code=code, interleave=interleave)
            told = "night", 70, 150, own, ("calibrated",), dropped, hidden
            yield from rows_of(f"options, {hidden} symbols of 128 hidden", receivers, *told)


def soft():
    """Soft against hard where packets begin to be lost, by what distances the receiver learned."""
    for learned in ((30, 70), (60, 100)):
        world = load_scene("night", f"scene.distance_m=[uniform,{learned[0]},{learned[1]}]")
        receiver = train(world, locator="truth", classifier="flda_3", frames=512)
        receiver.locator = RefinedLocator()
        kept = {"night": (receiver, world)}
        for distance in (80, 84, 88, 92):
            name, own = f"soft, learned {learned[0]} to {learned[1]} m", Signalling(code="ldpc")
            softs = ("calibrated", "scores", "hard")
            yield from rows_of(name, kept, "night", distance, 150, own, softs)


def noise():
    """Packets of noise: words of random soft values, and bits of the checksum."""
    draws = np.random.default_rng(16)
    for code in NOISE:
        layout = Layout(MessagePlan(SHAPE, Signalling(code=code)))
        coder, accepted, words = code_of(layout), 0, NOISE[code]
        for _ in range(words // 100):
            llr = (3 * draws.standard_normal((100, layout.word_bits))).astype(np.float32)
            infos = [one for one in coder.decode(llr) if one is not None]
            accepted += sum(unpacked(one) is not None for one in infos)
        yield code, words, accepted


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


def picture():
    """docs/images/messages.png: a symbol, what the camera saw about it, its soft values, the text again."""
    from matplotlib import pyplot

    text = Path(__file__).parents[1].joinpath("LICENSE").read_bytes()[:600]
    plan = MessagePlan(SHAPE, Signalling())
    film, world = film_of(text, plan), load_scene("night")
    receiver = train("night", locator="truth", classifier="flda_3", frames=128)
    receiver.locator = RefinedLocator()
    key, front, reception, seen = BlockKey(2, "messages", 0), Front(receiver), Reception(plan), []
    scene = narrowed(world.scene, {"distance_m": 40}).draw(key, SHAPE)[0][:1]
    shutter, got, values = Shutter(240.0, 0.0011, 0.03), [], []
    for part in record(world.simulator(), scene, torch.from_numpy(film), SYMBOL_S, shutter, key):
        seen += list(part.frames.grey[:, 0].numpy())
        values += list(front(part.frames.grey[:, 0].numpy()))
        got += reception.push(np.stack(values[-len(part.symbols) :]), (part.taken_s).tolist())
    got += reception.finish()
    assembly = Assembly()
    for one in got:
        if one.packet:
            assembly.add(one.packet)
    assert assembly.whole(reception.code.info_bytes) == text
    figure, axes = pyplot.subplots(2, 6, figsize=(12, 4.6), layout="constrained")
    for axis in axes.flat:
        axis.set_axis_off()
    pitch = (front.corners_px[1] - front.corners_px[0]).norm() / 8
    left, top = (front.corners_px[0] - pitch).round().int().tolist()
    side = int(10 * pitch)
    for at, number in enumerate((20, 21)):
        axes[0, at].imshow(film[number], cmap="gray")
        axes[0, at].set_title(f"symbol {number}")
    first = int(20 * 2.4)
    for at, frame in enumerate(range(first, first + 4)):
        axes[0, 2 + at].imshow(seen[frame][top : top + side, left : left + side], cmap="gray")
        axes[0, 2 + at].set_title(f"frame {frame}")
        axes[1, 2 + at].imshow(values[frame], cmap="RdBu_r", vmin=-12, vmax=12)
        axes[1, 2 + at].set_title("soft values")
    kinds = ["data", "anchor", "clock", "sync"]
    axes[1, 0].imshow(np.vectorize(kinds.index)(Layout(plan).kind), cmap="Set2", vmax=7)
    axes[1, 0].set_title("data, anchors,\nclock, sync cells")
    words = text.decode().split()
    told = f"{len(text)} bytes again:\n“{' '.join(words[:2])}\n{' '.join(words[2:6])} ...”"
    axes[1, 1].text(0.5, 0.5, told, ha="center", va="center")
    figure.savefig(RESULTS.parent / "images" / "messages.png", dpi=80)
    return []


def load():
    """Processor time a frame of a full-HD recording, and memory over 100,000 frames."""
    world, receiver = load_scene("night", "framing=full"), train("night", locator="truth", frames=128)
    receiver.locator = RefinedLocator()
    plan = MessagePlan(SHAPE, Signalling())
    film = film_of(MESSAGE, plan)[:64]
    key = BlockKey(3, "messages", 0)
    scene = narrowed(world.scene, {"distance_m": 50}).draw(key, SHAPE)[0][:1]
    told = scene, torch.from_numpy(film), SYMBOL_S, Shutter(100.0, 0.0011, 0.004), key
    parts = record(world.simulator(), *told, window=None, batch=16)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "whole.mp4"
        write_video(path, (grey for part in parts for grey in part.frames.grey[:, 0].numpy()), 100.0)
        begun = time.process_time()
        greys = np.stack([one.grey for one in read_recording(path, "luma", grey_only=True)])
        spent = {"read": time.process_time() - begun}
    front, begun = Front(receiver), time.process_time()
    llr = np.concatenate([front(greys[at : at + 30]) for at in range(0, len(greys), 30)])
    spent["front"] = time.process_time() - begun
    front, begun = Front(receiver), time.process_time()
    front(greys[:30])  # each of them is searched, for no panel is known yet
    spent["front"] = (spent["front"] - (time.process_time() - begun)) * len(greys) / (len(greys) - 30)
    reception, begun = Reception(plan), time.process_time()
    list(reception.push(llr, [i / 100 for i in range(len(llr))]))
    spent["clock"] = time.process_time() - begun
    for name, seconds in spent.items():
        yield f"{name}, ms a frame", f"{1e3 * seconds / len(greys):.2f}"
    reception, shown = Reception(plan), 8.0 * film_of(MESSAGE, plan).repeat(2, axis=0) - 4.0
    for turn in range(100_000 // len(shown) + 1):
        times = [(turn * len(shown) + i) / 200 for i in range(len(shown))]
        for at in range(0, len(shown), 64):
            list(reception.push(shown[at : at + 64], times[at : at + 64]))
        if turn in (10, 100_000 // len(shown)):
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            yield f"MB after {(turn + 1) * len(shown)} frames", f"{pages * 4096 / 1e6:.0f}"


PARTS = {
    "links": (links, "messages.csv", COLUMNS),
    "options": (options, "messages_options.csv", COLUMNS),
    "soft": (soft, "messages_soft.csv", COLUMNS),
    "picture": (picture, None, ()),
    "load": (load, "messages_load.csv", ("what", "value")),
    "noise": (noise, "messages_noise.csv", ("code", "packets", "accepted")),
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
        with (RESULTS / file).open("w", newline="", encoding="utf-8") as out:
            writer = csv.writer(out, lineterminator="\n")
            writer.writerow(head)
            for row in rows():
                writer.writerow(row)
                out.flush()
                print(*row, flush=True)
