"""The maximum a posteriori camera: exact without noise, efficient with it, honest about its error."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.bench.accuracy import mahalanobis, truth_grid
from circlecal.bench.bounds import bound_covariance, bound_errors
from circlecal.bench.scenarios import KNOWN, Draw, chosen_rows
from circlecal.camera_fit.config import CameraConfig, priors_of
from circlecal.camera_fit.model import INDEX, PARAMETERS, Frame, theta_of
from circlecal.errors import EstimationError
from circlecal.field import load_field
from circlecal.geometry.homography import SIDES, transfer_errors
from circlecal.observations import CirclePoints, Keypoint, LinePoints, MarkPoint, Observations
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import aimed_camera
from circlecal.synthetic.markings import circle_points, line_points, mark_point
from circlecal.synthetic.surface import Surface

SOCCER = load_field("soccer")
CIRCLE = SOCCER.circle_by_name["centre_circle"]
HOCKEY = load_field("ice-hockey")
EXACT = KNOWN.model_copy(update={"distance_log_sd": None, "elevation_sd_deg": None, "roll_sd_deg": 1e6})
"""Lens, principal point and surface known, and no opinion on the camera's place."""
MAIN = aimed_camera(np.array([5.0, 60.0, -16.0]), np.array([0.8, 0.5, 0.0]), 3600.0, 0.01, 1920, 1080)
WIDE = aimed_camera(np.array([-4.0, 62.0, -17.0]), np.array([-14.0, -8.0, 0.0]), 1700.0, 0.01, 1920, 1080)


def seen(camera, *, edges=("outer",), line="halfway_line", lines=(), mark=False, sigma=0.0, seed=0, count=200,
         circles=("centre_circle",), template=SOCCER, surface=None):  # fmt: skip
    """Observations of a camera; ``line=None`` for the circle alone. Without noise 0.3 px are stated."""
    rng = np.random.default_rng(seed)
    kind = {} if surface is None else {"surface": surface}

    def stated(points):
        return points if sigma else replace(points, sigma_px=np.full(len(points.points_px), 0.3))

    rims = [circle_points(camera, template, e, count, sigma, rng, circle=c, **kind) for c in circles for e in edges]
    names = (*(() if line is None else (line,)), *lines)
    straight = [line_points(camera, template, name, 60, sigma, rng, **kind) for name in names]
    spot = mark_point(camera, template, "centre_mark", sigma, rng, **kind) if mark else None
    return Observations(
        camera.width,
        camera.height,
        tuple(map(stated, rims)),
        tuple(map(stated, straight)),
        () if spot is None else (replace(spot, sigma_px=max(sigma, 0.3)),),
    )


def departure(fit, camera, reach_m=12.0, center=(0.0, 0.0)):
    """Largest error (px) of the homography about the circle."""
    field = np.random.default_rng(0).uniform(-reach_m, reach_m, (80, 2)) + center
    return float(transfer_errors(fit.H_image_field, field, camera.project(field, distort=False)).max())


def refusal(observations, config=KNOWN, circle=CIRCLE, template=SOCCER):
    with pytest.raises(EstimationError) as refused:
        estimate_camera(observations, template, circle, config)
    assert refused.value.stage == "camera"
    return refused.value


# -- without noise -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "given",
    [
        {"edges": ("outer", "inner")},
        {"edges": ("outer",)},
        {"edges": ("inner",)},
        {"edges": ("center",)},
        {"mark": True},
        {"edges": ("outer", "inner"), "mark": True},
    ],
    ids=lambda given: "+".join(map(str, given.get("edges", ("outer",)))) + ("+mark" if "mark" in given else ""),
)
def test_circle_and_halfway_line_are_exact(given):
    fit = estimate_camera(seen(MAIN, **given), SOCCER, CIRCLE, EXACT)
    assert departure(fit, MAIN) < 1e-6
    np.testing.assert_allclose(fit.camera.position_m, MAIN.position_m, atol=1e-5)
    assert fit.rejected == ()
    assert np.linalg.norm(fit.H_field_image @ fit.H_image_field / np.trace(fit.H_field_image @ fit.H_image_field) * 3
                          - np.eye(3)) < 1e-9  # fmt: skip


@pytest.mark.parametrize("mark", [True, False])
def test_circle_and_touchline_are_exact(mark):
    fit = estimate_camera(seen(WIDE, line="side_line_top", mark=mark), SOCCER, CIRCLE, EXACT)
    assert departure(fit, WIDE) < 1e-6


