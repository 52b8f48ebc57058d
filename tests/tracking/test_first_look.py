"""What the frames of a clip that were calibrated alone tell of its paint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.config import Config, load_config
from circlecal.field import load_field
from circlecal.geometry.projective import Array
from circlecal.rig.tripod import Venue
from circlecal.rig.venue import read_venue, venue_settings, write_venue
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import sample_scene
from circlecal.synthetic.scene import Scene
from circlecal.tracking.clip import track_frames
from circlecal.tracking.entry import ClipFrame
from circlecal.tracking.first_look import FirstLook, learn_paint, suit_tracking
from circlecal.tracking.survey import survey_clip

FLOOR, PAINT = (150.0, 180.0, 210.0), (60.0, 165.0, 190.0)
"""Yellow lines that are nearly as light as their wooden floor."""
COUNT, STEP_S = 3, 0.2
PLACES = np.array([[0.0, 0.0], [3.0, 0.0], [-3.0, 0.0], [0.0, 3.0], [0.0, -3.0]])


@pytest.fixture(scope="module")
def hall() -> tuple[list[NDArray[np.uint8]], list[Array]]:
    """Pictures of a camera that pans over a hall whose lines lie where the template has them, and where in each the
    middle and four points of the circle are.
    """
    scene = sample_scene("wood", np.random.default_rng([77, 10]), 640, 360)
    look = {"turf_bgr": FLOOR, "paint_bgr": PAINT, "gloss": 0.1, "patchiness": 0.02, "texture": 0.015, "noise": 0.6}
    return _pan_over(replace(scene, config=scene.config.model_copy(update=look), extras=(), painted=None))


def _pan_over(scene: Scene) -> tuple[list[NDArray[np.uint8]], list[Array]]:
    """Pictures of a camera that pans, and where in each the middle and four points of the circle are."""
    pictures, there = [], []
    for index in range(COUNT):
        turn = np.array([np.radians(0.6) * (index - COUNT / 2), 0.0, 0.0])
        camera = replace(scene.camera, angles_rad=scene.camera.angles_rad + turn)
        pictures.append(render(replace(scene, camera=camera), np.random.default_rng(5)).image)
        there.append(camera.project(scene.surface.lift(PLACES)))
    return pictures, there


def _survey(pictures: list[NDArray[np.uint8]], config: Config, known: Venue | None = None) -> Venue:
    def pictures_at(times: Sequence[float]) -> Iterator[NDArray[np.uint8] | None]:
        return iter([pictures[min(round(time / STEP_S), COUNT - 1)] for time in times])

    return survey_clip(pictures_at, COUNT * STEP_S, config, known)


def test_a_clip_is_followed_along_the_colour_of_its_paint(
    hall: tuple[list[NDArray[np.uint8]], list[Array]], tmp_path: Path
) -> None:
    pictures, there = hall
    futsal, config = load_field("futsal"), load_config("futsal")
    found = _survey(pictures, config)
    assert len(found.tripods) == 1
    assert found.paint_bgr is not None
    blue, green, red = found.paint_bgr
    assert blue < -40 < min(green, red)
    # the file hands the colour on: to clips, and to single frames
    path = tmp_path / "venue.yaml"
    write_venue(path, found, futsal)
    venue = read_venue(path, futsal)
    assert venue.paint_bgr == found.paint_bgr
    assert load_config("futsal", venue_settings(path, futsal)).mask.paint_bgr == found.paint_bgr
    _require_tracked(pictures, there, venue, config)


def _require_tracked(pictures: list[NDArray[np.uint8]], there: list[Array], venue: Venue, config: Config) -> None:
    """Every frame is answered, to a pixel; a field turned by 180 degrees is the same one."""
    frames = [ClipFrame(index, index * STEP_S, picture) for index, picture in enumerate(pictures)]
    for tracked, place in zip(track_frames(frames, venue, config), there, strict=True):
        assert tracked.status == "calibrated" and tracked.view is not None
        off = np.linalg.norm(tracked.view.project(PLACES) - place, axis=1)
        turned = np.linalg.norm(tracked.view.project(-PLACES) - place, axis=1)
        assert min(off.max(), turned.max()) < 1.0


def test_lines_of_several_colours_that_are_all_dark_are_followed() -> None:
    scene = sample_scene("ice", np.random.default_rng([77, 1]), 640, 360)
    pictures, there = _pan_over(replace(scene, extras=(), decals=(), painted=None))
    config = load_config("ice-hockey")
    found = _survey(pictures, config)
    assert len(found.tripods) == 1 and found.paint_bgr is None
    _require_tracked(pictures, there, found, config)


def test_what_a_user_says_of_the_paint_is_not_learnt_anew() -> None:
    look = FirstLook(paints=[(-60.0, -12.0, -15.0)] * 3)
    assert learn_paint(look, load_config("futsal")) == (-60.0, -12.0, -15.0)
    assert learn_paint(look, load_config("futsal", ["mask.paint_bgr=[80, 10, 10]"])) is None
    assert learn_paint(look, load_config("futsal", ["learning.enabled=false"])) is None
    assert learn_paint(FirstLook(paints=look.paints[:2]), load_config("futsal")) is None
    white = FirstLook(paints=[(90.0, 80.0, 85.0)] * 5)
    assert learn_paint(white, load_config("futsal")) is None
    told = suit_tracking(load_config("futsal", ["mask.paint_bgr=[80, 10, 10]"]), (-60.0, -12.0, -15.0))
    assert told.mask.paint_bgr == (80.0, 10.0, 10.0)
