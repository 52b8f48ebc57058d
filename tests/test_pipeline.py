"""The whole chain on rendered frames and on observations."""

import json
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from circlecal.config import Config, load_config
from circlecal.errors import ConfigError, InputError
from circlecal.evaluation.bench.detect import compare
from circlecal.field import load_field
from circlecal.geometry.homography import compass_label
from circlecal.geometry.projective import apply_homography, normalise_line, transform_lines
from circlecal.geometry.surface import Surface
from circlecal.observations import Keypoint, Observations, join_observations
from circlecal.overlay import draw_overlay, stage_pictures
from circlecal.pipeline import attempts, field_of, refinements, run, run_observations
from circlecal.pipeline.attempts import face_camera
from circlecal.pipeline.refinements import calibrate_scene
from circlecal.pipeline.setting import Setting, frame_generator, prepare_scene
from circlecal.records.json_text import result_line
from circlecal.records.stored import calibration_of_record
from circlecal.records.writing import result_record
from circlecal.refusals import REFUSALS, Confidence
from circlecal.stages.camera import estimate_camera
from circlecal.stages.correspondences import is_turned, turn_correspondences
from circlecal.stages.homography import turn_fit
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.looks import sample_config
from circlecal.synthetic.markings import circle_points, line_points
from circlecal.synthetic.renderer import Rendering, render
from circlecal.synthetic.sampling import SCENE_PROFILES, render_frame
from circlecal.synthetic.scene import Scene

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
    error, _, _ = compare(rendering.truth, calibration.attempt.camera)
    return error


def same(one, other):
    np.testing.assert_array_equal(one.H_image_field, other.H_image_field)
    np.testing.assert_array_equal(one.attempt.camera.covariance, other.attempt.camera.covariance)
    np.testing.assert_array_equal(one.attempt.ellipses.primary.conic, other.attempt.ellipses.primary.conic)


def test_the_picture_alone_is_calibrated(frames, easy):
    assert easy.status == "calibrated"
    assert easy.attempt.mask.source == "detector"
    assert error_px(frames.easy, easy) < 3.0
    assert (easy.width, easy.height, easy.field_name, easy.circle_name) == (*SIZE, "soccer", "centre_circle")


def test_dark_markings_are_measured_as_the_detector_saw_them(frames):
    config = load_config(None, ["mask.detector.marking=any"])
    found = run(255 - frames.easy.image, config, frame_id="easy")
    assert found.attempt.mask.polarity == -1.0
    assert found.status == "calibrated"
    assert error_px(frames.easy, found) < 3.0


def test_a_frame_with_its_mask_is_calibrated(frames, easy):
    found = run(frames.easy.image, CONFIG, mask=frames.easy.truth.classes, frame_id="easy")
    assert found.status == "calibrated"
    assert found.attempt.mask.source == "file"
    assert error_px(frames.easy, found) < 3.0
    assert abs(error_px(frames.easy, found) - error_px(frames.easy, easy)) < 2.0


def test_the_centre_mark_need_not_be_seen(frames):
    found = run(frames.hidden.image, CONFIG, frame_id="hidden")
    assert found.status == "calibrated"
    assert found.attempt.cues.mark is None
    assert error_px(frames.hidden, found) < 10.0


def test_every_intermediate_is_returned_and_timed(easy):
    assert list(easy.timings_ms) == PICTURE_STAGES
    assert all(ms > 0 for ms in easy.timings_ms.values())
    for stage in (*PICTURE_STAGES[:-1], "ellipses", "observations"):
        if stage != "ellipse":
            assert getattr(easy.attempt, stage) is not None, stage
    assert easy.verdict.checks
    assert all(check.passed for check in easy.verdict.checks)
    np.testing.assert_array_equal(easy.H_image_field, easy.attempt.camera.H_image_field)


