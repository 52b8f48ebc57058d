import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from circlecal.api.calls import calibrate_annotation
from circlecal.config import Config, load_config
from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.formats.annotation import AnnotatedMarking, Annotation
from circlecal.geometry.camera import Camera, camera_from_soccernet, image_center
from circlecal.geometry.surface import Surface
from circlecal.observations import MarkingKey
from circlecal.pictures.files import PictureFile, read_image
from circlecal.pipeline import field_of
from circlecal.refusals import REFUSALS
from circlecal.workbench.answers import (
    ADVICE,
    ONE_OF_THEM,
    TAKE_AWAY,
    answer,
    continues,
    describe,
    distance_to_polyline,
)
from circlecal.workbench.doubts import find_wrong_name
from circlecal.workbench.interpretations import Interpretation, _lines_beside, _Search, interpret, name_marking
from circlecal.workbench.measuring import (
    begin_annotation,
    complete_circle,
    exact_clicks,
    follow_path,
    measure_picture,
    snap_click,
)

SAMPLES = Path(__file__).parents[2] / "samples"
FEW = ("halfway_line", "side_line_top", "big_rect_right_main", "big_rect_right_top", "small_rect_left_main")


@pytest.fixture(scope="module")
def begun(open_frame) -> Annotation:
    return begin_annotation(open_frame, Config(), PictureFile("open", Path("open.png"), "open"))


PAINTER_OFF_PX = -0.375
"""The painter of tests counts from the corner of its pixels, four of which make one of the picture."""


def drawn(camera, name: str) -> np.ndarray:
    return PAINTER_OFF_PX + camera.project(load_field("soccer").polylines(0.2)[name])


def test_a_refused_frame_keeps_what_was_measured(open_frame, begun):
    assert open_frame.found.verdict.code == "rotation_free"
    assert [m.name for m in begun.markings if m.kind == "curve"] == ["centre_circle"]
    assert any(m.kind == "line" and m.name is None and m.used for m in begun.markings)


@pytest.mark.parametrize("name", ["centre_circle", "side_line_top"])
def test_a_click_near_paint_lands_on_its_middle(open_frame, wide_camera, name):
    truth = drawn(wide_camera, name)
    seen = truth[open_frame.shows(np.nan_to_num(truth, nan=-1.0))]
    seen = seen[seen[:, 0] < 370.0] if name == "side_line_top" else seen  # beyond, it is not painted
    rng = np.random.default_rng(3)
    for place in seen[rng.integers(0, len(seen), 12)]:
        click = np.clip(place + rng.normal(0, 2, 2), 12, (947, 527))
        found = snap_click(open_frame, click)
        assert found.on_paint
        assert distance_to_polyline(found.points, truth)[0] < 0.4
        assert 0.05 < found.sigma[0] < 1.0


def test_a_click_on_bare_grass_stays_where_it_is(open_frame):
    click = np.array([480.0, 500.0])
    found = snap_click(open_frame, click)
    assert not found.on_paint
    assert found.points[0] == pytest.approx(click)
    assert found.sigma[0] == exact_clicks(open_frame, click[None]).sigma[0]


def test_a_drag_follows_a_curve(open_frame, wide_camera):
    truth = drawn(wide_camera, "centre_circle")
    seen = truth[open_frame.shows(truth)]
    path = seen[10:120:6] + np.random.default_rng(0).normal(0, 1.5, seen[10:120:6].shape)
    found = follow_path(open_frame, path)
    assert found.on_paint and len(found.points) > 20
    assert np.median(distance_to_polyline(found.points, truth)) < 0.3


def test_two_clicks_on_a_line_measure_what_lies_between(open_frame, wide_camera):
    truth = drawn(wide_camera, "side_line_top")
    seen = truth[open_frame.shows(np.nan_to_num(truth, nan=-1.0))]
    found = follow_path(open_frame, seen[[20, -20]] + (0.0, 1.5))
    assert len(found.points) > 50
    assert np.median(distance_to_polyline(found.points, truth)) < 0.3


def test_two_clicks_on_the_circle_measure_it_all(open_frame, wide_camera):
    truth = drawn(wide_camera, "centre_circle")
    found = complete_circle(open_frame, truth[[30, 90]])
    assert found is not None and len(found.points) > 100
    assert np.median(distance_to_polyline(found.points, truth)) < 0.3
    assert complete_circle(open_frame, np.array([[50.0, 500.0], [900.0, 500.0]])) is None


