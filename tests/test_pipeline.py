"""The whole chain on rendered frames and on observations."""

from dataclasses import dataclass

import numpy as np
import pytest

from circlecal.bench.detect import compare
from circlecal.config import Config, load_config
from circlecal.errors import ConfigError, InputError
from circlecal.observations import Keypoint, Observations
from circlecal.pipeline import field_of, frame_generator, joined, run, run_observations
from circlecal.synthetic.markings import circle_points, line_points
from circlecal.synthetic.renderer import Rendering
from circlecal.synthetic.sampling import render_frame

CONFIG = Config()
SIZE = (1280, 720)
PICTURE_STAGES = [
    "mask", "edges", "rays", "ellipse", "cues", "correspondences", "homography", "camera", "verdict",
]  # fmt: skip


@dataclass(frozen=True)
class Frames:
    """Rendered once for all tests."""

    easy: Rendering
    hidden: Rendering
    grass: np.ndarray


@pytest.fixture(scope="module")
def frames() -> Frames:
    turf = np.random.default_rng(1).normal((45, 115, 70), 4, (SIZE[1], SIZE[0], 3)).clip(0, 255).astype(np.uint8)
    return Frames(
        render_frame("easy", np.random.default_rng(3), *SIZE),
        render_frame("hidden_mark", np.random.default_rng(3), *SIZE),
        turf,
    )


@pytest.fixture(scope="module")
def easy(frames):
    return run(frames.easy.image, CONFIG, frame_id="easy")


def error_px(rendering, calibration):
    """Mean reprojection error near the circle in pixels at 1920 px width, in the stored picture."""
    error, _, _ = compare(rendering.truth, calibration.camera)
    return error


def same(one, other):
    np.testing.assert_array_equal(one.H_image_field, other.H_image_field)
    np.testing.assert_array_equal(one.camera.covariance, other.camera.covariance)
    np.testing.assert_array_equal(one.ellipses.primary.conic, other.ellipses.primary.conic)


def test_the_picture_alone_is_calibrated(frames, easy):
    assert easy.status == "calibrated"
    assert easy.mask.source == "detector"
    assert error_px(frames.easy, easy) < 3.0
    assert (easy.width, easy.height, easy.field_name, easy.circle_name) == (*SIZE, "soccer", "centre_circle")


def test_a_frame_with_its_mask_is_calibrated(frames, easy):
    found = run(frames.easy.image, CONFIG, mask=frames.easy.truth.classes, frame_id="easy")
    assert found.status == "calibrated"
    assert found.mask.source == "file"
    assert error_px(frames.easy, found) < 3.0
    assert abs(error_px(frames.easy, found) - error_px(frames.easy, easy)) < 2.0


def test_the_centre_mark_need_not_be_seen(frames):
    found = run(frames.hidden.image, CONFIG, frame_id="hidden")
    assert found.status == "calibrated"
    assert found.cues.mark is None
    assert error_px(frames.hidden, found) < 10.0


def test_every_intermediate_is_returned_and_timed(easy):
    assert list(easy.timings_ms) == PICTURE_STAGES
    assert all(0 < ms < 60_000 for ms in easy.timings_ms.values())
    for stage in (*PICTURE_STAGES[:-1], "ellipses", "observations"):
        if stage != "ellipse":
            assert getattr(easy, stage) is not None, stage
    assert easy.verdict.checks
    assert all(check.passed for check in easy.verdict.checks)
    np.testing.assert_array_equal(easy.H_image_field, easy.camera.H_image_field)


def test_grass_is_refused_with_a_reason(frames):
    found = run(frames.grass, CONFIG, frame_id="grass")
    assert found.status == "refused"
    assert found.verdict.stage == "mask"
    assert " " in found.verdict.reason
    assert found.H_image_field is None
    assert found.camera is None
    assert found.mask is not None
    assert list(found.timings_ms) == ["mask"]


def test_a_refused_frame_keeps_what_was_reached(frames):
    strict = load_config(None, ["ellipse.minimum_arc_deg=360", "ellipse.minimum_points=6"])
    image, middle = frames.easy.image.copy(), int(frames.easy.truth.imaged_center_px[0])
    image[:, :middle] = frames.grass[:, :middle]
    found = run(image, strict, mask=frames.easy.truth.classes, frame_id="half")
    assert (found.status, found.verdict.code, found.verdict.stage) == ("refused", "arc_too_short", "ellipse")
    assert found.edges is not None
    assert found.rays is not None
    assert found.camera is None


def test_same_seed_same_answer_whatever_the_order(frames, easy):
    run(frames.hidden.image, CONFIG, frame_id="hidden")
    same(run(frames.easy.image, CONFIG, frame_id="easy"), easy)


def test_seed_and_name_of_the_frame_fix_the_draws():
    def draws(seed, name):
        return frame_generator(seed, name).random(4).tolist()

    assert draws(0, "a") == draws(0, "a")
    assert draws(0, "a") != draws(0, "b")
    assert draws(0, "a") != draws(1, "a")