def test_grass_is_refused_with_a_reason(frames):
    found = run(frames.grass, CONFIG, frame_id="grass")
    assert found.status == "refused"
    assert found.verdict.stage == "mask"
    assert " " in found.verdict.reason
    assert found.H_image_field is None
    assert found.attempt.camera is None
    assert found.attempt.mask is not None
    assert list(found.timings_ms) == ["mask"]


def test_a_refused_frame_keeps_what_was_reached(frames):
    strict = load_config(None, ["ellipse.maximum_rms_px=0.001", "ellipse.minimum_points=6"])
    image, middle = frames.easy.image.copy(), int(frames.easy.truth.imaged_center_px[0])
    image[:, :middle] = frames.grass[:, :middle]
    found = run(image, strict, mask=frames.easy.truth.classes, frame_id="half")
    assert (found.status, found.verdict.code, found.verdict.stage) == ("refused", "residual_too_large", "ellipse")
    assert found.attempt.edges is not None
    assert found.attempt.rays is not None
    assert found.attempt.camera is None


def test_other_markings_turn_a_circle_without_a_halfway_line():
    rendering = render_frame("no_halfway", np.random.default_rng([5, 2]), *SIZE)
    found = run(rendering.image, load_config(None, ["cues.field_lines=false"]), frame_id="half")
    assert rendering.truth.expect == found.status[:9] == "calibrate"
    assert found.attempt.cues.halfway is None
    assert found.attempt.mask.confidence is Confidence.TENTATIVE
    assert len(found.attempt.camera.named_lines) >= 2
    assert error_px(rendering, found) < 5.0
    assert {c.circle for c in found.attempt.observations.circles} >= {"centre_circle"}
    quick = run(rendering.image, CONFIG, frame_id="half")
    assert error_px(rendering, quick) < 5.0
    assert {c.circle for c in quick.attempt.observations.circles} >= {"centre_circle"}


def test_a_circle_with_one_line_beside_it_is_refused():
    rendering = render_frame("no_halfway", np.random.default_rng([5, 9]), *SIZE)
    found = run(rendering.image, CONFIG, frame_id="half")
    assert rendering.truth.expect == "refuse"
    assert (found.status, found.verdict.code, found.verdict.stage) == ("refused", "rotation_free", "camera")
    assert found.attempt.camera is None
    assert found.attempt.mask.conic is None


def test_same_seed_same_answer_whatever_the_order(frames, easy):
    run(frames.hidden.image, CONFIG, frame_id="hidden")
    same(run(frames.easy.image, CONFIG, frame_id="easy"), easy)


def test_the_seed_alone_fixes_the_draws():
    def draws(seed):
        return frame_generator(seed).random(4).tolist()

    assert draws(0) == draws(0)
    assert draws(0) != draws(1)


def test_the_name_of_a_frame_changes_nothing(frames, easy):
    other = run(frames.easy.image, CONFIG, frame_id="another name")
    same(replace(other, id=easy.id, source=easy.source), easy)


def test_another_seed_changes_next_to_nothing(frames, easy):
    other = run(frames.easy.image, load_config(None, ["seed=7"]), frame_id="easy")
    assert other.seed == 7
    assert abs(error_px(frames.easy, other) - error_px(frames.easy, easy)) < 0.3


def test_without_the_camera_stage_the_homography_answers(frames):
    plain = load_config(None, ["camera.enabled=false", "verdict.max_circle_residual_px=6"])
    found = run(frames.easy.image, plain, frame_id="easy")
    assert found.attempt.camera is None
    assert found.status == "calibrated"
    np.testing.assert_array_equal(found.H_image_field, found.attempt.homography.H_image_field)
    assert found.attempt.correspondences.case == 1
    assert "camera" not in found.timings_ms


def test_why_there_are_no_correspondences_is_recorded(frames):
    """The camera does without the case that was asked for."""
    found = run(frames.easy.image, load_config(None, ["correspondences.case=2"]), frame_id="easy")
    assert found.status == "calibrated"
    assert found.attempt.correspondences is None
    record = result_record(found, load_field("soccer"))
    assert record.no_correspondences.startswith("no point of known field position is seen, and case 2 needs one. Give ")
    assert "--keypoints" in record.no_correspondences
    assert calibration_of_record(record).attempt.no_correspondences == record.no_correspondences


