"""A court of another league than the one that was named."""

import re
from functools import cache
from importlib import import_module

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.detection.picture import Scaling
from circlecal.detection.ridges import RidgePoints
from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.geometry.surface import FLAT
from circlecal.observations import MarkingKey
from circlecal.pipeline import calibrate_image, other_fields
from circlecal.pipeline.other_fields import AGREEMENT_RATIO, FIELD_RATIO, refuse_other_field
from circlecal.pipeline.setting import Scene as PictureScene
from circlecal.placement import LaidField, Outlines, SeenPaint, SurfaceRidges, ViewEvidence, lay_over_view
from circlecal.placement.paint_maps import _map_ridges
from circlecal.results import Agreement
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.looks import sample_config
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import render_frame
from circlecal.synthetic.scene import Scene
from circlecal.yaml_text import config_folder

SOCCER_SEED = 3801455670


@cache
def picture_of(profile, seed, size, field):
    """A rendered picture, which tests share and nobody writes into."""
    picture = render_frame(profile, np.random.default_rng(seed), *size, load_field(field)).image
    picture.flags.writeable = False
    return picture


def calibrate_court(named, seed):
    """A rendered NBA court, calibrated as that of a league."""
    picture = picture_of("court", seed, (1280, 720), "basketball-nba")
    return calibrate_image(picture, load_config(None, {"field.template": named}), frame_id="court")


@pytest.fixture(scope="module")
def judged():
    """What decides whether another field is seen, and the accepted court of which it decides."""
    kept = []

    def keep(*given):
        kept.append(given)
        return given[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("circlecal.pipeline.run"), "refuse_other_field", keep)
        calibrate_court("basketball-nba", 4)
    ((setting, scene, attempt),) = kept
    assert attempt.is_calibrated
    return setting, scene, attempt


@pytest.mark.parametrize("seed", [4, 5])
def test_a_court_of_another_league_is_refused_and_named(seed):
    """Cameras of courts that were named wrongly were 20 to 37 px off, and said 2 to 7 px of themselves."""
    found = calibrate_court("basketball", seed)
    assert (found.status, found.verdict.code) == ("refused", "other_field")
    assert "looks like basketball-nba:" in found.verdict.reason
    assert found.verdict.check("other_field_ratio").value > FIELD_RATIO


def test_the_league_that_was_named_is_calibrated(judged):
    for verdict in (calibrate_court("basketball-nba", 5).verdict, refuse_other_field(*judged).verdict):
        assert verdict.status == "calibrated"
        assert verdict.check("other_field_ratio").value < 1.0


def test_a_rink_of_another_league_is_told_by_the_places_of_its_markings():
    """Both leagues' rinks cover the same paint; this one was calibrated 93 px off. With each marking
    measured anew seven carry the right league's camera, and four the other one's.
    """
    picture = render_frame("rink", np.random.default_rng(8), 1280, 720, load_field("ice-hockey")).image
    found = calibrate_image(picture, load_config(None, {"field.template": "ice-hockey-nhl"}), frame_id="rink")
    assert (found.status, found.verdict.code) == ("refused", "other_field")
    assert found.verdict.check("other_field_ratio").passed
    assert found.verdict.check("other_field_agreement").value > 1.1 * AGREEMENT_RATIO
    assert "looks like ice-hockey: its markings lie where" in found.verdict.reason


def test_a_template_that_leaves_markings_out_is_not_refused_for_a_fuller_one(tmp_path):
    """Spots of the fuller one counted for it: six of eight real rinks were refused under a plain template."""
    text = (config_folder() / "fields" / "ice-hockey-nhl.yaml").read_text(encoding="utf-8")
    plain = re.sub(r"  - \{name: \w+_spot_.*\n", "", text).replace("name: ice-hockey-nhl", "name: plain", 1)
    (tmp_path / "plain.yaml").write_text(plain, encoding="utf-8")
    assert load_field(str(tmp_path / "plain.yaml")).names < load_field("ice-hockey-nhl").names
    picture = render_frame("rink", np.random.default_rng(8), 1280, 720, load_field("ice-hockey-nhl")).image
    found = calibrate_image(
        picture, load_config(None, {"field.template": str(tmp_path / "plain.yaml")}), frame_id="rink"
    )
    assert found.status == "calibrated", found.verdict.reason


