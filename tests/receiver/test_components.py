from __future__ import annotations

import cv2
import numpy as np
import pytest
import scipy.ndimage
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st
from kornia.contrib import connected_components_union_find
from kornia.morphology import dilation, erosion
from scipy.spatial import ConvexHull

from vocc_torch.receiver import components as components_module
from vocc_torch.receiver import ladder, quadrilateral
from vocc_torch.receiver.components import (
    Blobs,
    Components,
    close_mask,
    collect_blobs,
    joined,
    label_components,
    runs_of,
)
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.types import Frames, Panels, PanelShape

EIGHT = np.ones((3, 3))


def painted(components: Components) -> np.ndarray:
    labels = np.zeros(components.runs.size, np.int64)
    runs = components.runs
    fields = (runs.frame, runs.row, runs.start, runs.end, components.label)
    for frame, row, start, end, label in zip(*(one.tolist() for one in fields), strict=True):
        labels[frame, row, start : end + 1] = label
    return labels


def random_mask(seed: int) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    masks, height, width = rng.integers(1, 4), rng.integers(1, 30), rng.integers(1, 30)
    return torch.from_numpy(rng.random((masks, height, width)) < rng.choice([0.02, 0.2, 0.4, 0.6, 0.97]))


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_components_equal_scipys(seed: int) -> None:
    mask = random_mask(seed)
    components = label_components(mask)
    ours, found = painted(components), 0
    assert ((ours > 0) == mask.numpy()).all()
    for frame, (plane, labels) in enumerate(zip(mask.numpy(), ours, strict=True)):
        theirs, count = scipy.ndimage.label(plane, EIGHT)
        pairs = set(zip(theirs[plane].tolist(), labels[plane].tolist(), strict=True))
        assert len(pairs) == count == len({ours for _, ours in pairs})
        for number, own in pairs:
            assert components.area_px[own].item() == (theirs == number).sum()
            assert components.frame[own].item() == frame
        found += count
    assert sorted(set(ours[ours > 0].tolist())) == list(range(1, found + 1))


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_labels_of_pixels_are_those_of_their_runs(seed: int) -> None:
    mask = random_mask(seed)
    components = label_components(mask)
    frame, row, column = torch.ones_like(mask).nonzero(as_tuple=True)
    assert components.at(frame, row, column).tolist() == painted(components).flatten().tolist()


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_joined_runs_bound_the_foreground(seed: int) -> None:
    mask = random_mask(seed)
    closed = mask | torch.from_numpy(np.random.default_rng(seed).random(mask.shape) < 0.5)
    cover = runs_of(closed)
    found = joined(mask, cover)
    expected = []
    for frame, row, start, end in zip(
        *(one.tolist() for one in (cover.frame, cover.row, cover.start, cover.end)), strict=True
    ):
        lit = mask[frame, row, start : end + 1].nonzero()[:, 0] + start
        if len(lit):
            expected.append((frame, row, lit[0].item(), lit[-1].item(), len(lit)))
    fields = (found.frame, found.row, found.start, found.end, found.pixels)
    assert list(zip(*(one.tolist() for one in fields), strict=True)) == expected


def random_masks(
    seed: int, frames: int = 5, size: tuple[int, int] = (40, 53), share: float = 0.06
) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).random((frames, *size)) < share)


def closed_labels(mask: torch.Tensor, size: int) -> Components:
    return label_components(close_mask(mask[:, None], size)[:, 0])


def opencv_blobs(mask: np.ndarray, size: int) -> list[dict[str, object]]:
    """Components of the closed mask, by first mask pixel in raster order, from OpenCV and NumPy."""
    plane = np.pad(mask.astype(np.uint8), size)
    closed = cv2.morphologyEx(plane, cv2.MORPH_CLOSE, np.ones((size, size), np.uint8))[size:-size, size:-size]
    count, labels = cv2.connectedComponents(closed, connectivity=8)
    found = []
    for label in range(1, count):
        rows, columns = np.nonzero((labels == label) & mask)
        extremes = [(columns[rows == row].min(), columns[rows == row].max()) if (rows == row).any() else None
                    for row in range(rows.min(), rows.max() + 1)]  # fmt: skip
        found.append(
            {
                "area": int((labels == label).sum()),
                "mask": len(rows),
                "first": (int(columns[0]), int(rows[0])),
                "left": int(columns.min()),
                "extremes": extremes,
            }
        )
    return sorted(found, key=lambda blob: blob["first"][::-1])


def as_opencv(blobs: Blobs, frame: int) -> list[dict[str, object]]:
    found = []
    for i in (blobs.frame == frame).nonzero()[:, 0].tolist():
        left = blobs.left_px[i].item()
        height = int((blobs.first[i] <= blobs.last[i]).nonzero().max()) + 1
        rows = zip(blobs.first[i, :height].tolist(), blobs.last[i, :height].tolist(), strict=True)
        found.append(
            {
                "area": blobs.area_px[i].item(),
                "mask": blobs.mask_px[i].item(),
                "first": tuple(blobs.first_px[i].tolist()),
                "left": left,
                "extremes": [(a + left, b + left) if a <= b else None for a, b in rows],
            }
        )
    return found


@pytest.mark.parametrize(("closing", "share"), [(1, 0.3), (3, 0.06), (5, 0.02), (11, 0.004)])
def test_blobs_equal_opencvs(closing: int, share: float) -> None:
    mask = random_masks(closing, share=share)
    blobs = collect_blobs(runs_of(mask), closed_labels(mask, closing))
    for frame in range(len(mask)):
        expected = opencv_blobs(mask[frame].numpy(), closing)
        assert as_opencv(blobs, frame) == expected
        assert blobs.components[frame].item() == len(expected)
    assert blobs.frame.tolist() == sorted(blobs.frame.tolist())


