"""Every gate of the verdict, by its code and its words."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.checks import CHECKS
from circlecal.geometry.camera_parameters import CROWN, INDEX, LOG_FOCAL, PARAMETERS
from circlecal.geometry.conic_fits import fit_conic
from circlecal.geometry.conics import circle_conic, transform_conic
from circlecal.geometry.homography import turn_homography
from circlecal.geometry.surface import FLAT, Surface
from circlecal.observations import LineEnd, MarkingKey
from circlecal.refusals import Confidence
from circlecal.results import (
    Attempt,
    CameraFit,
    Cues,
    EllipseFits,
    FieldSize,
    HomographyFit,
    MarkCue,
    MarkingMask,
    OtherSize,
    Verdict,
)
from circlecal.stages.verdict import VerdictConfig, judge, renew_sigmas
from circlecal.stages.verdict_on_picture import is_confirmed

from .conftest import CIRCLE, SOCCER, fit_of, fits_of, line_cue, true_conic, view

CAMERA = view()
CONFIG = VerdictConfig()
NEAR_PX = CONFIG.max_mark_distance_px * CAMERA.width / 1920.0
LINE = line_cue(CAMERA)
UNIT_RING = np.stack([np.cos(np.linspace(0.0, 6.28, 1500)), np.sin(np.linspace(0.0, 6.28, 1500))], axis=-1)
NO_FITS = EllipseFits(None, None, None)
MARK = MarkCue("centre_mark", CAMERA.project(np.zeros(2)), 0.5, 30.0)


def keyed(residuals):
    """Residuals by the text of their markings."""
    return {MarkingKey.parse(text): px for text, px in residuals.items()}


def camera_fit(camera=CAMERA, **changes):
    H = camera.homography
    given = {
        "camera": camera,
        "surface": FLAT,
        "parameters": (),
        "covariance": np.zeros((len(PARAMETERS), len(PARAMETERS))),
        "H_covariance": np.zeros((8, 8)),
        "imaged_center_px": H[:2, 2] / H[2, 2],
        "imaged_center_covariance": np.zeros((2, 2)),
        "noise_scale": 1.0,
        "data_share": 1.0,
        "residual_correlation": 1.0,
        "max_sigma_px": 2.0,
        "max_sigma_m": 0.1,
        "residuals_px": {"centre_circle outer": 0.3, "halfway_line": 0.3, "centre_mark": 0.5},
        "theta": np.zeros(0),
    }
    given |= changes
    rejected = tuple(map(MarkingKey.parse, given.pop("rejected", ())))
    return CameraFit(**given | {"residuals_px": keyed(given["residuals_px"]), "rejected": rejected})


def homography_fit(H):
    return HomographyFit(H, turn_homography(H, np.zeros(2)), np.zeros(8), 10.0, 0.0)


TENTATIVE = Confidence.TENTATIVE


def verdict(camera=None, homography=None, cues=None, config=CONFIG, fits=None, confidence=Confidence.ACCEPTED):
    mask = MarkingMask(np.zeros((2, 2), np.uint8), "detector", confidence=confidence)
    attempt = Attempt(
        mask, ellipses=fits or fits_of(CAMERA), cues=cues or Cues(LINE, MARK), homography=homography, camera=camera
    )
    return judge(attempt, SOCCER, CIRCLE, CAMERA.width, config)


@pytest.mark.parametrize(
    ("option", "value", "check", "limit"),
    [
        ("max_rejected_share", 0.07, "rejected_share", 0.07),
        ("max_line_reach", 1.3, "line_reach", 1.3),
        ("max_line_residual_px", 1.1, "line_residual_px", 1.1 * CAMERA.width / 1920.0),
        ("max_roll_deg", 7.0, "roll_deg", 7.0),
        ("stands_m", 5.0, "distance_radii", (np.hypot(SOCCER.length_m, SOCCER.width_m) + 5.0) / CIRCLE.radius_m),
    ],
)
def test_a_limit_that_is_widened_or_narrowed_is_that_of_its_check(option, value, check, limit):
    fits = NO_FITS if check == "rejected_share" else None
    configs = CONFIG, CONFIG.model_copy(update={option: value})
    usual, asked = (verdict(camera_fit(), config=config, fits=fits) for config in configs)
    assert asked.check(check).limit == pytest.approx(limit)
    assert usual.check(check).limit != asked.check(check).limit


def test_a_likely_circle_needs_the_mark_or_another_marking():
    bare = Cues(LINE, None)
    assert verdict(camera_fit(), confidence=TENTATIVE).status == "calibrated"
    assert verdict(camera_fit(named_lines=("side_line_top",)), cues=bare, confidence=TENTATIVE).status == "calibrated"
    for camera, cues in (
        (camera_fit(), bare),
        (camera_fit(named_lines=("halfway_line",)), bare),
        (camera_fit(rejected=("centre_mark",)), None),
    ):
        assert verdict(camera, cues=cues, confidence=TENTATIVE).code == "circle_unconfirmed"


@pytest.mark.parametrize(("residual_px", "confirms"), [(0.3, True), (1.3, True), (1.5, False), (3.0, False)])
@pytest.mark.parametrize("marking", ["side_line_top", "penalty_arc_left center"])
def test_markings_that_were_measured_where_the_camera_puts_them_confirm_a_likely_circle(marking, residual_px, confirms):
    camera = camera_fit(residuals_px={marking: residual_px * CAMERA.width / 1920.0})
    cues = Cues(LINE, None, (line_cue(CAMERA, "side_line_top"),))
    found = verdict(camera, cues=cues, confidence=TENTATIVE)
    assert (found.code != "circle_unconfirmed") == confirms
    without_line = verdict(camera, cues=Cues(None, None), confidence=TENTATIVE)
    is_off = "arc" in marking and residual_px > CONFIG.max_circle_residual_px
    assert without_line.code == ("residual_too_large" if is_off else "circle_unconfirmed")


def test_a_likely_circle_may_confirm_itself():
    bare = Cues(LINE, None)
    exact = camera_fit(residuals_px={"centre_circle outer": 0.05})
    assert verdict(exact, cues=bare, confidence=TENTATIVE).status == "calibrated"
    vague = replace(exact, max_sigma_px=55.0 * CAMERA.width / 1920.0)
    assert verdict(vague, cues=bare, confidence=TENTATIVE).code == "too_uncertain"
    assert verdict(vague, cues=bare).status == "calibrated"
    assert (
        verdict(replace(vague, named_lines=("side_line_top",)), cues=bare, confidence=TENTATIVE).status == "calibrated"
    )
    arc = replace(fit_of(true_conic(CAMERA), "outer"), arc_deg=100.0)
    assert (
        verdict(exact, fits=EllipseFits(arc, None, None), cues=bare, confidence=TENTATIVE).code == "circle_unconfirmed"
    )


@pytest.mark.parametrize(
    ("residual_px", "arc_deg", "confirms"),
    [
        (0.08, 120.0, False),
        (0.08, 135.0, True),
        (0.08, 150.0, True),
        (0.15, 175.0, False),
        (0.15, 190.0, True),
        (0.25, 360.0, False),
    ],
)
def test_more_of_a_circle_may_be_less_exact(residual_px, arc_deg, confirms):
    camera = camera_fit(residuals_px={"centre_circle outer": residual_px * CAMERA.width / 1920.0})
    fits = EllipseFits(replace(fit_of(true_conic(CAMERA), "outer"), arc_deg=arc_deg), None, None)
    found = verdict(camera, fits=fits, cues=Cues(LINE, None), confidence=TENTATIVE)
    assert (found.status == "calibrated") == confirms


@pytest.mark.parametrize(
    ("seen_deg", "named", "code"),
    [
        (70.0, ("side_line_top",), None),
        (70.0, (), "circle_unconfirmed"),
        (42.0, ("side_line_top",), None),
        (38.0, ("side_line_top",), "arc_too_short"),
    ],
)
def test_of_a_short_arc_the_camera_tells_the_length_and_lines_confirm_it(seen_deg, named, code):
    angle = np.radians(np.linspace(200.0, 200.0 + seen_deg, 50))
    points_px = CAMERA.project(CIRCLE.radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    fit = replace(fit_of(true_conic(CAMERA), "outer"), arc_deg=20.0, points_px=points_px)
    fits = EllipseFits(fit, None, None, least_arc_deg=60.0)
    found = verdict(camera_fit(named_lines=named), cues=Cues(LINE, None), fits=fits)
    assert found.code == code
    assert found.check("arc_deg").value == pytest.approx(seen_deg, abs=0.5)


def test_a_good_camera_is_accepted_with_every_check():
    found = verdict(camera_fit())
    assert (found.status, found.code, found.reason, found.stage) == ("calibrated", None, None, None)
    assert all(check.passed for check in found.checks)
    assert {check.name for check in found.checks} == set(
        CHECKS
    ) - WITHOUT_CIRCLE - OF_THE_DETECTOR - OF_THE_PICTURE - OF_OTHERS - {
        "confirmations",
        "likely_residual_px",
        "found_share",
        "named_markings",
        "beyond_end_widths",
        "end_residual_px",
        "other_end_reach",
        "crossed_end_beyond",
        "noise_beside_mark",
        "arc_residual_px",
        "other_size_share",
        "least_line_share",
        "lines_found_share",
        "surface_share",
        "painted_width_m",
        "other_field_ratio",
        "other_field_agreement",
        "beyond_rules_m",
        "crown_m",
        "arc_deg",
        "chord_radii",
    }


def test_an_arc_that_turns_the_field_lies_where_the_camera_puts_it():
    unit = CAMERA.width / 1920.0
    off = camera_fit(residuals_px={"centre_circle outer": 0.1, "penalty_arc_left center": 4.6 * unit})
    found = verdict(off, cues=Cues(None, None))
    assert found.code == "residual_too_large"
    assert "arc of the field" in found.reason
    # a few of its points lie on a player
    bulk = keyed({"penalty_arc_left center": 1.0 * unit})
    assert verdict(replace(off, bulk_residuals_px=bulk), cues=Cues(None, None)).status == "calibrated"


@pytest.mark.parametrize(
    ("width_m", "sd_m", "status"),
    [(33.2, 0.3, "refused"), (41.4, 0.1, "refused"), (43.0, 0.3, "calibrated"), (38.0, 2.0, "calibrated")],
)
def test_a_field_far_beyond_the_rules_is_none(width_m, sd_m, status):
    """The rules allow 45 to 90 m."""
    size = FieldSize(100.0, width_m, 1.0, sd_m, False, 0.0)
    found = verdict(camera_fit(field_size=size))
    assert found.status == status
    assert found.code == (None if status == "calibrated" else "line_beyond_field")


@pytest.mark.parametrize(
    ("share", "away_px", "status"), [(0.09, 25.0, "refused"), (0.019, 90.0, "calibrated"), (0.4, 15.0, "calibrated")]
)
def test_what_speaks_for_another_size_and_quite_another_camera_is_uncertain(share, away_px, status):
    found = verdict(camera_fit(other_size=OtherSize(share, away_px * CAMERA.width / 1920.0)))
    assert found.status == status
    assert found.code == (None if status == "calibrated" else "too_uncertain")


@pytest.mark.parametrize(
    ("crown_m", "sd_m", "code"), [(-0.04, 0.004, "picture_contradicts"), (-0.01, 0.004, None), (-0.04, 0.0, None)]
)
@pytest.mark.parametrize("fits", [None, NO_FITS])
def test_ground_that_is_estimated_hollow_is_a_pitch_upside_down(fits, crown_m, sd_m, code):
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[CROWN, CROWN] = sd_m**2
    residuals = {"side_line_top": 0.3} if fits is NO_FITS else {"centre_circle outer": 0.3}
    camera = camera_fit(surface=replace(FLAT, crown_m=crown_m), covariance=covariance, residuals_px=residuals)
    found = verdict(camera, fits=fits)
    assert found.code == code
    assert "hollow" in (found.reason or "hollow")


def test_an_end_of_the_halfway_line_alone_must_fit_the_marking_that_it_lies_on():
    unit = CAMERA.width / 1920.0
    line = replace(LINE, ends=(LineEnd(np.array([600.0, 100.0]), False),))
    off = camera_fit(residuals_px={"centre_circle outer": 0.05, "halfway_line": 0.1, "side_line_top": 2.5 * unit})
    found = verdict(off, cues=Cues(line, None))
    assert found.code == "residual_too_large"
    assert "taken for the end of the halfway line" in found.reason
    assert verdict(replace(off, residuals_px=keyed({"side_line_top": 1.5 * unit})), cues=Cues(line, None)).code is None
    # with another marking at its place the end is not what the size hangs on
    assert verdict(replace(off, named_lines=("side_line_bottom",)), cues=Cues(line, None)).code is None


OF_THE_DETECTOR = {"marking_rms_px", "band_width", "painted_share", "whole_share"}
OF_OTHERS = {"circle_told", "rival_ratio", "paint_of_view", "missing_markings", "frames_to_confirmed", "assumed_place"}
OF_THE_PICTURE = {
    "unexplained_widths", "painted_share_of_carriers", "bare_widths", "bare_ends", "reversal",
    "rough_share", "above_share", "beyond_share", "near_share", "seam_share", "noise_scale", "contradictions",
}  # fmt: skip
WITHOUT_CIRCLE = {"field_in_front", "marking_residual_px", "rejected_share"}


def test_without_the_circle_lines_and_points_are_judged():
    given = {"residuals_px": {"side_line_top": 0.4, "kp_3": 0.5}, "reference_m": np.array([4.0, -3.0])}
    found = verdict(camera_fit(**given), fits=NO_FITS)
    assert found.status == "calibrated"
    names = {check.name for check in found.checks}
    assert names >= WITHOUT_CIRCLE
    assert not names & {"circle_in_front", "circle_residual_px", "line_residual_px"}


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"residuals_px": {"side_line_top": 0.4, "kp_3": 3.0}}, "residual_too_large", "kp_3 does not lie where"),
        ({"rejected": ("a", "b", "c", "d")}, "observations_contradict", "contradict each other"),
        ({"reference_m": np.array([4.0, 300.0])}, "field_behind_camera", "behind the camera"),
        ({"max_sigma_px": 300.0}, "too_uncertain", "too little is seen"),
    ],
)
def test_without_the_circle_the_gates_refuse(changes, code, words):
    found = verdict(camera_fit(**changes), fits=NO_FITS)
    assert found.help
    assert (found.status, found.code) == ("refused", code)
    assert words in found.reason


@pytest.mark.parametrize(("residual_px", "status"), [(1.45, "calibrated"), (1.55, "refused")])
def test_what_scatters_by_itself_may_lie_three_of_its_standard_deviations_off(residual_px, status):
    stated = keyed({"kp_3": 0.5})
    found = verdict(camera_fit(residuals_px={"kp_3": residual_px}, stated_sigma_px=stated), fits=NO_FITS)
    assert found.status == status


def position(x, y, z):
    return replace(CAMERA, position_m=np.array([x, y, z]))


FAILURES = {
    "too high": (camera_fit(position(4.0, 58.0, -200.0)), "implausible_camera", "higher than", 200.0),
    "too low": (camera_fit(position(4.0, 58.0, -1.0)), "implausible_camera", "lower than", 1.0),
    "too far": (camera_fit(position(4.0, 500.0, -60.0)), "implausible_camera", "further away than", 55.04),
    "beyond the stands": (camera_fit(position(4.0, 190.0, -60.0)), "implausible_camera", "further away than", 21.78),
    "too near": (camera_fit(view(position=(0.5, 1.0, -9.0), focal=900.0)), "implausible_camera", "closer than", 0.9913),
    "rolled": (
        camera_fit(replace(CAMERA, angles_rad=CAMERA.angles_rad + np.radians([0.0, 0.0, -35.0]))),
        "implausible_camera",
        "lean to its side",
        34.7,
    ),
    "on its side": (
        camera_fit(replace(CAMERA, angles_rad=CAMERA.angles_rad + np.radians([0.0, 0.0, -90.0]))),
        "implausible_camera",
        "the picture lies on its side or upside down: turn it upright (roll",
        89.7,
    ),
    "long lens": (
        camera_fit(replace(CAMERA, focal_px=np.full(2, 50 * 1280.0))), "implausible_camera", "longer than", 50.0
    ),
    "short lens": (
        camera_fit(replace(CAMERA, focal_px=np.full(2, 0.2 * 1280.0))), "implausible_camera", "shorter than", 0.2
    ),
    "circle": (
        camera_fit(residuals_px={"centre_circle inner": 1.5}), "residual_too_large", "does not lie on the paint", 1.5
    ),
    "structure": (
        camera_fit(residuals_px={"centre_circle center": 1.3}, residual_correlation=10.0),
        "residual_too_large",
        "in a regular way",
        1.23,
    ),
    "line": (camera_fit(residuals_px={"halfway_line": 1.5}), "residual_too_large", "the halfway line that", 1.5),
    "mark": (camera_fit(residuals_px={"centre_mark": 9.0}), "mark_contradicts_circle", "the centre mark is not", 9.0),
    "uncertain px": (camera_fit(max_sigma_px=70.0), "too_uncertain", "too little is seen", 70.0),
    "uncertain on average": (camera_fit(mean_sigma_px=20.0), "too_uncertain", "too little is seen", 20.0),
    "uncertain m": (camera_fit(max_sigma_m=4.0), "too_uncertain", "too little is seen", 4.0),
    "not a number": (camera_fit(max_sigma_m=float("nan")), "too_uncertain", "too little is seen", float("nan")),
    "mirrored": (camera_fit(camera=view(position=(4.0, 58.0, 16.0))), "mirrored", "seen mirrored", None),
}  # fmt: skip


@pytest.mark.parametrize(("camera", "code", "words", "value"), FAILURES.values(), ids=FAILURES.keys())
def test_every_gate_has_a_code_and_words(camera, code, words, value):
    found = verdict(camera)
    assert (found.status, found.code, found.stage) == ("refused", code, "verdict")
    assert words in found.reason
    failed = [check for check in found.checks if not check.passed]
    assert CHECKS[failed[0].name].code == code
    assert value is None or failed[0].value == pytest.approx(value, rel=0.01, nan_ok=True)


def test_the_reason_of_an_implausible_camera_has_its_value_limit_and_option():
    """Measured at a ceiling camera that was refused: neither the table nor the overlay said what must be widened."""
    short = verdict(FAILURES["short lens"][0])
    assert short.reason.endswith(
        "than lenses are (focal length, picture widths: 0.2, must be at least 0.3, set by verdict.focal_widths)"
    )
    high = verdict(FAILURES["too high"][0])
    assert "(height of the camera, m: 200, must be at most 150, set by verdict.height_m)" in high.reason
    assert "camera.focal_px" in short.help and "the reason names" in short.help


def test_a_camera_may_stand_in_the_stands():
    """The field's diagonal is 125 m, and the stands reach 60 m further."""
    far = verdict(camera_fit(position(4.0, 170.0, -60.0))).check("distance_radii")
    assert far.passed and far.value * CIRCLE.radius_m == pytest.approx(180.3, abs=0.1)
    assert far.limit * CIRCLE.radius_m == pytest.approx(185.1, abs=0.1)