def test_without_camera_and_line_there_is_no_answer(frames):
    plain = load_config(None, ["camera.enabled=false", "cues.halfway_line=false"])
    found = run(frames.easy.image, plain, frame_id="easy")
    assert found.verdict.code == "no_line_or_point"


def test_a_field_with_several_circles_is_answered_without_the_camera_stage():
    """Another circle than the first is tried there too, and nothing asks for a camera that no stage estimated."""
    rendering = render_frame("ice", np.random.default_rng([0, 19, SCENE_PROFILES.index("ice")]))
    for setting in ("solver=great_axis", "camera.enabled=false"):
        found = run(rendering.image, load_config("ice-hockey", [setting]), frame_id="ice-19")
        assert found.attempt.camera is None
        assert found.status == "calibrated" or found.verdict.code in REFUSALS


def points_of_record(record):
    """Where the eight points and tangents of a record lie against its own homography: rms of both, px and 1."""
    H = np.array(record["H_image_field"] or record["rejected_estimate"]["H_image_field"])
    points, tangents = record["correspondences"]["points"], record["correspondences"]["tangents"]
    field, image = (np.array([p[key] for p in points]) for key in ("field_m", "image_px"))
    lines = normalise_line(transform_lines(H, np.array([t["field_line"] for t in tangents])))
    seen = np.array([t["image_line"] for t in tangents])
    lines *= np.sign((lines * seen).sum(axis=1, keepdims=True))
    turned = np.linalg.norm(lines[:, :2] - seen[:, :2], axis=1)
    return np.linalg.norm(apply_homography(H, field) - image, axis=1), turned


@pytest.mark.parametrize("side", ["main", "opposite", "left_goal", "right_goal"])
@pytest.mark.parametrize("profile", ["easy", "behind_goal", "oblique"])
def test_points_tangents_homography_and_camera_of_a_record_agree_about_the_side(profile, side):
    """The closed form chooses its side of the field before the camera is known: the camera decides."""
    rendering = render_frame(profile, np.random.default_rng([7, 3]), *SIZE)
    found = run(rendering.image, load_config(None, [f"correspondences.camera_side={side}"]), frame_id=profile)
    template, circle = field_of(CONFIG)
    record = json.loads(result_line(result_record(found, template)))
    if found.attempt.camera is None or record["correspondences"] is None:
        pytest.skip("this frame has no camera to compare with")
    size = 2 * max(found.attempt.ellipses.primary.ellipse.semi_axes)
    off, tangents = points_of_record(record)
    assert off.max() < 0.2 * size
    assert tangents.max() < 0.5
    by_label = {p["label"]: np.array(p["field_m"]) for p in record["correspondences"]["points"]}
    for label, place in by_label.items():
        assert compass_label(place - np.asarray(circle.center)) == label
    np.testing.assert_allclose(
        found.attempt.homography.H_field_image @ found.attempt.homography.H_image_field, np.eye(3) * (
            found.attempt.homography.H_field_image @ found.attempt.homography.H_image_field
        )[2, 2], atol=1e-6,
    )  # fmt: skip


def test_what_the_closed_form_named_from_the_other_side_is_turned(easy):
    _, circle = field_of(CONFIG)
    center = np.asarray(circle.center)
    turned = turn_correspondences(easy.attempt.correspondences, center)
    assert is_turned(turned, easy.H_image_field, center) and not is_turned(
        easy.attempt.correspondences, easy.H_image_field, center
    )
    attempt = replace(easy.attempt, correspondences=turned, homography=turn_fit(easy.attempt.homography))
    again = face_camera(attempt, center)
    for mine, first in zip(again.correspondences.points, easy.attempt.correspondences.points, strict=True):
        assert mine.label == first.label
        np.testing.assert_array_equal(mine.image_px, first.image_px)
    for mine, first in zip(again.correspondences.tangents, easy.attempt.correspondences.tangents, strict=True):
        np.testing.assert_array_equal(mine.image_line, first.image_line)
    np.testing.assert_allclose(again.homography.H_image_field, easy.attempt.homography.H_image_field)


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
    assert found.attempt.mask is None
    assert list(found.timings_ms) == PICTURE_STAGES[3:]
    field = np.array([[9.15, 0.0], [-9.15, 0.0], [0.0, 9.15], [0.0, -9.15]])
    seen = found.attempt.camera.camera.project(field)
    assert np.abs(seen - camera.project(field)).max() < 4.0


