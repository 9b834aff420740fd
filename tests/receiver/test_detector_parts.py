"""The detector's stages, each against another program or a closed form."""

import cv2
import numpy as np
import pytest
import torch
from scipy.ndimage import maximum_filter
from skimage.filters import threshold_otsu

from vocc_torch.receiver.detector import pyramid as pyramid_file
from vocc_torch.receiver.detector.clues import alignment, randomness, two_levels
from vocc_torch.receiver.detector.fit import fitted
from vocc_torch.receiver.detector.judge import judged
from vocc_torch.receiver.detector.pyramid import Pyramid, bilinear, gate
from vocc_torch.receiver.detector.scout import Scout, distinct, peaks
from vocc_torch.types import PanelShape


def noise(*size: int, seed: int = 0) -> torch.Tensor:
    """Draw numbers, 0 to 255."""
    return 255 * torch.rand(*size, generator=torch.Generator().manual_seed(seed))


BITS = noise(8, 8, seed=2) < 127


def test_readings_between_pixels_are_opencvs():
    plane, at = (
        noise(40, 60),
        noise(1, 500, 2, seed=1) / 255 * torch.tensor([59.0, 39.0]) + 0.5,
    )
    wanted = cv2.remap(
        plane.numpy(),
        at[0].numpy() - 0.5,
        None,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    # OpenCV's steps.
    assert (
        bilinear(plane, at)[0] - torch.from_numpy(wanted[:, 0])
    ).abs().max() < 255 / 32 + 1e-3


def test_cells_are_read_through_the_homography_of_opencv():
    plane = torch.from_numpy(cv2.GaussianBlur(noise(120, 160).numpy(), (0, 0), 3))
    quad = np.array([[30, 20], [68, 26], [70, 62], [28, 55]], np.float32)
    samples, shape = 4, PanelShape(8, 9)
    cells = np.array([[0, 0], [9, 0], [9, 8], [0, 8]], np.float32)
    places = (
        np.stack(np.meshgrid(np.arange(44), np.arange(40)), -1) + 0.5
    ) / samples - 1
    matrix = cv2.getPerspectiveTransform(cells, quad)
    at = (
        cv2.perspectiveTransform(places.reshape(1, -1, 2).astype(np.float32), matrix)[0]
        - 0.5
    )
    wanted = cv2.remap(plane.numpy(), at[:, 0], at[:, 1], cv2.INTER_LINEAR).reshape(
        40, 44
    )
    seen = Pyramid.of(plane[None, None]).read_cells(
        torch.from_numpy(quad)[None].double(), shape, samples, 1
    )
    assert np.abs(seen[0].numpy() - wanted).max() < 0.5


def test_halvings_are_opencvs_area_means():
    plane = noise(64, 96)
    for number, level in enumerate(Pyramid.of(plane[None, None]).levels):
        size = 96 >> number, 64 >> number
        assert (
            np.abs(
                level.numpy()
                - cv2.resize(plane.numpy(), size, interpolation=cv2.INTER_AREA)
            ).max()
            < 1e-3
        )


def test_the_gate_takes_the_tiles_with_a_lattice(monkeypatch):
    monkeypatch.setattr(pyramid_file, "SETTINGS", pyramid_file.PyramidSettings(tiles=2))
    plane = torch.linspace(0, 255, 1920).expand(1080, 1920).clone()
    for row, column in ((3, 7), (16, 29)):
        tile = plane[64 * row : 64 * row + 64, 64 * column : 64 * column + 64]
        tile[::2, ::2] = 0
    assert sorted(gate(plane).tolist()) == [[3, 7], [16, 29]]


def test_candidates_are_the_local_maxima():
    outputs = noise(2, 9, 20, 30)
    score = outputs[:, 0].numpy()
    best = np.sort(
        score[score == maximum_filter(score, (0, 3, 3), mode="constant", cval=-1)]
    )[::-1]
    picture, quads, values = peaks(outputs, 10)
    assert values.tolist() == pytest.approx(best[:10].tolist())
    row, column = np.argwhere(score[int(picture[0])] == score.max())[0]
    moves = outputs[int(picture[0]), 1:, row, column].view(4, 2)
    assert torch.allclose(
        quads[0], 8 * torch.tensor([column + 0.5, row + 0.5]).float() + 16 * moves
    )


def test_of_candidates_at_one_place_the_best_is_taken():
    square = torch.tensor([[0.0, 0.0], [80.0, 0.0], [80.0, 80.0], [0.0, 80.0]]).double()
    quads = torch.stack([square, square + 9.0, square / 4 + 30, square + 200.0])
    assert distinct(quads, torch.tensor([1.0, 2.0, 0.0, -1.0]), 9).tolist() == [1, 2, 3]


def test_the_scout_is_convolutional():
    """What it says of a place does not depend on what is far away, nor on the place."""
    net, crop = Scout().eval(), noise(1, 1, 160, 160)
    with torch.inference_mode():
        moved = net(torch.nn.functional.pad(crop, (160, 0, 0, 0)))[..., 20:]
        assert (moved - net(crop))[..., 4:-4, 10:-4].abs().max() < 1e-3


def test_candidates_are_pictured_through_the_homography_of_opencv():
    """A smooth picture, where interpolation does not matter; and corners in a picture are those in the frame."""

    class Seen(torch.nn.Module):
        def forward(self, pictures):
            self.pictures = pictures
            maps = torch.zeros(len(pictures), 4, 24, 24)
            for corner, (row, column) in enumerate(
                ((4, 5), (4, 18), (18, 18), (18, 5))
            ):
                maps[:, corner, row, column] = 50.0
            return torch.zeros(len(pictures)), maps

    plane = cv2.GaussianBlur(noise(90, 120).numpy(), (0, 0), 4)
    quad = np.array([[30, 20], [66, 26], [63, 52], [28, 44]], np.float32)
    square = np.array([[10, 10], [38, 10], [38, 38], [10, 38]], np.float32)
    net, scales = Seen(), Pyramid.of(torch.from_numpy(plane)[None, None])
    _, moved = judged(net, scales, torch.from_numpy(quad)[None].double())
    # OpenCV counts from a pixel's centre.
    matrix = cv2.getPerspectiveTransform(quad - 0.5, square - 0.5)
    wanted = cv2.warpPerspective(plane, matrix, (48, 48))
    assert np.abs(net.pictures[0].numpy() - wanted).max() < 2
    places = np.array([[[11, 9], [37, 9], [37, 37], [11, 37]]], np.float32) - 0.5
    back = cv2.perspectiveTransform(places, np.linalg.inv(matrix)) + 0.5
    assert np.abs(moved[0].numpy() - back[0]).max() < 1e-3


def test_two_levels_are_parted_as_otsu_does():
    """Against scikit-image's threshold, on values that two levels explain well and on such as they do not."""
    values = torch.randn(20, 64, generator=torch.Generator().manual_seed(5)).double()
    values += torch.linspace(0, 12, 20)[:, None] * BITS.flatten()
    for one, parted in zip(values.numpy(), two_levels(values)[0].tolist(), strict=True):
        # To the end of the bin.
        high = one > threshold_otsu(one, 4096) + np.ptp(one) / 8192
        within = high.mean() * one[high].var() + (~high).mean() * one[~high].var()
        assert parted == pytest.approx(
            np.log((one.var() - within + 1) / (within + 1)), abs=1e-3
        )


def test_alignment_is_what_a_least_squares_fit_leaves():
    """Against NumPy's, for spots that are off a lattice by chance, whatever its shift, stretch and shear."""
    draw = torch.Generator().manual_seed(7)
    v, u = torch.meshgrid(
        torch.linspace(-1, 1, 8), torch.linspace(-1, 1, 8), indexing="ij"
    )
    fields = torch.stack([torch.ones_like(u), u, v, u * v], -1)
    off = 0.05 * torch.randn(6, 8, 8, 2, generator=draw)
    off += fields @ (0.05 * torch.randn(6, 4, 2, generator=draw))[:, None]
    at = (torch.arange(16) + 0.5) / 16 - 0.5
    across, down = ((at - off[..., axis, None]).square() for axis in (0, 1))
    spots = torch.exp(-(down[..., :, None] + across[..., None, :]) / 0.02) * 200
    cells = (spots * BITS[..., None, None]).permute(0, 1, 3, 2, 4)
    free = 2 * int(BITS.sum()) - 8
    rest = [
        np.linalg.lstsq(fields[BITS].double().numpy(), one[BITS].double().numpy())[
            1
        ].sum()
        for one in off
    ]
    spread = (np.array(rest) + 0.03**2 * int(BITS.sum())) / free
    wanted = np.log(0.15**2 / spread) / 2
    seen = alignment(cells, BITS.expand(6, 8, 8), torch.zeros(6))
    assert seen.tolist() == pytest.approx(wanted.tolist(), abs=0.05)


def test_bits_by_a_rule_look_less_random():
    odd = torch.arange(8) % 2 == 1
    rule = torch.stack([BITS, odd[:, None] & odd, odd.expand(8, 8), odd[:, None] ^ odd])
    pairs, lines = randomness(rule)
    assert (pairs[1:] < pairs[0] - 10).all()
    assert (lines[1:] < lines[0] - 1).all()


@pytest.mark.parametrize("pitch_px", [3.0, 4.4, 9.0, 23.0])
def test_a_lattice_is_fitted_in_a_level_that_suits_it(pitch_px):
    """The lattice of drawn spots is found from corners that are off."""
    size = int(17 * pitch_px + 60)
    y, x = np.mgrid[:size, :size] + 0.5
    light = np.full(y.shape, 0.05)
    for (down, right), lit in np.ndenumerate(BITS.numpy()):
        apart = np.hypot(
            y - 30 - (down + 0.5) * pitch_px, x - 30 - (right + 0.5) * pitch_px
        )
        light += (0.57 * lit + 0.03) * np.exp(-((apart / (0.25 * pitch_px)) ** 2) / 2)
    grey = torch.from_numpy(255 * light.clip(0, 1) ** (1 / 2.2)) + 2 * torch.randn(
        size, size
    )
    truth = (
        30 + 8 * pitch_px * torch.tensor([[0.0, 0.0], [1, 0], [1, 1], [0, 1]]).double()
    )
    off = (
        0.2 * pitch_px * torch.tensor([[1.0, 1.0], [-1, 1], [0.5, -1], [1, 0]]).double()
    )
    found, share = fitted(
        Pyramid.of(grey.round().clamp(0, 255)[None, None]),
        (truth + off)[None],
        PanelShape(8, 8),
    )
    assert (found[0] - truth).abs().max() < 0.06 * pitch_px
    assert share[0] > 0.7