@pytest.mark.parametrize(("sigma", "is_plausible"), [(0.003, False), (0.012, True), (0.5, True)])
@pytest.mark.parametrize("focal", [0.292, 0.25])
def test_a_focal_length_is_too_short_by_more_than_its_own_uncertainty(focal, sigma, is_plausible):
    """A camera of a robot has 0.290 picture widths, and was measured to 0.292 +- 1.2 %."""
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[LOG_FOCAL, LOG_FOCAL] = sigma**2
    short = camera_fit(replace(CAMERA, focal_px=np.full(2, focal * 1280.0)), covariance=covariance)
    check = verdict(short).check("shortest_focal_widths")
    assert check.passed is (is_plausible and focal > 0.27)


def test_a_halfway_line_beyond_the_field_belongs_to_another_circle():
    beyond = CAMERA.project(np.linspace([0.0, -34.0], [0.0, 15.0], 200) * 1.6)
    long = replace(LINE, points_px=beyond, sigma_px=np.full(200, 0.1))
    found = verdict(camera_fit(), cues=Cues(long, MARK))
    assert (found.status, found.code) == ("refused", "line_beyond_field")
    assert "further than this field is wide" in found.reason
    assert found.check("line_reach").value == pytest.approx(1.48, abs=0.01)
    lines = tuple(f"line {k}" for k in range(4))
    assert verdict(camera_fit(named_lines=lines), cues=Cues(long, MARK)).status == "calibrated"
    assert verdict(camera_fit(named_lines=lines[:3]), cues=Cues(long, MARK)).code == "line_beyond_field"
    strays = np.r_[LINE.points_px, beyond[:4]]
    assert verdict(camera_fit(), cues=Cues(replace(LINE, points_px=strays), MARK)).status == "calibrated"