def test_circle_centre_mark_and_a_line_beside_it_are_exact():
    fit = estimate_camera(seen(WIDE, line="big_rect_left_main", mark=True), SOCCER, CIRCLE, EXACT)
    assert departure(fit, WIDE) < 1e-6


def test_circle_and_keypoints_are_exact():
    given = seen(WIDE, line=None)
    corner = np.array([-36.0, -20.0])
    given = replace(given, keypoints=(Keypoint("corner", corner, WIDE.project(corner), 0.3),))
    assert departure(estimate_camera(given, SOCCER, CIRCLE, EXACT), WIDE) < 1e-6


def test_two_circles_of_a_rink_are_exact():
    names = ("faceoff_left_top", "faceoff_left_bottom")
    circle = HOCKEY.circle_by_name[names[0]]
    camera = aimed_camera(np.array([-12.0, 42.0, -14.0]), np.array([-20.0, 0.5, 0.0]), 2200.0, 0.01, 1920, 1080)
    given = seen(camera, line=None, circles=names, template=HOCKEY, count=60)
    fit = estimate_camera(given, HOCKEY, circle, EXACT)
    assert departure(fit, camera, 8.0, (-20.0, 0.0)) < 1e-6


def test_circle_and_known_position_without_a_line_are_exact():
    config = KNOWN.model_copy(update={"position_m": tuple(MAIN.position_m), "roll_sd_deg": 1e6})
    fit = estimate_camera(seen(MAIN, line=None), SOCCER, CIRCLE, config)
    assert departure(fit, MAIN) < 1e-6


def test_arc_and_penalty_line_are_exact():
    arc = SOCCER.circle_by_name["penalty_arc_left"]
    camera = aimed_camera(np.array([-8.0, 55.0, -16.0]), np.array([-40.0, 0.0, 0.0]), 1800.0, 0.01, 1920, 1080)
    angle = np.radians(np.linspace(arc.start_deg, arc.end_deg, 120))
    field = np.asarray(arc.center) + arc.radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    given = seen(camera, line=None, lines=("big_rect_left_main",), circles=("penalty_arc_left",))
    points = replace(given.circles[0], points_px=camera.project(field), sigma_px=np.full(120, 0.3))
    fit = estimate_camera(replace(given, circles=(points,)), SOCCER, arc, EXACT)
    assert departure(fit, camera, 8.0, (-36.0, 0.0)) < 1e-6


@pytest.mark.parametrize("shape", ["parabola", "roof"])
def test_lens_crown_and_principal_point_at_their_prior_means_are_exact(shape):
    camera = replace(MAIN, kappa=np.array([0.03, 0.0]))
    config = EXACT.model_copy(
        update={"distortion": "radial", "k1_mean": 0.03, "crown_shape": shape, "crown_m": 0.06, "crown_sd_m": 0.03,
                "principal_point_sd_px": 5.0}
    )  # fmt: skip
    fit = estimate_camera(seen(camera, mark=True, surface=Surface(0.06, shape)), SOCCER, CIRCLE, config)
    assert departure(fit, camera) < 1e-5
    assert fit.crown_m == pytest.approx(0.06, abs=1e-5)
    assert fit.crown_shape == shape
    assert fit.camera.kappa[0] == pytest.approx(0.03, abs=1e-6)


def test_a_crown_that_is_not_modelled_is_seen_in_the_residuals():
    given = seen(MAIN, surface=Surface(0.09, "roof"), edges=("center",))
    flat = estimate_camera(given, SOCCER, CIRCLE, EXACT)
    roof = estimate_camera(given, SOCCER, CIRCLE, EXACT.model_copy(update={"crown_shape": "roof", "crown_sd_m": 0.3}))
    assert roof.crown_m == pytest.approx(0.09, abs=2e-3)
    assert flat.residuals_px["centre_circle center"] > 10 * roof.residuals_px["centre_circle center"]