def test_tangents_change_the_answer_without_a_camera_and_its_picture(frames):
    """A touchline that was seen contradicts the circle by both their noise, and tangents give the circle more say."""
    camera = frames.easy.truth.camera
    template, _ = field_of(CONFIG)
    given = given_by(camera, template)
    far = line_points(camera, template, "side_line_top", 30, 0.3, np.random.default_rng(6))
    far_m, answers, pictures = np.array([[-10.0, -30.0], [10.0, -30.0]]), [], []
    for used in ("true", "false"):
        plain = load_config(None, ["camera.enabled=false", f"homography.use_tangents={used}"])
        seen = replace(given, lines=(*given.lines, far))
        found = run_observations(seen, plain, frame_id="given", convention="paint")
        assert found.status == "calibrated"
        answers.append(result_record(found, template))
        pictures.append(stage_pictures(frames.easy.image, found, template)["07-homography"])
        assert np.abs(apply_homography(found.H_image_field, far_m) - camera.project(far_m)).max() < 15.0  # no lens
    with_them, without = answers
    assert np.abs(np.array(with_them.residuals_px.homography) - without.residuals_px.homography).max() > 1e-3
    moved = apply_homography(with_them.H_image_field, far_m) - apply_homography(without.H_image_field, far_m)
    assert np.abs(moved).max() > 1e-2
    assert not np.array_equal(*pictures)


def test_conventions_differ_by_the_paint(frames):
    """Points on the centreline of the paint, read as lying at the official radius, make the circle too large."""
    camera = frames.easy.truth.camera
    template, circle = field_of(CONFIG)
    rng = np.random.default_rng(6)
    given = given_by(camera, template)
    middle = Observations(*SIZE, (circle_points(camera, template, "center", 80, 0.2, rng),), given.lines)
    paint = run_observations(middle, CONFIG, frame_id="a", convention="paint")
    official = run_observations(middle, CONFIG, frame_id="a")
    assert paint.attempt.correspondences.radius_m == pytest.approx(template.radius(circle, "center"))
    assert official.attempt.correspondences.radius_m == pytest.approx(circle.radius_m)


def test_too_few_observations_are_refused(frames):
    template, _ = field_of(CONFIG)
    given = given_by(frames.easy.truth.camera, template)
    bare = run_observations(Observations(*SIZE), CONFIG, frame_id="bare")
    assert (bare.status, bare.verdict.code) == ("refused", "no_circle")
    few = replace(given.circles[0], points_px=given.circles[0].points_px[:4], sigma_px=given.circles[0].sigma_px[:4])
    part = run_observations(Observations(*SIZE, (few,), given.lines), CONFIG, frame_id="part")
    assert (part.status, part.verdict.code) == ("refused", "no_ellipse")
    alone = run_observations(Observations(*SIZE, given.circles), CONFIG, frame_id="alone")
    assert (alone.status, alone.verdict.code) == ("refused", "rotation_free")


