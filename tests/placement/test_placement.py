"""Which circle of a rink or a court is the one seen: told by lines, arcs and other circles, without a halfway line."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.detection import DetectorConfig
from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.geometry.camera_parameters import PARAMETERS
from circlecal.geometry.conics import circle_conic, sampson_distance, transform_conic
from circlecal.geometry.surface import FLAT
from circlecal.observations import CirclePoints, LinePoints, MarkingKey, Observations
from circlecal.paint.local_energy import local_energy
from circlecal.pipeline import doubtful_circle, field_of, field_paint, placed_field, placed_view, run
from circlecal.pipeline import setting as frame
from circlecal.pipeline.attempts import estimate
from circlecal.pipeline.placed_field import (
    OTHER_SIGHTING,
    PRECISE_MARKINGS,
    RIVAL_RATIO,
    _Answer,
    _is_believed,
    _is_precise,
)
from circlecal.pipeline.placed_view import LARGEST_RESIDUAL_PX, _leave_out_stray_markings
from circlecal.pipeline.template_markings import measure_template
from circlecal.placement import (
    PlacedField,
    ViewEvidence,
    add_rims,
    mean_distance_px,
    refine_placements,
    search,
    search_placements,
    see_paint,
    see_surface,
    weigh_view,
)
from circlecal.placement.camera_batch import cameras_before_circles
from circlecal.placement.paint_maps import STEPS_PER_PX
from circlecal.records.writing import result_record
from circlecal.results import (
    Attempt,
    CameraFit,
    Check,
    CircleCandidate,
    Cues,
    MarkCue,
    MarkingMask,
    PaintersFit,
    Verdict,
)
from circlecal.stages import camera as camera_stage
from circlecal.stages.camera import estimate_camera
from circlecal.stages.edges import detect_edges
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.renderer import render
from circlecal.synthetic.scene import RenderConfig, Scene

SIZE = (1280, 720)
RINK = load_field("ice-hockey-nhl")
ICE = RenderConfig(
    ground="ice",
    turf_bgr=(228.0, 225.0, 220.0),
    marking_width_m=RINK.marking_width_m,
    stripe_contrast=0.0,
    texture=0.02,
    shade=0.0,
    haze=0.0,
    wear=0.1,
    noise=2.0,
    board_distance_m=0.05,
    board_height_m=1.1,
    corner_m=8.0,
    shadow_count=0,
)
RIGHT_END = aim_camera(np.array([3.0, 36.0, -13.0]), np.array([19.0, 1.0, 0.0]), 1750.0, 0.01, *SIZE)
LEFT_CIRCLE = aim_camera(np.array([-2.0, 36.0, -12.0]), np.array([-16.0, 2.0, 0.0]), 2100.0, -0.01, *SIZE)


@dataclass(frozen=True)
class Paint:
    """What was seen, as far as it is told apart."""

    name: str

    @property
    def key(self):
        return (self.name,)

    @property
    def surface(self):
        return self.name


def markings_error_px(camera, view):
    """Mean distance of the rink's markings in the picture from where a view puts them."""
    nodes = RINK.outlines[1].reshape(-1, 2)
    seen = camera.project(nodes)
    shown = ((seen > 0) & (seen < SIZE)).all(axis=1)
    return np.linalg.norm(view.project(nodes[shown]) - seen[shown], axis=1).mean()


@pytest.mark.parametrize("camera", [RIGHT_END, LEFT_CIRCLE], ids=["right_end", "left_circle"])
def test_an_end_zone_is_calibrated_without_centre_circle_and_halfway_line(camera):
    assert not (np.abs(camera.project([[0.0, 0.0]]) - np.array(SIZE) / 2) < np.array(SIZE) / 2).all()
    picture = render(
        Scene(camera, RINK, FLAT, ICE, widths_m={"blue_line_left": 0.3, "blue_line_right": 0.3}),
        np.random.default_rng(3),
    )
    config = load_config(None, ["field.template=ice-hockey-nhl"])
    found = run(picture.image, config, frame_id="rink")
    assert found.status == "calibrated", found.verdict
    assert found.circle_name.startswith("faceoff_right" if camera is RIGHT_END else "faceoff_left")
    assert markings_error_px(camera, found.attempt.camera.view) < 8.0
    check = found.verdict.check("rival_ratio")
    assert check is None or check.value >= RIVAL_RATIO
    if camera is LEFT_CIRCLE:
        # one circle that is named is the only one that is looked for
        named = load_config(None, ["field.template=ice-hockey-nhl", "field.any_circle=false"])
        assert run(picture.image, named, frame_id="rink").status == "refused"


def homography_of(cameras, k):
    """Field to pixels (3, 3) without lens of one camera of a batch."""
    focal = np.exp(cameras.log_focal[k])
    intrinsics = np.array([[focal, 0.0, cameras.middle[0]], [0.0, focal, cameras.middle[1]], [0.0, 0.0, 1.0]])
    return intrinsics @ np.column_stack([cameras.rotation[k][:, :2], cameras.shift[k]])


def test_every_first_camera_sees_its_circle_where_the_picture_does():
    circle = RINK.circle_by_name["faceoff_left_top"]
    conic = transform_conic(LEFT_CIRCLE.homography, circle_conic(circle.center, RINK.radius(circle, "center")))
    middle = (np.array(SIZE) - 1) / 2
    cameras = cameras_before_circles([conic], RINK, SIZE[0], middle, "main")
    angle = np.linspace(0, 2 * np.pi, 40)
    for k in range(0, len(cameras.own), 97):
        own = RINK.circles[cameras.own[k]]
        rim = np.asarray(own.center) + RINK.radius(own, "center") * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        seen = np.c_[rim, np.ones(len(rim))] @ homography_of(cameras, k).T
        assert np.abs(sampson_distance(conic, seen[:, :2] / seen[:, 2:])).max() < 1e-6
        stands = -cameras.rotation[k].T @ cameras.shift[k]
        assert stands[1] >= 0
        assert stands[2] < 0
    # one of them is nearly the camera that took the picture
    off = np.linalg.norm(-np.einsum("bij,bi->bj", cameras.rotation, cameras.shift) - LEFT_CIRCLE.position_m, axis=1)
    assert off.min() < 6.0


