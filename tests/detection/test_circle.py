import cv2
import numpy as np
import pytest

from circlecal.detection import circle
from circlecal.detection.circle import (
    LEAST_RMS_PX,
    THINNEST_BAND,
    CircleHypothesis,
    MeasuredCircle,
    check_circle,
    describe_circle,
    find_refusal,
    hide_samples,
    measure_band_width,
    measure_circle,
)
from circlecal.detection.ellipse_batch import EllipseBatch, ellipse_conic
from circlecal.detection.options import AcceptanceConfig, ProfilesConfig
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.ellipses import Ellipse, conic_from_ellipse, ellipse_from_conic
from circlecal.geometry.projective import Array
from circlecal.paint.bands import MeasuredCurve, measure_curve

from .conftest import Scene, paint_scene

GATES = AcceptanceConfig()


def judged(whole: float = 0.95, share: float = 0.95, rms: float = 0.5) -> CircleHypothesis:
    conic = conic_from_ellipse(Ellipse(np.array([500.0, 300.0]), (200.0, 60.0), 0.0))
    return CircleHypothesis(conic, 1.0, whole, share, share, share, rms, np.zeros((0, 2)))


def refusal(circle: CircleHypothesis, has_halfway: bool) -> str | None:
    return find_refusal(check_circle(circle, has_halfway, 1920, GATES))


def test_a_good_circle_needs_no_line() -> None:
    assert refusal(judged(), has_halfway=False) is None


def test_a_short_arc_is_refused_with_and_without_a_line() -> None:
    assert refusal(judged(whole=0.33), has_halfway=True) == "arc_too_short"
    assert refusal(judged(whole=0.39), has_halfway=False) == "arc_too_short"


def test_a_part_without_its_line_must_be_nearly_complete() -> None:
    part = judged(whole=0.5, share=0.8)
    assert refusal(part, has_halfway=False) == "circle_support_too_low"
    assert refusal(part, has_halfway=True) is None


def test_a_whole_circle_with_its_line_may_be_hidden_more() -> None:
    hidden = judged(whole=0.7, share=0.7)
    assert refusal(hidden, has_halfway=False) == "circle_support_too_low"
    assert refusal(hidden, has_halfway=True) is None


def test_scatter_is_judged_by_size_only_for_a_whole_circle_with_a_line() -> None:
    large = 0.5 * (LEAST_RMS_PX + GATES.rms_share * 200.0 * 4)  # between both limits in a picture 480 px wide
    assert find_refusal(check_circle(judged(rms=large), True, 480, GATES)) is None
    assert find_refusal(check_circle(judged(rms=large), False, 480, GATES)) == "circle_off_marking"
    assert find_refusal(check_circle(judged(rms=20.0), True, 480, GATES)) == "circle_off_marking"


def test_every_gate_tells_value_and_limit() -> None:
    checks = {check.name: check for check in check_circle(judged(whole=0.33), True, 1920, GATES)}
    assert (checks["whole_share"].value, checks["whole_share"].passed) == (0.33, False)
    assert checks["whole_share"].limit == GATES.whole_share_with_line
    assert checks["painted_share"].passed and checks["marking_rms_px"].passed


@pytest.fixture(scope="module")
def scene() -> Scene:
    return paint_scene(noise=1.5)


def start(scene: Scene, shift: float) -> EllipseBatch:
    ellipse = ellipse_from_conic(scene.conic)
    assert ellipse is not None
    frame = ellipse.frame()
    return EllipseBatch(frame[None, :2, 2] + shift, frame[None, :2, 0] * 1.01, frame[None, :2, 1])


def test_measurement_finds_the_paint_from_a_rough_start(scene: Scene) -> None:
    gray = scene.image[:, :, 1].copy()
    circle = measure_circle(gray, start(scene, 1.5), 1.0, ProfilesConfig())
    assert abs(circle.angle_share.sum() - 1.0) < 1e-9
    assert np.abs(sampson_distance(scene.conic, circle.curve.marking_points)).mean() < 0.12
    assert np.abs(sampson_distance(ellipse_conic(circle.ellipse), scene.circle_points())).mean() < 0.12
    hypothesis = describe_circle(circle, 1.0, 960)
    assert hypothesis.whole_share > 0.93
    assert hypothesis.rms_px < 0.5


def test_a_dark_marking_is_measured_as_such_only(scene: Scene) -> None:
    gray = 255 - scene.image[:, :, 1]
    light, dark = (measure_circle(gray, start(scene, 1.0), sign, ProfilesConfig()) for sign in (1.0, -1.0))
    assert light.angle_share[light.curve.supported].sum() < 0.3
    assert dark.angle_share[dark.curve.supported].sum() > 0.9


