"""Keyed random streams: every draw is a function of (seed, point, block, stream), and of nothing else."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

BLOCK_FRAMES = 64
"""Frames in a block, the unit of random draws and of Monte Carlo bookkeeping."""


def training_point(number: int) -> str:
    """Name the point of a training's frames; the first is the training of a receiver that is trained once.

    No test point is called so: an experiment's name has no slash, and is not ``train``.

    Example:
        >>> training_point(0), training_point(3)
        ('train', 'train/3')
    """
    return f"train/{number}" if number else "train"


def _words(text: str) -> list[int]:
    """Hash a name to four 32-bit words that do not depend on Python's hash seed."""
    digest = hashlib.sha256(text.encode(errors="surrogatepass")).digest()
    return list(map(int, np.frombuffer(digest, "<u4", 4)))


@dataclass(frozen=True, slots=True)
class BlockKey:
    """The name of one block of frames, from which its random streams follow.

    Batch size, device and number of workers are not part of the key, so they cannot change a draw.

    Args:
        seed: root seed, an integer of at least 0.
        point: name of the study point, for instance ``"ambient/ambient_lx=4000"``.
        block: index of the block within the point, at least 0.

    Example:
        >>> key = BlockKey(seed=0, point="train", block=3)
        >>> float(key.generator("bits").random()) == float(key.generator("bits").random())
        True
        >>> float(key.generator("bits").random()) == float(key.generator("distance_m").random())
        False
    """

    seed: int
    point: str
    block: int

    def generator(self, stream: str) -> np.random.Generator:
        """Give a fresh generator of the named stream; the same name gives the same numbers again."""
        return np.random.Generator(np.random.PCG64(self._sequence(stream)))

    def tiles(self, stream: str) -> Callable[[int, int], np.random.Generator]:
        """Give a fresh generator of each tile of a plane, by its row and column, of the named stream.

        A tile's numbers do not depend on which other tiles are drawn. They come from SFC64, the quickest of
        NumPy's generators, which makes up for the time that a seed for each tile costs.

        Example:
            >>> tile = BlockKey(seed=0, point="train", block=3).tiles("effect.read_noise")
            >>> float(tile(2, 5).random()) == float(tile(2, 5).random())
            True
            >>> float(tile(2, 5).random()) == float(tile(5, 2).random())
            False
        """
        root = self._sequence(stream).generate_state(4)

        def tile(row: int, column: int) -> np.random.Generator:
            sequence = np.random.SeedSequence(root, spawn_key=(row, column))
            return np.random.Generator(np.random.SFC64(sequence))

        return tile

    def _sequence(self, stream: str) -> np.random.SeedSequence:
        """Give the seeds of the named stream."""
        words = [self.seed, self.block, *_words(self.point), *_words(stream)]
        # NumPy reads an array of the same words some times faster than a list of numbers of any size.
        short = max(self.seed, self.block) < 1 << 32
        return np.random.SeedSequence(
            np.array(words, dtype=np.uint32) if short else words
        )


@dataclass(frozen=True, slots=True)
class FrameKey:
    """The name of one rendered frame, from which the random streams of its effects follow.

    Args:
        block: the block that the frame belongs to.
        frame: its index in the block, 0 to 63.
        take: which picture of the scene it is: the test frame, or a preamble; each has noise of its own, and
            shares what belongs to the scene.

    Example:
        >>> block = BlockKey(seed=0, point="doc", block=0)
        >>> keys = [FrameKey(block, 5), FrameKey(block, 5, "on"), FrameKey(block, 6)]
        >>> len({float(key.generator("read_noise").random()) for key in keys})
        3
        >>> len({float(key.generator("stuck_leds", of_scene=True).random()) for key in keys})
        2
    """

    block: BlockKey
    frame: int
    take: str = "frame"

    def generator(self, stream: str, *, of_scene: bool = False) -> np.random.Generator:
        """Give a fresh generator of the named stream; the same name gives the same numbers again.

        Args:
            stream: the name.
            of_scene: draw what belongs to the scene and so is the same in all its takes, not to one picture.
        """
        take = "" if of_scene else f"/{self.take}"
        return self.block.generator(f"{stream}{take}/{self.frame}")

    def tiles(self, stream: str) -> Callable[[int, int], np.random.Generator]:
        """Give a fresh generator of each tile of this picture; see :meth:`BlockKey.tiles`."""
        return self.block.tiles(f"{stream}/{self.take}/{self.frame}")


def sensor_generator(seed: int, stream: str) -> np.random.Generator:
    """Give a fresh generator of what belongs to the sensor: the same in every frame of a run.

    Args:
        seed: the run's root seed, at least 0.
        stream: the name of what is drawn, for instance ``"effect.prnu/0/3"``.

    Example:
        >>> float(sensor_generator(0, "prnu").random()) == float(sensor_generator(0, "prnu").random())
        True
    """
    entropy = [seed, *_words("sensor"), *_words(stream)]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy)))