def test_extra_observations_are_used_with_the_picture(frames, easy):
    rng = np.random.default_rng(8)
    field = np.array([[9.0, 3.0], [-8.0, -2.0], [4.0, -7.0]])
    pixels = frames.easy.truth.view.project(field)
    keypoints = tuple(
        Keypoint(f"point {k}", field[k], pixels[k] + rng.normal(0, 0.3, 2), 0.5) for k in range(len(field))
    )
    found = run(frames.easy.image, CONFIG, extra=Observations(*SIZE, keypoints=keypoints), frame_id="easy")
    assert found.status == "calibrated"
    assert {"point 0", "point 1", "point 2"} <= {
        str(key) for key in (*found.attempt.camera.residuals_px, *found.attempt.camera.rejected)
    }
    assert found.attempt.camera.max_sigma_px < easy.attempt.camera.max_sigma_px
    assert error_px(frames.easy, found) < 3.0


def test_joining_keeps_everything(frames):
    template, _ = field_of(CONFIG)
    given = given_by(frames.easy.truth.camera, template)
    both = join_observations(given, given)
    assert (len(both.circles), len(both.lines), both.width) == (2, 2, SIZE[0])


BOX = aim_camera(np.array([3.0, 62.0, -17.0]), np.array([-40.0, -4.0, 0.0]), 1250.0, 0.01, *SIZE)
BOX_LINES = ("big_rect_left_main", "big_rect_left_top", "side_line_left", "small_rect_left_main", "side_line_top")


def box(template):
    rng = np.random.default_rng(9)
    lines = tuple(line_points(BOX, template, name, 12, 0.4, rng) for name in BOX_LINES)
    return Observations(*SIZE, lines=lines)


def test_lines_without_the_circle_are_calibrated_and_written():
    template, _ = field_of(CONFIG)
    found = run_observations(box(template), CONFIG, frame_id="box", convention="paint")
    assert found.status == "calibrated", found.verdict
    assert found.attempt.ellipses.all() == ()
    assert (found.attempt.correspondences, found.attempt.homography) == (None, None)
    field = np.array([[-36.0, -15.0], [-45.0, 0.0], [-50.0, -18.0]])
    assert np.abs(found.attempt.camera.camera.project(field) - BOX.project(field)).max() < 4.0
    record = json.loads(result_line(result_record(found, template)))
    assert record["status"] == "calibrated"
    assert record["ellipses"]["primary"] is None
    assert record["camera"]["reference_m"] == pytest.approx(found.attempt.camera.reference_m)


def test_a_frame_without_the_circle_needs_a_camera_and_has_no_published_solver():
    template, _ = field_of(CONFIG)
    for settings in (["camera.enabled=false"], ["solver=great_axis"]):
        found = run_observations(box(template), load_config(None, settings), frame_id="box", convention="paint")
        assert (found.status, found.verdict.code) == ("refused", "no_ellipse")


def test_what_is_given_beside_a_picture_without_the_circle_is_used():
    template, _ = field_of(CONFIG)
    grass = np.full((SIZE[1], SIZE[0], 3), (40, 120, 50), np.uint8)
    alone = run(grass, CONFIG, frame_id="grass")
    found = run(grass, CONFIG, extra=box(template), frame_id="grass")
    assert alone.status == "refused"
    assert found.status == "calibrated", found.verdict
    one = run(grass, CONFIG, extra=Observations(*SIZE, lines=box(template).lines[:1]), frame_id="grass")
    # the picture's own reason, not that one line is too little
    assert one.verdict == alone.verdict
    draw_overlay(grass, found, template)
    stage_pictures(grass, found, template)


def test_an_interlaced_frame_is_calibrated_at_the_moment_between_its_halves(frames):
    early, late = (np.roll(frames.easy.image, shift, axis=1) for shift in (-5, 5))
    woven = early.copy()
    woven[1::2] = late[1::2]
    joined_halves = run(woven, CONFIG, frame_id="easy")
    as_stored = run(woven, load_config(None, ["mask.deinterlace=false"]), frame_id="easy")
    assert error_px(frames.easy, joined_halves) < 1.0
    assert as_stored.status == "refused" or error_px(frames.easy, as_stored) > error_px(frames.easy, joined_halves)


