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
    "file",
    "seed",
    "point",
    "block",
    "frame",
    "width_px",
    "height_px",
    "origin_x_px",
    "origin_y_px",
    "surround_grey",
    *CORNERS,
    "bits",
    *SCENE_FIELDS,
    *FURTHER,
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
    origins = seen.origin_px.tolist()
    for i, key in enumerate(names):
        texts = {
            name: "".join("01"[bit] for bit in sent[i].flatten().tolist())
            for name, sent in bits.items()
        }
        block = key.block
        yield (
            block.seed,
            block.point,
            block.block,
            key.frame,
            width,
            height,
            *origins[i],
            surround[i],
            *corners[i],
            texts["bits"],
            *values[i],
            *(texts.get(name, "") for name in FURTHER),
        )


def read_truth(path: Path) -> Iterator[dict[str, Any]]:
    """Read the rows of a table, as numbers but for :data:`WORDS`."""
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            yield {
                name: text if name in WORDS else json.loads(text or "null")
                for name, text in row.items()
            }


def write_truth(path: Path, files: Sequence[Path]) -> None:
    """Join tables, a row in memory at a time."""

    def lines() -> Iterator[Sequence[str]]:
        yield COLUMNS
        for table in files:
            with table.open(newline="", encoding="utf-8") as file:
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
        "keypoints": KEYPOINTS,
        "skeleton": [[1, 2], [2, 3], [3, 4], [4, 1]],
    }
    head = {
        "info": {"description": "simulated by vocc_torch"},
        "categories": [category],
    }
    with atomic_file(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(json.dumps(head).removesuffix("}"))
        for name, build in (("images", image_of), ("annotations", annotation_of)):
            file.write(f',\n"{name}": [')
            comma = ""
            for number, row in enumerate(read_truth(table), 1):
                if item := build(number, row):
                    file.write(f"{comma}\n{json.dumps(item)}")
                    comma = ","
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
    corner, size = inside.min(axis=0), np.ptp(inside, axis=0)
    if not size.all():
        return None
    x, y = inside.T
    visible = (inside == corners).all(axis=1)
    keypoints = np.column_stack([corners, np.full(4, 2.0)]) * visible[:, None]
    return {
        "id": number,
        "image_id": number,
        "category_id": 1,
        "iscrowd": 0,
        "bbox": [*corner.tolist(), *size.tolist()],
        "area": float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2),
        "segmentation": [inside.flatten().tolist()],
        "keypoints": keypoints.flatten().tolist(),
        "num_keypoints": int(visible.sum()),
        "bits": row["bits"],
        **{name: row[name] for name in FURTHER if row.get(name)},
    }
