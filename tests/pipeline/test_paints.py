"""Lines of several colours on one floor."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from circlecal.config import config_digest, load_config
from circlecal.detection.options import FieldRegionConfig
from circlecal.detection.paints import find_paints
from circlecal.field import load_field
from circlecal.paint.brightness import brightness_of_paint
from circlecal.pipeline import paints as module
from circlecal.pipeline import run
from circlecal.records.writing import result_record
from circlecal.results import Attempt, FieldCandidate, FrameCalibration, LikelySport, Verdict
from circlecal.synthetic.floors import (
    BLACK,
    BLUE,
    GREEN,
    RED,
    WHITE,
    YELLOW,
    basketball_lines,
    handball_lines,
    tennis_lines,
    volleyball_lines,
)
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import render_frame, sample_scene
from circlecal.synthetic.scene import ExtraPaint

INKS = (WHITE, YELLOW, RED, BLUE, BLACK, GREEN)
FLOOR = np.array([95.0, 145.0, 185.0])


@pytest.fixture(scope="module")
def hall():
    """Futsal in one colour among the lines of basketball, handball, volleyball and tennis, each in its colour."""
    rng = np.random.default_rng([901, 14])
    scene = sample_scene("wood", rng, 1280, 720, load_field("futsal"))
    inks = [INKS[k] for k in rng.permutation(6)]
    free = next(k for k in range(6) if np.abs(np.array(inks[k]) - scene.config.turf_bgr).max() > 75)
    inks[5], inks[free] = inks[free], inks[5]
    sports = basketball_lines(), handball_lines(), volleyball_lines(), tennis_lines()
    extras = tuple(ExtraPaint(lines, 0.05, inks[k], 0.9) for k, lines in enumerate(sports))
    config = scene.config.model_copy(update={"paint_bgr": inks[5], "gloss": 0.1})
    scene = replace(scene, config=config, extras=extras)
    return render(scene, rng).image, scene


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_the_lines_of_one_colour_answer_where_those_of_five_sports_are_refused(hall):
    image, scene = hall
    config, together = load_config("futsal"), load_config("futsal", ["mask.tell_paints=false"])

    def calibrate(chosen):
        return run(image, chosen, frame_id="hall")

    first = calibrate(config)
    assert first.status == "refused"
    assert module.calibrate_by_paint(image, together, first, calibrate) is first
    found = module.calibrate_by_paint(image, config, first, calibrate)
    assert found.status == "calibrated"
    points = np.array([[0.0, 0.0], [3.0, 0.0], [-3.0, 0.0], [0.0, 3.0], [0.0, -3.0]])
    there = scene.camera.project(scene.surface.lift(points))
    assert np.linalg.norm(found.view.project(points) - there, axis=1).max() < 2.0
    record = result_record(found, found.template)
    added, painted = np.array(record.paint.added_bgr), np.array(scene.config.paint_bgr) - scene.config.turf_bgr
    assert added @ painted > 0.9 * np.linalg.norm(added) * np.linalg.norm(painted)
    assert record.paint.polarity == ("light" if painted @ (0.114, 0.587, 0.299) > 0.0 else "dark")
    assert record.paint.others_bgr
    assert record.config_digest == config_digest(config) != config_digest(together)


def draw_floor(*inks: tuple[float, float, float]) -> np.ndarray:
    """Three lines of each ink on a wooden floor."""
    image = np.full((360, 640, 3), FLOOR, np.float64)
    rng = np.random.default_rng(0)
    for ink in inks * 3:
        first, last = rng.uniform((20, 60), (620, 340), (2, 2))
        cv2.line(image, np.rint(first).astype(int), np.rint(last).astype(int), ink, 3, cv2.LINE_AA)
    return np.clip(image + rng.normal(0, 1.5, image.shape), 0, 255).astype(np.uint8)


def test_every_paint_of_a_floor_is_found():
    inks = (225.0, 230.0, 230.0), (40.0, 140.0, 200.0), (45.0, 40.0, 180.0), (170.0, 80.0, 35.0)
    found = find_paints(draw_floor(*inks), FieldRegionConfig())
    assert len(found) == 4
    for ink in inks:
        added = np.array(ink) - FLOOR
        cosines = [added @ paint / np.linalg.norm(added) / np.linalg.norm(paint) for paint in found]
        assert max(cosines) > 0.97
    assert find_paints(np.full((360, 640, 3), 120, np.uint8), FieldRegionConfig()) == ()


def test_along_a_colour_its_paint_is_light_and_others_hardly_show():
    image = np.full((1, 3, 3), FLOOR).astype(np.uint8)
    yellow, red = np.array([-60.0, -2.0, 5.0]), np.array([-50.0, -105.0, -5.0])
    image[0, 1] = FLOOR + yellow
    image[0, 2] = FLOOR + red
    gray = brightness_of_paint(image, None)[0].astype(int)
    assert abs(gray[1] - gray[0]) < 10
    alone = brightness_of_paint(image, yellow)[0].astype(int)
    assert alone[1] - alone[0] > 50
    apart = brightness_of_paint(image, yellow, [red])[0].astype(int)
    assert apart[1] - apart[0] > 25
    assert abs(apart[2] - apart[0]) < 0.15 * (apart[1] - apart[0])
    for colour in ((255.0, 255.0, 255.0), (-1.0, 2.0, -3.0)):
        ends = np.array([[[0, 0, 0], [255, 255, 255], [255, 0, 255], [0, 255, 0]]], np.uint8)
        assert brightness_of_paint(ends, colour).dtype == np.uint8


@pytest.mark.parametrize(
    ("paints", "count"),
    [
        ([(60.0, 61.0, 70.0), (-18.0, -18.0, -21.0)], 0),
        ([(60.0, 61.0, 70.0), (-10.0, 60.0, 70.0)], 2),
        ([(-18.0, -18.0, -21.0), (-79.0, -8.0, 2.0)], 2),
        ([(-79.0, -8.0, 2.0), (60.0, 61.0, 70.0)], 1),
    ],
    ids=["white and shade", "white and yellow", "black and yellow", "yellow and white"],
)
def test_what_the_brightness_shows_alone_is_not_looked_at_again(monkeypatch, paints, count):
    """White lines on a floor with dark seams are what all lines together are; two light paints hide each other."""
    looked = []

    def look(image, _, options, *__):
        looked.append(options.paint_bgr)
        return SimpleNamespace(candidates=[SimpleNamespace(score=0.7)])

    monkeypatch.setattr(module, "tell_paints", lambda *_: tuple(np.array(paint) for paint in paints))
    monkeypatch.setattr(module, "look_quickly", look)
    picture = np.zeros((36, 64, 3), np.uint8)
    first = SimpleNamespace(template=load_field("futsal"))
    assert len(module._find_likely_paints(picture, first, load_config("futsal"))) == count == len(looked)


@pytest.mark.parametrize(
    ("evidence", "explained", "by_colour", "taken"),
    [
        (0.43, 0.6, 1.7, "basketball-nba"),
        (0.43, 0.6, 0.2, "basketball-ncaa"),
        (0.86, 0.6, 1.7, "basketball-ncaa"),
        (0.43, 0.8, 1.7, "basketball-ncaa"),
    ],
    ids=["little is painted", "less by colour", "enough is painted", "no other paint is seen"],
)
def test_colours_are_looked_at_before_a_league_that_little_speaks_for_is_believed(
    monkeypatch, evidence, explained, by_colour, taken
):
    """A rendered NBA court was taken for another league's with 0.43 picture widths of its markings."""
    config, paint = load_config(None, {"field.template": "auto"}), np.array([60.0, 61.0, 70.0])

    def answer(name, evidence):
        seen = FieldCandidate(name, "basketball", "calibrated", None, evidence, 0.6, explained)
        attempt = Attempt(verdict=Verdict("calibrated", None, None, None))
        found = FrameCalibration("x", 64, 36, name, "centre_circle", attempt, 0, "", template=load_field(name))
        return replace(found, fields=(seen,), paint_bgr=tuple(paint))

    monkeypatch.setattr(module, "_may_have_paints", lambda *_: True)
    monkeypatch.setattr(module, "_find_likely_paints", lambda *_: [(paint, config.mask)])
    first, other = answer("basketball-ncaa", evidence), answer("basketball-nba", by_colour)
    among = []

    def calibrate(chosen):
        among.append(chosen.field.among)
        return other

    found = module.calibrate_by_paint(np.zeros((36, 64, 3), np.uint8), config, first, calibrate)
    assert found.field_name == taken
    # other sports were weighed by all lines together
    assert among in ([], [("basketball-ncaa", "basketball", "basketball-nba")])