def test_a_face_off_circle_is_not_taken_for_the_centre_circle():
    """Its brackets look like a halfway line, but the other markings are not where they would have to be."""
    rendering = render_frame("ice", np.random.default_rng([0, 19, SCENE_PROFILES.index("ice")]))
    found = run(rendering.image, load_config("ice-hockey", []), frame_id="ice-19")
    assert found.status == "calibrated"
    assert error_px(rendering, found) < 3.0


def test_markings_that_must_be_in_view_are_looked_for_although_the_centre_mark_is_seen():
    """Circle, halfway line and centre mark on otherwise bare grass, where a penalty area would have to be."""
    rng, soccer = np.random.default_rng(4), load_field("soccer")
    bare = soccer.model_copy(update={"lines": (soccer.line_by_name["halfway_line"],), "arcs": ()})
    camera = aim_camera(np.array([1.5, 74.0, -20.0]), np.array([16.0, 0.0, 0.0]), 1133.0, 0.007, *SIZE, 0.03)
    look = sample_config("easy", rng, SIZE[0]).model_copy(update={"scorebug": False, "shade": 0.0})
    picture = render(Scene(camera, bare, Surface("roof", crown_m=0.05), look, ()), rng).image
    setting = Setting(CONFIG, *field_of(CONFIG), *SIZE, frame_generator(CONFIG.seed))
    found = calibrate_scene(setting, prepare_scene(setting, picture, None, None))
    assert found.cues.mark is not None
    assert found.code == "markings_missing"


@pytest.mark.parametrize("is_found", [True, False])
def test_a_part_of_the_circle_is_measured_along_a_draft_and_no_draft_is_an_answer(monkeypatch, is_found):
    """Other sizes of the field are tried once only."""
    drafts = []

    def count(*args, is_draft, **named):
        drafts.append(is_draft)
        return estimate_camera(*args, is_draft=is_draft, **named)

    monkeypatch.setattr(attempts, "estimate_camera", count)
    if not is_found:
        monkeypatch.setattr(refinements, "measure_curves", lambda *_: {})
    image = render_frame("partial", np.random.default_rng(1), *SIZE).image
    setting = Setting(CONFIG, *field_of(CONFIG), *SIZE, frame_generator(CONFIG.seed))
    attempt = calibrate_scene(setting, prepare_scene(setting, image, None, None))
    assert attempt.ellipses.primary.arc_deg < refinements.PARTIAL_DEG
    assert attempt.is_calibrated
    assert drafts[:2] == [True, False] and not any(drafts[1:])


@pytest.mark.parametrize(("field", "is_compared"), [("soccer", False), ("futsal", True), ("ice-hockey", False)])
def test_colours_of_lines_are_compared_where_one_paint_adds_one_colour(field, is_compared):
    """Mown stripes change what white paint adds to grass, and a rink has several paints."""
    setting = SimpleNamespace(config=load_config(None, [f"field.template={field}"]), template=load_field(field))
    scene, marking = SimpleNamespace(relief=None), SimpleNamespace(source="detector")
    assert attempts.has_one_paint(setting, scene, marking) is is_compared


@pytest.mark.parametrize(("field", "told"), [("soccer", "yellow"), ("futsal", "any"), ("ice-hockey", "none")])
def test_lines_of_other_sports_are_set_apart_by_the_colours_that_tell_them(monkeypatch, field, told):
    """On grass only yellow does, on a floor in one paint each, on a rink none."""
    monkeypatch.setattr(attempts, "leave_out_yellow_lines", lambda *_: "yellow")
    monkeypatch.setattr(attempts, "leave_out_other_paints", lambda *_: "any")
    setting = SimpleNamespace(config=load_config(None, [f"field.template={field}"]), template=load_field(field))
    scene = SimpleNamespace(relief=None, image=None)
    marking = SimpleNamespace(source="detector", band_px=3.0)
    assert attempts.set_apart_other_sports(setting, scene, marking, object(), "none") == told
    assert attempts.set_apart_other_sports(setting, scene, marking, None, "none") == "none"
