"""A small frame that the whole chain calibrates, painted from the field template, and the command line in process."""

import gc
import logging
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from circlecal.batch import run as batch_run
from circlecal.batch.task import F, Task, finish
from circlecal.cli import main
from circlecal.field import load_field
from circlecal.geometry.camera import Camera, image_center
from circlecal.records.log import Finished

# the same examples every time, however slow the machine is
settings.register_profile(
    "circlecal",
    deadline=None,
    derandomize=True,
    max_examples=60,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("circlecal")

# where no bytecode is to be written beside the code, each of the many processes that tests start compiles all of it
if sys.dont_write_bytecode:
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix = str(
        Path(__file__).parents[1] / ".pytest_cache" / "bytecode"
    )
    sys.dont_write_bytecode = False

FRAME_SIZE = (960, 540)
LONGEST = (
    "golden/", "workbench/", "batch/", "tracking/", "rig/", "test_recipes", "test_readme", "evaluation/", "fuzz/",
    "report/test_browser",
)  # fmt: skip
"""What takes longest is begun first, so that several workers end at about one time: a file is run by one of them."""


def pytest_sessionstart() -> None:
    """What thousands of tests are made of is no garbage: nothing is looked for in it while they are collected."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Garbage is looked for from here on, among what the tests themselves make."""
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest first, and leave the others in their order."""
    places = {name: place for place, name in enumerate(LONGEST)}

    def place_of(item: pytest.Item) -> int:
        file = item.nodeid.removeprefix("tests/")
        return next((place for name, place in places.items() if file.startswith(name)), len(places))

    items.sort(key=place_of)


class Outcome(NamedTuple):
    """Exit code and both streams of a command."""

    code: int
    out: str
    err: str


@pytest.fixture(scope="session")
def frame_camera() -> Camera:
    """A main camera that shows the centre circle."""
    width, height = FRAME_SIZE
    return Camera(
        width=width,
        height=height,
        focal_px=np.array([2300.0, 2300.0]),
        principal_point_px=image_center(width, height),
        angles_rad=np.radians([-2.8, 76.0, 0.3]),
        position_m=np.array([3.0, 62.0, -15.5]),
        kappa=np.zeros(2),
    )


@pytest.fixture(scope="session")
def frame_image(frame_camera: Camera) -> np.ndarray:
    """Picture (540, 960, 3) of that camera."""
    return paint_frame(frame_camera)


def paint_frame(camera: Camera, markings: tuple[str, ...] | None = None) -> np.ndarray:
    """Picture (H, W, 3) of the markings, of all and the centre mark where none are named."""
    frame_camera, width, height = camera, camera.width, camera.height
    template = load_field("soccer")
    scale = 4  # anti-aliasing by painting large and reducing
    picture = np.full((height * scale, width * scale, 3), (60, 130, 70), np.uint8)
    half = template.marking_width_m / 2
    for name, points in template.polylines(0.1).items():
        if markings is not None and name not in markings:
            continue
        tangent = np.gradient(points, axis=0)
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1)[:, None]
        band = np.concatenate([points + half * normal, (points - half * normal)[::-1]])
        _paint(picture, frame_camera, np.split(band, 2), scale)
    if markings is None:
        _paint_spot(picture, frame_camera, scale)
    noise = np.random.default_rng(1).normal(0, 2, (height, width, 3))
    reduced = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    return np.clip(cv2.GaussianBlur(reduced, (0, 0), 0.6) + noise, 0, 255).astype(np.uint8)


def _paint(picture: np.ndarray, camera: Camera, sides: list[np.ndarray], scale: int) -> None:
    left, right = (camera.project(side) * scale for side in (sides[0], sides[1][::-1]))
    for k in range(len(left) - 1):
        quad = np.array([left[k], left[k + 1], right[k + 1], right[k]])
        if np.isfinite(quad).all() and np.abs(quad).max() < 1e5:
            cv2.fillConvexPoly(picture, np.round(quad * 16).astype(np.int32), (235, 240, 240), cv2.LINE_8, 4)


def _paint_spot(picture: np.ndarray, camera: Camera, scale: int) -> None:
    angle = np.linspace(0, 2 * np.pi, 60)
    rim = camera.project(0.12 * np.stack([np.cos(angle), np.sin(angle)], axis=1)) * scale
    cv2.fillPoly(picture, [np.round(rim * 16).astype(np.int32)], (235, 240, 240), cv2.LINE_8, 4)


@pytest.fixture
def frame_file(tmp_path: Path, frame_image: np.ndarray) -> Path:
    """The picture as ``frames/good.png``."""
    path = tmp_path / "frames" / "good.png"
    path.parent.mkdir()
    cv2.imwrite(str(path), frame_image)
    return path


@pytest.fixture
def blank_file(frame_file: Path) -> Path:
    """A picture without any marking, ``frames/blank.png``."""
    path = frame_file.with_name("blank.png")
    cv2.imwrite(str(path), np.full((120, 160, 3), (60, 130, 70), np.uint8))
    return path


@pytest.fixture(autouse=True)
def _logging_of_a_library() -> None:
    """Commands say how much is logged, in this process for good, and fixtures of a whole module run commands too."""
    logger = logging.getLogger("circlecal")
    logger.setLevel(logging.NOTSET)
    logger.handlers = []


def finish_here(frames: Iterator[F], task: Task[F], workers: int, scheduler: str | None) -> Iterator[Finished]:
    """Stands in for the workers of a batch."""
    return (finish(task, frame) for frame in frames)


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames of a batch are finished here, one after the other: a worker takes longer to start than they do."""
    monkeypatch.setattr(batch_run, "_finish_frames", finish_here)


@pytest.fixture(scope="module")
def module_in_this_process() -> Iterator[None]:
    """As ``in_this_process``, for fixtures that all tests of a module share."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch_run, "_finish_frames", finish_here)
        yield


@pytest.fixture
def run_circlecal(capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """Run a command in this process."""

    def run(*arguments: object) -> Outcome:
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
        streams = capsys.readouterr()
        return Outcome(int(ended.value.code or 0), streams.out, streams.err)

    return run
