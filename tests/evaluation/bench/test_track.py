"""What ``bench track`` says of answers whose errors are known, and that it runs."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.errors import InputError
from circlecal.evaluation.bench import track
from circlecal.evaluation.bench.track import ClipTime, ClipTruth, clips_of, compare
from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS
from circlecal.geometry.surface import Surface
from circlecal.tracking.results import TrackedFrame

SIZE, SURFACE, SPENT = (1920, 1080), Surface("roof", 9.15, 0.05), ClipTime(1.0, 2.0, 6.0, 0.0)
SHOTS = ["main"] * 4 + ["cut"] * 2 + ["main"] * 4 + ["replay"]


def camera(index: int, pan_rad: float = 0.0) -> Camera:
    angles = np.array([0.01 * index + pan_rad, 1.33, 0.0])
    return Camera(*SIZE, np.full(2, 2500.0), image_center(*SIZE), angles, np.array([0.0, 60.0, -15.0]), np.zeros(2))


def truth() -> ClipTruth:
    pitch = {"length_m": 104.0, "width_m": 67.0, "crown_m": 0.05, "crown_shape": "roof", "crown_reference_m": 9.15}
    frames = [
        {"time_s": k / 25, "shot": shot, "camera": None if shot == "cut" else camera(k).soccernet()}
        for k, shot in enumerate(SHOTS)
    ]
    content = {"id": "clip", "kind": "cuts", "width": 1920, "height": 1080, "rate": 25.0, "pitch": pitch}
    return ClipTruth.model_validate_json(json.dumps({**content, "frames": frames}))


def answer(index: int, pan_rad: float = 0.0, tripod: str = "camera-1") -> TrackedFrame:
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[[INDEX["pan"], INDEX["tilt"]], [INDEX["pan"], INDEX["tilt"]]] = 1e-4**2
    view = FieldView(camera(index, pan_rad), SURFACE, np.array([-1.0, -1.0]), covariance)
    return TrackedFrame(index, index / 25, SIZE, 0, tripod, "calibrated", view=view)


def refused(index: int) -> TrackedFrame:
    return TrackedFrame(index, index / 25, SIZE, 0, None, "refused", "lost")


def test_true_answers_have_no_error():
    frames = [answer(k) if shot == "main" else refused(k) for k, shot in enumerate(SHOTS)]
    row = compare(frames, truth(), SPENT)
    assert (row.frames, row.answered, row.good, row.wrong, row.tripods) == (8, 1.0, 1.0, 0.0, 1)
    assert row.p90_px < 1e-6 and row.jitter_p90_px < 1e-6 and row.coverage == 1.0
    assert (row.in_cuts, row.in_replays, row.found_again) == (0, 0, (0,))
    assert row.time.times_decoding == 4.0


def test_a_field_that_is_turned_by_180_degrees_is_the_same_one():
    frames = [answer(k) for k in range(4)]
    turned = [replace(frame, view=replace(frame.view, camera=frame.view.camera.turn_field())) for frame in frames]
    row = compare(turned, truth(), SPENT)
    assert row.good == 0.5 and row.median_px < 1e-6


def test_errors_are_those_that_were_made():
    """A pan off by 1 mrad moves the picture by about 2.5 px; one that wavers shows in the jitter."""
    row = compare([answer(k, 1e-3) for k in range(4)], truth(), SPENT)
    assert row.answered == 0.5 and row.median_px == pytest.approx(2.5, abs=0.3)
    assert row.jitter_p90_px < 0.05 and row.coverage < 0.1
    wavering = compare([answer(k, 1e-3 * (-1) ** k) for k in range(4)], truth(), SPENT)
    assert wavering.jitter_median_px == pytest.approx(4 * 2.5 / 6**0.5, rel=0.15)
    wrong = compare([answer(0, 0.02)], truth(), SPENT)
    assert wrong.wrong == pytest.approx(1 / 8) and wrong.good == 0.0


def test_cuts_replays_and_cameras_are_counted():
    frames = [answer(k, tripod="camera-1" if k < 4 else "camera-2") for k in (0, 1, 2, 3, 4, 8, 9, 10)]
    row = compare(frames, truth(), SPENT)
    assert (row.in_cuts, row.in_replays, row.tripods) == (1, 1, 2)
    assert row.found_again == (2,)
    assert compare([], truth(), SPENT).found_again == (4,)


def test_a_folder_without_clips_or_truth_is_told(tmp_path):
    with pytest.raises(InputError, match="holds no clip"):
        clips_of(tmp_path)
    (tmp_path / "clip.mp4").touch()
    with pytest.raises(InputError, match=r"clip\.json: cannot be read"):
        clips_of(tmp_path)
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "clip.json").write_text("{}")
    with pytest.raises(InputError, match="id: Field required"):
        clips_of(tmp_path)


def test_pictures_between_frames_are_surveyed_as_track_does(monkeypatch):
    """Half of all times fall more than half a frame before the next one; without their pictures a survey is half."""
    asked = []
    monkeypatch.setattr(track, "pictures_at", lambda path, times, exact=True: asked.append(exact) or iter(()))
    monkeypatch.setattr(track, "survey_clip", lambda pictures_at, *_, **__: list(pictures_at([0.1])) and None)
    monkeypatch.setattr(track, "track_frames", lambda *_: iter(()))
    video = SimpleNamespace(path="clip.mp4", name="clip", duration_s=1.0, rate=25.0, frames=lambda _: iter(()))
    track._track(video, load_config())
    assert asked == [False]


def test_it_renders_tracks_and_prints(run_circlecal):
    size = ("--count", 1, "--kinds", "still", "--seconds", 0.6, "--rate", 5, "--width", 480)
    outcome = run_circlecal("bench", "track", *size)
    assert outcome.code == 0, outcome.err
    assert "still_00000" in outcome.out and "x decoding" in outcome.out
    assert run_circlecal("bench", "track", "--kinds", "dance").code == 2


@pytest.mark.parametrize("profile", ["", "snow", "rink,court"])
def test_a_wrong_look_of_clips_is_one_line(run_circlecal, profile):
    outcome = run_circlecal("bench", "track", "--profile", profile)
    assert outcome.code == 2 and "--profile" in outcome.err and outcome.err.count("\n") == 1
