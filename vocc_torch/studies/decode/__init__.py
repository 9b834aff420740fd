"""``task=decode``: its section of the configuration; nothing here needs torch."""

from dataclasses import dataclass

from vocc_torch.errors import VoccError

CHANNELS = ("luma", "max", "red", "green", "blue", "auto", "unmix")
FOLLOWS = ("true", "false", "auto")
TURNS = (0, 90, 180, 270)
MOST_SCALE = 16
MOST_PANELS = 64


@dataclass
class DecodeConfig:
    """How ``task=decode`` reads a recording, and what it writes besides the bits.

    Args:
        channel: how colour becomes grey: ``luma`` (Rec. 601), ``max`` (brightest channel), ``red``,
            ``green``, ``blue``, ``auto``: the channel or mix that the first frames are read best in, or
            ``unmix``: three colours sent at once on one panel, each read by itself.
        annotate: whether each picture is written with the panel and the bits drawn in; of a video none is.
        scale: enlarge annotated pictures by this whole number, 1 to 16.
        most: panels that are read in a frame, at most, 1 to 64; more than one only with the detector,
            or one from outside that finds several.
        follow: whether the panel is followed from frame to frame, with a full search only now and then:
            ``true`` for a recording in order, ``auto`` for videos alone, ``false`` where each frame stands
            for itself; null follows in a live source alone.
        turn: clockwise angle by which each frame is turned before it is read, 0, 90, 180 or 270 degrees, for
            a panel that does not hang upright.
        mirror: whether left and right are then exchanged, for a panel that is seen in a mirror.
        show: whether a viewer shows each frame with corners and bits while it is read (extra ``viewer``).

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
    show: bool = False

    def __post_init__(self) -> None:
        """Check the channel, the numbers and the word."""
        if self.channel not in CHANNELS:
            raise VoccError.of(
                "decode.channel", repr(self.channel), f"one of {', '.join(CHANNELS)}"
            )
        if not 1 <= self.scale <= MOST_SCALE:
            raise VoccError.of("decode.scale", self.scale, f"from 1 to {MOST_SCALE}")
        if self.follow is not None:
            self.follow = self.follow.lower()  # true and false are written by YAML too
            if self.follow not in FOLLOWS:
                raise VoccError.of(
                    "decode.follow", repr(self.follow), "true, false or auto"
                )
        if self.scale > 1 and not self.annotate:
            raise VoccError.of(
                "decode.scale", self.scale, "1 where decode.annotate is false"
            )
        if not 1 <= self.most <= MOST_PANELS:
            raise VoccError.of("decode.most", self.most, f"from 1 to {MOST_PANELS}")
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
