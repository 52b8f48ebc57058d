"""Clips of a few frames, which show one view."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.config import load_config
from circlecal.geometry.camera_parameters import PARAMETERS
from circlecal.pipeline import calibrate_image
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import sample_scene
from circlecal.tracking.clip import track_frames
from circlecal.tracking.entry import ClipFrame
from circlecal.tracking.survey import survey_clip

PERIOD_S = 0.04


@pytest.fixture(scope="module")
def picture() -> NDArray[np.uint8]:
    scene = sample_scene("easy", np.random.default_rng([3, 0]), 960, 540)
    return render(scene, np.random.default_rng(5)).image


@pytest.mark.parametrize("count", [1, 4])
def test_a_clip_of_a_few_frames_is_answered_as_a_frame_alone(count: int, picture: NDArray[np.uint8]) -> None:
    config = load_config()

    def pictures_at(times: Sequence[float]) -> Iterator[NDArray[np.uint8] | None]:
        return iter([picture if time_s < count * PERIOD_S - 1e-6 else None for time_s in times])

    alone = calibrate_image(picture, config, frame_id="alone").attempt.camera
    assert alone is not None
    venue = survey_clip(pictures_at, count * PERIOD_S, config, period_s=PERIOD_S)
    (tripod,) = venue.tripods
    assert len(tripod.used) == 1
    assert (
        np.abs(tripod.model.thetas(tripod.head_low[None], tripod.mean)[0] - alone.theta)[: len(PARAMETERS) - 3].max()
        < 1e-6
    )
    frames = [ClipFrame(k, k * PERIOD_S, picture) for k in range(count)]
    found = list(track_frames(frames, venue, config))
    assert [frame.status for frame in found] == ["calibrated"] * count
    for frame in found:
        assert frame.head is not None
        assert np.abs(frame.head.values - alone.theta[:3]).max() < 1e-3


def test_what_one_frame_tells_of_its_tripod_is_as_uncertain_as_the_frame(picture: NDArray[np.uint8]) -> None:
    config = load_config()
    fit = calibrate_image(picture, config, frame_id="alone").attempt.camera
    assert fit is not None
    (tripod,) = survey_clip(lambda times: iter([picture]), PERIOD_S, config, period_s=PERIOD_S).tripods
    # the camera's place, by the axis and the lever arm that nothing tells
    _, _, by_common = tripod.model.linearise_one(tripod.head_low, tripod.mean)
    place = by_common[4:7] @ tripod.covariance @ by_common[4:7].T
    assert np.sqrt(np.diag(place)) == pytest.approx(np.sqrt(np.diag(fit.covariance)[4:7]), rel=0.1)
