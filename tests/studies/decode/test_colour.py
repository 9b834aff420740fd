"""``decode.channel=auto``: the plane that parts On from Off is found, and luma stays where none is better."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

import vocc_torch as vt
from vocc_torch.errors import VoccError
from vocc_torch.measure.train import receiver_for
from vocc_torch.receiver.features import cell_means
from vocc_torch.receiver.locators import DetectorLocator
from vocc_torch.receiver.resample import rectify
from vocc_torch.recordings.frames import RecordedFrame
from vocc_torch.recordings.reading import read_recording
from vocc_torch.studies.decode.colour import FIXED, fisher_mix, unmixed
from vocc_torch.studies.decode.decoder import in_channel
from vocc_torch.studies.decode.reading import read_panels
from vocc_torch.types import Frames, Panels, PanelShape

SHAPE = PanelShape(8, 8)


@pytest.fixture(scope="module")
def receiver(make_plan):
    return receiver_for(make_plan(locator="paper", training_frames=64))


def red_on_white(noise=3.0, frames=1):
    """A dark board with red LEDs before a white wall, (N,H,W,3) uint8, and its bits (N,8,8)."""
    rng = np.random.default_rng(4)
    bits = rng.random((frames, 8, 8)) < 0.5
    picture = np.full((frames, 140, 150, 3), 210.0)
    picture[:, 22:118, 27:123] = 20.0
    spot = np.exp(-((np.arange(12) - 5.5) ** 2) / 18)
    lit = np.kron(bits, np.outer(spot, spot)[None])
    picture[:, 22:118, 27:123] += lit[..., None] * np.array([180.0, 8.0, 4.0])
    return (picture + rng.normal(0, noise, picture.shape)).round().clip(0, 255).astype(
        np.uint8
    ), bits


def recorded(colours):
    for index, colour in enumerate(colours):
        yield RecordedFrame("film.png", index, None, colour, FIXED[0](colour))


def test_a_red_panel_on_white_is_read_in_its_colour(receiver):
    """White is brighter than red LEDs by luma; in the plane that is found no bit of six frames is wrong."""
    colours, bits = red_on_white(frames=6)
    by_luma = list(read_panels(receiver, recorded(colours)))
    assert all(
        (one.bits != bit).mean() > 0.1 for one, bit in zip(by_luma, bits, strict=True)
    )
    frames, told, _ = in_channel(receiver, recorded(colours), "auto")
    read = list(read_panels(receiver, frames))
    assert len(read) == 6
    assert np.array_equal([one.bits for one in read], bits)
    assert "red" in told
    assert "in the first 4 frames" in told
    assert np.array_equal(read[5].frame.colour, colours[5])


def test_grey_pictures_are_luma_to_the_byte(receiver):
    colours, _ = red_on_white(frames=2)
    greys = colours[..., :1].repeat(3, axis=-1)
    frames, told, _ = in_channel(receiver, recorded(greys), "auto")
    assert all(np.array_equal(one.grey, greys[one.index, ..., 0]) for one in frames)
    assert told == "decode.channel=auto: luma, for the first 2 frames are grey"


def corners(left, top, right, bottom):
    return torch.tensor(
        [[[left, top], [right, top], [right, bottom], [left, bottom]]],
        dtype=torch.float64,
    )


@pytest.mark.parametrize("margin", [False, True])
def test_the_mix_is_the_discriminant_of_scikit_learn(margin):
    """Their directions agree to 1e-6, On is brighter, and the cells take the middle half of the greys."""
    (colour,), (bits,) = red_on_white(noise=12.0)
    takes = [
        Frames.whole(torch.from_numpy(np.ascontiguousarray(colour[..., i])))
        for i in range(3)
    ]
    panels = Panels.known(corners(27.0, 22.0, 123.0, 118.0))
    cells = torch.stack(
        [cell_means(rectify(take, panels, SHAPE, 8), SHAPE).double() for take in takes],
        dim=-1,
    )
    inside = slice(None) if margin else slice(1, -1)
    cells = cells[:, inside, inside]
    on = np.pad(bits, 1) if margin else bits
    mix = fisher_mix("mix", cells, torch.from_numpy(on)[None])
    weights, rows, on = mix.weights, cells.reshape(-1, 3).numpy(), on.ravel()
    (theirs,) = LinearDiscriminantAnalysis(solver="eigen").fit(rows, on).coef_
    cosine = np.dot(theirs, weights) / np.linalg.norm(theirs) / np.linalg.norm(weights)
    assert cosine == pytest.approx(1, abs=1e-6)
    mixed = rows @ np.array(weights) + mix.offset
    assert mixed[on].mean() > mixed[~on].mean()
    assert (mixed.min(), mixed.max()) == pytest.approx((63.75, 191.25))


def three_colours(leak, frames=2, gamma=2.2):
    """A board whose LEDs shine in three colours that leak into all channels, and the bits (N,3,8,8)."""
    rng = np.random.default_rng(7)
    bits = rng.random((frames, 3, 8, 8)) < 0.5
    light = np.full((frames, 140, 150, 3), 0.01)
    light[:, 22:118, 27:123] = 0.02
    spot = np.exp(-((np.arange(12) - 5.5) ** 2) / 18)
    for colour in range(3):
        lit = np.kron(bits[:, colour], np.outer(spot, spot)[None])
        light[:, 22:118, 27:123] += 0.3 * lit[..., None] * leak[colour]
    grey = 255 * light ** (1 / gamma) + rng.normal(0, 2.0, light.shape)
    return grey.round().clip(0, 255).astype(np.uint8), bits


LEAK = np.array([[1.0, 0.35, 0.05], [0.4, 1.0, 0.3], [0.1, 0.45, 1.0]])


@pytest.mark.parametrize("follow", ["false", "true"])
def test_three_colours_that_leak_are_read_each_by_itself(receiver, follow):
    """Without a wrong bit, where single channels have many; the mixes undo the leak."""
    colours, bits = three_colours(LEAK)
    frames, told, lights = in_channel(receiver, recorded(colours), "unmix")
    read = list(read_panels(receiver, frames, follow=follow, lights=lights))
    assert [one.row()[-1] for one in read] == ["red", "green", "blue"] * 2
    assert np.array_equal(
        np.stack([one.bits for one in read]).reshape(2, 3, 8, 8), bits
    )
    assert told.startswith("decode.channel=unmix: red (")
    own = np.array([one.weights for one in unmixed(receiver, list(colours))[1]])
    ratio = LEAK @ own.T  # of each colour's light in each plane
    assert np.abs(ratio / ratio.diagonal() - np.eye(3)).max() < 0.1
    mixed = [
        next(read_panels(receiver, iter([replace(one, grey=one.colour[..., 1])])))
        for one in recorded(colours)
    ]
    assert (
        np.mean(
            [(one.bits != bit[1]).mean() for one, bit in zip(mixed, bits, strict=True)]
        )
        > 0.02
    )


def test_a_photograph_of_one_colour_is_not_unmixed(photo):
    """Two of three colours that least squares makes of it have On and Off that lie together."""
    receiver = vt.train("paper", classifier="tag_planes", frames=64)
    receiver.locator = DetectorLocator()
    with pytest.raises(
        VoccError, match=r"decode\.channel is unmix: it must be auto, or one channel"
    ):
        in_channel(receiver, read_recording(photo, "luma"), "unmix")
