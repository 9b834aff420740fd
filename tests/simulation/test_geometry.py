"""The pinhole against OpenCV's projection, the paper's numbers, and refusals by name."""

import cv2
import numpy as np
import pytest
import torch

from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.simulation.framing import led_centres_px, panel_centre_px, panel_corners_px
from vocc_torch.types import PanelShape, Scene

PANELS = [
    LedPanel(),
    LedPanel(shape=PanelShape(3, 5), led_diameter_m=0.05, led_gap_m=0.01),
    LedPanel(shape=PanelShape(1, 1), led_gap_m=0.0),
]


def projected(points_m, camera):
    """OpenCV's pinhole without distortion; the principal point is the middle of the sensor's area."""
    focal = camera.focal_length_mm / (camera.sensor_width_mm / camera.width_px)
    intrinsic = np.array([[focal, 0, camera.width_px / 2], [0, focal, camera.height_px / 2], [0, 0, 1.0]])
    pixels, _ = cv2.projectPoints(np.asarray(points_m, float), np.zeros(3), np.zeros(3), intrinsic, None)
    return pixels.reshape(-1, 2)


def scenes(seed, count=8):
    rng = np.random.default_rng(seed)
    return Scene.cat(
        [
            Scene.of(
                distance_m=rng.uniform(1, 90), offset_x_m=rng.uniform(-9, 9), offset_y_m=rng.uniform(-3, 3)
            )
            for _ in range(count)
        ]
    )


@pytest.mark.parametrize("panel", PANELS)
@pytest.mark.parametrize("camera", [Camera(), Camera(focal_length_mm=18, width_px=640, height_px=481)])
def test_led_centres_are_opencvs_projection(panel, camera):
    scene = scenes(1)
    x, y = led_centres_px(scene, camera, panel)
    pitch = panel.led_diameter_m + panel.led_gap_m
    rows, columns = panel.shape.rows, panel.shape.columns
    for b in range(len(scene)):
        points = [
            (
                float(scene.offset_x_m[b]) + (c - (columns - 1) / 2) * pitch,
                float(scene.offset_y_m[b]) + (r - (rows - 1) / 2) * pitch,
                float(scene.distance_m[b]),
            )
            for r in range(rows)
            for c in range(columns)
        ]
        ours = torch.stack(torch.meshgrid(x[b], y[b], indexing="xy"), dim=-1).reshape(-1, 2)
        np.testing.assert_allclose(ours.numpy(), projected(points, camera), rtol=0, atol=1e-9)


@pytest.mark.parametrize("panel", PANELS)
def test_corners_and_centre_are_opencvs_projection(panel):
    scene, camera = scenes(2), Camera()
    corners, centres = panel_corners_px(scene, camera, panel), panel_centre_px(scene, camera)
    half_x, half_y = (n * panel.pitch_m / 2 for n in (panel.shape.columns, panel.shape.rows))
    for b in range(len(scene)):
        x, y, z = (float(v[b]) for v in (scene.offset_x_m, scene.offset_y_m, scene.distance_m))
        clockwise = [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]
        points = [(x + dx, y + dy, z) for dx, dy in clockwise] + [(x, y, z)]
        ours = torch.cat([corners[b], centres[b : b + 1]])
        np.testing.assert_allclose(ours.numpy(), projected(points, camera), rtol=0, atol=1e-9)
