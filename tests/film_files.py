"""Films that tests write."""

import av
import numpy as np


def write_film(path, frames, codec="mpeg4", interlaced=False):
    """Encode grey frames (N,H,W) or colours (N,H,W,3), uint8, at 25 frames a second."""
    with av.open(str(path), "w") as container:
        options = {"flags": "+ildct+ilme", "top": "1"} if interlaced else {}
        stream = container.add_stream(codec, rate=25, options=options)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt, stream.bit_rate = "yuv420p", 20_000_000
        for frame in frames:
            colour = frame if frame.ndim == 3 else np.repeat(frame[..., None], 3, 2)
            picture = av.VideoFrame.from_ndarray(colour, format="rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path
