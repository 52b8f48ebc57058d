"""Fields of another size than their template's, flat and crowned: what was seen chooses, and sigma tells the rest."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera.options import CameraConfig
from circlecal.camera.priors import Priors
from circlecal.camera.spike_and_slab import possible_worlds, shares_of_sizes
from circlecal.camera.world import World
from circlecal.config import Config
from circlecal.errors import ConfigError
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS
from circlecal.geometry.surface import FLAT, Surface
from circlecal.pipeline import field_of
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import aim_camera
from tests.camera.test_problem import problem_of

from .camera_views import CIRCLE, MAIN, SOCCER, seen

CENTRED = CameraConfig(principal_point_sd_px=5.0)
"""The principal point of all cameras that are drawn here is the middle of the picture."""
DEFAULT = CENTRED.model_copy(update={"model_sigma_px": 0.1, "correlation_px": 10.0, "k1_mean": 0.03})
WITH_TOUCHLINES = aim_camera(np.array([14.0, 82.0, -19.0]), np.array([2.0, 3.0, 0.0]), 1900.0, 0.01, 1920, 1080, 0.03)
GROUND = Surface("roof", 9.15, 0.05)
SIZES = {"usual": 0.9, "other_length": 0.04, "any": 0.06}
CROWN, LENGTH, BREADTH = INDEX["crown"], INDEX["length"], INDEX["breadth"]


def estimated(width_m, lines, config=DEFAULT, camera=WITH_TOUCHLINES):
    painted = load_field("soccer", {"width": width_m})
    given = seen(camera, edges=("center",), lines=lines, template=painted, sigma=0.15, surface=GROUND)
    return estimate_camera(given, SOCCER, CIRCLE, config)


FROM_THE_FIELDS_PLANE = aim_camera(np.array([0.1, 66.0, -15.0]), np.array([0.0, -6.0, 0.0]), 2900.0, 0.0, 1920, 1080)


def nameless_touchline(width_m, camera=FROM_THE_FIELDS_PLANE, surface=GROUND):
    """Circle, halfway line and a far touchline that nobody named, of such a field."""
    painted = load_field("soccer", {"width": width_m})
    options = {"edges": ("center",), "lines": ("side_line_top",), "sigma": 0.05, "surface": surface}
    given = seen(camera, template=painted, **options)
    return replace(given, lines=(given.lines[0], replace(given.lines[1], line=None)))


def test_the_noise_that_a_usual_field_leaves_does_not_hide_another_size():
    fit = estimate_camera(nameless_touchline(56.0), SOCCER, CIRCLE, CameraConfig())
    assert fit.named_lines == ("side_line_top",)
    assert fit.other_size.share > 0.1
    assert fit.other_size.share == pytest.approx(1.0 - fit.field_size.usual_share)
    assert fit.other_size.away_px > 20.0
    # sizes that are mixed widen the covariance, and take nothing of the observations' share
    assert 0.02 < fit.data_share < 0.05
    usual = estimate_camera(nameless_touchline(68.0), SOCCER, CIRCLE, CameraConfig())
    assert usual.field_size.is_usual
    assert usual.field_size.usual_share > 0.97


def test_a_field_of_another_size_may_have_a_parabolic_profile():
    """On a roof it fits no better than a usual field does on a parabola."""
    camera = aim_camera(np.array([3.6, 67.0, -24.7]), np.array([-6.0, -12.0, 0.0]), 6000.0, 0.0, 1920, 1080, 0.06)
    given = nameless_touchline(78.0, camera, Surface("parabola", 9.15, 0.025))
    fit = estimate_camera(given, SOCCER, CIRCLE, CameraConfig())
    assert not fit.field_size.is_usual
    assert abs(fit.field_size.width_m - 78.0) < 3.0 * fit.field_size.width_sd_m < 6.0


def priors():
    mean, sd = np.zeros(len(PARAMETERS)), np.ones(len(PARAMETERS))
    mean[CROWN], sd[CROWN] = 0.05, 0.03
    return Priors(mean, sd, 60.0, 0.6, 0.2, 0.1, np.zeros(2))


@pytest.mark.parametrize("width_m", [54.0, 78.0])
def test_a_touchline_of_another_field_does_not_bend_the_camera(width_m):
    fit = estimated(width_m, ("side_line_top",))
    assert not fit.field_size.is_usual
    assert abs(fit.field_size.width_m - width_m) < 3.0 * fit.field_size.width_sd_m < 6.0
    away = fit.camera.position_m - WITH_TOUCHLINES.position_m
    sd = np.sqrt(np.diag(fit.covariance)[4:7])
    assert (np.abs(away) < 3.0 * sd).all()
    assert np.linalg.norm(away) < 6.0
    assert fit.rejected == ()
    # where only the usual size is thought of, all else says that this is no touchline
    usual = estimated(width_m, ("side_line_top",), DEFAULT.model_copy(update={"usual_size_share": 1.0}))
    assert [key.name for key in usual.rejected] == ["side_line_top"]
    assert np.linalg.norm(usual.camera.position_m - WITH_TOUCHLINES.position_m) < 6.0


def test_a_usual_field_stays_the_usual_one():
    fit = estimated(68.0, ("side_line_top", "side_line_bottom"))
    assert fit.field_size.is_usual
    assert fit.field_size.usual_share > 0.95
    assert abs(fit.field_size.width_m - 68.0) < 0.5
    assert "usual" in str(fit.field_size)
    assert "estimated" in str(estimated(54.0, ("side_line_top",)).field_size)


def test_what_cannot_be_told_widens_sigma():
    """Circle, halfway line and one touchline, seen from its plane: the size decides how far away the camera stands."""
    camera = aim_camera(np.array([0.1, 66.0, -15.0]), np.array([0.0, -6.0, 0.0]), 2900.0, 0.0, 1920, 1080)
    alone = estimated(68.0, ("side_line_top",), DEFAULT.model_copy(update={"usual_size_share": 1.0}), camera)
    fit = estimated(68.0, ("side_line_top",), camera=camera)
    assert fit.field_size.usual_share < 0.99
    assert fit.max_sigma_px > alone.max_sigma_px


def test_worlds_are_those_that_the_rules_allow():
    worlds = possible_worlds(SOCCER, priors(), SIZES, 0.2)
    kinds = [(w.size, w.is_flat) for w in worlds]
    assert kinds == [(size, is_flat) for is_flat in (False, True) for size in SIZES]
    assert sum(w.share for w in worlds) == pytest.approx(1.0)
    assert len(possible_worlds(SOCCER, priors(), {"usual": 1.0, "any": 0.0}, 0.0)) == 1
    exact = SOCCER.model_copy(update={"length_range_m": None, "width_range_m": None})
    assert all(w.is_usual_size for w in possible_worlds(exact, priors(), SIZES, 0.2))
    some_curved = possible_worlds(SOCCER, priors(), SIZES, 0.2, 0.25)
    assert some_curved[0].share == pytest.approx(0.9 * 0.8 * 0.75)
    curved = some_curved[0].curve()
    assert curved.share == pytest.approx(0.9 * 0.8 * 0.25)
    # a parabola's crown is as much less than a roof's as the circle's radius is less than half the width
    assert curved.priors(priors(), priors(), SOCCER).mean[CROWN] == pytest.approx(0.05 * 9.15 / 34.0)
    any_flat = World("any", True, 0.1).priors(priors(), priors(), SOCCER)
    assert (any_flat.mean[CROWN], any_flat.mean[LENGTH], any_flat.mean[BREADTH]) == (0.0, 0.0, -0.5)
    assert any_flat.sd[BREADTH] == pytest.approx(45.0 / np.sqrt(12.0))
    assert any_flat.sd[CROWN] < 0.01


def test_a_parabola_is_thought_of_before_a_far_camera_on_a_roof():
    """Most of a circle on a pitch that falls little: a roof or a flat pitch fits it too, with a camera 145 m away."""
    camera = aim_camera(np.array([6.0, 68.4, -12.6]), np.array([-4.0, 2.0, 0.0]), 7870.0, 0.0, 1920, 1080)
    given = seen(camera, edges=("center",), sigma=0.1, surface=Surface("parabola", 9.15, 0.008))
    whole = given.circles[0]
    inside = whole.points_px[:, 0] < np.quantile(whole.points_px[:, 0], 0.7)
    part = replace(whole, points_px=whole.points_px[inside], sigma_px=whole.sigma_px[inside])
    fit = estimate_camera(replace(given, circles=(part,)), SOCCER, CIRCLE, DEFAULT)
    sd = np.sqrt(np.diag(fit.covariance)[4:7])
    assert (np.abs(fit.camera.position_m - camera.position_m) < 2.0 * sd).all()
    assert fit.camera.position_m[1] < 100.0


def test_a_camera_high_over_the_field_is_a_rare_one():
    """Circle, halfway line and a touchline 26 m away: 34 m away it would lie beneath the camera."""
    camera = aim_camera(np.array([-2.6, 60.7, -17.4]), np.array([-1.5, -4.0, 0.0]), 3305.0, 0.0, 1920, 1080)
    painted = load_field("soccer", {"width": 52.0})
    given = seen(camera, edges=("center",), lines=("side_line_top",), template=painted, sigma=1.0, surface=FLAT)
    fit = estimate_camera(given, SOCCER, CIRCLE, CENTRED)
    assert fit.field_size.usual_share < 0.1


def test_a_principal_point_off_the_middle_is_no_other_field_and_no_other_place():
    """As far off as a real camera's: a circle and a touchline must not be explained by where the camera stands."""
    view = aim_camera(np.array([0.2, 67.6, -19.6]), np.array([-14.0, -6.0, 0.0]), 4577.0, -0.003, 1920, 1080, 0.03)
    camera = replace(view, principal_point_px=view.principal_point_px + np.array([15.0, 32.0]))
    given = seen(camera, edges=("center",), lines=("side_line_top",), sigma=0.1, surface=Surface("roof", 9.15, 0.0))
    fit = estimate_camera(given, SOCCER, CIRCLE, CameraConfig())
    sd = np.sqrt(np.diag(fit.covariance)[4:7])
    assert (np.abs(fit.camera.position_m - camera.position_m) < 2.0 * sd).all()
    assert abs(fit.field_size.width_m - 68.0) < 2.0 * fit.field_size.width_sd_m


