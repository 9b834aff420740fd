"""Pictures, films, arrays and live cameras as a sequence of frames."""

CHANNELS = ("luma", "max", "red", "green", "blue")
"""How colour becomes grey: Rec. 601 luma, the brightest channel, or one channel."""
