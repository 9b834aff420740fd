"""Frames as a video."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

from vocc_torch.arrays import Bytes
from vocc_torch.errors import library
from vocc_torch.files import atomic_file

SLOWEST_PARTS = 1001
"""Frame rates are written as fractions with at most this below."""


def write_video(
    path: Path, frames: Iterable[Bytes], fps: float, quality: int = 12
) -> None:
    """Write frames as H.264 in MP4; an odd last row or column is left out, as players ask for.

    Args:
        path: the file, replaced whole.
        frames: (H,W) uint8 greys, or (H,W,3) colours, of one size, one by one.
        fps: frames a second.
        quality: x264's constant rate factor, 0 (lossless) to 51.

    Raises:
        VoccError: PyAV is not installed, there are no frames, or the file cannot be written.
    """
    av = library("av", "video", f"{path} is a video")
    # What says how to read it goes first, so that a film which is cut can be read up to there.
    first = {"movflags": "faststart"}
    with (
        atomic_file(path) as temporary,
        av.open(str(temporary), "w", options=first) as container,
    ):
        rate = Fraction(fps).limit_denominator(SLOWEST_PARTS)
        stream = container.add_stream(
            "libx264", rate=rate, options={"crf": str(quality), "preset": "fast"}
        )
        stream.pix_fmt = "yuv420p"
        for number, shown in enumerate(frames):
            even = np.ascontiguousarray(
                shown[: len(shown) // 2 * 2, : shown.shape[1] // 2 * 2]
            )
            if not number:
                stream.height, stream.width = even.shape[:2]
            picture = av.VideoFrame.from_ndarray(
                even, format="gray" if even.ndim == 2 else "rgb24"
            )
            picture.pts = number
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