def test_short_lines_of_a_penalty_area_together_ask_for_another_size():
    """A part of the circle, the far touchline and a corner of a penalty area 5 m nearer and 5 m further across."""
    camera = aim_camera(np.array([-11.3, 72.0, -13.6]), np.array([-15.0, -12.0, 0.0]), 4194.0, 0.02, 1920, 1080)
    painted = load_field("soccer", {"length": 96.0, "width": 78.0})
    names = ("side_line_top", "big_rect_left_top", "big_rect_left_main")
    given = seen(camera, edges=("center",), lines=names, template=painted, sigma=0.2, surface=FLAT)
    lines = tuple(line if line.line == "halfway_line" else replace(line, line=None) for line in given.lines)
    fit = estimate_camera(replace(given, lines=lines), SOCCER, CIRCLE, CENTRED)
    assert "big_rect_left_top" in fit.named_lines
    assert abs(fit.field_size.width_m - 78.0) < 3.0 * fit.field_size.width_sd_m
    assert fit.field_size.width_sd_m < 0.5


def test_circle_alone_needs_no_choice_of_size():
    fit = estimate_camera(seen(MAIN, sigma=0.3), SOCCER, CIRCLE, DEFAULT)
    assert fit.field_size.is_usual
    others = 1.0 - DEFAULT.usual_size_share
    usual_width = 1.0 - others * (1.0 - DEFAULT.other_length_share)
    assert fit.field_size.usual_share == pytest.approx(usual_width, abs=0.02)