def test_a_halfway_line_whose_end_was_used_may_not_run_past_the_other_end():
    seen = CAMERA.project(np.linspace([0.0, -10.0], [0.0, 39.0], 200))
    cues = Cues(replace(LINE, points_px=seen, sigma_px=np.full(200, 0.1)), MARK)
    assert verdict(camera_fit(), cues=cues).status == "calibrated"
    residuals = {"centre_circle center": 0.3, "halfway_line": 0.3}
    found = verdict(camera_fit(residuals_px={**residuals, "side_line_top": 0.5}), cues=cues)
    assert (found.status, found.code) == ("refused", "line_beyond_field")
    assert "past the far side" in found.reason
    for name in ("side_line_bottom", "side_line_left"):
        assert verdict(camera_fit(residuals_px={**residuals, name: 0.5}), cues=cues).status == "calibrated"


@pytest.mark.parametrize(("scatter_px", "is_line"), [(0.05, True), (1.0, False), (6.0, False)])
def test_points_beside_the_line_behind_its_end_lie_on_a_player(scatter_px, is_line):
    rng = np.random.default_rng(0)
    own, behind = (CAMERA.project(np.linspace([0.0, a], [0.0, b], n)) for a, b, n in ((-10, 33, 180), (36, 39, 20)))
    points = np.concatenate(
        [own + rng.normal(0.0, 0.05, own.shape), behind + rng.normal(0.0, scatter_px, behind.shape)]
    )
    cues = Cues(replace(LINE, points_px=points, sigma_px=np.full(200, 0.1)), MARK)
    fit = camera_fit(residuals_px={"centre_circle center": 0.3, "halfway_line": 0.3, "side_line_top": 0.5})
    check = verdict(fit, cues=cues).check("other_end_reach")
    assert check.passed is not is_line


