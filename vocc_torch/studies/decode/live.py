"""Live decoding: each frame is read, printed and written as it arrives, until the source ends or Ctrl-C."""

import csv
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from vocc_torch.errors import VoccError
from vocc_torch.recordings.streams import LiveStream
from vocc_torch.studies.decode.reading import COLUMNS, Reading
from vocc_torch.studies.decode.summary import Summary, print_line
from vocc_torch.studies.decode.viewer import Viewer

MS_PER_S = 1000


def summarised(summary: Summary, latencies_s: Sequence[float], dropped: int) -> str:
    """Say in one line in how many frames a panel was found, and the latency.

    Args:
        summary: of the frames that were read.
        latencies_s: from a frame's arrival until its bits were written, for each frame.
        dropped: frames that were not read.

    Example:
        >>> summarised(Summary(frames=3, shown=2), [0.01, 0.02, 0.03], 1)
        'panel found in 2 of 3 frames; latency 20 ms, 29 ms at the 95th percentile; 1 frames dropped'
    """
    text = f"panel found in {summary.shown} of {summary.frames} frames"
    if latencies_s:
        median, high = MS_PER_S * np.quantile(latencies_s, [0.5, 0.95])
        text += f"; latency {median:.0f} ms, {high:.0f} ms at the 95th percentile"
    return text + f"; {dropped} frames dropped" * bool(dropped)


def decode_live(
    readings: Iterator[Reading],
    stream: LiveStream,
    path: Path,
    console: Console,
    viewer: Viewer | None,
) -> None:
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
    summary, latencies_s = Summary(), list[float]()
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        try:
            for reading in readings:
                table.writerow(reading.row())
                file.flush()
                summary.add(reading)
                if reading.frame.arrived_s is not None:
                    latencies_s.append(time.monotonic() - reading.frame.arrived_s)
                print_line(console, line_of(reading))
                if viewer is not None:
                    viewer.show(reading)
        except KeyboardInterrupt:
            pass
        finally:
            print_line(console, summarised(summary, latencies_s, stream.dropped))
    if not summary.frames:
        raise VoccError(f"input {stream.source}: no frame arrived")


def line_of(reading: Reading) -> str:
    """One line of the terminal for a frame: its time, its bits and their smallest margin."""
    time_s = reading.frame.time_s
    place = f"frame {reading.frame.index:6d}" if time_s is None else f"{time_s:9.3f} s"
    return (
        f"{place}  {reading.text}  margin {reading.margin:.3g}"
        if reading.found
        else f"{place}  no panel"
    )
