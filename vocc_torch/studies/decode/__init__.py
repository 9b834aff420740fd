"""``task=decode``: its section of the configuration; nothing here needs torch."""

from dataclasses import dataclass

from vocc_torch.errors import VoccError, demand_word, whole_number
from vocc_torch.recordings import CHANNELS as GREY_CHANNELS

CHANNELS = (*GREY_CHANNELS, "auto", "unmix")
ARITHMETICS = ("float32", "int8")
FOLLOWS = ("true", "false", "auto")
TURNS = (0, 90, 180, 270)
MOST_SCALE = 16
MOST_PANELS = 64


@dataclass
class DecodeConfig:
    """How ``task=decode`` reads a recording, and what else it writes.

    Args:
        channel: how colour becomes grey: ``luma`` (Rec. 601), ``max`` (brightest channel), ``red``,
            ``green``, ``blue``, ``auto`` (the channel or mix with the best margins in the first frames), or
            ``unmix`` (three colours that one panel sends at once).
        annotate: write each picture with corners and bits drawn in; not for films.
        scale: enlarge annotated pictures by a whole number, 1 to 16.
        most: most panels per frame, 1 to 64. More than 1 needs a locator that finds several, such as the
            detector.
        follow: follow the panel from frame to frame and search the whole frame only now and then. ``true``
            does so in every source, even a folder of pictures; ``auto`` in films and live sources; ``false``
            never; null in live sources only.
        turn: turn each frame clockwise before reading, 0, 90, 180 or 270 degrees.
        mirror: exchange left and right after turning.
        newest: read the newest frame of a live source and drop those that wait for the receiver. Null does
            so for cameras and addresses; standard input waits.
        show: show each frame with corners and bits while it is read (extra ``viewer``).
        arithmetic: of the detector's networks: ``float32``, or ``int8``, which takes less time on a CPU
            (extra ``onnx``). Null takes the receiver's, float32 of those that ship.

    Raises:
        VoccError: an unknown channel, a number out of its range, or another word for ``follow``.
    """

    channel: str = "luma"
    annotate: bool = True
    scale: int = 1
    most: int = 1
    follow: str | None = None
    turn: int = 0
    mirror: bool = False
    newest: bool | None = None
    show: bool = False
    arithmetic: str | None = None

    def __post_init__(self) -> None:
        """Check the channel, the numbers and the word."""
        demand_word("decode.channel", self.channel, CHANNELS)
        if self.arithmetic is not None:
            demand_word("decode.arithmetic", self.arithmetic, ARITHMETICS)
        whole_number("decode.scale", self.scale, 1, MOST_SCALE)
        whole_number("decode.most", self.most, 1, MOST_PANELS)
        if self.follow is not None:
            self.follow = self.follow.lower()  # true and false are written by YAML too
            demand_word("decode.follow", self.follow, FOLLOWS)
        if self.scale > 1 and not self.annotate:
            raise VoccError.of(
                "decode.scale", self.scale, "1 where decode.annotate is false"
            )
        if self.turn not in TURNS:
            raise VoccError.of("decode.turn", self.turn, "0, 90, 180 or 270 degrees")

    @property
    def grey_only(self) -> bool:
        """Whether nothing but a film's own greys is used."""
        return self.channel == "luma" and not self.show

    @property
    def first_channel(self) -> str:
        """How colour becomes grey where a recording is read: luma until its channel is chosen."""
        return "luma" if self.channel in ("auto", "unmix") else self.channel