@pytest.mark.parametrize(("end_m", "crossed", "code"), [(-34.0, True, None), (-37.0, True, None),
                                                        (-38.0, True, "line_beyond_field"),
                                                        (-41.0, True, "line_beyond_field"),
                                                        (-41.0, False, None), (34.0, True, None)])  # fmt: skip
def test_a_line_that_the_halfway_line_crosses_is_the_border_of_the_field(end_m, crossed, code):
    wide = view(focal=1400.0)
    ends = (LineEnd(wide.project(np.array([[0.0, end_m]]))[0], crossed),)
    fit = camera_fit(wide, residuals_px={"centre_circle center": 0.3, "halfway_line": 0.3, "side_line_top": 0.5})
    found = verdict(fit, cues=Cues(replace(LINE, ends=ends), MARK))
    checks = [check for check in found.checks if check.name == "crossed_end_beyond"]
    assert len(checks) == (crossed and end_m < 0.0)
    assert all(check.passed == (code is None) for check in checks)
    assert found.code == code or (code is None and "crosses" not in (found.reason or ""))


@pytest.mark.parametrize("shape", ["roof", "parabola"])
def test_the_reach_of_the_halfway_line_is_that_on_the_crowned_and_grown_field(shape):
    wide, breadth_m = view(focal=1400.0), 3.0
    theta = np.zeros(len(PARAMETERS))
    theta[INDEX["breadth"]] = breadth_m
    surface = Surface(shape, 9.15, 0.12)
    fit = camera_fit(wide, surface=surface, parameters=PARAMETERS, theta=theta, covariance=np.eye(len(PARAMETERS)))
    half = (SOCCER.width_m + breadth_m) / 2
    seen = wide.project(surface.lift(np.linspace([0.0, -half], [0.0, half], 201)))
    fit = replace(fit, residuals_px=keyed({"side_line_top": 0.3, "side_line_bottom": 0.3}))
    found = verdict(fit, cues=Cues(replace(LINE, points_px=seen, sigma_px=np.full(201, 0.1)), MARK))
    reaches = [check.value for check in found.checks if check.name in {"line_reach", "other_end_reach"}]
    assert reaches == pytest.approx([0.95, 0.9, 0.9], abs=1e-6)  # of 95 % of the points


