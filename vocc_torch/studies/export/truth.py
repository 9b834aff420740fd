"""Ground truth of exported frames: CSV files with a row per frame, and one COCO file."""

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from vocc_torch.files import atomic_file
from vocc_torch.hardware import PanelShape
from vocc_torch.report.folder import Cells, write_rows
from vocc_torch.rng import FrameKey
from vocc_torch.simulation.effects import colour
from vocc_torch.simulation.scene import SCENE_FIELDS
from vocc_torch.types import Frames, Panels, Scene

NAME = "truth.csv"
KEYPOINTS = ("top_left", "top_right", "bottom_right", "bottom_left")
CORNERS = tuple(f"{axis}_{corner}" for corner in KEYPOINTS for axis in "xy")
FURTHER = tuple(f"bits_{name}" for name in colour.FURTHER)
WORDS = ("file", "point", "bits", *FURTHER)
COLUMNS = (
    *(
        "file",
        "seed",
        "point",
        "block",
        "frame",
        "width_px",
        "height_px",
        "origin_x_px",
        "origin_y_px",
    ),
    *("surround_grey", *CORNERS, "bits", *SCENE_FIELDS, *FURTHER),
)
"""Columns of ``truth.csv``."""


def rows_of(
    scene: Scene,
    bits: Mapping[str, Tensor],
    names: Sequence[FrameKey],
    seen: Frames,
    panels: Panels,
) -> Iterator[Cells]:
    """Give the cells after ``file`` of each frame of a batch.

    Args:
        scene: B scenes.
        bits: (B,R,C) bool, by column.
        names: the frames' keys.
        seen: the frames.
        panels: the true corners.
    """
    height, width = seen.grey.shape[-2:]
    corners = (panels.corners_px - seen.origin_px[:, None]).flatten(1).tolist()
    surround = [None] * len(scene) if seen.surround is None else seen.surround.tolist()
    values = torch.stack([getattr(scene, name) for name in SCENE_FIELDS], 1).tolist()
    origins, flat = (
        seen.origin_px.tolist(),
        {name: sent.flatten(1) for name, sent in bits.items()},
    )
    for i, (block, frame) in enumerate((name.block, name.frame) for name in names):
        first, *further = (
            "".join("01"[bit] for bit in flat[name][i].tolist()) if name in flat else ""
            for name in ("bits", *FURTHER)
        )
        head = block.seed, block.point, block.block, frame, width, height
        yield (
            *head,
            *origins[i],
            surround[i],
            *corners[i],
            first,
            *values[i],
            *further,
        )


def read_truth(path: Path) -> Iterator[dict[str, Any]]:
    """Read the rows of a table, as numbers but for :data:`WORDS`."""
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            numbers = {
                name: json.loads(row[name] or "null")
                for name in COLUMNS
                if name not in WORDS
            }
            yield row | numbers


def write_truth(path: Path, files: Sequence[Path]) -> None:
    """Join tables, a row in memory at a time."""

    def lines() -> Iterator[Sequence[str]]:
        yield COLUMNS
        for file_row in files:
            with file_row.open(newline="", encoding="utf-8") as file:
                yield from list(csv.reader(file))[1:]

    write_rows(path, lines())


def write_coco(path: Path, table: Path, shape: PanelShape) -> None:
    """Write all frames as one COCO file with keypoints, a frame in memory at a time.

    A corner outside the picture has visibility 0; boxes and outlines end where the picture does.

    Args:
        path: the file, replaced whole.
        table: the truth of all frames.
        shape: rows and columns of the panel.
    """
    category = {
        "id": 1,
        "name": "led_panel",
        "rows": shape.rows,
        "columns": shape.columns,
    }
    category |= {"keypoints": KEYPOINTS, "skeleton": [[1, 2], [2, 3], [3, 4], [4, 1]]}
    head = {
        "info": {"description": "simulated by vocc_torch"},
        "categories": [category],
    }
    with atomic_file(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(json.dumps(head).removesuffix("}"))
        for name, build in (("images", image_of), ("annotations", annotation_of)):
            file.write(f',\n"{name}": [')
            every = (
                build(number, row) for number, row in enumerate(read_truth(table), 1)
            )
            for index, item in enumerate(item for item in every if item is not None):
                file.write(f"{',' * (index > 0)}\n{json.dumps(item)}")
            file.write("]")
        file.write("}\n")


def image_of(number: int, row: dict[str, Any]) -> dict[str, Any]:
    """Describe a picture: what COCO asks for, and everything of the row that is not the panel's."""
    known = {
        "id": number,
        "file_name": row["file"],
        "width": row["width_px"],
        "height": row["height_px"],
    }
    columns = {"file", "width_px", "height_px", "bits", *FURTHER, *CORNERS}
    return known | {name: value for name, value in row.items() if name not in columns}


def annotation_of(number: int, row: dict[str, Any]) -> dict[str, Any] | None:
    """Describe a picture's panel; None where it lies outside."""
    corners = np.array([row[name] for name in CORNERS]).reshape(4, 2)
    inside = corners.clip(0, (row["width_px"], row["height_px"]))
    (left, top), (right, bottom) = (
        inside.min(axis=0).tolist(),
        inside.max(axis=0).tolist(),
    )
    if left == right or top == bottom:
        return None
    x, y = inside.T
    visible = (inside == corners).all(axis=1)
    keypoints = np.column_stack([corners, np.full(4, 2.0)]) * visible[:, None]
    return {
        **{"id": number, "image_id": number, "category_id": 1, "iscrowd": 0},
        "bbox": [left, top, right - left, bottom - top],
        "area": float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2),
        "segmentation": [inside.flatten().tolist()],
        "keypoints": keypoints.flatten().tolist(),
        "num_keypoints": int(visible.sum()),
        "bits": row["bits"],
        **{name: row[name] for name in FURTHER if row.get(name)},
    }