@pytest.mark.parametrize(("seed", "named"), [((SOCCER_SEED, 77, 1), "handball"), ((SOCCER_SEED, 77, 6), "futsal")])
def test_a_pitch_of_soccer_is_no_court_since_its_lines_would_be_too_thin(seed, named):
    """Circle, halfway line and touchline look like those of a court of a third of the size: such answers were 900 px
    off, with 6 to 10 px said of themselves; their lines would be 2 to 3 cm wide.
    """
    picture = render_frame("broadcast", np.random.default_rng(seed), 1280, 720, load_field("soccer")).image
    found = calibrate_image(picture, load_config(None, {"field.template": named}), frame_id="pitch")
    assert (found.status, found.verdict.code) == ("refused", "other_field")
    check = found.verdict.check("painted_width_m")
    assert not check.passed
    assert check.value < 0.85 * check.limit


def test_lines_of_a_hall_are_as_wide_as_they_are_painted():
    picture = picture_of("wood", 1000, (960, 540), "futsal")
    found = calibrate_image(picture, load_config(None, {"field.template": "futsal"}), frame_id="hall")
    check = found.verdict.check("painted_width_m")
    assert found.status == "calibrated"
    assert check.value > 1.2 * check.limit


@pytest.mark.parametrize(("name", "seed"), [("futsal", 1), ("handball-any", 2)])
def test_a_hall_of_another_size_is_measured(name, seed):
    """A futsal hall of 36 x 18 m was refused as a robots' field, a handball hall was calibrated 70 px off."""
    hall = load_field(name.removesuffix("-any"), {"length": 36.0, "width": 18.0})
    rendered = render_frame("wood", np.random.default_rng(seed), 960, 540, hall)
    found = calibrate_image(rendered.image, load_config(None, {"field.template": name}), frame_id="hall")
    assert found.status == "calibrated"
    places = hall.outlines[1].reshape(-1, 2)
    true = rendered.truth.view.project(places)
    seen = ((true > 0) & (true < (960, 540))).all(axis=1)
    assert np.linalg.norm(found.view.project(places) - true, axis=1)[seen].mean() < 4.0


@pytest.mark.parametrize(
    ("seen", "code"),
    [
        (ViewEvidence(0.28, 0.61, 0.31, surface_share=0.54), "picture_contradicts"),
        (ViewEvidence(0.25, 0.51, 0.51, surface_share=1.0), "markings_missing"),
        (ViewEvidence(0.39, 0.55, 0.43, surface_share=1.0), None),
        (ViewEvidence(0.25, 0.51, 0.80, surface_share=0.9), None),
    ],
)
def test_a_hall_lies_on_the_floor_and_most_of_it_is_painted(seen, code, monkeypatch):
    """What halls of futsal showed that were named handball, 236 and 100 px off, and what right ones show at least."""
    monkeypatch.setattr(other_fields, "weigh_view", lambda view, template, paint: seen)
    monkeypatch.setattr(other_fields, "lay_over_attempt", lambda *_: [])
    picture = picture_of("wood", 1000, (960, 540), "futsal")
    # all colours together alone: along each of them the evidence that stands in would be no other
    config = load_config(None, {"field.template": "futsal", "mask.tell_paints": False})
    found = calibrate_image(picture, config, frame_id="hall")
    assert found.verdict.code == code