def test_the_gap_of_the_edges_is_that_on_the_crowned_field():
    """On its far side, which falls away from a low camera, the paint of a crowned field looks narrower."""
    low, surface = view(position=(4.0, 50.0, -5.0), focal=3000.0), Surface("parabola", 9.15, 0.05)
    angle = np.radians(np.linspace(215.0, 325.0, 300))
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    fits = {}
    for edge in ("outer", "inner"):
        points = low.project(surface.lift(SOCCER.radius(CIRCLE, edge) * ring))
        fits[edge] = fit_of(fit_conic(points), edge, points=points)
    found = verdict(camera_fit(low, surface=surface), fits=EllipseFits(fits["outer"], fits["inner"], None))
    assert found.check("narrowest_edge_gap").value == pytest.approx(1.0, abs=0.02)


def test_white_residuals_are_no_structure():
    assert verdict(camera_fit(residuals_px={"centre_circle center": 1.3})).status == "calibrated"


@pytest.mark.parametrize(
    ("inner_m", "code", "words"),
    [
        (9.03, None, None),
        (9.15 - 0.12 * 4, "edges_contradict", "far wider"),
        (9.15 - 0.12 * 0.3, "edges_contradict", "far narrower"),
    ],
)
def test_inner_against_outer_edge(inner_m, code, words):
    near = view(position=(4.0, 40.0, -22.0), focal=2300.0)
    inner = fit_of(transform_conic(near.homography, circle_conic((0.0, 0.0), inner_m)), "inner")
    fits = EllipseFits(fit_of(true_conic(near), "outer"), inner, None)
    found = verdict(camera_fit(near), fits=fits)
    assert found.code == code
    assert words is None or words in found.reason
    # blur drives the edges apart by up to 3 px at 1920 px width
    narrow, wide = (found.check(f"{name}_edge_gap").value for name in ("narrowest", "widest"))
    outer, own_inner = (near.project(r * UNIT_RING) for r in (9.15, 9.03))
    gap_px = np.median(np.linalg.norm(outer[:, None] - own_inner, axis=2).min(axis=1))
    assert narrow / wide == pytest.approx(1.0 + 3.0 * near.width / 1920.0 / gap_px, rel=0.03)


