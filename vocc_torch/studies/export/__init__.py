"""``task=export``, frames for others: its section of the configuration; nothing here needs torch."""

from dataclasses import dataclass

from vocc_torch.errors import VoccError, demand_ranges, demand_word, within

POINTS = ("train", "test")
BLOCK = 64
MOST_SHARD = 8192
MOST_FRAMES = 10_000_000


@dataclass
class ExportConfig:
    """What ``task=export`` writes.

    Args:
        points: ``train`` exports the training frames, ``test`` the test frames at each value of the
            experiment.
        frames: frames per point, 1 to 10000000.
        shard_frames: frames per folder, a multiple of 64, 64 to 8192. A resumed run renders unfinished
            folders again.

    Raises:
        VoccError: a value out of its range.
    """

    points: str = "train"
    frames: int = within(1, MOST_FRAMES, default=1000, whole=True)
    shard_frames: int = 1024

    def __post_init__(self) -> None:
        """Check every range."""
        demand_word("export.points", self.points, POINTS)
        demand_ranges("export", self)
        if self.shard_frames not in range(BLOCK, MOST_SHARD + 1, BLOCK):
            rule = f"a multiple of {BLOCK} from {BLOCK} to {MOST_SHARD}"
            raise VoccError.of("export.shard_frames", self.shard_frames, rule)


@dataclass
class GraphConfig:
    """How ``task=export_receiver`` checks a graph.

    Args:
        frames: simulated frames on which the graph is compared with torch, at least 1.
    """

    frames: int = within(1, MOST_FRAMES, default=1024, whole=True)

    def __post_init__(self) -> None:
        """Check the range."""
        demand_ranges("export_receiver", self)