@pytest.mark.parametrize(("found_share", "told"), [(0.7, "another field"), (0.9, "basketball-ncaa")])
def test_another_field_is_named_only_where_most_of_it_is_painted(found_share, told, monkeypatch):
    own, rival = ViewEvidence(0.4, 0.6, 0.8, found_widths=0.9), ViewEvidence(0.9, found_share, 0.9, found_widths=1.8)
    monkeypatch.setattr(other_fields, "weigh_view", lambda view, template, paint: own)

    def lay(attempt, template, circle, paint, others):
        seen = [rival if other.name == "basketball-ncaa" else own for other in others]
        return [LaidField(circle, attempt.camera.view, one) for one in seen]

    monkeypatch.setattr(other_fields, "lay_over_attempt", lay)
    found = calibrate_court("basketball-nba", 4)
    assert found.verdict.code == "other_field"
    assert f"looks like {told}: " in found.verdict.reason


def test_a_hall_whose_touchlines_are_bare_has_another_scale():
    """Circle and halfway line of a handball court carried a camera of a futsal court, 111 px off, whose touchlines were
    in view and not painted; under its own name nothing that is in view is bare.
    """
    picture = render_frame("wood", np.random.default_rng(1), 960, 540, load_field("handball")).image
    codes = [
        calibrate_image(picture, load_config(None, {"field.template": name}), frame_id="hall").verdict.code
        for name in ("futsal", "handball")
    ]
    assert codes == ["markings_missing", None]


def render_house():
    """A house of curling from behind, and its true camera."""
    camera = aim_camera(np.array([27.0, 0.8, -3.5]), np.array([17.6, 0.1, 0.0]), 1100.0, 0.01, 960, 540)
    rng = np.random.default_rng(3)
    return render(Scene(camera, load_field("curling"), FLAT, sample_config("ice", rng, 960)), rng).image, camera


def test_a_house_from_behind_is_told_by_its_lines(monkeypatch):
    """It was refused with a camera 0.5 px off, since its half-inch lines stand out as little as lines that are not
    there. On the wrong side of the house neither the back line nor the hog line is found.
    """
    picture, camera = render_house()
    config = load_config(None, {"field.template": "curling"})
    found = calibrate_image(picture, config, frame_id="house")
    assert found.status == "calibrated"
    assert found.verdict.check("lines_found_share").value > 0.85
    places = load_field("curling").outlines[1].reshape(-1, 2)
    true = camera.project(np.column_stack([places, np.zeros(len(places))]))
    seen = ((true > 0) & (true < (960, 540))).all(axis=1)
    off = [np.linalg.norm(found.view.project(turn * places) - true, axis=1)[seen].mean() for turn in (1.0, -1.0)]
    assert min(off) < 2.0
    missed = Agreement(
        ("centre_line", "tee_line_right", "back_line_right"),
        np.array([302.0, 358.0, 490.0]),
        np.array([0.85, 0.55, 0.0]),
    )
    monkeypatch.setattr(other_fields, "look_for_markings", lambda *_: missed)
    assert calibrate_image(picture, config, frame_id="house").verdict.code == "markings_missing"


def test_a_house_is_told_by_a_single_line_that_is_bare(monkeypatch):
    """Circle, tee line and centre line lie alike about a camera on the other side, 1,000 px off, which was believed: of
    all its lines three quarters are there, but nothing of the back line.
    """
    picture, _ = render_house()
    found = calibrate_image(picture, load_config(None, {"field.template": "curling"}), frame_id="house")
    assert found.verdict.check("least_line_share").value > 0.5
    one_bare = Agreement(
        ("centre_line", "tee_line_right", "back_line_right"),
        np.array([900.0, 200.0, 200.0]),
        np.array([0.86, 0.9, 0.0]),
    )
    monkeypatch.setattr(other_fields, "look_for_markings", lambda *_: one_bare)
    template = load_field("curling")
    scene = PictureScene(picture, picture[..., 0], None, None, None)
    judged = other_fields.judge_lines(scene, found.attempt, template, template.circle_by_name["twelve_foot_right"])
    assert judged.code == "markings_missing"
    assert judged.verdict.check("lines_found_share").passed