def test_limits_are_for_1920_px_of_width():
    """1280 px wide: two thirds of the limit."""
    just = 2.0 * 1280 / 1920
    assert verdict(camera_fit(residuals_px={"centre_circle outer": just - 0.01})).status == "calibrated"
    assert verdict(camera_fit(residuals_px={"centre_circle outer": just + 0.01})).status == "refused"


def test_a_circle_behind_the_camera():
    standing_in_it = replace(CAMERA, position_m=np.array([0.0, 5.0, -2.0]))
    found = verdict(camera_fit(standing_in_it))
    assert found.code == "circle_behind_camera"
    assert "behind the camera" in found.reason


def test_a_rejected_mark_is_not_held_against_the_camera():
    camera = camera_fit(residuals_px={"centre_mark": 90.0}, rejected=("centre_mark",))
    assert verdict(camera).status == "calibrated"


def test_a_rejected_mark_is_held_against_a_camera_that_does_not_explain_the_rest_either():
    noisy = camera_fit(rejected=("centre_mark",), noise_scale=3.7)
    assert verdict(noisy).code == "mark_contradicts_circle"
    assert verdict(camera_fit(rejected=("centre_mark",))).status == "calibrated"
    assert verdict(replace(noisy, noise_scale=2.1)).code == "mark_contradicts_circle"
    assert verdict(replace(noisy, noise_scale=1.9)).status == "calibrated"