@pytest.mark.parametrize(
    ("evidence", "found", "explained", "believed"),
    [
        (1.0, 0.7, 0.3, True),
        (0.2, 0.7, 0.3, False),
        (1.0, 0.4, 0.3, False),
        (0.2, 0.5, 0.8, True),
        (0.1, 0.5, 0.8, False),
    ],
)
def test_a_placed_field_is_believed_where_it_is_painted_or_explains_what_is(evidence, found, explained, believed):
    assert _is_believed(ViewEvidence(evidence, found, explained)) is believed


def test_a_field_that_may_lie_in_two_ways_is_refused_with_both(monkeypatch):
    """Of one face-off circle alone nothing tells which of four it is, whatever the evidence."""

    def weigh(view, *_):
        return ViewEvidence(1.0 if view.camera is LEFT_CIRCLE else 0.9, 0.8, 0.8)

    monkeypatch.setattr(placed_field, "weigh_view", weigh)
    config = load_config(None, ["field.template=ice-hockey-nhl"])
    template, circle = field_of(config)
    setting = frame.Setting(config, template, circle, *SIZE, np.random.default_rng(0))
    carrying = {MarkingKey(str(k)): 0.1 for k in range(3)}
    left, right = (
        Attempt(
            circle_name=name,
            camera=replace(fit(camera), residuals_px=carrying),
            verdict=Verdict("calibrated", None, None, None),
        )
        for name, camera in (("faceoff_left_top", LEFT_CIRCLE), ("faceoff_right_top", RIGHT_END))
    )
    placements = iter([left, right])
    monkeypatch.setattr(placed_field, "look_for_paint", lambda *_: Paint("seen"))
    monkeypatch.setattr(placed_field, "follow_placement", lambda *_: next(placements))
    lain = [PlacedField(circle, np.eye(3), FieldView(camera), 1.0, 0.8) for camera in (LEFT_CIRCLE, RIGHT_END)]
    monkeypatch.setattr(placed_field, "search_placements", lambda *_: object())
    monkeypatch.setattr(placed_field, "refine_placements", lambda *_: lain)
    scene = frame.Scene(np.zeros((*SIZE[::-1], 3), np.uint8), np.zeros(SIZE[::-1], np.uint8), None, None, None)
    seen = MarkingMask(scene.gray, "detector", conic=np.eye(3))
    (found,) = placed_field.place_template(setting, scene, Attempt(mask=seen))
    assert (found.code, found.circle_name) == ("circle_open", "faceoff_left_top")
    record = result_record(setting.calibration(found, "x", None), template)
    others = [other for other in record.alternatives if other.kind == "other_circle"]
    assert [(other.circle, other.evidence) for other in others] == [("faceoff_right_top", 0.9)]
    assert record.field.circle == "faceoff_left_top"
    assert record.rejected_estimate is not None


@pytest.mark.parametrize(
    ("explained", "score", "count"), [(0.8, 0.5, 1), (0.1, 0.5, 0), (0.8, 0.05, 0)], ids=["seen", "paint", "circle"]
)
def test_what_explains_little_or_has_no_circle_leads_to_no_camera(monkeypatch, explained, score, count):
    """A camera takes most of the time; two sightings of one surface lead to one."""
    config = load_config(None, ["field.template=ice-hockey-nhl"])
    template, circle = field_of(config)
    setting = frame.Setting(config, template, circle, *SIZE, np.random.default_rng(0))
    followed = []

    class Sighting(Paint):
        surface = "one"

    paints = iter([Sighting("first"), Sighting("second")])
    monkeypatch.setattr(placed_field, "weigh_view", lambda *_: ViewEvidence(1.0, 0.8, explained))
    monkeypatch.setattr(placed_field, "look_for_paint", lambda *_: next(paints))
    monkeypatch.setattr(placed_field, "follow_placement", lambda *given: followed.append(given))
    monkeypatch.setattr(placed_field, "search_placements", lambda *_: object())
    lain = [PlacedField(circle, np.eye(3), FieldView(LEFT_CIRCLE), 1.0, 0.8)]
    monkeypatch.setattr(placed_field, "refine_placements", lambda *_: lain)
    scene = frame.Scene(np.zeros((*SIZE[::-1], 3), np.uint8), np.zeros(SIZE[::-1], np.uint8), None, None, None)
    seen = MarkingMask(scene.gray, "detector", candidates=(CircleCandidate(np.eye(3), score, ()),))
    first = replace(seen, sightings=(seen,))
    assert list(placed_field.place_template(setting, scene, Attempt(mask=first))) == []
    assert len(followed) == count


