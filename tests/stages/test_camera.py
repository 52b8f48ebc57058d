"""The maximum a posteriori camera without noise: exact, in every view and with every prior."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera.field_evidence import log_evidence
from circlecal.camera.options import CameraConfig, priors_of, usual_kappa
from circlecal.camera.problem import evaluate, with_priors
from circlecal.camera.residuals import ground_feet
from circlecal.camera.world import USUAL
from circlecal.estimation.completion import strongest_barrel
from circlecal.estimation.task import Task
from circlecal.evaluation.bench.scenarios import KNOWN, select_rows
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel, project, theta_of
from circlecal.geometry.homography import SIDES
from circlecal.geometry.surface import Surface
from circlecal.observations import Keypoint, MarkingKey
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import aim_camera

from .camera_views import CIRCLE, EXACT, HOCKEY, MAIN, SOCCER, WIDE, departure, seen


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
    camera = aim_camera(np.array([-12.0, 42.0, -14.0]), np.array([-20.0, 0.5, 0.0]), 2200.0, 0.01, 1920, 1080)
    given = seen(camera, line=None, circles=names, template=HOCKEY, count=60)
    fit = estimate_camera(given, HOCKEY, circle, EXACT)
    assert departure(fit, camera, 8.0, (-20.0, 0.0)) < 1e-6


def test_circle_and_known_position_without_a_line_are_exact():
    config = KNOWN.model_copy(update={"position_m": tuple(MAIN.position_m), "roll_sd_deg": 1e6})
    fit = estimate_camera(seen(MAIN, line=None), SOCCER, CIRCLE, config)
    assert departure(fit, MAIN) < 1e-6


def test_arc_and_penalty_line_are_exact():
    arc = SOCCER.circle_by_name["penalty_arc_left"]
    camera = aim_camera(np.array([-8.0, 55.0, -16.0]), np.array([-40.0, 0.0, 0.0]), 1800.0, 0.01, 1920, 1080)
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
    fit = estimate_camera(seen(camera, mark=True, surface=Surface(shape, crown_m=0.06)), SOCCER, CIRCLE, config)
    assert departure(fit, camera) < 1e-5
    assert fit.surface.crown_m == pytest.approx(0.06, abs=1e-5)
    assert fit.surface.shape == shape
    assert fit.camera.kappa[0] == pytest.approx(0.03, abs=1e-6)


def test_a_crown_that_is_not_modelled_is_seen_in_the_residuals():
    given = seen(MAIN, surface=Surface("roof", crown_m=0.09), edges=("center",))
    flat = estimate_camera(given, SOCCER, CIRCLE, EXACT)
    roof = estimate_camera(given, SOCCER, CIRCLE, EXACT.model_copy(update={"crown_shape": "roof", "crown_sd_m": 0.3}))
    assert roof.surface.crown_m == pytest.approx(0.09, abs=2e-3)
    paint = MarkingKey("centre_circle", "center")
    assert flat.residuals_px[paint] > 10 * roof.residuals_px[paint]


@pytest.mark.parametrize("shape", ["roof", "parabola"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_profile_of_the_pitch_is_told_by_the_frame(shape, seed):
    surface = Surface(shape, crown_m=0.06)
    given = seen(WIDE, edges=("center",), mark=True, lines=("side_line_top",), sigma=0.2, seed=seed, surface=surface)
    fit = estimate_camera(given, SOCCER, CIRCLE, CameraConfig(k1_mean=0.0, k1_sd=0.005))
    assert fit.surface.shape == shape
    assert fit.surface.crown_m == pytest.approx(0.06, abs=0.02)


def test_a_profile_that_makes_no_difference_is_a_roof():
    fit = estimate_camera(seen(MAIN, sigma=0.5), SOCCER, CIRCLE, CameraConfig(k1_mean=0.0, crown_m=0.0))
    assert fit.surface.shape == "roof"


@pytest.mark.parametrize(("kappa", "sigma"), [(-0.06, 1.0), (0.12, 0.3)])
def test_a_lens_unlike_others_is_told_by_the_frame(kappa, sigma):
    bent = replace(WIDE, kappa=np.array([kappa, 0.0]))
    given = seen(bent, edges=("center",), mark=True, sigma=sigma)
    fit = estimate_camera(given, SOCCER, CIRCLE, CameraConfig(crown_m=0.0))
    assert fit.camera.kappa[0] == pytest.approx(kappa, abs=0.02)
    lens = np.array([usual_kappa(CameraConfig(), WIDE.focal_px[0] / WIDE.width), 0.0])
    usual = seen(replace(WIDE, kappa=lens), edges=("center",), mark=True, sigma=sigma)
    fit = estimate_camera(usual, SOCCER, CIRCLE, CameraConfig(crown_m=0.0))
    assert fit.covariance[INDEX["kappa_1"], INDEX["kappa_1"]] < 0.015**2


def test_a_lens_is_told_by_what_would_be_noise_without_it():
    bent = replace(MAIN, kappa=np.array([-0.1, 0.0]))
    fit = estimate_camera(seen(bent, edges=("center",), mark=True, sigma=0.1), SOCCER, CIRCLE, CameraConfig())
    assert fit.camera.kappa[0] == pytest.approx(-0.1, abs=0.02)
    assert fit.noise_scale < 2.0


def test_no_lens_is_believed_that_bends_lines_more_than_a_fisheye(monkeypatch):
    """A circle that was not painted round looks like a lens; this one bends it far more than a lens so long can."""
    given = seen(replace(MAIN, kappa=np.array([-0.12, 0.0])), edges=("center",), mark=True, sigma=1.0)
    guarded = estimate_camera(given, SOCCER, CIRCLE, CameraConfig(crown_m=0.0))
    fisheye = strongest_barrel(guarded.theta, MAIN.width)
    assert fisheye == pytest.approx(-1.0 / (3.0 * (2.0 * guarded.camera.focal_px[0] / MAIN.width) ** 2))
    for module in ("completion", "worlds"):
        monkeypatch.setattr(f"circlecal.estimation.{module}.strongest_barrel", lambda *_: -np.inf)
    believed = estimate_camera(given, SOCCER, CIRCLE, CameraConfig(crown_m=0.0))
    assert believed.camera.kappa[0] < fisheye
    assert guarded.camera.kappa[0] > believed.camera.kappa[0] + 0.01


@pytest.mark.parametrize("side", sorted(SIDES))
def test_cameras_on_every_side(side):
    toward = np.array(SIDES[side])
    position = np.r_[58.0 * toward + 4.0 * toward[::-1], -15.0]
    camera = aim_camera(position, np.array([0.5, 0.5, 0.0]), 3000.0, 0.01, 1920, 1080)
    fit = estimate_camera(seen(camera, line="halfway_line"), SOCCER, CIRCLE, EXACT, side)
    assert departure(fit, camera) < 1e-6
    opposite = next(s for s, d in SIDES.items() if np.allclose(d, -toward))
    other = estimate_camera(seen(camera), SOCCER, CIRCLE, EXACT, opposite)
    # the field turned by 180 degrees
    np.testing.assert_allclose(other.camera.position_m[:2], -position[:2], atol=1e-4)
    np.testing.assert_allclose(other.camera.turn_field().position_m, position, atol=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_never_upside_down_and_never_mirrored(seed):
    rng = np.random.default_rng(seed)
    (scenario,) = select_rows(["8a" if seed % 2 else "7"])
    draw = scenario.draw(rng)
    fit = estimate_camera(draw.observations, scenario.template, scenario.circle, draw.config)
    assert fit.camera.position_m[2] < 0
    assert 0 < fit.camera.angles_rad[1] < np.pi
    assert abs(fit.camera.angles_rad[2]) < np.pi / 2
    assert np.linalg.det(fit.H_image_field) > 0
    assert fit.camera.position_m[1] > 0


def test_priors_scale_with_the_picture_and_can_be_fixed():
    model = ProjectionModel(960, 540, Surface("flat"))
    priors = priors_of(CameraConfig(principal_point_sd_px=8.0, crown_shape="flat"), SOCCER, CIRCLE, model)
    assert priors.sd[INDEX["pp_x"]] == pytest.approx(4.0)
    assert priors.sd[INDEX["crown"]] == 0.0
    assert priors.sd[INDEX["log_aspect"]] == 0.0
    assert np.isinf(priors.sd[INDEX["log_focal"]])
    assert priors.distance_m == pytest.approx(7 * 9.15)
    known = priors_of(CameraConfig(position_m=(1.0, 2.0, -3.0)), SOCCER, CIRCLE, model)
    np.testing.assert_allclose(known.mean[4:7], [1.0, 2.0, -3.0])
    assert np.isinf(known.distance_log_sd)
    assert np.isinf(known.elevation_sd_rad)


def test_a_known_focal_length_tells_how_far_away_the_camera_stands():
    """Of circle and halfway line alone, where zoom can stand for distance."""
    given = seen(MAIN, edges=("center",), sigma=1.0, seed=3)
    focal = float(MAIN.focal_px[0])
    free = estimate_camera(given, SOCCER, CIRCLE, KNOWN)
    held = estimate_camera(given, SOCCER, CIRCLE, KNOWN.model_copy(update={"focal_px": focal, "focal_sd": 0.002}))
    sd = {
        name: np.sqrt([fit.covariance[INDEX[name], INDEX[name]] for fit in (free, held)]) for name in ("log_focal", "y")
    }
    assert sd["log_focal"][1] < 0.0021 < 0.01 < sd["log_focal"][0]
    assert sd["y"][1] < 0.3 * sd["y"][0]
    assert held.camera.focal_px[0] == pytest.approx(focal, rel=0.006)
    assert abs(held.camera.position_m[1] - MAIN.position_m[1]) < 3.0 * sd["y"][1]


def test_a_known_lens_enters_the_priors():
    model = ProjectionModel(960, 540, Surface("flat"))
    config = CameraConfig(focal_px=1200.0, k1_mean=-0.1, k1_sd=0.0, k2_mean=0.01)
    priors = priors_of(config, SOCCER, CIRCLE, model)
    assert priors.mean[INDEX["log_focal"]] == pytest.approx(np.log(1200.0))
    assert priors.sd[INDEX["log_focal"]] == pytest.approx(0.005)
    assert [(priors.mean[INDEX[k]], priors.sd[INDEX[k]]) for k in ("kappa_1", "kappa_2")] == [(-0.1, 0.0), (0.01, 0.0)]
    pinhole = priors_of(config.model_copy(update={"distortion": "none"}), SOCCER, CIRCLE, model)
    free = priors_of(config.model_copy(update={"k2_sd": 0.02}), SOCCER, CIRCLE, model)
    assert (free.mean[INDEX["kappa_2"]], free.sd[INDEX["kappa_2"]]) == (0.01, 0.02)
    assert pinhole.mean[INDEX["kappa_2"]] == 0.0


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


def test_points_of_the_circle_lie_on_the_crowned_pitch():
    """They lay on the plane that touches it at its middle, up to 1 px beside the circle with 0.3 px stated."""
    surface = Surface("roof", 9.15, 0.08)
    config = EXACT.model_copy(
        update={"crown_shape": "roof", "crown_m": 0.07, "crown_sd_m": 0.02, "distortion": "radial"}
    )
    given = seen(WIDE, sigma=0.1, surface=surface, mark=True, lines=("side_line_top", "side_line_bottom"))
    fit = estimate_camera(given, SOCCER, CIRCLE, config)
    points = np.array([p.field_m for p in fit.derived_points])
    found = np.array([p.image_px for p in fit.derived_points])
    np.testing.assert_allclose(found, fit.camera.project(fit.surface.lift(points), distort=False), atol=1e-6)
    # the crown's own error is part of theirs
    straight, covariance = fit.theta.copy(), fit.covariance.copy()
    straight[INDEX["kappa_1"]] = covariance[INDEX["kappa_1"]] = covariance[:, INDEX["kappa_1"]] = 0.0
    linear, _ = project(straight[None], points[None], fit.model).covariances(covariance)
    told = np.array([np.trace(p.covariance) for p in fit.derived_points])
    np.testing.assert_allclose(told, np.trace(linear, axis1=1, axis2=2), rtol=0.1)


@pytest.mark.parametrize("lines", [(), ("side_line_bottom",)])
def test_two_cameras_that_see_a_flat_circle_alike_are_both_known(lines):
    """From near the floor a near camera with a short lens sees circle and halfway line as a far one with a long lens
    does: sigma covers both, or the line that only one of them names decides.
    """
    futsal = load_field("futsal")
    circle = futsal.circle_by_name[futsal.default_circle]
    camera = aim_camera(np.array([-16.7, 22.9, -3.57]), np.array([-5.0, 2.0, 0.0]), 2439.0, -0.019, 1920, 1080, 0.033)
    given = seen(
        camera, edges=("center",), lines=lines, template=futsal, sigma=0.1, circles=(circle.name,), count=300
    )  # fmt: skip
    halfway, *others = given.lines
    given = replace(given, lines=(halfway, *(replace(line, line=None) for line in others)))
    fit = estimate_camera(given, futsal, circle, CameraConfig(k1_mean=0.03))
    assert fit.named_lines == lines
    assert np.linalg.norm(fit.camera.position_m - camera.position_m) < (0.1 if lines else 1.0)
    assert (fit.max_sigma_px < 5.0) if lines else (fit.max_sigma_px > 100.0)


def test_evidence_is_told_where_other_frames_stand_for_the_priors():
    problem = Task(seen(MAIN, sigma=0.5), SOCCER, CIRCLE, CameraConfig(), "main", None).problem()
    theta = theta_of(MAIN, problem.model)[None]
    state = evaluate(problem, theta, ground_feet(problem.curves, theta, problem.model))
    sd = problem.priors.sd.copy()
    sd[INDEX["crown"]] = np.inf
    free = replace(problem.priors, sd=sd)
    assert np.isfinite(log_evidence(USUAL, *with_priors(problem, state, free), SOCCER, len(problem.curves.keys)))


def test_a_camera_on_the_far_side_is_known_as_well_as_that_of_the_turned_field():
    """Its pan is about a half turn."""
    position, target = np.array([8.0, -60.0, -14.0]), np.array([7.94, 0.0, 0.0])
    camera = aim_camera(position, target, 2000.0, 0.0, 1920, 1080)
    near = estimate_camera(
        seen(camera, lines=("side_line_bottom",), sigma=0.3), SOCCER, CIRCLE, CameraConfig(), "opposite"
    )
    turned = estimate_camera(
        seen(camera.turn_field(), lines=("side_line_top",), sigma=0.3), SOCCER, CIRCLE, CameraConfig()
    )
    assert near.max_sigma_px == pytest.approx(turned.max_sigma_px, rel=0.05)