def test_a_rejected_mark_far_from_where_circle_and_line_put_it_is_held_against_them():
    """Of a picture that was cut out of a larger one circle and line explain everything, with another camera."""
    rejected = camera_fit(rejected=("centre_mark",))
    limit_px = CONFIG.max_mark_distance_px * CAMERA.width / 1920.0
    for off_px, code in ((0.9 * limit_px, None), (1.1 * limit_px, "mark_contradicts_circle")):
        seen = replace(MARK, point_px=MARK.point_px + np.array([0.0, off_px]))
        assert verdict(rejected, cues=Cues(LINE, seen)).code == code
        known = camera_fit(rejected=("centre_mark",), named_lines=("side_line_top",))
        assert verdict(known, cues=Cues(LINE, seen)).status == "calibrated"
    with_lines = camera_fit(rejected=("centre_mark",), noise_scale=3.7, named_lines=("side_line_top",))
    assert verdict(with_lines).status == "calibrated"


def test_other_lines_and_other_circles_are_no_gate():
    residuals = {"side_line_top": 9.0, "penalty_arc_left outer": 9.0}
    assert verdict(camera_fit(residuals_px=residuals)).status == "calibrated"


def test_homography_without_a_camera():
    H = CAMERA.homography
    assert verdict(homography=homography_fit(H)).status == "calibrated"
    beside = np.array([[1.0, 0, 6.0], [0, 1, 0], [0, 0, 1]]) @ H
    refused = verdict(homography=homography_fit(beside))
    assert refused.code == "residual_too_large"
    assert "does not lie on the paint" in refused.reason


def solved(cues):
    """The attempt of a published solver: a homography, no camera."""
    judged = Verdict("calibrated", None, None, None)
    return Attempt(ellipses=fits_of(CAMERA), cues=cues, homography=homography_fit(CAMERA.homography), verdict=judged)


def test_a_solvers_second_circle_is_confirmed_by_what_lies_where_its_homography_puts_it():
    def confirmed(cues):
        return is_confirmed(solved(cues), SOCCER, CIRCLE, NEAR_PX)

    assert confirmed(Cues(LINE, MARK))
    assert not confirmed(Cues(LINE, replace(MARK, point_px=MARK.point_px + np.array([20.0, 0.0]))))
    seen = []
    for name in ("side_line_top", "side_line_bottom"):
        start, end = SOCCER.line_ends(SOCCER.line_by_name[name])
        points = CAMERA.project(np.linspace(0.45, 0.55, 30)[:, None] * (end - start) + start)
        seen.append(replace(LINE, name=None, points_px=points, sigma_px=np.full(30, 0.1)))
    assert confirmed(Cues(LINE, None, tuple(seen)))
    assert not confirmed(Cues(LINE, None, tuple(seen[:1])))
    moved = tuple(replace(cue, points_px=cue.points_px + np.array([0.0, 30.0])) for cue in seen)
    assert not confirmed(Cues(LINE, None, moved))
    assert not confirmed(Cues(LINE, None))
    assert not is_confirmed(Attempt(), SOCCER, CIRCLE, NEAR_PX)


def test_nothing_estimated():
    found = verdict()
    assert (found.status, found.code, found.stage) == ("refused", "no_homography", "verdict")
    assert found.checks == ()