def test_a_touchline_that_the_halfway_line_ends_beside_carries_no_camera():
    """A futsal court that was named handball was calibrated 50 px off; its line ended 2.6 m before a touchline."""
    picture = picture_of("wood", 1000, (960, 540), "futsal")
    found = calibrate_image(picture, load_config(None, {"field.template": "handball"}), frame_id="hall")
    camera, end = found.attempt.camera, MarkingKey("side_line_top")
    assert found.status == "refused"
    assert camera.missed_ends_px[end] > 20.0
    assert end not in camera.residuals_px and end not in camera.point_residuals_px and end in camera.left_out


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("basketball", True),
        ("ice-hockey", True),
        ("robocup", True),
        ("soccer", False),
        ("soccer-7", False),
        ("futsal", True),
    ],
)
def test_sizes_that_vary_within_the_rules_make_no_league(name, expected):
    assert load_field(name).has_leagues is expected


def test_a_field_with_colours_is_laid_over_paint_of_which_none_is_told():
    """A hall's lines are looked at without their colours, and a rink's circle is blue."""
    futsal, rink = load_field("futsal"), load_field("ice-hockey")
    rows, columns = 270, 480
    points = np.stack([np.arange(100.0, 300.0), np.full(200, 140.0)], axis=-1)
    ridges = RidgePoints(points, np.tile([0.0, 1.0], (200, 1)), np.ones(200, np.int64))
    region, scaling = np.ones((rows, columns), np.bool_), Scaling(np.ones(2))
    maps = _map_ridges(ridges, region, scaling, np.ones((1, 200), np.bool_))
    paint = SeenPaint(SurfaceRidges(ridges, np.ones((1, 200), np.bool_), maps), (), np.ones(200, np.bool_))
    camera = aim_camera(np.array([0.0, 20.0, -8.0]), np.zeros(3), 500.0, 0.0, columns, rows)
    assert Outlines.of(rink).has_colours
    conic = np.diag([1.0 / 60.0**2, 1.0 / 25.0**2, -1.0])
    laid = lay_over_view(FieldView(camera), futsal.circles[0], conic, futsal, rink, paint)
    assert np.isfinite(laid.seen.evidence)


def test_a_camera_whose_markings_are_bare_is_refused_where_no_other_field_is_laid(judged, monkeypatch):
    """A house of curling was seen from its other side, 17 m off: a quarter of what that camera put into view was
    painted, and the sport has no other field to be compared with.
    """
    bare = ViewEvidence(-0.3, 0.23, 0.77, bare_widths=0.36, found_widths=0.42)
    monkeypatch.setattr(other_fields, "weigh_view", lambda view, template, paint: bare)
    assert refuse_other_field(*judged).verdict.code == "markings_missing"


@pytest.mark.parametrize(("explained", "code"), [(0.55, "other_field"), (0.96, None)])
def test_where_much_paint_is_unexplained_other_fields_are_laid_about_every_circle_alike(
    explained, code, judged, monkeypatch
):
    """Rinks of another league were calibrated 50 to 880 px off about a wrong face-off circle, where the right league
    fits no better; about the circle that was seen twice as much speaks for it.
    """
    own = ViewEvidence(0.66, 0.91, explained, found_widths=1.19)
    right = ViewEvidence(1.38, 0.95, 0.96, found_widths=2.38)
    about = list[tuple[str, tuple[float, float]]]()

    def lay(attempt, template, circle, paint, others):
        about.append((circle.name, tuple(attempt.camera.camera.position_m[:2] - circle.center)))
        return [LaidField(circle, attempt.camera.view, own if len(about) == 1 else right) for _ in others]

    monkeypatch.setattr(other_fields, "weigh_view", lambda view, template, paint: own)
    monkeypatch.setattr(other_fields, "lay_over_attempt", lay)
    assert refuse_other_field(*judged).verdict.code == code
    names, places = zip(*about, strict=True)
    assert len(set(names)) == len(names)
    assert (len(names) > 1) == (code is not None)
    np.testing.assert_allclose(places, [places[0]] * len(places), atol=1e-9)
