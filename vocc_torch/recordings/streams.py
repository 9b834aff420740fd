"""Live frames: from a camera, from an address, or from a film on standard input."""

import os
import queue
import sys
import threading
import time
from collections.abc import Iterator
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
LOW_LATENCY = {"flags": "low_delay"}
CONNECT_TIMEOUT_S = 10.0
PIPE_QUEUE_FRAMES = 8
"""Frames read ahead of the receiver; a pipe then waits."""
CAMERA_QUEUE_FRAMES = 2
"""Frames read ahead of the receiver; a camera then drops the oldest."""


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
    try:
        if source == STANDARD_INPUT:
            return av.open(PipeReader(), options=dict(LOW_LATENCY))
        if source.startswith(CAMERA):
            driver, device = CAMERA_DRIVERS.get(sys.platform, CAMERA_DRIVERS["linux"])
            name = device.format(source.removeprefix(CAMERA))
            return av.open(name, format=driver, options=dict(LOW_LATENCY))
        options = (
            {**LOW_LATENCY, "rtsp_transport": "tcp"}
            if source.startswith("rtsp")
            else dict(LOW_LATENCY)
        )
        return av.open(source, options=options, timeout=CONNECT_TIMEOUT_S)
    except (av.error.FFmpegError, OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        if (
            source.startswith(ADDRESSES)
            and time.monotonic() - begun > CONNECT_TIMEOUT_S
        ):
            reason = f"no answer in {CONNECT_TIMEOUT_S:g} s"
        raise VoccError(f"input {source} cannot be opened ({reason})") from None


class LiveStream:
    """Frames of a live source, read by a thread of their own so that the newest is at hand.

    A pipe waits until the receiver has taken its frames, so that none is lost. A camera or an address does
    not wait: where the receiver is slower, the oldest frames are dropped and counted.

    Args:
        source: ``-``, ``camera:NUMBER`` or an address.
        channel: how colour becomes grey.
        grey_only: leave out the colour, which costs a fifth of the time.

    Raises:
        VoccError: a source that cannot be opened.
    """

    def __init__(self, source: str, channel: str, *, grey_only: bool = False) -> None:
        self.source = source
        self.channel = channel
        self.grey_only = grey_only
        self.dropped = 0
        self.is_closed = False
        self.container = opened(source)
        self.waits = source == STANDARD_INPUT
        capacity = PIPE_QUEUE_FRAMES if self.waits else CAMERA_QUEUE_FRAMES
        self.queue: queue.Queue[RecordedFrame | str | None] = queue.Queue(capacity)
        threading.Thread(target=self.fill, daemon=True).start()

    def fill(self) -> None:
        """Read until the source ends, in the thread."""
        av = av_library(self.source)
        end: str | None = None
        index = 0
        try:
            for picture in self.container.decode(video=0):
                name = "stdin" if self.waits else self.source
                if self.is_closed:
                    break
                for frame in frames_of(
                    picture,
                    name,
                    index,
                    self.channel,
                    self.grey_only,
                    time.monotonic(),
                ):
                    self.put(frame)
                    index += 1
        except (av.error.FFmpegError, IndexError, ValueError, OSError) as error:
            end = " ".join(str(error).split())
        self.queue.put(end)

    def put(self, frame: RecordedFrame) -> None:
        """Hand a frame on; where the queue of a camera is full its oldest frame is dropped."""
        while not self.waits and self.queue.full():
            try:
                self.queue.get_nowait()
                self.dropped += 1
            except queue.Empty:
                break
        self.queue.put(frame)

    def __iter__(self) -> Iterator[RecordedFrame]:
        """Give the frames as they arrive.

        Raises:
            VoccError: a source without frames, or one that fails.
        """
        is_empty = True
        while isinstance(item := self.queue.get(), RecordedFrame):
            is_empty = False
            yield item
        if item is not None:
            raise VoccError(f"input {self.source} ended ({item})")
        if is_empty:
            raise VoccError(f"input {self.source} has no frames")

    def close(self) -> None:
        """Let the source go; the thread ends with it."""
        self.is_closed = True
        while not self.queue.empty():
            self.queue.get_nowait()