def test_one_name_calibrates_the_frame(begun, wide_camera):
    assert not answer(begun, Config(), nameless=True).is_calibrated
    line = next(k for k, m in enumerate(begun.markings) if m.kind == "line" and len(m.points_px) > 100)
    told = answer(name_marking(begun, line, "side_line_top"), Config(), nameless=False)
    assert told.is_calibrated
    shown = describe(told)
    assert shown["missing"] is None and shown["sigma_px"] < 15
    assert shown["markings"][line]["rms_px"] < 1.0
    assert np.abs(told.found.attempt.camera.camera.position_m - wide_camera.position_m).max() < 6.0
    # what rounds to nothing has no sign
    fit = told.found.attempt.camera
    nearly = replace(fit.camera, position_m=np.array([-0.01, 62.0, -15.5]), angles_rad=np.array([-1e-6, 1.3, 0.0]))
    attempt = replace(told.found.attempt, camera=replace(fit, camera=nearly))
    facts = dict(describe(replace(told, found=replace(told.found, attempt=attempt)))["facts"])
    assert facts["camera"].startswith("0.0, 62.0 m")
    assert facts["pan, tilt, roll"].startswith("0.00°, ")


def test_a_wrong_name_is_marked(begun):
    markings = list(begun.markings)
    line = next(k for k, m in enumerate(markings) if m.kind == "line" and len(m.points_px) > 100)
    right = name_marking(begun, line, "side_line_top")
    halfway = right.markings[line].model_copy(
        update={
            "name": "halfway_line",
            "points_px": [[400.0, 300.0], [700.0, 310.0], [800.0, 313.0]],
            "sigma_px": [0.3] * 3,
        }
    )
    shown = describe(
        answer(right.model_copy(update={"markings": [*right.markings, halfway]}), Config(), nameless=False)
    )
    # three markings, one of them wrong: which one it is, nobody can tell
    assert any(told["contradicts"] for told in shown["markings"]) or shown["status"] == "refused"


@pytest.mark.parametrize(("share", "contradicts"), [(0.2, False), (0.3, True)])
def test_a_few_stray_points_do_not_contradict(begun, share, contradicts):
    line = next(k for k, m in enumerate(begun.markings) if m.kind == "line" and len(m.points_px) > 100)
    told = answer(name_marking(begun, line, "side_line_top"), Config(), nameless=False)
    assert told.is_calibrated
    points = told.annotation.markings[line].points.copy()
    points[: round(share * len(points))] += (0.0, 40.0)  # as measured along the players who hide it
    markings = list(told.annotation.markings)
    markings[line] = markings[line].model_copy(update={"points_px": points.tolist()})
    shown = describe(replace(told, annotation=told.annotation.model_copy(update={"markings": markings})))
    assert shown["markings"][line]["contradicts"] == contradicts


def test_one_click_calibrates_the_sample_with_a_touchline(monkeypatch):
    path = SAMPLES / "touchline_only.jpg"
    file = PictureFile(path.stem, path, path.stem)
    measured = measure_picture(read_image(path), Config(), file)
    begun = begin_annotation(measured, Config(), file)
    assert (measured.found.status, measured.found.verdict.code) == ("refused", "rotation_free")
    # the offered names are found among all markings of the field; few of them are as good here, and quicker
    template, circle = field_of(Config())
    few = template.model_copy(
        update={"lines": tuple(line for line in template.lines if line.name in FEW), "arcs": template.arcs[:0]}
    )
    monkeypatch.setattr("circlecal.workbench.interpretations.field_of", lambda config: (few, circle))
    quick = load_config(None, ["camera.starts=3"])
    assert interpret(begun, measured, quick, is_wanted=lambda: False) == []
    offered = interpret(begun, measured, quick)
    assert 1 <= len(offered) <= 2
    named = begun
    for index, name in offered[0].names.items():
        named = name_marking(named, index, name)
    # the circle, and both pieces of the line, follow from one click
    assert sorted(offered[0].names.values()) == ["centre_circle", "side_line_top", "side_line_top"]
    told = answer(named, Config(), nameless=True)
    truth = json.loads((SAMPLES / "truth" / "touchline_only.json").read_text())
    camera = camera_from_soccernet(truth["camera"], truth["width"], truth["height"])
    surface = Surface(truth["crown_shape"], truth["crown_reference_m"], truth["crown_m"])
    assert told.is_calibrated
    for name, limit_px in (("centre_circle", 2.0), ("side_line_top", 3.0)):
        places = template.polylines(0.5)[name]
        exact = FieldView(camera, surface).project(places)
        seen = measured.shows(np.nan_to_num(exact, nan=-1.0))
        assert seen.any()
        assert distance_to_polyline(exact[seen], told.found.view.project(places)).max() < limit_px


