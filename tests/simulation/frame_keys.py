"""Keys of frames, by which effects draw their numbers."""

from vocc_torch.rng import BlockKey, FrameKey


def frame_keys(point, frames, *, take="frame", start=0, seed=0):
    """Keys of frames from a number on, block by block."""
    return [
        FrameKey(BlockKey(seed, point, number // 64), number % 64, take)
        for number in range(start, start + frames)
    ]
