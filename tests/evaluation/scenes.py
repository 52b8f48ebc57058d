"""Cameras and annotations that the tests make themselves."""

import json

import numpy as np
import pytest

from circlecal.evaluation.soccernet_metric import MetricCamera, image_polylines
from circlecal.geometry.camera import Camera, image_center

SIZE = (960, 540)


def look_at_circle(x=3.0, y=66.0, z=-15.0, focal=1700.0, pan=-2.0, kappa=0.0, size=SIZE):
    """A main camera that shows the circle and more."""
    tilt = np.pi / 2 - np.arctan2(-z, y)
    return Camera(
        *size,
        focal_px=np.full(2, focal),
        principal_point_px=image_center(*size),
        angles_rad=np.array([np.radians(pan), tilt, 0.0]),
        position_m=np.array([x, y, z]),
        kappa=np.array([kappa, 0.0]),
    )


def annotation_of(camera, size=SIZE, every=9):
    """A line annotation of what a camera shows."""
    drawn = image_polylines(MetricCamera.from_camera(camera), *size)
    scale = np.array(size) - 1.0
    return {
        name: [{"x": x, "y": y} for x, y in points[:: max(1, min(every, len(points) - 1))] / scale]
        for name, points in drawn.items()
    }


@pytest.fixture
def write_set(tmp_path):
    """Write annotations and cameras of a few frames; returns both folders."""

    def write(cameras, predicted, name="pred"):
        truth, folder = tmp_path / "truth", tmp_path / name
        truth.mkdir(exist_ok=True)
        folder.mkdir(exist_ok=True)
        for frame, camera in cameras.items():
            (truth / f"{frame}.json").write_text(json.dumps(annotation_of(camera)))
        for frame, camera in predicted.items():
            (folder / f"camera_{frame}.json").write_text(json.dumps(camera.soccernet()))
        return truth, folder

    return write
