"""How far messages carry: packets of recordings over scenes, distances and camera rates, soft against hard.

``python benchmarks/messages.py [PART ...]`` writes docs/results/messages.csv, messages_noise.csv and
messages_clock.csv; parts are links, options, noise and clock.
"""

import csv
import sys
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
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.recording import Shutter, record
from vocc_torch.simulation.scene import narrowed

RESULTS = Path(__file__).parents[1] / "docs" / "results"
SHAPE = PanelShape(8, 8)
MESSAGE = np.random.default_rng(16).bytes(2000)
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


def rows_of(part, receivers, scene, distance, fps, options, softs, dropped=0.0):
    """Rows of one recording."""
    if scene not in receivers:
        learned = train(scene, locator="truth", classifier="flda_3", frames=256)
        learned.locator = RefinedLocator()
        receivers[scene] = learned, load_scene(scene)
    receiver, world = receivers[scene]
    scores, ber, spent, seconds = recorded(receiver, world, distance, fps, options, dropped)
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
    for scene, distance, fps in product(("night", "dashcam"), (30, 50, 70, 90, 110), (240, 150)):
        for code in ("ldpc", "rs"):
            softs = ("calibrated", "scores", "hard") if code == "ldpc" else ("calibrated",)
            yield from rows_of("links", receivers, scene, distance, fps, Signalling(code=code), softs)


def options():
    """With and without interleaving where every fifth frame is lost."""
    receivers = {}
    for code, interleave, distance in product(("ldpc", "rs"), (True, False), (70, 90)):
        own = Signalling(code=code, interleave=interleave)
        yield from rows_of("options", receivers, "night", distance, 150, own, ("calibrated",), 0.2)


def noise():
    """Packets of noise: words of random soft values, and bits of the checksum."""
    draws = np.random.default_rng(16)
    for code in ("ldpc", "rs", "none"):
        layout = Layout(MessagePlan(SHAPE, Signalling(code=code)))
        coder, accepted, words = code_of(layout), 0, 10_000
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
        for _ in range(10):
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
        yield ratio, drift, 10, total, f"{found / total:.5f}", f"{right / frames:.5f}", twice


def mixed(shown, times, exposure=0.07, readout=0.03):
    """Light of exposures that catch two symbols, row by row; and the symbols that they begin with."""
    rows = shown.shape[1]
    begins = times[:, None] + np.arange(rows) / rows * readout
    first, last = np.floor(begins).astype(int), np.floor(begins + exposure).astype(int)
    share = np.where(last > first, (last - begins) / exposure, 1.0)[..., None]
    at, most = np.arange(rows), len(shown) - 1
    light = shown[np.minimum(first, most), at] * share + shown[np.minimum(last, most), at] * (1 - share)
    return light, first[:, 0]


PARTS = {
    "links": (links, "messages.csv", COLUMNS),
    "options": (options, "messages_options.csv", COLUMNS),
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
        with (RESULTS / file).open("w", newline="", encoding="utf-8") as out:
            writer = csv.writer(out, lineterminator="\n")
            writer.writerow(head)
            for row in rows():
                writer.writerow(row)
                out.flush()
                print(*row, flush=True)