@pytest.mark.parametrize(("share", "is_usual"), [(0.5, False), (0.0, True)])
def test_a_field_of_the_usual_width_may_have_another_length(share, is_usual):
    """Circle, both touchlines and a penalty area 2 m nearer than usual."""
    painted = load_field("soccer", {"length": 101.0})
    names = ("side_line_top", "side_line_bottom", "big_rect_right_main")
    given = seen(WITH_TOUCHLINES, edges=("center",), lines=names, template=painted, sigma=0.2, surface=GROUND)
    fit = estimate_camera(given, SOCCER, CIRCLE, DEFAULT.model_copy(update={"other_length_share": share}))
    size = fit.field_size
    assert abs(size.width_m - 68.0) < 3.0 * size.width_sd_m
    assert size.is_usual == is_usual
    if not is_usual:
        assert abs(size.length_m - 101.0) < 3.0 * size.length_sd_m


def test_sizes_are_told_apart_by_what_shows_the_length():
    beside = seen(WITH_TOUCHLINES, edges=("center",), lines=("side_line_top",), template=SOCCER, sigma=0.2)
    before = seen(WITH_TOUCHLINES, edges=("center",), lines=("big_rect_right_main",), template=SOCCER, sigma=0.2)
    found = [shares_of_sizes(0.9, 0.4, problem_of(given, priors())) for given in (beside, before)]
    assert found[0] == pytest.approx({"usual": 0.94, "any": 0.06})
    assert found[1] == pytest.approx(SIZES)
    # and where no field has the usual size, its length is another one although nothing tells it
    resized = shares_of_sizes(0.0, 0.4, problem_of(beside, priors()))
    assert resized == pytest.approx({"other_length": 0.4, "any": 0.6})