@pytest.mark.parametrize("shape", ["roof", "parabola"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_profile_of_the_pitch_is_told_by_the_frame(shape, seed):
    surface = Surface(0.06, shape)
    given = seen(WIDE, edges=("center",), mark=True, lines=("side_line_top",), sigma=0.2, seed=seed, surface=surface)
    fit = estimate_camera(given, SOCCER, CIRCLE, CameraConfig(k1_mean=0.0, k1_sd=0.005))
    assert fit.crown_shape == shape
    assert fit.crown_m == pytest.approx(0.06, abs=0.02)


def test_a_profile_that_makes_no_difference_is_a_roof():
    fit = estimate_camera(seen(MAIN, sigma=0.5), SOCCER, CIRCLE, CameraConfig(k1_mean=0.0, crown_m=0.0))
    assert fit.crown_shape == "roof"


@pytest.mark.parametrize(("kappa", "sigma"), [(-0.06, 1.0), (0.12, 0.3)])
def test_a_lens_unlike_others_is_told_by_the_frame(kappa, sigma):
    bent = replace(WIDE, kappa=np.array([kappa, 0.0]))
    given = seen(bent, edges=("center",), mark=True, sigma=sigma)
    fit = estimate_camera(given, SOCCER, CIRCLE, CameraConfig(crown_m=0.0))
    assert fit.camera.kappa[0] == pytest.approx(kappa, abs=0.02)
    usual = seen(replace(WIDE, kappa=np.array([0.03, 0.0])), edges=("center",), mark=True, sigma=sigma)
    fit = estimate_camera(usual, SOCCER, CIRCLE, CameraConfig(crown_m=0.0))
    assert fit.covariance[INDEX["kappa_1"], INDEX["kappa_1"]] < 0.015**2


@pytest.mark.parametrize("side", sorted(SIDES))
def test_cameras_on_every_side(side):
    toward = np.array(SIDES[side])
    position = np.r_[58.0 * toward + 4.0 * toward[::-1], -15.0]
    camera = aimed_camera(position, np.array([0.5, 0.5, 0.0]), 3000.0, 0.01, 1920, 1080)
    fit = estimate_camera(seen(camera, line="halfway_line"), SOCCER, CIRCLE, EXACT, side)
    assert departure(fit, camera) < 1e-6
    opposite = next(s for s, d in SIDES.items() if np.allclose(d, -toward))
    other = estimate_camera(seen(camera), SOCCER, CIRCLE, EXACT, opposite)
    # the field turned by 180 degrees, and the truth among the alternatives
    np.testing.assert_allclose(other.camera.position_m[:2], -position[:2], atol=1e-4)
    ((alternative, score),) = other.alternatives
    np.testing.assert_allclose(alternative.position_m, position, atol=1e-4)
    assert score == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_never_upside_down_and_never_mirrored(seed):
    rng = np.random.default_rng(seed)
    (scenario,) = chosen_rows(["8a" if seed % 2 else "7"])
    draw = scenario.draw(rng)
    fit = estimate_camera(draw.observations, scenario.template, scenario.circle, draw.config)
    assert fit.camera.position_m[2] < 0
    assert 0 < fit.camera.angles_rad[1] < np.pi
    assert abs(fit.camera.angles_rad[2]) < np.pi / 2
    assert np.linalg.det(fit.H_image_field) > 0
    assert fit.camera.position_m[1] > 0


# -- with noise --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pooled():
    """Errors over bounds, and draws inside the 90 % regions, of several rows of the benchmark: 48 draws in all."""
    ratios, inside = [], {}
    for name in ("5", "6", "17"):
        scenario = next(s for s in chosen_rows([name]) if s.row == name)
        for index in range(16):
            rng = np.random.default_rng([11, index])
            draw = scenario.draw(rng)
            grid = truth_grid(draw, scenario.template)
            fit = estimate_camera(draw.observations, scenario.template, scenario.circle, draw.config)
            bound = bound_errors(draw.camera, bound_of(draw, scenario), grid, 200, rng).mean()
            error = transfer_errors(fit.H_image_field, grid, draw.camera.project(grid)).mean()
            ratios.append(error / bound)
            for quantity, held in mahalanobis(draw, fit, scenario.circle).items():
                inside.setdefault(quantity, []).append(held)
    return np.array(ratios), inside


def bound_of(draw: Draw, scenario):
    return bound_covariance(draw.camera, 0.0, draw.observations, scenario.template, scenario.circle, draw.config)


def test_error_is_that_of_the_bound_from_both_sides(pooled):
    """Clearly better than the bound would be a bug, too: of the noise, of the bound, or of the truth that leaks in."""
    ratios, _ = pooled
    assert 0.85 < ratios.mean() < 1.15
    # nor by a few good and many bad draws
    assert 0.6 < np.median(ratios) < 1.1


def test_parameters_scatter_as_their_covariance_says():
    """Twenty noises on one view: chi-square of seven degrees of freedom each, so their mean is 7 +- 0.85."""
    truth = theta_of(WIDE, Frame(WIDE.width, WIDE.height, "flat"))[:7]
    distances, errors = [], []
    for seed in range(20):
        given = seen(WIDE, lines=("side_line_top", "big_rect_left_main"), mark=True, sigma=0.3, seed=seed, count=80)
        fit = estimate_camera(given, SOCCER, CIRCLE, EXACT)
        scale = np.sqrt(np.diag(fit.covariance)[:7])
        error = (fit.theta[:7] - truth) / scale
        distances.append(error @ np.linalg.solve(fit.covariance[:7, :7] / np.outer(scale, scale), error))
        errors.append(error)
    assert 4.6 < np.mean(distances) < 9.6
    assert (np.abs(np.mean(errors, axis=0)) < 0.8).all()


def test_ninety_percent_regions_hold_about_ninety_percent(pooled):
    _, inside = pooled
    assert {"homography", "imaged centre", "position", "point right", "point top_left"} <= set(inside)
    for quantity in ("homography", "imaged centre", "position"):
        assert 0.80 <= np.mean(inside[quantity]) <= 0.99, quantity
    points = [np.mean(held) for quantity, held in inside.items() if quantity.startswith("point ")]
    assert len(points) == 8
    assert 0.82 <= np.mean(points) <= 0.97


def test_reported_sigma_grows_with_the_noise_and_falls_with_the_number_of_points():
    def sigma(noise, count):
        given = seen(MAIN, edges=("outer", "inner"), sigma=noise, count=count)
        return estimate_camera(given, SOCCER, CIRCLE, EXACT).max_sigma_px

    base = sigma(0.3, 100)
    assert 1.6 < sigma(0.6, 100) / base < 2.4
    assert 0.4 < sigma(0.3, 400) / base < 0.75


def test_known_position_helps():
    plain = estimate_camera(seen(MAIN, sigma=0.5), SOCCER, CIRCLE, KNOWN)
    told = KNOWN.model_copy(update={"position_m": tuple(MAIN.position_m), "position_sd_m": (0.1, 0.1, 0.1)})
    better = estimate_camera(seen(MAIN, sigma=0.5), SOCCER, CIRCLE, told)
    assert better.max_sigma_px < 0.7 * plain.max_sigma_px
    assert better.data_share < plain.data_share


def test_few_and_noisy_points_are_prior_dominated():
    certain = estimate_camera(seen(MAIN, edges=("outer", "inner"), mark=True, sigma=0.3), SOCCER, CIRCLE, KNOWN)
    assert certain.data_share > 0.8
    assert not certain.prior_dominated
    vague = estimate_camera(seen(MAIN, sigma=15.0, count=10), SOCCER, CIRCLE, KNOWN)
    assert vague.data_share < 0.5
    assert vague.prior_dominated


# -- contradictions, noise level, names --------------------------------------------------------------------------


def test_a_wrong_mark_is_named_and_left_out():
    given = seen(MAIN, edges=("outer", "inner"), mark=True, sigma=0.3)
    right = estimate_camera(given, SOCCER, CIRCLE, KNOWN)
    assert right.rejected == ()
    wrong = replace(given, marks=(MarkPoint("centre_mark", given.marks[0].point_px + np.array([0.0, 60.0]), 0.5),))
    fit = estimate_camera(wrong, SOCCER, CIRCLE, KNOWN)
    assert fit.rejected == ("centre_mark",)
    assert departure(fit, MAIN, 9.0) < max(8.0, 3 * departure(right, MAIN, 9.0))


def test_a_wrong_keypoint_is_named_and_the_right_ones_kept():
    given = seen(MAIN, edges=("outer", "inner"), sigma=0.3)
    places = {"right one": (9.15, 0.0), "left one": (-9.15, 0.0), "wrong one": (0.0, -9.15)}
    keypoints = tuple(
        Keypoint(name, np.array(at), MAIN.project(np.array(at)) + (40.0 if name == "wrong one" else 0.3), 1.0)
        for name, at in places.items()
    )
    fit = estimate_camera(replace(given, keypoints=keypoints), SOCCER, CIRCLE, KNOWN)
    assert fit.rejected == ("wrong one",)
    assert departure(fit, MAIN) < 8.0


def test_rotation_about_the_circle_is_free_without_line_and_point():
    for given in (seen(MAIN, line=None), seen(MAIN, line=None, mark=True, edges=("outer", "inner"))):
        refused = refusal(given)
        assert refused.code == "rotation_free"
        assert refused.reason == "rotation about the circle is free: show a line or a point"
    center = Keypoint("centre", np.zeros(2), MAIN.project(np.zeros(2)), 1.0)
    assert refusal(replace(seen(MAIN, line=None), keypoints=(center,))).code == "rotation_free"


def test_no_circle_or_no_ellipse_is_refused():
    refused = refusal(replace(seen(MAIN), circles=()))
    assert refused.code == "no_circle"
    assert "centre_circle" in refused.reason
    few = seen(MAIN)
    points = replace(few.circles[0], points_px=few.circles[0].points_px[:4], sigma_px=few.circles[0].sigma_px[:4])
    assert refusal(replace(few, circles=(points,))).code in {"no_ellipse", "no_camera"}


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


BROADCAST = aimed_camera(np.array([-2.0, 66.0, -18.0]), np.array([-22.0, -6.0, 0.0]), 1500.0, 0.005, 1920, 1080)
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
    camera = aimed_camera(np.array([4.7, 60.1, -14.8]), np.array([1.5, aim_m, 0.0]), 3900.0, 0.0, 1920, 1080)
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
    camera = aimed_camera(np.array([0.5, 62.0, -14.0]), np.array([2.0, -10.0, 0.0]), 2000.0, 0.0, 1920, 1080)
    fit = estimate_camera(with_nameless(camera, ("big_rect_right_main",)), SOCCER, CIRCLE, NAMING)
    assert fit.named_lines == ()
    assert fit.max_sigma_px > 30.0


# -- configuration -----------------------------------------------------------------------------------------------


def test_priors_scale_with_the_picture_and_can_be_fixed():
    frame = Frame(960, 540, "flat")
    priors = priors_of(CameraConfig(principal_point_sd_px=8.0, crown_shape="flat"), SOCCER, CIRCLE, frame)
    assert priors.sd[INDEX["pp_x"]] == pytest.approx(4.0)
    assert priors.sd[INDEX["crown"]] == 0.0
    assert priors.sd[INDEX["log_aspect"]] == 0.0
    assert np.isinf(priors.sd[INDEX["log_focal"]])
    assert priors.distance_m == pytest.approx(7 * 9.15)
    known = priors_of(CameraConfig(position_m=(1.0, 2.0, -3.0)), SOCCER, CIRCLE, frame)
    np.testing.assert_allclose(known.mean[4:7], [1.0, 2.0, -3.0])
    assert np.isinf(known.distance_log_sd)
    assert np.isinf(known.elevation_sd_rad)


def test_non_square_pixels():
    """Old PAL video: the stored picture is wider or narrower than what the camera saw."""
    camera = replace(MAIN, focal_px=MAIN.focal_px * [1.0, 1.1])
    given = seen(camera, edges=("outer", "inner"), mark=True)
    fit = estimate_camera(given, SOCCER, CIRCLE, EXACT.model_copy(update={"aspect": 1.1}))
    assert departure(fit, camera) < 1e-6
    free = estimate_camera(given, SOCCER, CIRCLE, EXACT.model_copy(update={"aspect_sd": 1e3}))
    assert free.camera.focal_px[1] / free.camera.focal_px[0] == pytest.approx(1.1, abs=1e-3)


def test_covariance_is_in_the_order_of_its_parameters():
    fit = estimate_camera(seen(MAIN, sigma=0.5), SOCCER, CIRCLE, KNOWN)
    assert fit.parameters == PARAMETERS
    fixed = [INDEX[name] for name in ("pp_x", "kappa_1", "crown", "width", "bloom")]
    assert (np.diag(fit.covariance)[fixed] == 0).all()
    assert (np.diag(fit.covariance)[:7] > 0).all()
    np.testing.assert_allclose(fit.covariance, fit.covariance.T, rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(fit.H_image_field.ravel()[8], 1.0)
    assert [p.label for p in fit.derived_points][:3] == ["right", "bottom_right", "bottom"]


# -- without the circle ------------------------------------------------------------------------------------------

BOX = aimed_camera(np.array([3.0, 62.0, -17.0]), np.array([-40.0, -4.0, 0.0]), 1900.0, 0.01, 1920, 1080)
BOX_LINES = ("big_rect_left_main", "big_rect_left_top", "side_line_left", "small_rect_left_main")


def corners(camera, *places, sigma=0.3):
    return tuple(Keypoint(f"corner {k}", np.array(p), camera.project(np.array(p)), sigma) for k, p in enumerate(places))


def box_departure(fit, camera):
    return departure(fit, camera, 10.0, (-42.0, -4.0))


@pytest.mark.parametrize(
    ("lines", "places"),
    [
        (BOX_LINES, ()),
        (BOX_LINES[:2], ((-36.0, 20.16), (-47.0, 9.16))),
        ((), ((-36.0, -20.16), (-36.0, 20.16), (-47.0, 9.16), (-52.5, -9.16))),
    ],
    ids=["lines", "lines and points", "points"],
)
def test_lines_and_points_without_the_circle_are_exact(lines, places):
    given = replace(seen(BOX, line=None, circles=(), lines=lines), keypoints=corners(BOX, *places))
    fit = estimate_camera(given, SOCCER, CIRCLE, EXACT)
    assert box_departure(fit, BOX) < 1e-6
    # judged about the penalty area, not about the circle
    assert np.linalg.norm(fit.reference_m - [-44.0, -10.0]) < 15
    assert 0 < fit.max_sigma_px < 20


def test_a_camera_behind_the_goal_needs_no_side():
    camera = aimed_camera(np.array([-75.0, -6.0, -14.0]), np.array([-44.0, 0.0, 0.0]), 1600.0, 0.01, 1920, 1080)
    given = seen(camera, line=None, circles=(), lines=BOX_LINES)
    assert box_departure(estimate_camera(given, SOCCER, CIRCLE, EXACT), camera) < 1e-6


def test_penalty_arc_and_one_line_with_a_known_position():
    arc = SOCCER.circle_by_name["penalty_arc_left"]
    angle = np.radians(np.linspace(arc.start_deg, arc.end_deg, 60))
    field = np.asarray(arc.center) + SOCCER.radius(arc, "outer") * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    given = seen(BOX, line=None, circles=(), lines=("big_rect_left_main",))
    part = CirclePoints("penalty_arc_left", "outer", BOX.project(field), np.full(60, 0.3))
    config = EXACT.model_copy(update={"position_m": tuple(BOX.position_m)})
    fit = estimate_camera(replace(given, circles=(part,)), SOCCER, CIRCLE, config)
    assert box_departure(fit, BOX) < 1e-3


def test_wrong_points_and_lines_are_named_and_left_out():
    places = ((-36.0, 20.16), (-47.0, 9.16), (-36.0, -20.16), (-41.5, 0.0))
    lines = (*BOX_LINES, "side_line_top", "small_rect_left_top")
    good = replace(seen(BOX, line=None, circles=(), lines=lines), keypoints=corners(BOX, *places))
    bad = replace(good.keypoints[1], point_px=good.keypoints[1].point_px + np.array([40.0, -25.0]))
    top = next(line for line in good.lines if line.line == "big_rect_left_top")
    given = replace(
        good,
        keypoints=(good.keypoints[0], bad, *good.keypoints[2:]),
        lines=tuple(
            replace(top, points_px=top.points_px + np.array([0.0, 60.0])) if s is top else s for s in good.lines
        ),
    )
    fit = estimate_camera(given, SOCCER, CIRCLE, EXACT)
    assert set(fit.rejected) == {"corner 1", "big_rect_left_top"}
    assert not {"corner 1", "big_rect_left_top"} & set(fit.residuals_px)
    assert box_departure(fit, BOX) < 1e-6


@pytest.mark.parametrize(
    ("lines", "places", "config"),
    [((), (), EXACT), (BOX_LINES[:3], (), EXACT), ((), ((-36.0, 20.16),), EXACT.model_copy(
        update={"position_m": (0.0, 60.0, -15.0)}))],
    ids=["nothing", "three lines", "one point"],
)  # fmt: skip
def test_too_little_beside_no_circle_is_refused(lines, places, config):
    given = replace(seen(BOX, line=None, circles=(), lines=lines), keypoints=corners(BOX, *places))
    refused = refusal(given, config)
    assert refused.code == "no_circle"
    assert f"{len(lines) + len(places)} points and named lines" in refused.reason