def test_paint_that_is_widest_near_the_camera_is_no_drawn_ring() -> None:
    """A robot sees the near part of its circle several times as wide as the far one, and wider than the sides."""
    turn = np.linspace(0.0, 2 * np.pi, 400, endpoint=False)
    ellipse = EllipseBatch(np.array([[960.0, 600.0]]), np.array([[540.0, 0.0]]), np.array([[0.0, 380.0]]))
    outward = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    points = np.array([960.0, 600.0]) + outward * (540.0, 380.0)
    normals = outward / (540.0, 380.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lowness = np.sin(turn)

    def band_width(width: Array) -> float | None:
        seen = np.ones(len(turn), np.bool_)
        curve = MeasuredCurve(points, normals, np.zeros(len(turn)), np.full(len(turn), 90.0), width, seen, seen)
        return measure_band_width(MeasuredCircle(ellipse, np.full(len(turn), 1 / len(turn)), curve, 1.0))

    from_near = band_width(np.where(lowness > 0, 34.0 + 12.0 * lowness, 34.0 + 20.0 * lowness))
    assert from_near is not None
    assert from_near > 5 * THINNEST_BAND
    rng = np.random.default_rng(0)
    drawn = [band_width(10.0 + rng.normal(0.0, 0.1, len(turn)) + bend * lowness) for bend in (0.0, 0.5)]
    assert all(width is not None and width < THINNEST_BAND for width in drawn)


def test_paint_on_the_field_is_wider_at_the_sides_than_a_drawn_ring() -> None:
    scene = paint_scene(width=1920, height=1080, noise=1.5)
    gray = scene.image[:, :, 1].copy()
    painted = describe_circle(measure_circle(gray, start(scene, 0.5), 1.0, ProfilesConfig()), 1.0, 1920)
    assert painted.band_width is not None
    assert 0.009 < painted.band_width < 0.017
    ellipse = ellipse_from_conic(scene.conic)
    assert ellipse is not None
    drawn = np.full_like(gray, 120)
    outline = np.rint(ellipse.points(np.linspace(0, 2 * np.pi, 721)) * 16).astype(np.int32)
    cv2.polylines(drawn, [outline], True, 220, 6, cv2.LINE_AA, 4)
    ring = describe_circle(measure_circle(drawn, start(scene, 0.5), 1.0, ProfilesConfig()), 1.0, 1920)
    assert ring.band_width is not None
    assert ring.band_width < THINNEST_BAND
    assert refusal(ring, has_halfway=True) == "width_unlike_marking"


@pytest.mark.parametrize(("is_painted", "rounds"), [(False, 1), (True, 2)])
def test_only_an_ellipse_along_which_something_is_painted_gets_a_second_round(is_painted, rounds, monkeypatch) -> None:
    picture = np.random.default_rng(1).normal(110, 3, (540, 960))
    if is_painted:
        cv2.ellipse(picture, (480, 270), (200, 70), 0, 0, 360, 220, 3, cv2.LINE_AA)
    ellipse = EllipseBatch(np.array([[480.0, 270.0]]), np.array([[200.0, 0.0]]), np.array([[0.0, 70.0]]))
    measured = []
    monkeypatch.setattr(circle, "measure_curve", lambda *given: (measured.append(1), measure_curve(*given))[1])
    found = measure_circle(picture.clip(0, 255).astype(np.uint8), ellipse, 1.0, ProfilesConfig())
    assert len(measured) == rounds
    assert (found.seen_share > 0.9) is is_painted


def test_what_graphics_cover_is_not_missed(scene: Scene) -> None:
    """Half of the circle lies under a band of graphics; of what is left all is painted."""
    gray = scene.image[:, :, 1].copy()
    circle = measure_circle(gray, start(scene, 0.0), 1.0, ProfilesConfig())
    covered = np.zeros(gray.shape, dtype=np.bool_)
    covered[: int(circle.ellipse.centers[0, 1])] = True
    half = hide_samples(circle, covered)
    assert hide_samples(circle, None) is circle
    assert np.count_nonzero(half.curve.inside) == pytest.approx(0.5 * np.count_nonzero(circle.curve.inside), rel=0.1)
    described = describe_circle(half, 1.0, gray.shape[1])
    assert described.picture_share > 0.9
    assert described.sector_share > 0.9
    assert described.whole_share == pytest.approx(0.5, abs=0.1)