def test_options_say_how_large_a_field_may_be():
    template, _ = field_of(Config.model_validate({"field": {"length_sd_m": 3.0, "width_sd_m": 0.0}}))
    assert (template.length_sd_m, template.width_sd_m) == (3.0, 0.0)
    assert template.length_range_m is template.width_range_m is None
    given, _ = field_of(Config.model_validate({"field": {"sizes": {"length": 100}}}))
    assert given.length_m == 100
    assert given.length_range_m is None
    assert given.width_range_m == (45, 90)
    with pytest.raises(ConfigError):
        field_of(Config.model_validate({"field": {"circle": "moon"}}))


def test_a_penalty_arc_is_expected_where_the_length_of_the_field_puts_it():
    """Its centre is 11 m from the goal line, however far that is from the centre mark."""
    names, _, shifts = SOCCER.outlines
    assert shifts[names.index("penalty_arc_right"), 1, 0] == 0.5
    assert shifts[names.index("penalty_arc_left"), 1, 0] == -0.5
    assert not shifts[names.index("centre_circle")].any()


def test_noise_is_not_grown_until_a_field_of_the_usual_size_fits():
    """A part of the circle and one touchline, on a field 10.9 m broader than usual: the usual does not fit."""
    camera = aim_camera(np.array([-10.3, 56.8, -16.4]), np.array([-10.0, -18.0, 0.0]), 4657.0, 0.025, 1920, 1080, 0.076)
    painted = load_field("soccer", {"length": 115.7, "width": 78.9})
    given = seen(
        camera, edges=("center",), lines=("side_line_top",), mark=True, template=painted, sigma=0.05,
        surface=Surface("parabola", 9.15, 0.023), count=600,
    )  # fmt: skip
    halfway, touchline = given.lines
    fit = estimate_camera(
        replace(given, lines=(halfway, replace(touchline, line=None))), SOCCER, CIRCLE, CameraConfig()
    )
    assert not fit.field_size.is_usual
    assert abs(fit.field_size.width_m - 78.9) < 4.0 * fit.field_size.width_sd_m
    assert np.linalg.norm(fit.camera.position_m - camera.position_m) < 6.0


def test_a_line_that_is_none_of_the_marking_that_it_was_taken_for_is_left_out_and_named():
    """The penalty area's side, 16 px off, bends the camera between the goal line's parallel and the touchline."""
    lines = ("side_line_top", "big_rect_right_main", "big_rect_right_top")
    given = seen(WITH_TOUCHLINES, edges=("center",), lines=lines, sigma=0.3, surface=GROUND)
    *others, side = given.lines
    wrong = replace(given, lines=(*others, replace(side, points_px=side.points_px + np.array([0.0, 16.0]))))
    fit = estimate_camera(wrong, SOCCER, CIRCLE, CameraConfig())
    assert [key.name for key in fit.rejected] == ["big_rect_right_top"]
    assert np.linalg.norm(fit.camera.position_m - WITH_TOUCHLINES.position_m) < 0.5
    assert estimate_camera(given, SOCCER, CIRCLE, CameraConfig()).rejected == ()
