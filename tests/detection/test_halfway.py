import cv2
import numpy as np
import pytest

from circlecal.detection import halfway
from circlecal.detection.circle import MeasuredCircle, measure_circle
from circlecal.detection.ellipse_batch import EllipseBatch
from circlecal.detection.halfway import find_halfway, find_segments_through_middle, measure_segments
from circlecal.detection.options import DetectorConfig
from circlecal.detection.ridges import find_ridges
from circlecal.geometry.ellipses import ellipse_from_conic

from .conftest import HALFWAY_AND_CIRCLE, Distance, Scene, level, paint_scene, upright

CONFIG = DetectorConfig()


def measured(scene: Scene) -> tuple[np.ndarray, MeasuredCircle]:
    ellipse = ellipse_from_conic(scene.conic)
    assert ellipse is not None
    frame = ellipse.frame()[None]
    batch = EllipseBatch(frame[:, :2, 2], frame[:, :2, 0], frame[:, :2, 1])
    gray = np.ascontiguousarray(scene.image[:, :, 1])
    return gray, measure_circle(gray, batch, 1.0, CONFIG.refinement)


def segment(scene: Scene, *ends: tuple[float, float]) -> np.ndarray:
    return scene.camera.project(np.array(ends))


@pytest.fixture(scope="module")
def crossed() -> Scene:
    """The halfway line, and another painted line 5 m beside it."""
    return paint_scene(markings=(*HALFWAY_AND_CIRCLE, upright(5.0)))


def test_the_line_through_the_middle_is_chosen(crossed: Scene) -> None:
    gray, circle = measured(crossed)
    segments = np.stack([segment(crossed, (5, -9), (5, 9)), segment(crossed, (0.1, -8), (-0.1, 8))])
    line = find_halfway(gray, circle, segments, CONFIG)
    assert line is not None
    ends = segment(crossed, (0, -9), (0, 9))
    assert np.abs(ends @ line.line[:2] + line.line[2]).max() < 0.5
    assert line.support > 0.9


def test_a_line_off_the_middle_is_none(crossed: Scene) -> None:
    gray, circle = measured(crossed)
    assert find_halfway(gray, circle, segment(crossed, (5, -9), (5, 9))[None], CONFIG) is None


def test_a_line_that_is_wider_in_the_picture_than_profiles_are_long_is_found(crossed: Scene) -> None:
    gray, circle = measured(crossed)
    start, end = np.rint(segment(crossed, (0, -14), (0, 14))).astype(int).tolist()
    wide = cv2.line(gray.copy(), start, end, int(np.percentile(gray, 99.9)), 11)
    line = find_halfway(wide, circle, segment(crossed, (0, -8), (0, 8))[None], CONFIG)
    assert line is not None
    assert line.support > 0.9


def seam(thinner: float) -> Distance:
    """At the halfway line's place, so many times as thin as paint."""
    return lambda x, y: (thinner * x, np.abs(y) <= 34.0)


def test_a_thin_seam_that_longer_profiles_alone_reach_is_no_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.3 of the usual half length wide, beside the straight run along which a line is looked for."""
    scene = paint_scene(markings=(HALFWAY_AND_CIRCLE[0], seam(3.0)))
    gray, circle = measured(scene)
    on, beside = (segment(scene, (x, -8), (x, 8))[None] for x in (0.0, 0.25))
    assert find_halfway(gray, circle, on, CONFIG) is not None
    assert find_halfway(gray, circle, beside, CONFIG) is None
    monkeypatch.setattr(halfway, "WIDE_SHARE", 0.0)
    reached = find_halfway(gray, circle, beside, CONFIG)
    assert reached is not None
    width_px = np.median(reached.curve.width[reached.curve.supported])
    assert width_px / (CONFIG.refinement.line_reach_px * gray.shape[1] / 1920.0) == pytest.approx(0.3, abs=0.05)


def test_a_line_that_is_not_painted_is_none() -> None:
    bare = paint_scene(markings=HALFWAY_AND_CIRCLE[:1])
    gray, circle = measured(bare)
    assert find_halfway(gray, circle, segment(bare, (0, -9), (0, 9))[None], CONFIG) is None
    assert find_halfway(gray, circle, np.zeros((0, 2, 2)), CONFIG) is None


def test_the_line_is_followed_beyond_the_circle_within_the_picture(crossed: Scene) -> None:
    gray, circle = measured(crossed)
    line = find_halfway(gray, circle, segment(crossed, (0, -8), (0, 8))[None], CONFIG)
    assert line is not None
    ends = np.stack(line.ends)
    crossings = segment(crossed, (0, -9.09), (0, 9.09))
    assert ends[:, 1].min() < crossings[:, 1].min() - 10
    assert ends[:, 1].max() > crossings[:, 1].max() + 10
    assert (ends >= 0).all()
    assert (ends <= (959, 539)).all()


def test_segments_are_measured_one_by_one() -> None:
    scene = paint_scene(markings=(*HALFWAY_AND_CIRCLE, level(12.0, -9.0, 9.0)))
    gray, _ = measured(scene)
    segments = np.stack([segment(scene, (-8, 12), (8, 12)), segment(scene, (-8, 14), (8, 14))])
    found = measure_segments(gray, segments, 1.0, CONFIG.refinement)
    assert found is not None
    share = [found.curve.supported[found.pieces == k].mean() for k in (0, 1)]
    assert share[0] > 0.9
    assert share[1] < 0.2
    assert measure_segments(gray, np.zeros((0, 2, 2)), 1.0, CONFIG.refinement) is None


def test_a_line_that_is_seen_outside_the_circle_only() -> None:
    """The picture shows the circle's left-hand part, and of the halfway line only what runs on towards the camera."""
    left_part = paint_scene(pan_deg=-16.5)
    gray, circle = measured(left_part)
    shown = segment(left_part, (0, 18), (0, 24))
    line = find_halfway(gray, circle, shown[None], CONFIG)
    assert line is not None
    assert line.outside
    assert line.support > 0.7


