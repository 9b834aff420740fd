"""Live frames: from a camera, from an address, or from a film on standard input."""

import os
import queue
import re
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from typing import Any

from vocc_torch.errors import VoccError
from vocc_torch.recordings.films import av_library, frames_of
from vocc_torch.recordings.frames import RecordedFrame

STANDARD_INPUT = "-"
CAMERA = "camera:"
ADDRESSES = ("rtsp://", "rtsps://", "http://", "https://")
CAMERA_DRIVERS = {
    "linux": ("v4l2", "/dev/video{}"),
    "darwin": ("avfoundation", "{}"),
    "win32": ("dshow", "video={}"),
}
"""FFmpeg's camera driver and device name of each system."""
SHORT_PROBE = {"fpsprobesize": "0"}
"""No frames are gathered to find the rate: MPEG-TS opens 20 frames sooner."""
CONNECT_TIMEOUT_S = 10.0
UNHELPFUL = re.compile(r"^\[Errno \d+\] |: '<none>'$")
"""FFmpeg's own error number, and its name for standard input."""


def is_stream(source: str) -> bool:
    """Whether an input is live: a camera, an address or standard input.

    Example:
        >>> is_stream("camera:0"), is_stream("-"), is_stream("film.mp4")
        (True, True, False)
    """
    return source == STANDARD_INPUT or source.startswith((CAMERA, *ADDRESSES))


class PipeReader:
    """Standard input as a file that FFmpeg reads forward only."""

    def read(self, size: int) -> bytes:
        """Read at most ``size`` bytes as soon as there are any."""
        return os.read(sys.stdin.fileno(), size)


def opened(source: str) -> Any:
    """Open a live source with PyAV.

    Raises:
        VoccError: PyAV is missing, or the source cannot be opened.
    """
    av, begun = av_library(source), time.monotonic()
    file: str | PipeReader = source
    driver, timeout_s, options = None, None, dict(SHORT_PROBE)
    if source == STANDARD_INPUT:
        file = PipeReader()
    elif source.startswith(CAMERA):
        driver, device = CAMERA_DRIVERS.get(sys.platform, CAMERA_DRIVERS["linux"])
        file = device.format(source.removeprefix(CAMERA))
    else:
        timeout_s = CONNECT_TIMEOUT_S
        if source.startswith("rtsp"):
            options["rtsp_transport"] = "tcp"
    try:
        return av.open(file, format=driver, options=options, timeout=timeout_s)
    except (av.error.FFmpegError, OSError, ValueError) as error:
        reason = UNHELPFUL.sub("", " ".join(str(error).split()))
        if timeout_s and time.monotonic() - begun > timeout_s:
            reason = f"no answer in {timeout_s:g} s"
        raise VoccError(f"input {source} cannot be opened ({reason})") from None


@dataclass(eq=False, repr=False)
class LiveStream:
    """Frames of a live source, read by a thread of their own; at most one waits for the receiver.

    Where the receiver is slower, either the waiting frame gives way to the newest and is counted, or the
    thread reads no further until it is taken.

    Args:
        source: ``-``, ``camera:NUMBER`` or an address.
        channel: how colour becomes grey.
        grey_only: leave out the colour, which costs a fifth of the time.
        newest: whether waiting frames are dropped; None drops those of cameras and addresses only.

    Raises:
        VoccError: a source that cannot be opened.
    """

    source: str
    channel: str
    grey_only: bool = False
    newest: bool | None = None

    def __post_init__(self) -> None:
        """Open the source, and begin to read."""
        if self.newest is None:
            self.newest = self.source != STANDARD_INPUT
        self.dropped = 0
        self.is_closed = False
        self.container = opened(self.source)
        self.queue: queue.Queue[RecordedFrame | str] = queue.Queue(1)
        threading.Thread(target=self.fill, daemon=True).start()

    def fill(self) -> None:
        """Read until the source ends, in the thread."""
        av = av_library(self.source)
        name = "stdin" if self.source == STANDARD_INPUT else self.source
        picture, numbers, failure = None, count(), ""
        try:
            for picture in self.container.decode(video=0):
                if self.is_closed:
                    break
                now = time.monotonic()
                for frame in frames_of(
                    picture, name, numbers, self.channel, self.grey_only, now
                ):
                    self.put(frame)
        except (av.error.FFmpegError, IndexError, ValueError, OSError) as error:
            reason = " ".join(str(error).split())
            if self.source == STANDARD_INPUT and picture is None:
                reason += "; it takes Matroska, MPEG-TS or YUV4MPEG"
            failure = f"ended ({reason})"
        self.queue.put(failure if picture or failure else "has no frames")

    def put(self, frame: RecordedFrame) -> None:
        """Hand a frame on: in the place of the one that waits, or wait until it is taken."""
        if self.is_closed:
            return
        if self.newest:
            with suppress(queue.Empty):
                self.queue.get_nowait()
                self.dropped += 1
        self.queue.put(frame)
        if not self.newest:
            self.queue.join()

    def __iter__(self) -> Iterator[RecordedFrame]:
        """Give the frames as they arrive.

        Raises:
            VoccError: a source without frames, or one that fails.
        """
        while isinstance(item := self.queue.get(), RecordedFrame):
            self.queue.task_done()
            yield item
        if item:
            raise VoccError(f"input {self.source} {item}")

    def close(self) -> None:
        """Let the source go; the thread ends with it."""
        self.is_closed = True
        with suppress(queue.Empty):
            self.queue.get_nowait()
            self.queue.task_done()