def test_small_closed_areas_are_left_out_but_counted() -> None:
    mask = random_masks(3)
    labels = closed_labels(mask, 3)
    every, large = collect_blobs(runs_of(mask), labels), collect_blobs(runs_of(mask), labels, min_area_px=9)
    keep = every.area_px >= 9
    assert 0 < len(large) < len(every)
    assert large.label.tolist() == every.label[keep].tolist()
    assert large.mask_px.tolist() == every.mask_px[keep].tolist()
    assert large.components.tolist() == every.components.tolist()


def test_an_empty_mask_has_no_blobs() -> None:
    mask = torch.zeros(2, 6, 7, dtype=torch.bool)
    blobs = collect_blobs(runs_of(mask), label_components(mask))
    assert len(blobs) == 0
    assert blobs.components.tolist() == [0, 0]


def test_only_the_largest_blobs_of_a_frame_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(components_module, "MOST_BLOBS", 3)
    mask = torch.zeros(2, 5, 40, dtype=torch.bool)
    for index, width in enumerate((1, 4, 2, 3, 4)):
        mask[0, 2, 8 * index : 8 * index + width] = True
    mask[1, 1, 5] = True
    blobs = collect_blobs(runs_of(mask), label_components(mask))
    assert blobs.frame.tolist() == [0, 0, 0, 1]
    assert blobs.mask_px.tolist() == [4, 3, 4, 1]
    assert blobs.components.tolist() == [5, 1]


@pytest.mark.parametrize("shape", ["disc", "turned square", "noise"])
def test_hulls_of_tall_blobs_equal_scipys(shape: str) -> None:
    y, x = np.mgrid[0:301, 0:301] - 150
    inside = {
        "disc": x**2 + y**2 <= 150**2,
        "turned square": np.abs(0.8 * x + 0.6 * y) + np.abs(0.8 * y - 0.6 * x) <= 140,
        "noise": np.random.default_rng(0).random((301, 301)) < 0.01,
    }[shape]
    rows, columns = np.nonzero(inside)
    points = np.stack([columns, rows - rows.min()], 1)
    height = points[:, 1].max() + 1
    first, last = np.full(height, 9999), np.full(height, -1)
    np.minimum.at(first, points[:, 1], points[:, 0])
    np.maximum.at(last, points[:, 1], points[:, 0])
    hull = quadrilateral.convex_hull(first[None], last[None])
    expected = {tuple(point) for point in points[ConvexHull(points).vertices].tolist()}
    assert {(int(a), int(b)) for a, b in hull[0].tolist()} == expected


def plain_components(mask: torch.Tensor) -> Components:
    """The labels of Kornia's union-find, brought to the form of ours."""
    labels = connected_components_union_find(mask[:, None])[:, 0]
    values = torch.cat([labels.new_zeros(1), labels[labels > 0].unique()])
    number, runs = torch.searchsorted(values, labels), runs_of(mask)
    frames = torch.arange(len(mask))[:, None, None].expand_as(number)
    frame = torch.zeros_like(values).index_put((number.flatten(),), frames.flatten())
    area = torch.bincount(number.flatten(), minlength=len(values)).index_fill(0, torch.tensor([0]), 0)
    return Components(runs, number[runs.frame, runs.row, runs.start], area, frame)


def plain_closing(mask: torch.Tensor, size_px: int) -> torch.Tensor:
    kernel = torch.ones(size_px, size_px)
    plane = F.pad(mask.float(), [size_px] * 4)
    closed = erosion(dilation(plane, kernel), kernel)
    return closed[..., size_px:-size_px, size_px:-size_px] > 0.5


def cluttered_frames() -> list[np.ndarray]:
    """Noise, coarse noise, lamps and specks: what a global threshold makes much foreground of."""
    rng = np.random.default_rng(11)
    frames = [rng.normal(102, sigma, (150, 170)) for sigma in (0.4, 2.0, 30.0)]
    for width in (4, 9):
        coarse = np.kron(rng.normal(0, 20, (-(-150 // width), -(-170 // width))), np.ones((width, width)))
        frames.append(102 + coarse[:150, :170])
    lamps = rng.normal(102, 1, (150, 170))
    y, x = np.mgrid[0:150, 0:170]
    for a, b, radius in zip(*rng.integers([[20], [20], [3]], [[130], [150], [20]], (3, 6)), strict=True):
        lamps[(y - a) ** 2 + (x - b) ** 2 <= radius**2] = 240
    frames.append(lamps)
    frames += [np.where(rng.random((150, 170)) < share, 255.0, 100.0) for share in (0.001, 0.01, 0.06)]
    return [frame.round().clip(0, 255).astype(np.uint8) for frame in frames]


@pytest.mark.parametrize(("closing", "lenient"), [(11, False), (11, True), (3, True), (1, True)])
def test_decisions_in_clutter_are_those_of_the_plain_way(
    closing: int, lenient: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = {"min_rectangularity": 0.0, "min_compactness": 0.0, "min_area_px": 1} if lenient else {}
    locator, shape = PaperLocator(closing_px=closing, **limits), PanelShape(8, 8)
    frames = Frames.whole(torch.from_numpy(np.stack(cluttered_frames())))
    quick = locator(frames, shape)
    monkeypatch.setattr(ladder, "label_components", plain_components)
    monkeypatch.setattr(ladder, "joined", lambda mask, closed: runs_of(mask))
    if closing > 1:
        monkeypatch.setattr(ladder, "close_mask", plain_closing)
    monkeypatch.setattr(quadrilateral, "_PART_ROWS", 1 << 15)
    plain = locator(frames, shape)
    assert quick.found.any()
    for name in Panels.__slots__:
        assert torch.equal(getattr(quick, name), getattr(plain, name)), name
