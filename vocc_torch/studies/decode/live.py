"""Live decoding: each frame is read, printed and written as it arrives, until the source ends or Ctrl-C."""

import csv
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.recordings.streams import LiveStream
from vocc_torch.studies.decode.reading import COLUMNS, Reading
from vocc_torch.studies.decode.summary import print_line
from vocc_torch.studies.decode.viewer import Viewer

MS_PER_S = 1000


@dataclass
class LiveRun:
    """Counts of a live run.

    Args:
        frames: frames that were read.
        found: frames that show a panel.
        latencies_s: from a frame's arrival until its bits were written, for each frame.
    """

    frames: int = 0
    found: int = 0
    latencies_s: list[float] = field(default_factory=list)

    def add(self, reading: Reading) -> None:
        """Count a frame that was written just now."""
        self.frames += 1
        self.found += reading.found
        if reading.frame.arrived_s is not None:
            self.latencies_s.append(time.monotonic() - reading.frame.arrived_s)

    def summary(self, dropped: int) -> str:
        """Say in one line how many frames show a panel, and how long they took.

        Example:
            >>> LiveRun(3, 2, [0.01, 0.02, 0.03]).summary(1)
            '2 of 3 frames show a panel; latency 20 ms, 29 ms at the 95th percentile; 1 frames dropped'
        """
        text = f"{self.found} of {self.frames} frames show a panel"
        if self.latencies_s:
            median, high = MS_PER_S * np.quantile(self.latencies_s, [0.5, 0.95])
            text += f"; latency {median:.0f} ms, {high:.0f} ms at the 95th percentile"
        return text + f"; {dropped} frames dropped" * bool(dropped)


def decode_live(
    readings: Iterator[Reading],
    stream: LiveStream,
    path: Path,
    console: Console,
    viewer: Viewer | None,
) -> LiveRun:
    """Print and write readings as they come; Ctrl-C ends them in order.

    Args:
        readings: what the receiver reads of the stream.
        stream: where the frames come from.
        path: the table of the bits, of which each row is on the disk once it is printed.
        console: where a line a frame is printed.
        viewer: shows each frame, or None.

    Raises:
        VoccError: the source fails; the table has the frames until then.
    """
    run = LiveRun()
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        try:
            for reading in readings:
                table.writerow(reading.row())
                file.flush()
                run.add(reading)
                print_line(console, line_of(reading))
                if viewer is not None:
                    viewer.show(reading)
        except KeyboardInterrupt:
            pass
        finally:
            print_line(console, run.summary(stream.dropped))
    if not run.frames:
        raise VoccError(f"input {stream.source}: no frame arrived")
    return run


def line_of(reading: Reading) -> str:
    """One line of the terminal for a frame: its time, its bits and their smallest margin."""
    time_s = reading.frame.time_s
    place = f"frame {reading.frame.index:6d}" if time_s is None else f"{time_s:9.3f} s"
    return (
        f"{place}  {reading.text}  margin {reading.margin:.3g}"
        if reading.found
        else f"{place}  no panel"
    )
