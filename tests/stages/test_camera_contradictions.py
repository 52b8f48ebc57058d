"""Observations of a camera that contradict the others, its noise level, and lines without a name."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera.options import CameraConfig
from circlecal.evaluation.bench.scenarios import KNOWN
from circlecal.geometry.camera_parameters import INDEX
from circlecal.geometry.surface import Surface
from circlecal.observations import Keypoint, LinePoints, MarkingKey, MarkPoint
from circlecal.refusals import REFUSALS
from circlecal.stages import camera
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import aim_camera

from .camera_views import CIRCLE, MAIN, SOCCER, departure, refusal, seen


def test_a_wrong_mark_is_named_and_left_out():
    given = seen(MAIN, edges=("outer", "inner"), mark=True, sigma=0.3)
    right = estimate_camera(given, SOCCER, CIRCLE, KNOWN)
    assert right.rejected == ()
    wrong = replace(given, marks=(MarkPoint("centre_mark", given.marks[0].point_px + np.array([0.0, 60.0]), 0.5),))
    fit = estimate_camera(wrong, SOCCER, CIRCLE, KNOWN)
    assert fit.rejected == (MarkingKey("centre_mark"),)
    assert departure(fit, MAIN, 9.0) < max(8.0, 3 * departure(right, MAIN, 9.0))


@pytest.mark.parametrize("along_px", [-6.0, 6.0])
def test_a_mark_that_bends_the_camera_to_itself_is_left_out(along_px):
    """A foot beside the centre mark: nothing else says how far away the camera stands, and the mark fits at once."""
    camera = aim_camera(np.array([-8.0, 53.2, -15.8]), np.array([2.0, 9.0, 0.0]), 2750.0, 0.03, 1920, 1080, 0.028)
    given = seen(camera, edges=("center",), mark=True, sigma=0.1, surface=Surface("roof", 9.15, 0.05))
    right = estimate_camera(given, SOCCER, CIRCLE, CameraConfig())
    assert right.rejected == ()
    line = given.lines[0].points_px
    along = (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0])
    foot = MarkPoint("centre_mark", given.marks[0].point_px + along_px * along, 0.3)
    fit = estimate_camera(replace(given, marks=(foot,)), SOCCER, CIRCLE, CameraConfig())
    assert fit.rejected == (MarkingKey("centre_mark"),)
    assert departure(fit, camera) < 5.0


def test_a_wrong_keypoint_is_named_and_the_right_ones_kept():
    given = seen(MAIN, edges=("outer", "inner"), sigma=0.3)
    places = {"right one": (9.15, 0.0), "left one": (-9.15, 0.0), "wrong one": (0.0, -9.15)}
    keypoints = tuple(
        Keypoint(name, np.array(at), MAIN.project(np.array(at)) + (40.0 if name == "wrong one" else 0.3), 1.0)
        for name, at in places.items()
    )
    fit = estimate_camera(replace(given, keypoints=keypoints), SOCCER, CIRCLE, KNOWN)
    assert fit.rejected == (MarkingKey("wrong one"),)
    assert departure(fit, MAIN) < 8.0


def test_rotation_about_the_circle_is_free_without_line_and_point():
    for given in (seen(MAIN, line=None), seen(MAIN, line=None, mark=True, edges=("outer", "inner"))):
        refused = refusal(given)
        assert refused.code == "rotation_free"
        assert refused.reason == REFUSALS["rotation_free"].words
    center = Keypoint("centre", np.zeros(2), MAIN.project(np.zeros(2)), 1.0)
    assert refusal(replace(seen(MAIN, line=None), keypoints=(center,))).code == "rotation_free"


def test_no_circle_or_no_ellipse_is_refused():
    refused = refusal(replace(seen(MAIN), circles=()))
    assert refused.code == "no_circle"
    assert "centre_circle" in refused.reason
    few = seen(MAIN)
    points = replace(few.circles[0], points_px=few.circles[0].points_px[:4], sigma_px=few.circles[0].sigma_px[:4])
    assert refusal(replace(few, circles=(points,))).code in {"no_ellipse", "no_camera"}


def test_where_all_that_was_seen_contradicts_itself_nothing_is_estimated(monkeypatch):
    monkeypatch.setattr(camera, "find_contradicting_markings", lambda task, problem, *_: list(problem.curves.keys))
    assert refusal(seen(MAIN)).code == "observations_contradict"


def wavy(camera, amplitude, waves=9, seed=0):
    """Circle points with noise, displaced along the arc by a smooth wave."""
    given = seen(camera, edges=("center",), sigma=0.3, count=240, seed=seed)
    points = given.circles[0]
    angle = np.linspace(0, 2 * np.pi * waves, 240)
    moved = points.points_px + amplitude * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return replace(given, circles=(replace(points, points_px=moved),))


def test_noise_level_follows_the_residuals():
    config = KNOWN.model_copy(update={"noise_from_residuals": True})
    white = estimate_camera(wavy(MAIN, 0.0), SOCCER, CIRCLE, config)
    assert 0.95 < white.noise_scale < 1.6
    wave = estimate_camera(wavy(MAIN, 1.0), SOCCER, CIRCLE, config)
    assert wave.noise_scale > 3.0
    assert wave.max_sigma_px > 2.0 * white.max_sigma_px
    assert wave.residual_correlation > 2.0 > white.residual_correlation
    # stated sigmas are never made smaller
    modest = replace(wavy(MAIN, 0.0).circles[0], sigma_px=np.full(240, 3.0))
    stated = replace(wavy(MAIN, 0.0), circles=(modest,))
    assert estimate_camera(stated, SOCCER, CIRCLE, config).noise_scale >= 1.0
    trusting = estimate_camera(wavy(MAIN, 1.0), SOCCER, CIRCLE, KNOWN)
    assert trusting.noise_scale == 1.0


BROADCAST = aim_camera(np.array([-2.0, 66.0, -18.0]), np.array([-22.0, -6.0, 0.0]), 1500.0, 0.005, 1920, 1080)
NAMING = CameraConfig(k1_mean=0.0, crown_shape="flat")
PENALTY_AREA = ("side_line_top", "big_rect_left_main", "big_rect_left_top", "small_rect_left_main")


def with_nameless(camera, names, seed=3):
    """Circle and halfway line, and further lines without their names."""
    given = seen(camera, edges=("center",), lines=names, sigma=0.3, seed=seed)
    halfway, *others = given.lines
    return replace(given, lines=(halfway, *(replace(line, line=None) for line in others)))


def test_lines_of_a_broadcast_view_get_their_names():
    given = with_nameless(BROADCAST, PENALTY_AREA)
    fit = estimate_camera(given, SOCCER, CIRCLE, NAMING)
    assert set(fit.named_lines) == set(PENALTY_AREA)
    without = estimate_camera(given, SOCCER, CIRCLE, NAMING.model_copy(update={"name_lines": False}))
    assert without.named_lines == ()
    assert fit.max_sigma_px < without.max_sigma_px
    far = np.array([-36.0, -10.0])
    assert departure(fit, BROADCAST, 6.0, far) < 6.0


@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_beside_a_line_under_a_wrong_name_every_line_gets_its_own(slope):
    """The line that is left out, far off or only bending the camera, keeps its number, and so do those behind it."""
    given = with_nameless(BROADCAST, PENALTY_AREA)
    x = np.linspace(300.0, 1500.0, 60)
    stray = LinePoints("side_line_bottom", np.stack([x, 700.0 + slope * (x - 900.0)], axis=-1), np.full(60, 0.3))
    halfway, *others = given.lines
    given = replace(given, lines=(halfway, stray, *others))
    fit = estimate_camera(given, SOCCER, CIRCLE, NAMING)
    assert MarkingKey("side_line_bottom") in fit.rejected
    assert fit.names_by_line == dict(enumerate(PENALTY_AREA, 2))
    again = estimate_camera(given, SOCCER, CIRCLE, NAMING, earlier=fit)
    assert len(again.names_by_line) >= 3
    assert again.names_by_line.items() <= fit.names_by_line.items()
    assert {MarkingKey(name) for name in again.named_lines}.isdisjoint(again.rejected)


def test_a_line_that_is_none_of_the_template_stays_without_a_name():
    """A board, a mowing edge or a shadow aslant over the field."""
    ends = BROADCAST.project(np.array([[-30.0, -18.0], [-12.0, 12.0]]))
    points = ends[0] + np.linspace(0, 1, 60)[:, None] * (ends[1] - ends[0])
    given = seen(BROADCAST, edges=("center",), sigma=0.3)
    given = replace(given, lines=(*given.lines, LinePoints(None, points, np.full(60, 0.3))))
    assert estimate_camera(given, SOCCER, CIRCLE, NAMING).named_lines == ()


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("side_line_left", True),
        ("big_rect_left_main", True),
        ("big_rect_left_top", False),
        ("small_rect_left_main", False),
    ],
)
def test_a_single_line_gets_the_right_name_or_none(line, named):
    """Lines that others of the template could be under another zoom stay without a name."""
    fit = estimate_camera(with_nameless(BROADCAST, (line,)), SOCCER, CIRCLE, NAMING)
    assert fit.named_lines == ((line,) if named else ())


def beside_boards(aim_m, share, pieces):
    """The far part of the circle, the touchline, and the ``pieces`` of edges behind it."""
    camera = aim_camera(np.array([4.7, 60.1, -14.8]), np.array([1.5, aim_m, 0.0]), 3900.0, 0.0, 1920, 1080)
    given = with_nameless(camera, ("side_line_top",))
    arc = given.circles[0]
    far = arc.points_px[:, 1] < np.quantile(arc.points_px[:, 1], share)
    edges = (LinePoints(None, points, np.full(len(points), 0.3)) for points in pieces(camera, given.lines[1].points_px))
    circles = (replace(arc, points_px=arc.points_px[far], sigma_px=arc.sigma_px[far]),)
    return replace(given, circles=circles, lines=(*given.lines, *edges))


def test_lines_that_the_fit_does_not_pass_through_get_no_name():
    """Pieces of an edge far behind the touchline are not the near touchline."""
    rng = np.random.default_rng(5)

    def pieces(camera, _):
        for first, last in ((-10.0, -6.5), (2.0, 4.5), (7.0, 10.5)):
            on_ground = np.stack([np.linspace(first, last, 20), np.full(20, -38.0)], axis=-1)
            yield camera.project(on_ground) + rng.normal(0.0, 1.0, (20, 2))

    fit = estimate_camera(beside_boards(-29.0, 0.2, pieces), SOCCER, CIRCLE, NAMING)
    assert fit.names_by_line == {1: "side_line_top"}


def test_the_touchline_gets_its_name_beside_edges_that_contradict_each_other():
    """Whatever the short pieces above it are taken for, the long line is the touchline."""
    rng = np.random.default_rng(5)
    places = ((175, 495, -51.0, -54.5), (1217, 1439, -52.0, -52.5), (346, 674, -37.0, -37.5), (871, 1118, -52.0, -48.0))

    def pieces(_, touchline):
        along = np.polyfit(*touchline.T, 1)
        for first, last, *above in places:
            x = np.linspace(first, last, 20)
            yield np.stack([x, np.polyval(along, x) + np.linspace(*above, 20) + rng.normal(0.0, 0.5, 20)], axis=-1)

    fit = estimate_camera(beside_boards(-40.0, 0.25, pieces), SOCCER, CIRCLE, NAMING)
    assert fit.names_by_line == {1: "side_line_top"}


def test_nothing_is_named_where_the_camera_is_too_vague():
    """Straight behind the halfway line zoom and distance are all but free, and so is the place of a further line."""
    camera = aim_camera(np.array([0.5, 62.0, -14.0]), np.array([2.0, -10.0, 0.0]), 2000.0, 0.0, 1920, 1080)
    fit = estimate_camera(with_nameless(camera, ("big_rect_right_main",)), SOCCER, CIRCLE, NAMING)
    assert fit.named_lines == ()
    assert fit.max_sigma_px > 30.0


@pytest.mark.parametrize(("kappa", "sigma", "is_held"), [(-0.02, 4.0, True), (-0.02, 2.0, False), (-0.04, 1.0, False)])
def test_an_unusual_lens_is_believed_where_much_speaks_for_it(kappa, sigma, is_held):
    """With little evidence the usual lens holds it back, as it must what uneven ground looks like."""
    camera = aim_camera(np.array([-1.0, 54.5, -13.2]), np.array([-1.0, -2.0, 0.0]), 2000.0, -0.006, 1920, 1080, kappa)
    ground, far = Surface("roof", 9.15, 0.03), ("side_line_top",)
    given = seen(camera, edges=("center",), lines=far, mark=True, sigma=sigma, surface=ground, count=400)
    fit = estimate_camera(given, SOCCER, CIRCLE, CameraConfig(k1_mean=0.03))
    found, sd = fit.theta[INDEX["kappa_1"]], np.sqrt(fit.covariance[INDEX["kappa_1"], INDEX["kappa_1"]])
    assert abs(found - kappa) < 1.5 * sd
    assert (found > kappa + 0.4 * sd) == is_held


def test_any_lens_widens_what_a_frame_leaves_open():
    """A lens unlike the usual one that little speaks for is not believed, but the answer is less certain of its own."""
    camera = aim_camera(np.array([-1.0, 54.5, -13.2]), np.array([-1.0, -2.0, 0.0]), 2000.0, -0.006, 1920, 1080, -0.02)
    given = seen(camera, edges=("center",), lines=("side_line_top",), mark=True, sigma=4.0, count=400)
    kappa = INDEX["kappa_1"]

    def estimate(share):
        fit = estimate_camera(given, SOCCER, CIRCLE, CameraConfig(k1_mean=0.03, other_lens_share=share))
        return fit.theta[kappa], np.sqrt(fit.covariance[kappa, kappa])

    (usual, usual_sd), (_, sd) = estimate(0.0), estimate(0.05)
    assert usual > -0.02 + 1.3 * usual_sd
    assert sd > 1.5 * usual_sd