def test_a_marking_that_lies_elsewhere_confirms_nothing():
    bare = Cues(LINE, None)
    off = camera_fit(named_lines=("side_line_top",), residuals_px={"centre_circle outer": 0.3, "side_line_top": 2.0})
    assert verdict(off, cues=bare, confidence=TENTATIVE).code == "circle_unconfirmed"


def test_the_paint_of_a_wide_circle_may_wander_by_a_share_of_its_width():
    """A residual that is too large for paint of a few pixels is none where the paint is a hundred times as wide."""
    camera = camera_fit(residuals_px={"centre_circle center": 3.0})
    attempt = Attempt(None, ellipses=fits_of(CAMERA), cues=Cues(LINE, MARK), camera=camera)
    wide = SOCCER.model_copy(update={"marking_width_m": 2.5})
    limits = [
        judge(attempt, field, CIRCLE, CAMERA.width, CONFIG).check("circle_residual_px").limit
        for field in (SOCCER, wide)
    ]
    assert limits[0] == pytest.approx(CONFIG.max_circle_residual_px * CAMERA.width / 1920.0)
    assert limits[1] > 3.0


@pytest.mark.parametrize(("off_px", "status"), [(1.3, "calibrated"), (1.9, "refused")])
def test_a_circle_may_lie_beside_its_place_as_painters_put_it(off_px, status):
    """Where other markings hold the camera, all of the circle lies as far off, which is no noise of its points."""
    told = {MarkingKey("centre_circle", "center"): 0.8}
    given = {"residuals_px": {"centre_circle center": off_px}, "residual_correlation": 100.0}
    assert verdict(camera_fit(**given, painted_sigma_px=told)).status == status
    assert verdict(camera_fit(**given)).status == "refused"


@pytest.mark.parametrize(
    ("x_m", "names", "halfway", "is_refused"),
    [
        (5.5, {}, None, True),
        (5.5, {0: "big_rect_left_main"}, None, False),
        (7.2, {}, None, True),  # 0.6 radii of it lie inside the circle, clear of its rim
        (7.5, {}, None, False),  # 0.45 radii
        (8.5, {}, None, False),
        (5.5, {}, LINE, False),
    ],
)
def test_a_circle_with_another_straight_marking_through_it_is_a_penalty_arc(x_m, names, halfway, is_refused):
    chord_px = CAMERA.project(np.stack([np.full(60, x_m), np.linspace(-12.0, 12.0, 60)], axis=-1))
    chord = replace(LINE, name=None, points_px=chord_px, sigma_px=np.full(60, 0.3))
    found = verdict(camera_fit(names_by_line=names), cues=Cues(halfway, None, (chord,)))
    assert (found.code == "paint_unexplained") == is_refused


@pytest.mark.parametrize(
    ("changes", "fails"),
    [
        ({}, None),
        ({"max_sigma_px": 1.01 * CONFIG.max_sigma_px * CAMERA.width / 1920.0}, "sigma_px"),
        ({"mean_sigma_px": 1.01 * CONFIG.max_mean_sigma_px * CAMERA.width / 1920.0}, "mean_sigma_px"),
        ({"max_sigma_m": 1.01 * CONFIG.max_sigma_m}, "sigma_m"),
    ],
)
def test_a_camera_that_became_too_uncertain_since_is_refused(changes, fails):
    before = verdict(camera_fit())
    camera = camera_fit(**{"max_sigma_px": 3.0, "mean_sigma_px": 1.5, "max_sigma_m": 0.2} | changes)
    after = renew_sigmas(before, camera)
    assert (before.status, after.status) == ("calibrated", "calibrated" if fails is None else "refused")
    if fails is not None:
        assert (after.code, after.stage) == (CHECKS[fails].code, "verdict")
    told = {check.name: check.value for check in after.checks if "sigma" in check.name}
    assert told == {
        "sigma_px": camera.max_sigma_px,
        "mean_sigma_px": camera.mean_sigma_px,
        "sigma_m": camera.max_sigma_m,
    }
    assert [(c.name, c.limit) for c in after.checks] == [(c.name, c.limit) for c in before.checks]
    assert [c.name for c in after.checks if not c.passed] == ([] if fails is None else [fails])


def test_a_refused_frame_keeps_its_reason_when_its_camera_becomes_less_certain():
    before = verdict(camera_fit(residuals_px={"centre_circle outer": 30.0}))
    after = renew_sigmas(before, camera_fit(max_sigma_px=1e6))
    assert (after.status, after.code) == ("refused", before.code)
    assert before.code != CHECKS["sigma_px"].code
    assert not after.check("sigma_px").passed
