"""A second camera of a clip, of which no frame is calibrated alone at first, since enough others are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.config import load_config
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import sample_scene
from circlecal.tracking import first_look
from circlecal.tracking.other_cameras import MOST_OF_STRETCH, MOST_STRETCHES, times_of_others
from circlecal.tracking.survey import survey_clip

SIZE = (960, 540)
STEP_S, OF_FIRST = 0.2, 3


@pytest.fixture(scope="module")
def pictures() -> list[NDArray[np.uint8]]:
    """Three of a camera beside the pitch and four of one high behind a goal."""
    scene = sample_scene("easy", np.random.default_rng([3, 0]), *SIZE)
    behind = np.array([-85.0, 2.0, -19.0])
    beside = [np.radians(0.4) * np.array([k, 0.0, 0.0]) + scene.camera.angles_rad for k in range(OF_FIRST)]
    cameras = [replace(scene.camera, angles_rad=angles) for angles in beside]
    for x in (-4.0, -2.0, 0.0, 2.0):
        cameras.append(aim_camera(behind, np.array([x, x, 0.0]), 1.5 * SIZE[0], 0.0, *SIZE, 0.0))
    return [render(replace(scene, camera=camera), np.random.default_rng(5)).image for camera in cameras]


@pytest.mark.parametrize(("of_second", "tripods"), [(4, 2), (2, 1)])
def test_three_frames_that_no_tripod_explains_make_another_camera(
    of_second: int, tripods: int, pictures: list[NDArray[np.uint8]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(first_look, "ENOUGH_ALONE", OF_FIRST)
    shown = pictures[: OF_FIRST + of_second]

    def pictures_at(times: Sequence[float]) -> Iterator[NDArray[np.uint8] | None]:
        numbers = [int(np.ceil(time_s / STEP_S - 1e-6)) for time_s in times]
        return iter([shown[k] if k < len(shown) else None for k in numbers])

    venue = survey_clip(pictures_at, len(shown) * STEP_S, load_config(), period_s=STEP_S)
    assert sorted(tripod.name for tripod in venue.tripods) == ["camera-1", "camera-2"][:tripods]
    if tripods == 2:
        (found,) = (tripod for tripod in venue.tripods if abs(tripod.mean[0]) > 40.0)
        assert abs(abs(found.mean[0]) - 85.0) < 0.5
        # no picture counts twice, by the time at which it was looked at and that of the look before
        assert len(found.used) == of_second


def test_the_longest_stretches_that_are_left_are_looked_at_evenly_and_no_picture_twice() -> None:
    is_left = {f"{k:.3f}": k in (4, 5, 6) for k in range(8)}
    assert times_of_others(is_left, 0.04) == pytest.approx(np.linspace(3.75, 6.25, MOST_OF_STRETCH))
    assert times_of_others({f"{k:.3f}": k > 4 for k in range(8)}, 1.0) == pytest.approx(np.linspace(4.75, 7.0, 3))
    assert times_of_others({f"{k:.3f}": False for k in range(8)}, 0.04) == []
    single = {f"{k:.3f}": k % 2 == 1 for k in range(4 * MOST_STRETCHES)}
    assert len(times_of_others(single, 0.5)) == 2 * MOST_STRETCHES
