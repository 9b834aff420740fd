"""Live latency: films played at the pace of a camera into ``vocc-torch task=decode input=-``.

Each frame is written into the pipe when a camera would take it. ``ms`` is the latency that the command states,
``printed_ms`` the time from when the frame is due until its line is printed, waits in pipe and container included.
Two films of 1280 x 720 px are drawn: the photographed panel of ``tests/data``, 260 px wide on grey (``easy``) and
56 px wide before another photograph (``hard``).

    python benchmarks/live.py --csv docs/results/live.csv
"""

import argparse
import csv
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import IO

import av
import numpy as np
from PIL import Image

DATA = Path(__file__).resolve().parents[1] / "tests/data"
SIZE = 1280, 720
FPS = 30, 60
TURN_FRAMES = 180
PANEL_PX = {"easy": 260, "hard": 56}
OPTION = "decode.newest=true"


def drawn(path: Path, frames: int) -> Path:
    """Encode a film, named by its difficulty, in which the panel drifts by a few pixels a frame."""
    panel_px = PANEL_PX[path.stem]
    background = Image.new("RGB", SIZE, (90, 90, 90))
    if path.stem == "hard":
        desk = Image.open(DATA / "led-matrix-8x16-desk.jpg").convert("RGB")
        background = desk.crop((0, 0, desk.width, desk.height // 2)).resize(SIZE)
    photo = Image.open(DATA / "led-panel-8x8-photo.png").convert("RGB")
    panel = photo.resize((panel_px, panel_px))
    with av.open(str(path), "w") as container:
        stream = container.add_stream(
            "libx264", rate=30, options={"tune": "zerolatency"}
        )
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for number in range(frames):
            angle = 2 * np.pi * number / TURN_FRAMES
            shift = np.array([np.cos(angle), np.sin(angle)]) * 100
            place = np.rint(np.array(SIZE) / 2 + shift - panel_px / 2).astype(int)
            frame = background.copy()
            frame.paste(panel, tuple(place.tolist()))
            container.mux(stream.encode(av.VideoFrame.from_image(frame)))
        container.mux(stream.encode())
    return path


def play(film: Path, fps: int, pipe: IO[bytes], due_s: list[float]) -> None:
    """Copy a film's packets into a pipe as MPEG-TS, and note when each is due."""
    with (
        av.open(str(film)) as source,
        av.open(pipe, "w", format="mpegts", options={"flush_packets": "1"}) as sink,
    ):
        stream = source.streams.video[0]
        copy = sink.add_stream_from_template(stream)
        begun_s = time.monotonic()
        for number, packet in enumerate(source.demux(stream)):
            if packet.dts is None:
                break
            due_s.append(begun_s + number / fps)
            time.sleep(max(0.0, due_s[-1] - time.monotonic()))
            packet.stream = copy
            sink.mux(packet)
    pipe.close()


def played(film: Path, fps: int) -> dict[str, object]:
    """Play a film into the command; give frames read and latencies from due time to printed line.

    Frames that are due before the command prints its first line, while it starts, are left out.
    """
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "vocc_torch", "task=decode", "input=-"]
        run = subprocess.Popen(
            [*command, "name=live", OPTION],
            bufsize=0,
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        assert run.stdin is not None
        assert run.stdout is not None
        due_s: list[float] = []
        given = film, fps, run.stdin, due_s
        threading.Thread(target=play, args=given, daemon=True).start()
        lines = [(line.decode(), time.monotonic()) for line in run.stdout]
        if run.wait() != 0:
            raise SystemExit(f"the command ended with status {run.returncode}")
        with (Path(folder) / "runs/live/bits.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
    printed_s = [at for line, at in lines if " s  " in line[:14]]
    places = [int(row["frame"]) for row in rows]
    first = int(np.searchsorted(due_s, printed_s[0]))
    late = [
        at - due_s[place]
        for place, at in zip(places, printed_s, strict=True)
        if place >= first
    ]
    (summary,) = (line for line, _ in lines if "panel found in" in line)
    (stated,) = re.findall(r"latency (\d+) ms, (\d+) ms", summary)
    median, high = 1000 * np.quantile(late, [0.5, 0.95])
    return {
        "film": film.stem,
        "fps": fps,
        "options": OPTION,
        "frames": len(due_s) - first,
        "read": len(late),
        "ms": stated[0],
        "ms_95": stated[1],
        "printed_ms": f"{median:.0f}",
        "printed_ms_95": f"{high:.0f}",
    }


def main() -> None:
    """Play each film at each pace."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=600, help="of each film")
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = []
        for name in PANEL_PX:
            film = drawn(Path(folder) / f"{name}.mp4", given.frames)
            for fps in FPS:
                rows.append(played(film, fps))
                print(*rows[-1].values())
    if given.csv:
        with given.csv.open("w", newline="") as file:
            table = csv.DictWriter(file, rows[0], lineterminator="\n")
            table.writeheader()
            table.writerows(rows)


if __name__ == "__main__":
    main()
