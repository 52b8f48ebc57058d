"""Robot soccer: low, near cameras with wide-angle lenses before wide paint, with ``configs/robocup.yaml``."""

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.evaluation.bench.detect import compare
from circlecal.field import load_field
from circlecal.geometry.surface import FLAT
from circlecal.observations import Observations
from circlecal.pipeline import run, run_observations
from circlecal.pipeline.field_choice import calibrate_unknown_field
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.markings import circle_points, line_points
from circlecal.synthetic.renderer import render
from circlecal.synthetic.scene import RenderConfig, Scene

ROBOCUP = load_field("robocup")
CONFIG = load_config("robocup", [])
SIZE = (800, 448)
LOOK = RenderConfig(
    marking_width_m=ROBOCUP.marking_width_m,
    stripe_contrast=0.0,
    texture=0.1,
    wear=0.3,
    wear_scale_m=0.05,
    defocus_px=1.0,
    noise=2.0,
    board_distance_m=1.0,
    board_height_m=0.6,
    stand_height_m=3.0,
    shadow_count=0,
)
TOWARDS_GOAL = aim_camera(np.array([-1.5, 0.3, -0.55]), np.array([0.3, 0.0, 0.0]), 470.0, 0.06, *SIZE, kappa=-0.06)
ALONG_LINE = aim_camera(np.array([0.4, 3.2, -0.9]), np.array([0.0, 0.2, 0.0]), 640.0, -0.09, *SIZE, kappa=0.03)
ASLANT = aim_camera(np.array([3.3, -0.9, -1.45]), np.array([0.0, 0.1, 0.0]), 435.0, 0.02, *SIZE, kappa=-0.08)
CLOSE = aim_camera(np.array([0.32, -1.41, -0.83]), np.array([-0.25, 0.05, 0.0]), 720.0, -0.1, *SIZE, kappa=-0.065)
GOAL_AREA = aim_camera(np.array([1.2, 0.5, -0.6]), np.array([4.2, -0.1, 0.0]), 480.0, 0.03, *SIZE, kappa=-0.05)


OVER_THE_CIRCLE = aim_camera(np.array([-2.5, 0.4, -0.5]), np.array([1.0, 0.0, 0.0]), 520.0, 0.07, *SIZE, kappa=-0.06)
FROM_A_MAST = aim_camera(np.array([0.6, 4.2, -4.4]), np.array([0.0, 0.2, 0.0]), 560.0, 0.02, *SIZE, kappa=-0.05)
SMALL_SIZE = load_field("robocup-ssl")
UNDER_THE_CEILING = aim_camera(
    np.array([0.3, 0.2, -4.6]), np.array([0.3, 0.18, 0.0]), 700.0, 0.02, 1280, 960, kappa=-0.03
)


def rendered(camera, template=ROBOCUP):
    look = LOOK.model_copy(update={"marking_width_m": template.marking_width_m})
    return render(Scene(camera, template, FLAT, look), np.random.default_rng(5))


@pytest.mark.parametrize("camera", [TOWARDS_GOAL, ALONG_LINE, ASLANT], ids=["towards_goal", "along_line", "aslant"])
def test_a_robots_picture_is_calibrated(camera):
    picture = rendered(camera)
    found = run(picture.image, CONFIG, frame_id="robot")
    assert found.status == "calibrated", found.verdict
    assert compare(picture.truth, found.attempt.camera)[0] < 4.0
    assert found.attempt.camera.camera.position_m[2] == pytest.approx(camera.position_m[2], abs=0.03)


def test_a_camera_may_stand_on_a_mast():
    """Above three metres every picture of a robots' field was refused."""
    picture = rendered(FROM_A_MAST)
    found = run(picture.image, CONFIG, frame_id="mast")
    assert found.status == "calibrated", found.verdict
    assert compare(picture.truth, found.attempt.camera)[0] < 1.0


def test_a_camera_under_the_ceiling_is_right_on_the_field_and_honest_about_its_height():
    """From straight above, zoom and height are one: a robot's usual elevation pulled the camera to 0.3 m."""
    picture = rendered(UNDER_THE_CEILING, SMALL_SIZE)
    config = load_config(None, {"field.template": "robocup-ssl"})
    found = run(picture.image, config, frame_id="ceiling")
    assert found.status == "calibrated", found.verdict
    camera = found.attempt.camera
    assert compare(picture.truth, camera)[0] < 1.0
    height, spread = -camera.camera.position_m[2], np.sqrt(camera.covariance[6, 6])
    assert abs(height - 4.6) < 2 * spread and 0.3 < spread < 2.0
    known = run(picture.image, load_config(config, {"camera.focal_px": 700.0}), frame_id="ceiling")
    assert -known.attempt.camera.camera.position_m[2] == pytest.approx(4.6, abs=0.1)


