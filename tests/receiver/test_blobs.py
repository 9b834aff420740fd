from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import torch

from vocc_torch.receiver import blobs as blobs_module
from vocc_torch.receiver.blobs import (
    Blobs,
    collect_blobs,
    compactness,
    proportion,
    rectangularity,
)
from vocc_torch.receiver.components import Components, label_components, runs_of
from vocc_torch.receiver.morphology import close_mask, halve_mask
from vocc_torch.types import PanelShape


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
        left, height = blobs.left_px[i].item(), blobs.heights_px()[i].item()
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
    assert blobs.heights_px().tolist() == []


def test_coarse_cells_join_fine_pixels_and_count_as_area() -> None:
    mask = torch.zeros(1, 3, 31, dtype=torch.bool)
    mask[0, 0, 0] = mask[0, 1, 9] = mask[0, 2, 30] = True
    cells = halve_mask(mask[:, None])
    # Three 2 px cells lie between the first two pixels: a closing by 5 cells fills them, one by 3 does not.
    apart = collect_blobs(runs_of(mask), label_components(close_mask(cells, 3)[:, 0]), level=1)
    assert apart.first_px.tolist() == [[0, 0], [9, 1], [30, 2]]
    assert apart.area_px.tolist() == [4, 4, 4]
    joined = collect_blobs(runs_of(mask), label_components(close_mask(cells, 5)[:, 0]), level=1)
    assert joined.mask_px.tolist() == [2, 1]
    assert joined.area_px.tolist() == [5 * 4, 4]
    assert joined.first[0].tolist() == [0, 9]
    large = collect_blobs(runs_of(mask), label_components(close_mask(cells, 5)[:, 0]), min_area_px=8, level=1)
    assert large.area_px.tolist() == [20]


def test_only_the_largest_blobs_of_a_frame_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blobs_module, "MOST_BLOBS", 3)
    mask = torch.zeros(2, 5, 40, dtype=torch.bool)
    for index, width in enumerate((1, 4, 2, 3, 4)):
        mask[0, 2, 8 * index : 8 * index + width] = True
    mask[1, 1, 5] = True
    blobs = collect_blobs(runs_of(mask), label_components(mask))
    assert blobs.frame.tolist() == [0, 0, 0, 1]
    assert blobs.mask_px.tolist() == [4, 3, 4, 1]
    assert blobs.components.tolist() == [5, 1]


def test_rectangularity_of_a_rectangle_and_a_disc() -> None:
    area = torch.tensor([6.0, math.pi, 9.0])
    assert rectangularity(area, torch.tensor([6.0, 4.0, 8.0])).tolist() == pytest.approx(
        [1.0, math.pi / 4, 1.0]
    )


@pytest.mark.parametrize("shape", [PanelShape(8, 8), PanelShape(4, 16), PanelShape(1, 5)])
def test_compactness_is_one_for_the_panels_own_rectangle_only(shape: PanelShape) -> None:
    width, height = shape.columns * 7.0, shape.rows * 7.0
    sides = torch.tensor([[width, height], [height, width], [width * 2, height], [width, height * 2]])
    values = compactness(sides.prod(1), 2 * sides.sum(1), shape)
    assert values[:2].tolist() == pytest.approx([1.0, 1.0])
    assert (values[2:] < 0.95).all()


def test_compactness_of_a_disc_against_a_square_panel() -> None:
    radius = 5.0
    value = compactness(
        torch.tensor([math.pi * radius**2]), torch.tensor([2 * math.pi * radius]), PanelShape()
    )
    assert value.item() == pytest.approx(math.pi / 4)


def test_compactness_of_a_long_lamp_is_the_textbook_quotient() -> None:
    # A rectangle of aspect a has Q / Q_square = 4 a / (1 + a)^2.
    value = compactness(torch.tensor([10.0]), torch.tensor([22.0]), PanelShape())
    assert value.item() == pytest.approx(40 / 121)


def test_proportion_is_symmetric_and_knows_the_panels_shape() -> None:
    shape = PanelShape(rows=4, columns=8)
    width, height = torch.tensor([80.0, 160.0, 40.0, 40.0]), torch.tensor([40.0, 40.0, 40.0, 80.0])
    assert proportion(width, height, shape).tolist() == pytest.approx([1.0, 0.5, 0.5, 0.25])