@pytest.mark.parametrize(
    ("field", "shown", "code", "settings", "sees"),
    [
        ("basketball-nba", None, None, [], True),
        ("ice-hockey-nhl", None, None, [], True),
        ("ice-hockey-nhl", None, "circle_open", [], True),
        ("ice-hockey-nhl", None, "no_circle_found", [], False),
        ("curling", None, None, [], True),
        ("soccer", None, None, [], False),
        ("auto", "basketball-nba", None, [], True),
        ("auto", "soccer", None, [], False),
        ("basketball-nba", None, None, ["mask.source=file"], False),
    ],
)
def test_a_court_that_is_refused_with_its_mask_is_looked_at_without(monkeypatch, field, shown, code, settings, sees):
    """A mask tells no other circle of a field than one, and neither discs nor further markings; soccer's answers with
    masks stay.
    """
    config = load_config(None, [f"field.template={field}", *settings])

    def calibrate(image, chosen, *, mask, **_):
        seen = Verdict("refused" if code else "calibrated", code, None, None)
        verdict = seen if mask is None else Verdict("refused", "few_points", None, "mask")
        name = shown or field
        template = load_field(name)
        return FrameCalibration("x", 64, 36, name, template.default_circle, Attempt(verdict=verdict), 0, "")

    monkeypatch.setattr(module, "run", calibrate)
    monkeypatch.setattr(module, "calibrate_unknown_field", calibrate)
    picture = np.zeros((36, 64, 3), np.uint8)
    found = module.calibrate_image(picture, config, mask=picture[..., 0], frame_id="x")
    assert found.verdict.code == (code if sees else "few_points")


@pytest.mark.parametrize(("profile", "field", "seed"), [("court", "basketball-nba", 2), ("rink", "ice-hockey-nhl", 0)])
def test_a_rendered_court_and_rink_calibrate_beside_their_masks(profile, field, seed):
    rendering = render_frame(profile, np.random.default_rng(seed), 960, 540)
    config = load_config(None, [f"field.template={field}"])
    assert run(rendering.image, config, mask=rendering.truth.classes, frame_id="x").status == "refused"
    found = module.calibrate_image(rendering.image, config, mask=rendering.truth.classes, frame_id="x")
    assert (found.status, found.attempt.mask.source) == ("calibrated", "detector")


def test_a_sport_in_several_paints_is_not_looked_for_in_one():
    config = load_config(None, {"field.template": "auto"})
    assert module._is_in_one_paint(LikelySport("basketball", 0.7), config)
    assert module._is_in_one_paint(LikelySport(None, 0.7), config)
    assert not module._is_in_one_paint(LikelySport("ice hockey", 0.7), config)