def test_a_field_laid_into_the_stands_shows_little_of_itself_on_the_surface():
    picture = render(Scene(RIGHT_END, RINK, FLAT, ICE), np.random.default_rng(3)).image
    surface = np.zeros(SIZE[::-1], np.bool_)
    surface[: SIZE[1] // 2] = True
    options = load_config(None, ["field.template=ice-hockey-nhl"]).mask.detector
    gray = np.asarray(picture.mean(axis=2), np.uint8)
    weights = []
    for region in (np.ones_like(surface), surface):
        mask = MarkingMask(np.zeros(SIZE[::-1], np.uint8), "detector", field_region=region, polarity=-1.0)
        paint = see_paint(see_surface(picture, gray, mask, options), mask)
        weights.append(weigh_view(FieldView(RIGHT_END), RINK, paint).surface_share)
    assert weights[0] == 1.0
    assert weights[1] < 0.6


def fit(camera):
    """A camera as the stage `camera` would return it."""
    return CameraFit(
        camera=camera,
        surface=FLAT,
        parameters=PARAMETERS,
        covariance=np.eye(len(PARAMETERS)),
        H_covariance=np.eye(8),
        imaged_center_px=np.zeros(2),
        imaged_center_covariance=np.eye(2),
        noise_scale=1.0,
        data_share=1.0,
        max_sigma_px=1.0,
        max_sigma_m=0.1,
        residuals_px={},
        theta=np.zeros(len(PARAMETERS)),
    )


def test_cameras_before_a_field_of_other_sizes_see_its_circle_where_the_picture_does():
    """What was laid as one league's rink starts another league's at the same circle, at its size and place."""
    circle = RINK.circle_by_name["faceoff_left_top"]
    conic = transform_conic(LEFT_CIRCLE.homography, circle_conic(circle.center, RINK.radius(circle, "center")))
    middle, other = (np.array(SIZE) - 1) / 2, load_field("ice-hockey")
    cameras = cameras_before_circles([conic], RINK, SIZE[0], middle, "main")
    suited = cameras.suit(RINK, other)
    angle = np.linspace(0, 2 * np.pi, 40)
    for k in range(0, len(suited.own), 97):
        assert other.circles[suited.own[k]].name == RINK.circles[cameras.own[k]].name
        own = other.circles[suited.own[k]]
        rim = np.asarray(own.center) + other.radius(own, "center") * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        seen = np.c_[rim, np.ones(len(rim))] @ homography_of(suited, k).T
        assert np.abs(sampson_distance(conic, seen[:, :2] / seen[:, 2:])).max() < 1e-6


def test_a_court_is_laid_by_arcs_and_lines_that_the_detector_did_not_tell(monkeypatch):
    """One circle was found and nothing else: what turns the court about it is among all that may be painted."""

    def take_few(*given):
        cameras = cameras_before_circles(*given)
        return cameras.take(np.flatnonzero(cameras.own == 2))

    monkeypatch.setattr(search, "cameras_before_circles", take_few)
    monkeypatch.setattr(search, "FOLLOWED", 200)
    monkeypatch.setattr(search, "FIRST_KEPT", 8)
    court, size = load_field("basketball-nba"), (960, 540)
    camera = aim_camera(np.array([4.0, 22.0, -9.0]), np.array([9.0, 0.0, 0.0]), 1100.0, 0.0, *size)
    gray = np.random.default_rng(0).normal(150.0, 2.0, size[::-1]).astype(np.uint8)
    for outline in court.outlines[1]:
        drawn = np.rint(camera.project(outline) * 16).astype(np.int32)
        cv2.polylines(gray, [drawn], False, 60, 2, cv2.LINE_AA, 4)
    circle = court.circle_by_name["free_throw_circle_right"]
    conic = transform_conic(camera.homography, circle_conic(circle.center, court.radius(circle, "center")))
    ground = np.ones(size[::-1], np.bool_)
    mask = MarkingMask(np.zeros_like(gray), "detector", conic, field_region=ground, polarity=-1.0)
    surface = see_surface(np.dstack([gray] * 3), gray, mask, DetectorConfig(), has_colours=False)
    paint = see_paint(surface, mask)
    rough = search_placements(paint, size, court, "main")
    best = refine_placements(rough, paint, size, court)[0]
    assert best.circle.name == circle.name
    assert mean_distance_px(FieldView(camera), best.view, court) < 4.0


@pytest.mark.parametrize(("stray", "count", "is_taken"), [(1, 4, True), (2, 15, True), (2, 12, False), (3, 20, False)])
def test_few_of_many_markings_may_lie_beside_the_paint(stray, count, is_taken):
    config = load_config(None, ["field.template=basketball-nba"])
    setting = frame.Setting(config, *field_of(config), 1920, 1080, np.random.default_rng(0))
    residuals = {MarkingKey(str(k)): 9.0 if k < stray else 0.3 for k in range(count)}
    attempt = Attempt(camera=replace(fit(LEFT_CIRCLE), residuals_px=residuals))
    assert placed_view._is_of_this_size(setting, attempt) is is_taken


def test_fields_of_one_sport_are_searched_for_once(monkeypatch):
    searches = []
    monkeypatch.setattr(placed_field, "look_for_paint", lambda *_: Paint("seen"))
    monkeypatch.setattr(placed_field, "search_placements", lambda *given: searches.append(given[2].name))
    gray = np.zeros(SIZE[::-1], np.uint8)
    scene = frame.Scene(np.zeros((*SIZE[::-1], 3), np.uint8), gray, None, None, None)
    for name in ("ice-hockey-nhl", "ice-hockey", "basketball"):
        config = load_config(None, [f"field.template={name}"])
        setting = frame.Setting(config, *field_of(config), *SIZE, np.random.default_rng(0))
        assert not list(
            placed_field.place_template(setting, scene, Attempt(mask=MarkingMask(gray, "detector", np.eye(3))))
        )
    assert searches == ["ice-hockey-nhl", "basketball"]


def _fit_of(residuals):
    """An attempt whose markings lie so many pixels from their places."""
    keys = {MarkingKey(name): rms for name, rms in residuals.items()}
    return Attempt(camera=replace(fit(LEFT_CIRCLE), residuals_px=keys), verdict=Verdict("calibrated", None, None, None))


def test_another_surface_or_polarity_asks_for_more_evidence():
    weighed = ViewEvidence(0.55, 0.63, 0.36)
    assert _is_believed(weighed)
    assert not _is_believed(weighed, OTHER_SIGHTING)
    assert _is_believed(replace(weighed, evidence=1.06), OTHER_SIGHTING)


def test_many_markings_at_their_exact_places_are_evidence_where_paint_is_faint():
    config = load_config(None, ["field.template=ice-hockey-nhl"])
    setting = frame.Setting(config, *field_of(config), 1920, 1080, np.random.default_rng(0))
    exact = {str(k): 0.2 for k in range(PRECISE_MARKINGS)}
    faint = ViewEvidence(0.1, 0.48, 0.4)
    assert not _is_believed(faint)
    assert _is_precise(setting, faint, _fit_of(exact))
    few = dict(list(exact.items())[1:])
    assert not _is_precise(setting, faint, _fit_of(few))
    assert not _is_precise(setting, faint, _fit_of(dict.fromkeys(exact, 1.0)))
    assert not _is_precise(setting, replace(faint, explained_share=0.2), _fit_of(exact))


def test_a_camera_that_carries_more_markings_weighs_more():
    """A circle and a blue line fit a wrong camera as well as five markings the right one."""
    many, few = (_fit_of({str(k): 0.3 for k in range(count)}) for count in (5, 2))
    heavy, light = _Answer(ViewEvidence(0.69, 0.8, 0.4), many), _Answer(ViewEvidence(0.57, 0.8, 0.4), few)
    assert heavy.weight > RIVAL_RATIO * light.weight


def test_the_few_markings_that_lie_farthest_are_left_out_of_the_fit(monkeypatch):
    config = load_config(None, ["field.template=basketball-nba"])
    setting = frame.Setting(config, *field_of(config), 1920, 1080, np.random.default_rng(0))
    points, sigma = np.zeros((2, 2)), np.ones(2)

    def measured(off):
        lines = tuple(LinePoints(str(k), points, sigma) for k in range(9))
        residuals = {str(k): 0.2 + off.get(k, 0.0) for k in range(9)}
        return replace(_fit_of(residuals), observations=Observations(1920, 1080, (), lines))

    def fit_rest(_, attempt, **__):
        kept = {line.line: rms[line.line] for line in attempt.observations.lines}
        return replace(_fit_of(kept), observations=attempt.observations)

    monkeypatch.setattr(placed_view, "take_observations", lambda _, seen, left: replace(seen, observations=left))
    monkeypatch.setattr(placed_view, "estimate", fit_rest)
    for off, left in (({3: 5.0, 7: 3.0}, 7), ({3: 5.0, 6: 4.0, 7: 3.0}, 7), ({3: 0.5}, 9), ({3: 1.5}, 8)):
        rms = {str(k): 0.2 + off.get(k, 0.0) for k in range(9)}
        found = _leave_out_stray_markings(setting, Attempt(), measured(off))
        assert len(found.observations.lines) == left
        is_clean = max(found.camera.residuals_px.values()) <= LARGEST_RESIDUAL_PX
        assert is_clean is (len(off) < 3)


def test_residuals_that_painters_errors_bring_are_those_of_no_other_field():
    config = load_config(None, ["field.template=ice-hockey-nhl"])
    setting = frame.Setting(config, *field_of(config), 1920, 1080, np.random.default_rng(0))
    beside = _fit_of({"blue_line_left": 0.3, "end_spot_left_top": 5.0, "neutral_spot_left_top": 4.0})
    assert not placed_view._is_of_this_size(setting, beside)
    painted = dict.fromkeys(beside.camera.residuals_px, 2.5)
    assert placed_view._is_of_this_size(
        setting, replace(beside, camera=replace(beside.camera, painted_sigma_px=painted))
    )


def _choose(answers, earlier=(), circle=None):
    """What is chosen among answers, and those that were not believed earlier, given as evidence and markings."""
    config = load_config(None, ["field.template=ice-hockey-nhl"])
    setting = frame.Setting(config, *field_of(config), *SIZE, np.random.default_rng(0))

    def follow(evidence, camera, markings):
        attempt = _fit_of(dict.fromkeys(markings, 0.1))
        attempt = replace(attempt, camera=replace(attempt.camera, camera=camera), circle_name=circle)
        return placed_field._Followed(Paint("seen"), FieldView(camera), _Answer(evidence, attempt))

    now, before = ([follow(*given) for given in part] for part in (answers, earlier))
    return placed_field._choose_answer(setting, now, before, 1.0)


END = ("faceoff_right_top", "faceoff_right_bottom", "blue_line_right")
OTHER_END = ("faceoff_left_top", "faceoff_left_bottom", "goal_line_left")


def test_an_end_with_a_line_that_is_not_painted_comes_near_no_other():
    right, wrong = ViewEvidence(1.1, 0.85, 0.5), ViewEvidence(0.9, 0.72, 0.5)
    found = _choose([(right, RIGHT_END, END), (wrong, LEFT_CIRCLE, OTHER_END)])
    assert found.code == "circle_open"
    bare = replace(wrong, bare_widths=0.5)
    assert _choose([(right, RIGHT_END, END), (bare, LEFT_CIRCLE, OTHER_END)]).is_calibrated
    # where the answer itself shows lines that are not painted, they tell nothing
    both = [(replace(right, bare_widths=0.5), RIGHT_END, END), (bare, LEFT_CIRCLE, OTHER_END)]
    assert _choose(both).code == "circle_open"


def test_what_was_not_believed_before_still_stands_beside_an_answer():
    weaker, stronger = ViewEvidence(0.6, 0.7, 0.5), ViewEvidence(0.8, 0.9, 0.5)
    assert _choose([(weaker, LEFT_CIRCLE, OTHER_END)]).is_calibrated
    assert _choose([(weaker, LEFT_CIRCLE, OTHER_END)], [(stronger, RIGHT_END, END[:2])]) is None
    near = replace(stronger, evidence=0.7)
    assert _choose([(weaker, LEFT_CIRCLE, OTHER_END)], [(near, RIGHT_END, END[:2])]).code == "circle_open"


def test_a_spot_in_the_middle_of_a_circle_does_not_tell_which_circle_it_is():
    weighed = ViewEvidence(1.0, 0.8, 0.8)
    circles = ("faceoff_left_top", "faceoff_left_bottom")
    assert _choose([(weighed, LEFT_CIRCLE, (*circles, "end_spot_left_top"))]) is None
    assert _choose([(weighed, LEFT_CIRCLE, (*circles, "neutral_spot_left_top"))]).is_calibrated


def test_each_surface_and_polarity_is_searched_until_one_answers(monkeypatch):
    config = load_config(None, ["field.template=basketball-nba"])
    setting = frame.Setting(config, *field_of(config), *SIZE, np.random.default_rng(0))
    gray = np.zeros(SIZE[::-1], np.uint8)
    seen = tuple(MarkingMask(gray, "detector", np.eye(3), polarity=sign) for sign in (1.0, -1.0, 1.0))
    answers = {id(seen[1]): Attempt(circle_name="centre_circle")}
    tried = []
    monkeypatch.setattr(
        placed_field,
        "_place_among",
        lambda _, __, mask, ___, factor, *____: tried.append((mask.polarity, factor)) or answers.get(id(mask)),
    )
    # the first surface shows the detector's answer and all that was found on it
    monkeypatch.setattr(placed_field, "look_for_paint", lambda _, mask, *__: Paint(str(id(mask))))
    scene = frame.Scene(np.zeros((*SIZE[::-1], 3), np.uint8), gray, None, None, None)
    mask = MarkingMask(gray, "detector", np.eye(3), polarity=1.0, sightings=seen)
    first = next(placed_field.place_template(setting, scene, Attempt(mask=mask)))
    assert (first.circle_name, tried) == ("centre_circle", [(1.0, 1.0), (1.0, 1.0), (-1.0, OTHER_SIGHTING)])


def test_a_league_is_laid_on_another_surface_than_the_first_one_that_was_laid_wrongly(monkeypatch):
    """On a rendered NBA court the sizes of FIBA were laid on one surface, where those of the NBA are refused."""
    config = load_config(None, ["field.template=basketball-nba"])
    setting = frame.Setting(config, *field_of(config), *SIZE, np.random.default_rng(0))
    gray, tried = np.zeros(SIZE[::-1], np.uint8), []
    masks = tuple(MarkingMask(gray, "detector", np.eye(3), polarity=float(k)) for k in range(3))
    monkeypatch.setattr(placed_field, "look_for_paint", lambda _, mask, *__: Paint(str(mask.polarity)))

    def place(_, __, mask, ___, ____, _____, ______, least):
        tried.append((mask.polarity, least))
        return Attempt(circle_name="centre_circle") if mask.polarity == 2.0 else None

    monkeypatch.setattr(placed_field, "_place_among", place)
    scene = frame.Scene(np.zeros((*SIZE[::-1], 3), np.uint8), gray, None, None, None)
    scene.looks.keep(("laid", setting.template.sport_name), placed_field._Laid(Paint("1.0").key, 1.36))
    first = Attempt(mask=replace(masks[0], sightings=(masks[2], masks[1])))
    assert [found.circle_name for found in placed_field.place_template(setting, scene, first)] == ["centre_circle"]
    assert tried == [(1.0, 0.0), (0.0, 1.36), (2.0, 1.36)]


def test_what_was_seen_alike_before_is_not_searched_again(monkeypatch):
    config = load_config(None, ["field.template=basketball-nba"])
    setting = frame.Setting(config, *field_of(config), *SIZE, np.random.default_rng(0))
    gray, tried = np.zeros(SIZE[::-1], np.uint8), []
    monkeypatch.setattr(placed_field, "look_for_paint", lambda *_: Paint("seen"))
    monkeypatch.setattr(placed_field, "_place_among", lambda *given: tried.append(given[4]))
    scene = frame.Scene(np.zeros((*SIZE[::-1], 3), np.uint8), gray, None, None, None)
    mask = MarkingMask(gray, "detector", np.eye(3))
    mask = replace(mask, sightings=(mask,))
    assert not list(placed_field.place_template(setting, scene, Attempt(mask=mask)))
    assert tried == [1.0]


def test_a_circle_with_its_line_takes_in_all_other_markings(monkeypatch):
    """Circle and halfway line leave a far corner uncertain; what else is painted there makes it sure."""
    size, config = (960, 540), load_config(None, ["field.template=basketball-nba"])
    court, circle = field_of(config)
    camera = aim_camera(np.array([3.0, 22.0, -9.0]), np.array([2.0, 0.0, 0.0]), 800.0, 0.0, *size)
    gray = np.random.default_rng(0).normal(150.0, 2.0, size[::-1]).astype(np.uint8)
    for outline in court.outlines[1]:
        drawn = np.rint(camera.project(outline) * 16).astype(np.int32)
        cv2.polylines(gray, [drawn], False, 60, 2, cv2.LINE_AA, 4)
    setting = frame.Setting(config, court, circle, *size, np.random.default_rng(0))
    conic = transform_conic(camera.homography, circle_conic(circle.center, court.radius(circle, "center")))
    ground = np.ones(size[::-1], np.bool_)
    mask = MarkingMask(np.zeros_like(gray), "detector", conic, field_region=ground, polarity=-1.0)
    seen = Attempt(mask=mask, edges=detect_edges(~gray, mask, config.edges))
    scene = frame.Scene(np.dstack([gray] * 3), gray, None, None, None)

    def measure_two(*given, **options):
        circles, lines = measure_template(*given, **options)
        return tuple(c for c in circles if c.circle == circle.name), tuple(n for n in lines if n.line == "halfway_line")

    with monkeypatch.context() as patch:
        patch.setattr(placed_view, "measure_template", measure_two)
        first = placed_view._calibrate_view(setting, scene, ~gray, seen, FieldView(camera))
    assert first.is_calibrated, first.verdict
    fuller = placed_view.ALL_MARKINGS.try_out(setting, scene, first)
    assert fuller is not None
    assert len(fuller.camera.residuals_px) > 8
    assert fuller.camera.max_sigma_px < 0.5 * first.camera.max_sigma_px
    assert mean_distance_px(FieldView(camera), fuller.camera.view, court) < 0.5
    # a camera that agrees with more markings, but lays most of the field beside the playing surface, is not taken
    stripe = np.zeros_like(ground)
    stripe[5 * size[1] // 12 : 7 * size[1] // 12] = True
    with monkeypatch.context() as patch:
        patch.setattr(placed_view, "settle_view", lambda *given: replace(fuller, mask=given[3].mask))
        assert placed_view.ALL_MARKINGS.try_out(setting, scene, first) is not None
        beside = replace(first, mask=replace(mask, field_region=stripe))
        assert placed_view.ALL_MARKINGS.try_out(setting, scene, beside) is None
    # with nothing but an uncertain circle and line, they may be any of the field's
    vague = replace(first, camera=replace(first.camera, max_sigma_px=25.0))
    assert placed_field.PLACED_FIELD.when(setting, vague)
    assert doubtful_circle.refuse_doubtful(setting, vague).code == "circle_unconfirmed"
    assert doubtful_circle.refuse_doubtful(setting, fuller) is fuller
    # so they may where they lay most of the field beside the playing surface, or where painters' errors leave much open
    told = replace(first, camera=replace(first.camera, max_sigma_px=0.1, painters=None))
    assert doubtful_circle.refuse_doubtful(setting, told) is told
    assert doubtful_circle.refuse_doubtful(setting, replace(told, mask=beside.mask)).code == "circle_unconfirmed"
    many = {MarkingKey(f"line_{k}"): 0.1 for k in range(6)}
    carried = replace(told, mask=beside.mask, camera=replace(told.camera, residuals_px=many))
    assert doubtful_circle.refuse_doubtful(setting, carried) is carried
    open_to = PaintersFit(told.camera.theta, 100.0 * told.camera.covariance, {}, {})
    painters = replace(told, camera=replace(told.camera, painters=open_to))
    assert doubtful_circle.refuse_doubtful(setting, painters).code == "circle_unconfirmed"
    # and where more of what they put into view is bare than painted
    painted = doubtful_circle.refuse_bare_field(setting, scene, told)
    assert painted.is_calibrated and painted.camera is told.camera
    assert painted.verdict.check("paint_of_view").passed and painted.verdict.check("paint_of_view").value > 0.0
    with monkeypatch.context() as patch:
        patch.setattr(doubtful_circle, "weigh_view", lambda *_: ViewEvidence(-0.1, 0.3, 0.3))
        bare = doubtful_circle.refuse_bare_field(setting, scene, told)
        assert bare.code == "circle_unconfirmed"
        assert bare.verdict.checks[-1] == Check("paint_of_view", -0.1, 0.0, False)
        assert doubtful_circle.refuse_bare_field(setting, scene, carried) is carried
    # one that is sure already, or whose circle was named, is left alone
    sure = replace(first, camera=replace(first.camera, max_sigma_px=0.1))
    assert placed_view.ALL_MARKINGS.try_out(setting, scene, sure) is None


def test_derivatives_of_first_cameras_are_those_of_their_pictures():
    circle = RINK.circle_by_name["faceoff_left_top"]
    conic = transform_conic(LEFT_CIRCLE.homography, circle_conic(circle.center, RINK.radius(circle, "center")))
    cameras = cameras_before_circles([conic], RINK, SIZE[0], (np.array(SIZE) - 1) / 2, "main")
    cameras = cameras.take(np.arange(0, len(cameras), 301))
    nodes = RINK.outlines[1].reshape(-1, 2)[::17]
    seen = cameras.project(nodes)
    shown = seen.ahead & (np.abs(seen.pixels) < SIZE[0]).all(axis=0) & (seen.local[2] > 5.0)
    directions = np.random.default_rng(0).normal(size=seen.pixels.shape).astype(np.float32)
    told = seen.derive(cameras, directions)
    step = 1e-3
    for k, unit in enumerate(np.eye(8)):
        ahead, behind = (cameras.move(sign * step * unit).project(nodes).pixels for sign in (1, -1))
        along = ((ahead - behind) / (2 * step) * directions).sum(axis=0)
        np.testing.assert_allclose(told[k][shown], along[shown], rtol=0.03, atol=2.0)


def test_rims_of_logos_are_seen_as_circles_that_may_be_filled_alone():
    circle = RINK.circle_by_name["centre_circle"]
    conic = transform_conic(LEFT_CIRCLE.homography, circle_conic((-16.0, 2.0), RINK.radius(circle, "center")))
    given = [conic], RINK, SIZE[0], (np.array(SIZE) - 1) / 2, "main"
    rims, circles = cameras_before_circles(*given, are_rims=True), cameras_before_circles(*given)
    assert {RINK.circles[own].name for own in set(rims.own.tolist())} == {"centre_circle"}
    assert len(set(circles.own.tolist())) == len(RINK.circles)


def test_the_rim_of_a_logo_is_paint_in_the_place_of_the_circles():
    """A dark disc has no ridge; with its rim the surface shows it, but not the edge of another thing."""
    picture = np.full((360, 640, 3), 220, np.uint8)
    cv2.ellipse(picture, (320, 180), (150, 60), 0, 0, 360, (120, 60, 60), cv2.FILLED, cv2.LINE_AA)
    cv2.rectangle(picture, (20, 20), (120, 80), (120, 60, 60), cv2.FILLED)
    picture = cv2.GaussianBlur(picture, (0, 0), 1.0)
    cv2.line(picture, (40, 300), (600, 320), (120, 60, 60), 2, cv2.LINE_AA)
    picture = (picture + np.random.default_rng(0).normal(0.0, 2.0, picture.shape)).clip(0, 255).astype(np.uint8)
    gray, ground = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.ones(picture.shape[:2], np.bool_)
    mask = MarkingMask(np.zeros_like(gray), "detector", field_region=ground, polarity=-1.0)
    paint = see_paint(see_surface(picture, gray, mask, DetectorConfig()), mask)
    rim = np.diag([1 / 150.0**2, 1 / 60.0**2, -1.0])
    shift = np.array([[1.0, 0.0, -320.0], [0.0, 1.0, -180.0], [0.0, 0.0, 1.0]])
    seen = add_rims(paint, local_energy(picture), mask, [shift.T @ rim @ shift], DetectorConfig())
    assert seen.are_rims
    assert len(seen.conics) == 1
    more = seen.maps.scaling.full(seen.surface.ridges.points[len(paint.surface.ridges) :])
    assert len(more) > 400
    assert np.abs(sampson_distance(seen.conics[0], more)).max() < 3.0
    assert seen.is_structure[len(paint.surface.ridges) :].all()
    x, y = np.rint(seen.maps.scaling.reduce(np.array([[320.0, 120.0]]))[0]).astype(int)
    here, there = (found.maps.steps[0].min(axis=0)[y, x] / STEPS_PER_PX for found in (seen, paint))
    assert here < 3.0 < 20.0 < there


def test_first_cameras_show_the_field_as_cameras_do():
    circle = RINK.circle_by_name["faceoff_left_top"]
    conic = transform_conic(LEFT_CIRCLE.homography, circle_conic(circle.center, RINK.radius(circle, "center")))
    cameras = cameras_before_circles([conic], RINK, SIZE[0], (np.array(SIZE) - 1) / 2, "main")
    nodes = RINK.outlines[1].reshape(-1, 2)
    for k in range(0, len(cameras), 1501):
        view = cameras.view(k, SIZE, np.ones(2))
        there = view.project(nodes)
        shown = view.shows(there)
        seen = cameras.take(slice(k, k + 1)).project(nodes)
        np.testing.assert_allclose(seen.pixels[:, 0].T[shown], there[shown], atol=0.02)
        assert seen.ahead[0][shown].all()


def test_ridges_of_a_surface_are_found_once_for_all_masks_and_templates(monkeypatch):
    looks = []
    monkeypatch.setattr(field_paint, "see_surface", lambda *given: looks.append(given[4]))
    gray, ground = np.zeros(SIZE[::-1], np.uint8), np.ones(SIZE[::-1], np.bool_)
    scene = frame.Scene(np.zeros((*SIZE[::-1], 3), np.uint8), gray, None, None, None)
    for name in ("basketball", "basketball-nba", "ice-hockey", "ice-hockey-nhl"):
        config = load_config(None, [f"field.template={name}"])
        for conic in (np.diag([1.0, 1.0, -1.0]), np.diag([1.0, 2.0, -1.0])):
            mask = MarkingMask(gray, "detector", conic, field_region=ground.copy(), polarity=-1.0)
            field_paint.look_for_paint(scene, mask, config, load_field(name))
    assert looks == [False, True]


def _observe_rink(camera, names, line):
    """Circles and a line of the rink as a camera sees them, to a fifth of a pixel."""
    rng, angle = np.random.default_rng(0), np.linspace(0, 2 * np.pi, 600)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    ends = RINK.line_ends(next(drawn for drawn in RINK.lines if drawn.name == line))

    def see(places):
        points = camera.project(places) + rng.normal(0, 0.2, places.shape)
        shown = points[((points > 0) & (points < SIZE)).all(axis=1)]
        return shown, np.full(len(shown), 0.2)

    circles = [RINK.circle_by_name[name] for name in names]
    rims = [np.asarray(circle.center) + RINK.radius(circle, "center") * ring for circle in circles]
    seen = tuple(CirclePoints(name, "center", *see(rim)) for name, rim in zip(names, rims, strict=True))
    return Observations(*SIZE, seen, (LinePoints(line, *see(np.linspace(*ends, 600))),))


def test_no_marking_of_a_placed_field_is_left_out_for_straining_the_camera(monkeypatch):
    """All that is painted said what each is: a circle that is painted too small still tells where the far end lies."""
    asked = []
    monkeypatch.setattr(camera_stage, "find_straining_marking", lambda *_: asked.append("strain"))
    names = ("faceoff_right_bottom", "faceoff_right_top")
    observations = _observe_rink(RIGHT_END, names, "goal_line_right")
    config = load_config(None, ["field.template=ice-hockey-nhl"])
    setting = frame.Setting(config, RINK, RINK.circle_by_name[names[0]], *SIZE, np.random.default_rng(0))
    seen = Attempt(mask=MarkingMask(np.zeros(SIZE[::-1], np.uint8), "detector", np.eye(3)))
    found = placed_view._calibrate_observations(setting, seen, observations)
    assert {key.name for key in found.camera.residuals_px} == {*names, "goal_line_right"}
    assert markings_error_px(RIGHT_END, found.camera.view) < 3.0
    assert asked == []
    estimate(setting, placed_view.take_observations(setting, seen, observations))
    assert asked == ["strain"]


def test_markings_all_over_the_picture_hold_all_that_the_model_leaves():
    """Only what lies close to the circle is as sure as its points: a lens bends what is far from it."""
    names = ("faceoff_right_bottom", "faceoff_right_top")
    config = load_config(None, ["field.template=ice-hockey-nhl"]).camera
    sigmas = []
    for close in (0.1, 0.01):
        options = config.model_copy(update={"close_sigma_px": close})
        fit = estimate_camera(
            _observe_rink(RIGHT_END, names, "goal_line_right"), RINK, RINK.circle_by_name[names[0]], options
        )
        sigmas.append(fit.max_sigma_px)
    assert sigmas[0] == sigmas[1] > 0.1


def test_a_field_of_other_sizes_is_laid_where_the_first_of_its_sport_lies(monkeypatch):
    gray, tried = np.zeros(SIZE[::-1], np.uint8), []
    masks = [MarkingMask(gray, "detector", np.eye(3), polarity=sign) for sign in (1.0, -1.0)]
    scene = frame.Scene(np.zeros((*SIZE[::-1], 3), np.uint8), gray, None, None, None)
    monkeypatch.setattr(placed_field, "look_for_paint", lambda _, mask, *__: Paint(str(mask.polarity)))

    def answer_dark(setting, _, mask, __, ___, most, *____):
        tried.append((setting.template.name, mask.polarity, most))
        return Attempt() if mask.polarity < 0 else None

    monkeypatch.setattr(placed_field, "_place_among", answer_dark)
    for name in ("ice-hockey-nhl", "ice-hockey", "basketball"):
        config = load_config(None, [f"field.template={name}"])
        setting = frame.Setting(config, *field_of(config), *SIZE, np.random.default_rng(0))
        next(placed_field.place_template(setting, scene, Attempt(mask=replace(masks[0], sightings=tuple(masks)))))
    usual, sibling = placed_field.MOST_PLACED, placed_field.MOST_OF_SIBLING
    rink = [("ice-hockey-nhl", 1.0, usual), ("ice-hockey-nhl", -1.0, usual), ("ice-hockey", -1.0, sibling)]
    assert tried == [*rink, ("basketball", 1.0, usual), ("basketball", -1.0, usual)]


@pytest.mark.parametrize(("placed", "found", "wandered"), [(0.07, 0.17, False), (0.7, 1.1, False), (0.2, 0.6, True)])
def test_a_camera_that_finds_much_more_paint_than_its_placement_lies_on_other_paint(placed, found, wandered):
    lain = PlacedField(RINK.circles[0], np.eye(3), FieldView(RIGHT_END), placed, 0.5)
    weighed = ViewEvidence(found, 0.6, 0.5)
    assert placed_field._has_wandered(weighed, lain) is wandered
    # unless many markings lie exactly where it puts them: a rim of a logo leads there from somewhat off
    config = load_config(None, ["field.template=ice-hockey-nhl"])
    setting = frame.Setting(config, *field_of(config), *SIZE, np.random.default_rng(0))
    few, many = (_fit_of({str(k): 0.2 for k in range(count)}) for count in (3, PRECISE_MARKINGS))
    assert placed_field._may_be_right(setting, weighed, few, lain) is not wandered
    assert placed_field._may_be_right(setting, weighed, many, lain)


@pytest.mark.parametrize(
    ("there", "is_told"),
    [
        (ViewEvidence(0.55, 0.8, 0.5), False),
        (ViewEvidence(0.4, 0.8, 0.5), True),
        (ViewEvidence(0.55, 0.8, 0.5, surface_share=0.6), True),
        (ViewEvidence(0.55, 0.8, 0.5, bare_widths=0.4), True),
    ],
)
def test_one_circle_with_a_line_is_told_where_the_paint_contradicts_it_about_all_others(monkeypatch, there, is_told):
    """Moved to another circle the same camera finds as much, or less, or lays the field into the stands."""
    told = "faceoff_left_top", "goal_line_left", "end_spot_left_top"
    looked = []

    def weigh(view, *_):
        looked.append(view.camera.position_m - LEFT_CIRCLE.position_m)
        return there

    monkeypatch.setattr(placed_field, "weigh_view", weigh)
    found = _choose([(ViewEvidence(0.6, 0.8, 0.5), LEFT_CIRCLE, told)], circle="faceoff_left_top")
    assert (found is not None) is is_told
    if is_told:
        assert len(looked) == 3  # the centre circle is blue
        assert all(np.linalg.norm(shift) > 10.0 for shift in looked)
        config = load_config(None, ["field.template=ice-hockey-nhl"])
        setting = frame.Setting(config, *field_of(config), *SIZE, np.random.default_rng(0))
        seen = MarkingMask(np.zeros(SIZE[::-1], np.uint8), "detector")
        vague = replace(found, mask=seen, camera=replace(found.camera, max_sigma_px=20.0, mean_sigma_px=5.0))
        assert not doubtful_circle.is_doubtful(setting, vague)
        vaguer = replace(vague, camera=replace(vague.camera, mean_sigma_px=20.0))
        assert doubtful_circle.is_doubtful(setting, vaguer)
    # without the spot in its middle a circle and a line fit many cameras
    assert _choose([(ViewEvidence(0.6, 0.8, 0.5), LEFT_CIRCLE, told[:2])], circle="faceoff_left_top") is None


def test_two_circles_alone_are_no_end_of_a_rink(monkeypatch):
    """They look alike at both ends; with the goal line the end is told."""
    config = load_config(None, ["field.template=ice-hockey-nhl"])
    template, circle = field_of(config)
    setting = frame.Setting(config, template, circle, *SIZE, np.random.default_rng(0))
    scene = frame.Scene(np.zeros((*SIZE[::-1], 3), np.uint8), np.zeros(SIZE[::-1], np.uint8), None, None, None)
    lain = [PlacedField(circle, np.eye(3), FieldView(LEFT_CIRCLE), 1.0, 0.8)]
    monkeypatch.setattr(placed_field, "weigh_view", lambda *_: ViewEvidence(1.0, 0.8, 0.8))
    monkeypatch.setattr(placed_field, "look_for_paint", lambda *_: Paint("seen"))
    monkeypatch.setattr(placed_field, "search_placements", lambda *_: object())
    monkeypatch.setattr(placed_field, "refine_placements", lambda *_: lain)
    seen = MarkingMask(scene.gray, "detector", conic=np.eye(3))
    count = {}
    for names in (
        ("faceoff_left_top", "faceoff_left_bottom"),
        ("faceoff_left_top", "faceoff_left_bottom", "goal_line"),
    ):
        camera = replace(fit(LEFT_CIRCLE), residuals_px={MarkingKey(name): 0.1 for name in names})
        attempt = Attempt(camera=camera, verdict=Verdict("calibrated", None, None, None))
        monkeypatch.setattr(placed_field, "follow_placement", lambda *_, attempt=attempt: attempt)
        count[len(names)] = len(list(placed_field.place_template(setting, scene, Attempt(mask=seen))))
    assert count == {2: 0, 3: 1}


@pytest.mark.parametrize("count", [2, 3])
def test_a_mark_beside_its_place_is_left_out_where_other_markings_decide(monkeypatch, count):
    """Spots are painted centimetres off; a circle and a line alone leave open what is wrong."""
    config = load_config(None, ["field.template=ice-hockey-nhl"])
    setting = frame.Setting(config, *field_of(config), *SIZE, np.random.default_rng(0))
    mark = MarkCue("faceoff_spot", np.zeros(2), 1.0, 9.0)
    camera = replace(fit(LEFT_CIRCLE), residuals_px={MarkingKey(str(k)): 0.1 for k in range(count)})
    refused = Verdict("refused", "mark_contradicts_circle", None, "camera")
    empty = Observations(*SIZE, (), (), ())
    attempt = Attempt(camera=camera, cues=Cues(None, mark), observations=empty, verdict=refused)
    again = []
    monkeypatch.setattr(placed_view, "_calibrate_observations", lambda *given: again.append(given) or attempt)
    assert placed_view._leave_out_mark(setting, attempt, attempt) is attempt
    assert len(again) == (count > 2)


@pytest.mark.parametrize(("radius_share", "is_drawn"), [(1.0, True), (1.1, False)])
def test_a_camera_that_leaves_out_its_own_circle_draws_it_where_it_was_seen(radius_share, is_drawn):
    """Of a school yard whose circle was left out as a stray: as a longer court it was 38 px off."""
    circle = RINK.circle_by_name["faceoff_left_top"]
    seen = circle_conic(np.asarray(circle.center), radius_share * RINK.radius(circle, "center"))
    conic = transform_conic(LEFT_CIRCLE.homography, seen)
    setting = frame.Setting(load_config(None), RINK, circle, LEFT_CIRCLE.width, LEFT_CIRCLE.height, None)
    camera = _fit_of({"blue_line_left": 0.3}).camera
    lain = PlacedField(circle, conic, FieldView(LEFT_CIRCLE), 1.0, 0.8)
    assert placed_view._draws_circle(setting, camera, lain) is is_drawn
    carried = replace(camera, residuals_px={MarkingKey(circle.name, "center"): 0.2})
    assert placed_view._draws_circle(setting, carried, lain)


def test_the_field_turned_by_half_is_no_rival():
    """Of a camera behind an end both stand on its side, and no marking tells one from the other."""
    setting = frame.Setting(load_config(None), RINK, RINK.circles[0], *SIZE, None)
    camera = fit(RIGHT_END)
    turned = replace(camera, camera=RIGHT_END.turn_field())
    assert placed_field._are_alike(setting, camera, turned)
    assert not placed_field._are_alike(setting, camera, replace(camera, camera=LEFT_CIRCLE))
    evidence = ViewEvidence(0.8, 0.8, 0.5)
    found = _choose([(evidence, RIGHT_END, END), (evidence, RIGHT_END.turn_field(), OTHER_END)])
    assert found is not None and found.is_calibrated and not found.rivals
