"""A frame that the chain refuses because nothing turns its circle, and a server of its own."""

import os
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest

from circlecal.config import Config
from circlecal.field import load_field
from circlecal.geometry.camera import Camera, image_center
from circlecal.pictures.files import PictureFile
from circlecal.workbench.measuring import MeasuredPicture, measure_picture
from tests.conftest import paint_frame


def zip_of(**files: bytes | str) -> bytes:
    """An archive of files; ``__`` stands for a slash in their names, ``_dot_`` for a dot."""
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in files.items():
            archive.writestr(name.replace("__", "/").replace("_dot_", "."), content)
    return stream.getvalue()


@pytest.fixture(scope="session")
def wide_camera() -> Camera:
    """A main camera that shows circle and far touchline."""
    width, height = 960, 540
    return Camera(
        width=width,
        height=height,
        focal_px=np.array([1150.0, 1150.0]),
        principal_point_px=image_center(width, height),
        angles_rad=np.radians([-2.0, 77.0, 0.2]),
        position_m=np.array([2.0, 66.0, -18.0]),
        kappa=np.array([0.03, 0.0]),
    )


@pytest.fixture(scope="session")
def open_image(wide_camera: Camera) -> np.ndarray:
    """Circle and two fifths of the far touchline alone: the circle may be turned any way."""
    picture = paint_frame(wide_camera, ("centre_circle", "side_line_top"))
    rows = wide_camera.project(load_field("soccer").polylines(1.0)["side_line_top"])[:, 1]
    width = picture.shape[1]
    grass = picture[-30:, :].reshape(-1, 3).mean(axis=0)
    picture[: int(np.nanmax(rows)) + 12, int(0.4 * width) :] = grass.round().astype(np.uint8)
    return picture


@pytest.fixture(scope="session")
def open_frame(open_image) -> MeasuredPicture:
    """That picture after the chain."""
    return measure_picture(open_image, Config(), PictureFile("open", Path("open.png"), "open"))


@pytest.fixture(scope="session")
def folder(tmp_path_factory, open_image, frame_image) -> Path:
    """A good picture, and the refused one twice: no test meets what another one changed."""
    path = tmp_path_factory.mktemp("pictures")
    for name in ("open", "keys"):
        cv2.imwrite(str(path / f"{name}.png"), open_image)
    cv2.imwrite(str(path / "good.png"), frame_image)
    return path


@pytest.fixture(scope="module")
def serve(tmp_path_factory) -> Iterator[Callable[..., tuple[subprocess.Popen[str], str]]]:
    """Start a server; its process and the address that it prints."""
    running: list[subprocess.Popen[str]] = []
    environment = os.environ | {"XDG_STATE_HOME": str(tmp_path_factory.mktemp("state"))}

    def start(*arguments: object) -> tuple[subprocess.Popen[str], str]:
        command = [sys.executable, "-m", "circlecal", "annotate", "--no-browser", "-q", *map(str, arguments)]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        running.append(server)
        assert server.stdout is not None
        return server, server.stdout.readline().strip()

    yield start
    for server in running:
        server.kill()
        server.wait()