def test_the_best_explains_most_and_shows_what_it_expects():
    ground = np.zeros((1, 2))
    usual = Interpretation({}, 0.6, 500.0, 300.0, ground, True)
    longer, found = replace(usual, explained_px=400.0), replace(usual, found_share=0.9)
    missed, other_side = replace(usual, found_share=0.2), replace(longer, on_usual_side=False)
    assert sorted((other_side, missed, usual, longer), key=lambda i: i.rank) == [longer, usual, missed, other_side]
    assert found.rank < usual.rank
    # half found is as good as nothing expected; more expected counts for what is found, and against what is missing
    assert replace(usual, found_share=0.5).rank == replace(usual, expected_px=0.0).rank
    assert replace(found, expected_px=900.0).rank < found.rank
    assert replace(missed, expected_px=900.0).rank > missed.rank


@pytest.mark.parametrize(("from_deg", "to_deg", "is_offered"), [(0.0, 140.0, True), (0.0, 220.0, False)])
def test_a_circle_most_of_which_is_not_painted_is_not_offered(
    open_frame, wide_camera, begun, from_deg, to_deg, is_offered
):
    """As of a penalty arc that was taken for the centre circle."""
    template, circle = field_of(Config())
    angle = np.radians(np.linspace(from_deg, to_deg, 400))
    ring = PAINTER_OFF_PX + wide_camera.project(9.09 * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    bare = np.zeros(open_frame.light.shape, np.uint8)
    cv2.polylines(bare, [np.rint(ring).astype(np.int32)], False, 255, 9)
    measured = replace(open_frame, light=cv2.inpaint(open_frame.light, bare, 5, cv2.INPAINT_TELEA))
    curve = next(k for k, m in enumerate(begun.markings) if m.kind == "curve")
    line = next(k for k, m in enumerate(begun.markings) if m.kind == "line" and len(m.points_px) > 100)
    search = _Search(measured, Config(), template, circle)
    tried = search.try_name(begun, line, "side_line_top", given={curve: "centre_circle"})
    assert (tried is not None) == is_offered


def test_pieces_of_one_line():
    along = np.linspace(0.0, 600.0, 40)
    line = np.stack([along, 300.0 - 0.04 * along + 1e-5 * (along - 300.0) ** 2], axis=1)
    assert continues(line[:12], line[20:], 1.0)
    assert not continues(line[:12], line[20:] + np.array([0.0, 12.0]), 1.0)
    assert not continues(line[:20], np.stack([along[:20] + 300.0, 300.0 - 0.5 * along[:20]], axis=1), 1.0)


def test_a_flag_refuses_a_frame(begun):
    told = answer(begun.model_copy(update={"flag": "no_field"}), Config(), nameless=True)
    assert (told.found.status, told.found.verdict.code) == ("refused", "no_field")
    assert describe(told)["template"] == {}


def test_settings_of_a_frame_are_in_force(begun):
    line = next(k for k, m in enumerate(begun.markings) if m.kind == "line" and len(m.points_px) > 100)
    named = name_marking(begun, line, "side_line_top")
    wider = named.model_copy(update={"settings": {"field.sizes.width": 74.0}})
    usual, changed = (answer(a, Config(), nameless=False).found.attempt.camera for a in (named, wider))
    assert usual is not None and changed is not None
    assert abs(usual.camera.position_m[1] - changed.camera.position_m[1]) > 0.5


def test_lines_that_a_curve_is_seen_with():
    template = field_of(Config())[0]
    for arc in template.arcs:
        side = arc.name.rpartition("_")[2]
        beside = _lines_beside(arc, template)
        assert f"big_rect_{side}_main" in beside and "side_line_top" in beside
        assert not [name for name in beside if {"left": "right", "right": "left"}[side] in name]
    assert "halfway_line" in _lines_beside(template.circles[0], template)


def test_the_advice_for_a_wrong_click_is_to_take_it_away(begun):
    line = next(k for k, m in enumerate(begun.markings) if m.kind == "line" and len(m.points_px) > 100)
    right = name_marking(begun, line, "side_line_top")
    ends = [[300.0, 500.0], [860.0, 380.0]]
    wrong = AnnotatedMarking(name="halfway_line", kind="line", points_px=ends, sigma_px=[0.5, 0.5])
    told = answer(right.model_copy(update={"markings": [*right.markings, wrong]}), Config(), nameless=False)
    shown = describe(told)
    assert shown["status"] == "refused" and any(marking["contradicts"] for marking in shown["markings"])
    assert shown["missing"] in (ONE_OF_THEM, f"The name halfway line contradicts the rest. {TAKE_AWAY}")
    found = find_wrong_name(told.annotation, begun, Config())
    assert found is not None and found.name == "halfway_line" and TAKE_AWAY in found.tell()


def test_no_advice_of_the_page_needs_the_command_line():
    codes = {"residual_too_large", "implausible_camera", "circle_unconfirmed", "few_markings", "markings_missing"}
    assert codes <= ADVICE.keys() and ADVICE.keys() - {"too_few_observations"} <= REFUSALS.keys()
    assert not any("--" in advice for advice in ADVICE.values())


def test_what_the_whole_picture_told_counts_in_its_annotation_too(open_frame):
    """From which circle the camera was found, and that no marking is left out for being painted a little off."""
    found = open_frame.found
    told = replace(found, circle_name="penalty_arc_left", attempt=replace(found.attempt, is_placed=True))
    picture = PictureFile("open", Path("open.png"), "open")
    begun = begin_annotation(replace(open_frame, found=told), Config(), picture)
    assert (begun.circle, begun.placed) == ("penalty_arc_left", True)
    assert begin_annotation(open_frame, Config(), picture).circle is None


def test_an_annotation_of_a_rink_is_calibrated_from_the_circle_that_the_picture_was():
    field, config = load_field("ice-hockey-nhl"), load_config(None, {"field.template": "ice-hockey-nhl"})
    camera = Camera(
        width=1280,
        height=720,
        focal_px=np.array([1600.0, 1600.0]),
        principal_point_px=image_center(1280, 720),
        angles_rad=np.radians([28.0, 72.0, 0.0]),
        position_m=np.array([1.6, 32.0, -9.8]),
        kappa=np.zeros(2),
    )
    angle = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    markings = []
    for name in ("faceoff_right_top", "faceoff_right_bottom"):
        ring = field.curve_points(field.circle_by_name[name], "center", angle)
        markings.append(marked(camera, name, "curve", ring))
    for name in ("goal_line_right", "blue_line_right"):
        markings.append(marked(camera, name, "line", field.polylines(0.2)[name]))
    told = Annotation(id="rink", width=1280, height=720, field="ice-hockey-nhl", markings=markings)
    alone = calibrate_annotation(told, config)
    placed = calibrate_annotation(told.model_copy(update={"placed": True, "circle": "faceoff_right_top"}), config)
    assert (alone.circle_name, placed.circle_name) == ("centre_circle", "faceoff_right_top")
    assert (alone.attempt.is_placed, placed.attempt.is_placed) == (False, True)
    assert placed.attempt.camera.max_sigma_px < alone.attempt.camera.max_sigma_px
    left_out = [m.model_copy(update={"used": m.name != "faceoff_right_top"}) for m in told.markings]
    other = told.model_copy(update={"circle": "faceoff_right_top", "markings": left_out})
    assert calibrate_annotation(other, config).circle_name == "centre_circle", "what is taken away counts no more"


def marked(camera: Camera, name: str, kind: str, places: np.ndarray) -> AnnotatedMarking:
    """A measured marking, as far as the picture shows it."""
    points = camera.project(places)
    points = points[((points > 5) & (points < (camera.width - 5, camera.height - 5))).all(axis=1)]
    return AnnotatedMarking(
        name=name, kind=kind, points_px=points.tolist(), sigma_px=[0.08] * len(points), source="measured"
    )


def test_what_an_accepted_calibration_left_out_is_not_used(frame_image):
    file = PictureFile("good", Path("good.png"), "good")
    measured = measure_picture(frame_image, Config(), file)
    assert measured.found.status == "calibrated"
    used = {marking.name for marking in begin_annotation(measured, Config(), file).markings if marking.used}
    assert "side_line_top" in used
    attempt = measured.found.attempt
    camera = replace(attempt.camera, rejected=(MarkingKey("side_line_top", None),))
    found = replace(measured.found, attempt=replace(attempt, camera=camera))
    begun = begin_annotation(replace(measured, found=found), Config(), file)
    assert {marking.name for marking in begun.markings if not marking.used} == {"side_line_top"}
