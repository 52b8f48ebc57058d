"""The table of the whole chain on rendered frames."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import Config, load_config
from circlecal.evaluation.bench import detect
from circlecal.evaluation.bench.detect import compare, profile_config, run_profiles
from circlecal.pipeline import run
from circlecal.synthetic.sampling import SCENE_PROFILES, render_frame


@pytest.mark.parametrize("command", ["detect", "constants"])
def test_unknown_profiles_are_named(run_circlecal, command):
    outcome = run_circlecal("bench", command, "--profiles", "easy,moon")
    assert outcome.code == 2
    assert "--profiles: moon is unknown; known: easy, " in " ".join(outcome.err.split())


def test_two_profiles(run_circlecal, monkeypatch):
    finished, found = [], []

    def keep(names, count, seed, advance, width):
        def note(profile):
            finished.append(profile)
            advance(profile)

        found.extend(run_profiles(names, count, seed, note, width))
        return found

    monkeypatch.setattr(detect, "run_profiles", keep)
    outcome = run_circlecal("bench", "detect", "--count", 1, "--profiles", "easy,negative", "--width", 960)
    assert outcome.code == 0, outcome.err
    easy, negative = found
    assert f"{easy.median_px:.2f}" in outcome.out and "negative" in outcome.out
    assert finished == ["easy", "negative"]
    assert (easy.profile, easy.frames, easy.calibrated, easy.good, easy.wrong) == ("easy", 1, 1.0, 1.0, 0.0)
    assert 0 < easy.median_px == easy.p90_px < 5.0
    assert 0 < easy.predicted_median_px < 50.0
    assert 0 <= easy.coverage <= 1
    assert 0 < easy.bound_median_px < 5.0
    assert (easy.bound_good, negative.bound_good) == (1.0, 0.0)
    assert np.isnan(negative.bound_median_px)
    assert easy.decoding_ms > 0
    assert easy.times_decoding * easy.decoding_ms >= easy.stage_ms["mask"]
    assert {"mask", "edges", "camera"} <= set(easy.stage_ms)
    assert (negative.calibrated, negative.wrong) == (0.0, 0.0)
    assert easy.right == negative.right == 1.0
    assert np.isnan(negative.median_px)
    assert {"easy", "negative", "hidden_mark"} <= set(SCENE_PROFILES)
    assert easy.wrong_kinds == negative.wrong_kinds == {}


def test_frames_of_other_widths(monkeypatch):
    sizes = []

    def render_and_note(profile, rng, width, height):
        sizes.append((width, height))
        return render_frame(profile, rng, width, height)

    monkeypatch.setattr(detect, "render_frame", render_and_note)
    (small,) = run_profiles(["easy"], 1, 0, width=640)
    assert small.good == 1.0
    assert small.stage_ms["edges"] > 0
    (large,) = run_profiles(["easy"], 1, 0, width=1280)
    assert large.good == 1.0
    assert sizes == [(640, 360), (1280, 720)]


def test_profiles_run_with_what_a_user_knows():
    ice = render_frame("ice", np.random.default_rng(1), 640, 360).truth
    assert profile_config("ice", ice).field.template == "ice-hockey"
    oblong = next(
        t
        for t in (render_frame("archive", np.random.default_rng([2, k])).truth for k in range(12))
        if t.camera.focal_px[0] != t.camera.focal_px[1]
    )
    assert profile_config("archive", oblong).camera.aspect == pytest.approx(oblong.to_json()["pixel_aspect"])
    assert profile_config("easy", render_frame("easy", np.random.default_rng(3), 640, 360).truth) == Config()


def test_a_frame_without_a_circle_is_wrong_however_near():
    easy = render_frame("easy", np.random.default_rng(3), 1280, 720)
    found = run(easy.image, Config(), frame_id="easy")
    error, _, _ = compare(replace(easy.truth, visible_circle_deg=0.0), found.attempt.camera)
    assert error == float("inf")


def test_comparison_takes_the_turned_field_for_the_same():
    """Which side the camera stands on cannot be seen: that alone is no error. What is said of the errors was that of
    places that the other camera does not see.
    """
    rendering = render_frame("easy", np.random.default_rng(3), 1280, 720)
    errors, said = [], []
    for side in ("main", "opposite"):
        config = load_config(None, [f"correspondences.camera_side={side}"])
        found = run(rendering.image, config, frame_id="easy")
        error, predicted, inside = compare(rendering.truth, found.attempt.camera)
        errors.append(error)
        said.append((predicted, inside))
        assert predicted > 0
        assert 0 <= inside <= 1
    assert max(errors) < 5.0
    np.testing.assert_allclose(*said, rtol=0.05)