def test_another_seed_changes_next_to_nothing(frames, easy):
    other = run(frames.easy.image, load_config(None, ["seed=7"]), frame_id="easy")
    assert other.seed == 7
    assert abs(error_px(frames.easy, other) - error_px(frames.easy, easy)) < 0.3


def test_without_the_camera_stage_the_closed_form_answers(frames):
    plain = load_config(None, ["camera.enabled=false", "verdict.max_circle_residual_px=6"])
    found = run(frames.easy.image, plain, frame_id="easy")
    assert found.camera is None
    assert found.status == "calibrated"
    np.testing.assert_array_equal(found.H_image_field, found.homography.H_image_field)
    assert found.correspondences.case == 1
    assert "camera" not in found.timings_ms


def test_without_camera_and_line_there_is_no_answer(frames):
    plain = load_config(None, ["camera.enabled=false", "cues.halfway_line=false"])
    found = run(frames.easy.image, plain, frame_id="easy")
    assert found.verdict.code == "no_line_or_point"


def test_a_mask_of_another_size_is_an_input_error(frames):
    with pytest.raises(InputError, match=r"some frame: the mask is 640x360, the picture 1280x720"):
        run(frames.easy.image, CONFIG, mask=np.zeros((360, 640), np.uint8), frame_id="some frame")


def test_unknown_circle_and_template():
    with pytest.raises(ConfigError, match=r"field.circle: 'moon' .* known: centre_circle"):
        field_of(load_config(None, ["field.circle=moon"]))
    with pytest.raises(ConfigError, match="unknown"):
        field_of(load_config(None, ["field.template=moon"]))
    template, circle = field_of(load_config(None, ["field.template=ice-hockey", "field.circle=faceoff_left_top"]))
    assert (template.name, circle.name) == ("ice-hockey", "faceoff_left_top")


def given_by(camera, template, sigma=0.3):
    rng = np.random.default_rng(5)
    return Observations(
        camera.width,
        camera.height,
        (circle_points(camera, template, "outer", 80, sigma, rng),),
        (line_points(camera, template, "halfway_line", 30, sigma, rng),),
    )


def test_observations_alone_are_calibrated(frames):
    camera = frames.easy.truth.camera
    template, _ = field_of(CONFIG)
    found = run_observations(
        given_by(camera, template), CONFIG, frame_id="given", source="somewhere", convention="paint"
    )
    assert found.status == "calibrated"
    assert found.source == "somewhere"
    assert found.mask is None
    assert list(found.timings_ms) == PICTURE_STAGES[3:]
    field = np.array([[9.15, 0.0], [-9.15, 0.0], [0.0, 9.15], [0.0, -9.15]])
    seen = found.camera.camera.project(field)
    assert np.abs(seen - camera.project(field)).max() < 4.0


def test_conventions_differ_by_the_paint(frames):
    """Points on the centreline of the paint, read as lying at the official radius, make the circle too large."""
    camera = frames.easy.truth.camera
    template, circle = field_of(CONFIG)
    rng = np.random.default_rng(6)
    given = given_by(camera, template)
    middle = Observations(*SIZE, (circle_points(camera, template, "center", 80, 0.2, rng),), given.lines)
    paint = run_observations(middle, CONFIG, frame_id="a", convention="paint")
    official = run_observations(middle, CONFIG, frame_id="a")
    assert paint.correspondences.radius_m == pytest.approx(template.radius(circle, "center"))
    assert official.correspondences.radius_m == pytest.approx(circle.radius_m)


def test_too_few_observations_are_refused(frames):
    template, _ = field_of(CONFIG)
    given = given_by(frames.easy.truth.camera, template)
    bare = run_observations(Observations(*SIZE), CONFIG, frame_id="bare")
    assert (bare.status, bare.verdict.code) == ("refused", "no_ellipse")
    alone = run_observations(Observations(*SIZE, given.circles), CONFIG, frame_id="alone")
    assert (alone.status, alone.verdict.code) == ("refused", "rotation_free")


def test_extra_observations_are_used_with_the_picture(frames, easy):
    camera = frames.easy.truth.camera
    rng = np.random.default_rng(8)
    field = np.array([[9.0, 3.0], [-8.0, -2.0], [4.0, -7.0]])
    pixels = camera.project(np.c_[field, frames.easy.truth.crown_m * np.abs(field[:, 1]) / 9.15])
    keypoints = tuple(
        Keypoint(f"point {k}", field[k], pixels[k] + rng.normal(0, 0.3, 2), 0.5) for k in range(len(field))
    )
    found = run(frames.easy.image, CONFIG, extra=Observations(*SIZE, keypoints=keypoints), frame_id="easy")
    assert found.status == "calibrated"
    assert {"point 0", "point 1", "point 2"} <= {*found.camera.residuals_px, *found.camera.rejected}
    assert found.camera.max_sigma_px < easy.camera.max_sigma_px
    assert error_px(frames.easy, found) < 3.0


def test_joining_keeps_everything(frames):
    template, _ = field_of(CONFIG)
    given = given_by(frames.easy.truth.camera, template)
    both = joined(given, given)
    assert (len(both.circles), len(both.lines), both.width) == (2, 2, SIZE[0])