def test_a_ceiling_camera_whose_lens_is_told_needs_no_other_prior():
    """What the refusal of a lens that is too short advises must not lead to a wrong camera."""
    picture = rendered(UNDER_THE_CEILING, SMALL_SIZE)
    config = load_config("robocup-ceiling", {"field.template": "robocup-ssl"})
    config = config.model_copy(update={"camera": CONFIG.camera, "verdict": CONFIG.verdict})
    refused = run(picture.image, config, frame_id="ceiling")
    assert (refused.status, refused.verdict.code) == ("refused", "implausible_camera")
    assert "camera.focal_px" in refused.verdict.help
    told = config.model_copy(update={"camera": CONFIG.camera.model_copy(update={"focal_px": 700.0})})
    found = run(picture.image, told, frame_id="ceiling")
    assert found.status == "calibrated", found.verdict
    assert -found.attempt.camera.camera.position_m[2] == pytest.approx(4.6, abs=0.1)


def test_a_picture_tells_kid_size_by_itself():
    """KidSize was none of the fields that auto tries, and was taken for the Standard Platform League's."""
    picture = rendered(OVER_THE_CIRCLE, load_field("robocup-kid"))
    found = calibrate_unknown_field(picture.image, load_config(None, {"field.template": "auto"}), frame_id="kid")
    assert (found.status, found.field_name) == ("calibrated", "robocup-kid")


def test_a_part_of_the_circle_is_calibrated_with_its_mark_and_never_wrongly_without():
    picture = rendered(CLOSE)
    assert 150 < picture.truth.visible_circle_deg < 320
    found = run(picture.image, CONFIG, frame_id="close")
    assert found.status == "calibrated", found.verdict
    assert found.attempt.cues.mark is not None
    assert compare(picture.truth, found.attempt.camera)[0] < 4.0
    hidden = render(Scene(CLOSE, ROBOCUP, FLAT, LOOK, center_mark_painted=False), np.random.default_rng(5))
    without = run(hidden.image, CONFIG, frame_id="close")
    assert without.status == "refused" or compare(hidden.truth, without.attempt.camera)[0] < 12.0


def test_near_paint_is_many_pixels_wide():
    near = TOWARDS_GOAL.project([[-0.725, 0.0], [-0.775, 0.0]])
    assert np.linalg.norm(near[1] - near[0]) > 15


def test_without_the_circle_nothing_is_calibrated():
    assert run(rendered(GOAL_AREA).image, CONFIG, frame_id="goal").status == "refused"


def test_a_mask_of_the_markings_is_taken():
    picture = rendered(TOWARDS_GOAL)
    found = run(picture.image, CONFIG, mask=picture.truth.classes, frame_id="robot")
    assert (found.status, found.attempt.mask.source) == ("calibrated", "file")
    assert compare(picture.truth, found.attempt.camera)[0] < 4.0


def test_annotated_points_need_no_picture():
    rng = np.random.default_rng(2)
    observations = Observations(
        *SIZE,
        (circle_points(TOWARDS_GOAL, ROBOCUP, "center", 40, 0.7, rng),),
        (line_points(TOWARDS_GOAL, ROBOCUP, "halfway_line", 12, 0.7, rng),),
    )
    found = run_observations(observations, CONFIG, frame_id="clicked", convention="paint")
    assert found.status == "calibrated", found.verdict
    np.testing.assert_allclose(found.attempt.camera.camera.position_m, TOWARDS_GOAL.position_m, atol=0.05)


def test_the_fields_of_the_humanoid_league_are_sizes_of_the_same_template():
    adult = {"length": 14, "width": 9, "circle_radius": 1.5, "penalty_area_depth": 3, "penalty_area_width": 6}
    field = load_field("robocup", adult)
    assert (field.length_m, field.width_m) == (14.0, 9.0)
    assert field.circle_by_name["centre_circle"].radius_m == 1.5
    np.testing.assert_allclose(field.line_ends(field.line_by_name["big_rect_right_main"]), [[4, -3], [4, 3]])


def test_sizes_are_those_of_the_middle_of_the_paint():
    circle = ROBOCUP.circle_by_name["centre_circle"]
    assert ROBOCUP.radius(circle, "outer") == pytest.approx(0.775)
    assert ROBOCUP.line_ends(ROBOCUP.line_by_name["side_line_left"])[0] == pytest.approx([-4.5, -3.0])
