"""``decode.channel=auto``: find the mix that parts On from Off; ``unmix``: the colours sent at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from vocc_torch.arrays import Bytes, Numbers
from vocc_torch.receiver.discriminant import ClassScatter, Discriminant
from vocc_torch.receiver.features import cell_means
from vocc_torch.receiver.levels import GAMMA, LIGHT_OF_GREY
from vocc_torch.receiver.receiver import Decoded, Receiver
from vocc_torch.receiver.resample import cell_size_px, rectify
from vocc_torch.recordings import CHANNELS as GREY_CHANNELS
from vocc_torch.recordings.frames import to_grey
from vocc_torch.studies.decode import CHANNELS
from vocc_torch.studies.decode.judge import LIMITS, is_doubtful, parted
from vocc_torch.types import Frames, Panels, PanelShape


@dataclass(frozen=True)
class ColourSettings:
    """How planes are compared, and colours parted."""

    frames: int = 4  # of a recording that decide for all of it
    # A plane is taken instead of luma if it parts On from Off so many times as far.
    clearly: float = 1.2  # at luma's panel
    elsewhere: float = 2.0  # at another panel
    rounds: int = 30  # of unmixing, at most
    # Least singular value of bits of colours that differ, over the root of the rows.
    least_singular: float = 0.1
    least_parted: float = 4.0  # of a colour; one level that is split gives up to 3.5


SETTINGS = ColourSettings()


class Mix(NamedTuple):
    """One grey plane of a colour picture.

    Args:
        name: a channel of :func:`~vocc_torch.recordings.frames.to_grey`, or of the mix.
        weights: of red, green and blue; none for a channel.
        offset: grey value of a black pixel.
        linear: whether light is mixed, grey values freed of the camera's gamma, 255 being white.

    Example:
        >>> Mix("red - green", (1.0, -1.0, 0.0))(np.array([[[200, 90, 7]]], dtype=np.uint8)).item()
        110
    """

    name: str
    weights: tuple[float, ...] = ()
    offset: float = 0.0
    linear: bool = False

    def __call__(self, colour: Bytes) -> Bytes:
        """Turn (H,W,3) uint8 into (H,W) uint8; what is beyond 0 to 255 is clipped."""
        if not self.weights:
            return to_grey(colour, self.name)
        light = LIGHT_OF_GREY[colour] if self.linear else colour
        weights = np.array(self.weights, dtype=np.float32)
        mixed = np.float32(self.offset) + light @ weights
        if self.linear:
            mixed = 255 * (mixed / 255).clip(0, 1) ** (1 / GAMMA)
        return mixed.round().clip(0, 255).astype(np.uint8)

    def __str__(self) -> str:
        """Name it, with its weights."""
        parts = [
            f"{w:+.3g} {name} "
            for w, name in zip(self.weights, CHANNELS[2:5], strict=False)
        ]
        return self.name + f" ({''.join(parts)}{self.offset:+.3g})" * bool(parts)


FIXED = (
    *map(Mix, GREY_CHANNELS),
    # How much more of one colour than of the others: nothing that is white, grey or black has any.
    Mix("red beyond the others", (1.0, -0.5, -0.5)),
    Mix("green beyond the others", (-0.5, 1.0, -0.5)),
    Mix("blue beyond the others", (-0.5, -0.5, 1.0)),
)
"""What is tried before any panel is known."""


class Trial(NamedTuple):
    """Frames decoded in one plane.

    Args:
        sure: panels that are not doubtful.
        apart: mean of :func:`~vocc_torch.studies.decode.judge.parted`.
        mix: the plane.
        read: what was read.
    """

    sure: int
    apart: float
    mix: Mix
    read: Decoded


def channel_of(
    receiver: Receiver, colours: Sequence[Bytes], most: int = 1
) -> Trial | None:
    """Find the plane in which a receiver parts On from Off best; None where the frames are grey.

    Every plane of :data:`FIXED` is located and decoded. At the panels of the best one, mixes by
    :func:`fisher_mix` are made and decoded too. The planes are compared by frames whose panel is no doubtful
    one, then by the distance of On and Off. Luma stays where no other is clearly better, and where the others
    part On from Off no farther than one level of light is by chance.

    Args:
        receiver: locates and decides.
        colours: frames (H,W,3) uint8 of one size.
        most: panels of a frame, at most; the best one counts.
    """
    if all((colour == colour[..., :1]).all() for colour in colours):
        return None
    trials = [_tried(receiver, mix, colours, most) for mix in FIXED]
    read = _best(trials, receiver.shape).read
    cells = _cells(receiver, np.stack(colours), read.panels)
    bits = read.bits[read.found]
    on = torch.nn.functional.pad(bits, (1, 1, 1, 1))
    for mix in (
        fisher_mix("On against Off", cells[:, 1:-1, 1:-1], bits),
        fisher_mix("On against Off and surround", cells, on),
    ):
        if mix is not None:
            trials.append(_tried(receiver, mix, colours, most))
    return _best(trials, receiver.shape)


def _best(trials: Sequence[Trial], shape: PanelShape) -> Trial:
    """Choose the plane that parts best of those clearly better than luma and beyond chance; else luma."""
    luma = best = trials[0]
    corners_px = luma.read.corners_px
    reach_px = torch.maximum(*cell_size_px(corners_px, shape))
    for trial in trials:
        off_px = (trial.read.corners_px - corners_px).norm(dim=-1).amax(dim=-1)
        same = bool((off_px <= reach_px)[trial.read.found].all())
        times = SETTINGS.clearly if same else SETTINGS.elsewhere
        clearly = luma.apart * times * (trial.sure <= luma.sure)
        far = trial.apart >= max(LIMITS.least_parted, clearly)
        if far and trial.sure >= luma.sure and trial[:2] > best[:2]:
            best = trial
    return best


def _plane(receiver: Receiver, mix: Mix, colours: Sequence[Bytes]) -> torch.Tensor:
    """Mix the grey planes of colours of one size, where the receiver is."""
    planes = np.stack([mix(colour) for colour in colours])
    return torch.from_numpy(planes).to(receiver.device)


def _tried(
    receiver: Receiver, mix: Mix, colours: Sequence[Bytes], most: int = 1
) -> Trial:
    """Decode a mix of colours of one size: the best panel of each, of up to ``most``."""
    plane = _plane(receiver, mix, colours)
    if receiver.locator.finds_several:
        whose, several = receiver.decode_several(plane, most)
        first = torch.tensor([whose.index(number) for number in range(len(plane))])
        read = Decoded(*(batch[first] for batch in several))
    else:
        read = receiver.decode(plane)
    apart = torch.where(read.found, parted(read.scores, read.bits), 0.0)
    sure = int((read.found & ~is_doubtful(read)).sum())
    return Trial(sure, float(apart.mean()), mix, read)


def _cells(receiver: Receiver, colours: Numbers, panels: Panels) -> torch.Tensor:
    """Average the cells (n,R+2,C+2,3) of the panels found in colours (N,H,W,3)."""
    means, shape = [], receiver.shape
    for plane in torch.from_numpy(colours).permute(3, 0, 1, 2).to(receiver.device):
        patches = rectify(Frames.whole(plane.contiguous()), panels, shape, 8)
        means.append(cell_means(patches, shape).double())
    return torch.stack(means, dim=-1)[panels.found]


def fisher_mix(name: str, cells: torch.Tensor, on: torch.Tensor) -> Mix | None:
    """Weigh channels by Fisher's discriminant of the colours of On cells and of Off ones, in float64.

    A singular scatter, as of a colour that does not vary, is solved as :meth:`Discriminant.of` states: by the
    least norm, and where the means differ along a direction without scatter, mostly along that.

    Args:
        name: of the mix.
        cells: (B,R,C,3) float64 red, green and blue.
        on: (B,R,C) bool, the two groups.

    Returns:
        The mix in which On is brighter than Off and the cells take the middle half of 0 to 255; None where
        there are no two groups.
    """
    if on.all() or not on.any():
        return None
    rows = cells.reshape(-1, 3)
    scatter = ClassScatter.of_rows(rows, on.reshape(-1))
    direction = Discriminant.of(scatter)[0].direction
    low, high = (float(end) for end in (rows @ direction).aminmax())
    if not high > low:
        return None
    gain = 127.5 / (high - low)
    return Mix(name, tuple((direction * gain).tolist()), 63.75 - low * gain)


def unmixed(
    receiver: Receiver, colours: Sequence[Bytes]
) -> tuple[Mix, tuple[Mix, ...]]:
    """Find what part of each channel's light is of which colour of LEDs, where three send bits of their own.

    The panel is located in the plane of :data:`FIXED` that shows it best. Light of a cell is that of its Off
    LEDs, and of each that is On: bits are split channel by channel first, the colours' light follows by least
    squares, bits anew from what each colour then has, and so on until none changes.

    Args:
        receiver: locates.
        colours: frames (H,W,3) uint8 of one size.

    Returns:
        That plane, and three with the light of each colour as the channel has it that sees it best; none
        where there is no panel, where two colours, or a colour and none, send the same bits, and where On and
        Off of a colour lie no farther apart than one level of light does by chance.
    """
    trials = [_tried(receiver, mix, colours) for mix in FIXED]
    best = max(trials, key=lambda trial: trial[:2])
    panels = best.read.panels
    cells = _cells(receiver, LIGHT_OF_GREY[np.stack(colours)], panels)
    rows = cells[:, 1:-1, 1:-1].reshape(-1, 3)
    if not len(rows):
        return best.mix, ()
    bits = rows > (rows.amin(0) + rows.amax(0)) / 2
    least = SETTINGS.least_singular * len(rows) ** 0.5
    for _ in range(SETTINGS.rounds):
        design = torch.nn.functional.pad(bits.double(), (1, 0), value=1.0)
        if torch.linalg.svdvals(design)[-1] < least:
            return best.mix, ()
        light = torch.linalg.lstsq(design, rows, driver="gelsd").solution
        inverse = torch.linalg.pinv(light[1:])
        before, bits = bits, (rows - light[0]) @ inverse > 0.5
        if torch.equal(before, bits):
            break
    strength, channel = light[1:].max(1)
    inverse = inverse * strength
    offsets = light[0, channel] - light[0] @ inverse
    mixes = [
        Mix(name, tuple(weights), offset, True)
        for name, *weights, offset in zip(
            CHANNELS[2:5], *inverse.tolist(), offsets.tolist(), strict=True
        )
    ]
    for mix in mixes:
        with torch.inference_mode():
            read = receiver(_plane(receiver, mix, colours), panels)
        apart = parted(read.scores, read.bits)[panels.found].mean()
        # NaN where no panel is found, which is no distance either.
        if not apart >= SETTINGS.least_parted:
            return best.mix, ()
    return best.mix, tuple(mixes)