@pytest.mark.parametrize(("last_m", "found"), [(18.0, True), (14.0, False)])
def test_a_line_that_is_seen_outside_only_ends_where_the_field_does(last_m: float, found: bool) -> None:
    """Beyond the touchline the picture goes on for longer than the line is seen; a short piece may be anything."""
    scene = paint_scene(markings=(HALFWAY_AND_CIRCLE[0], beside(9.15, last_m)), pan_deg=-16.5)
    gray, circle = measured(scene)
    line = find_halfway(gray, circle, segment(scene, (0, min(16.2, last_m - 2.0)), (0, last_m))[None], CONFIG)
    assert (line is not None) == found
    if line is not None:
        assert line.outside
        assert line.support > 0.7


def test_a_line_that_is_far_fainter_than_the_circle_is_a_streak_of_the_floor() -> None:
    bare, whole = (paint_scene(markings=HALFWAY_AND_CIRCLE[:k]).image.astype(float) for k in (1, 2))
    scene = paint_scene(markings=HALFWAY_AND_CIRCLE)
    _, circle = measured(scene)
    across = segment(scene, (0, -9), (0, 9))[None]
    for share, found in ((0.15, False), (0.6, True)):
        mixed = (bare + share * (whole - bare)).round().astype(np.uint8)
        gray = np.ascontiguousarray(mixed[:, :, 1])
        assert (find_halfway(gray, circle, across, CONFIG) is not None) == found


def test_a_short_piece_of_the_line_is_found_through_the_middle() -> None:
    scene = paint_scene(markings=(HALFWAY_AND_CIRCLE[0], upright(0.0, 5.0), level(7.0, -8.0, 8.0)))
    gray, circle = measured(scene)
    ridges = find_ridges(gray.astype(np.float32), np.full(gray.shape, 255, np.uint8), 1.0, CONFIG.ridges)
    pieces = find_segments_through_middle(ridges.points, ridges.normals, circle, CONFIG.halfway.distance)
    ends = segment(scene, (0, -9), (0, 9))
    lines = [np.cross(np.append(a, 1), np.append(b, 1)) for a, b in pieces]
    off = [np.abs(ends @ line[:2] + line[2]).max() / np.hypot(*line[:2]) for line in lines]
    assert min(off) < 1.5
    line = find_halfway(gray, circle, pieces, CONFIG)
    assert line is not None and np.abs(ends @ line.line[:2] + line.line[2]).max() < 1.0
    assert (
        len(find_segments_through_middle(ridges.points[:0], ridges.normals[:0], circle, CONFIG.halfway.distance)) == 0
    )


def beside(first: float, last: float) -> Distance:
    """The halfway line where y lies between two values."""
    return lambda x, y: (x, (y >= first) & (y <= last))


@pytest.mark.parametrize(("behind_m", "found"), [(-30.0, True), (-12.0, False)])
def test_a_line_that_is_worn_off_inside_the_circle_is_seen_on_both_sides(behind_m: float, found: bool) -> None:
    """On one side alone too little of it is seen to be more than an accident."""
    worn = (HALFWAY_AND_CIRCLE[0], beside(13.0, 30.0), beside(behind_m, -11.8))
    scene = paint_scene(markings=worn)
    gray, circle = measured(scene)
    line = find_halfway(gray, circle, segment(scene, (0.05, 14), (0, 22))[None], CONFIG)
    assert (line is not None) == found
    if line is not None:
        assert line.outside
        ends = segment(scene, (0, -9), (0, 9))
        assert np.abs(ends @ line.line[:2] + line.line[2]).max() < 0.7
