"""What painters' errors, which all frames of a clip have in common, leave open of tripods and of answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.config import load_config
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import INDEX, project
from circlecal.rig.tripod import COMMON, PLACE, PaintersShare, TripodEstimate
from circlecal.tracking.answers import SigmaLimits, answer_shot
from circlecal.tracking.entry import Entry
from circlecal.tracking.frame_paint import PART_M, HeadedFrame
from circlecal.tracking.looking import LookedAt, Place
from circlecal.tracking.markings import DrawnTemplate, grow_places, template_curves
from circlecal.tracking.painters import align_errors, move_by_errors, name_errors
from circlecal.tracking.results import TrackedFrame
from circlecal.tracking.tripod_fit import common_priors, fit_tripod
from circlecal.tracking.tripod_problem import BEYOND_PARTS, TripodProblem, TripodState
from tests.tracking.scenes import HEAD, SIZE, draw, measure_ideal, template, tripod

PAINTED = replace(template_curves(template()), placement_sd_m=0.05, radius_sd_m=0.03)
"""A soccer pitch whose painters err as those of a rink do."""
HEADS = [np.array([np.log(2000.0 + 30.0 * k), pan, 1.38]) for k, pan in enumerate(np.linspace(0.1, -0.5, 6))]


def paint_beside(frame: HeadedFrame, drawn: DrawnTemplate, errors: NDArray[np.float64]) -> HeadedFrame:
    """What a frame shows where painters have made errors (E,), in their standard deviations."""
    model = tripod().model
    theta = model.thetas(frame.head[None], tripod().mean)[0]
    away = move_by_errors(frame.measured, drawn, theta, model.projection) @ errors
    seen = frame.measured
    points = seen.points_px + away[:, None] * seen.normals
    return replace(frame, measured=replace(seen, points_px=points))


@pytest.fixture(scope="module")
def frames() -> list[HeadedFrame]:
    rng = np.random.default_rng(4)
    seen = [measure_ideal(head, np.zeros(2), 0.1, rng) for head in HEADS]
    return [HeadedFrame(str(k), head, m) for k, (head, m) in enumerate(zip(HEADS, seen, strict=True))]


def fit(frames: list[HeadedFrame], drawn: DrawnTemplate = PAINTED) -> TripodEstimate:
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    sd[PLACE["width"]] = 0.0
    return fit_tripod(frames, tripod(), mean, sd, drawn, parts_m=PART_M).estimate


def test_errors_move_the_paint_as_they_move_the_markings(frames: list[HeadedFrame]) -> None:
    seen, model = frames[0].measured, tripod().model
    theta = model.thetas(HEADS[0][None], tripod().mean)[0]
    names, moves = name_errors(PAINTED), move_by_errors(seen, PAINTED, theta, model.projection)

    def pixels(drawn: DrawnTemplate, field_m: NDArray[np.float64]) -> NDArray[np.float64]:
        places = grow_places(drawn, seen.marking, field_m, theta)
        return np.asarray(project(theta[None], places[None], model.projection).pixels[0])

    usual = pixels(PAINTED, seen.field_m)
    for name, change in (("centre_circle x", (0.05, 0.0)), ("halfway_line y", (0.0, 0.05))):
        is_of = seen.marking == PAINTED.names.index(name.split()[0])
        moved = pixels(PAINTED, seen.field_m + np.where(is_of[:, None], change, 0.0))
        np.testing.assert_allclose(
            ((moved - usual) * seen.normals).sum(axis=1), moves[:, names.index(name)], atol=2e-3, rtol=0.01
        )
        assert is_of.any()
    # the circle and both penalty arcs are drawn with one compass
    (compass,) = (name for name in names if name.startswith("radius 9."))
    drawn_larger = seen.field_m - PAINTED.center[seen.marking]
    is_round = PAINTED.radius[seen.marking] > 9.0
    outward = np.where(
        is_round[:, None], drawn_larger / np.maximum(np.linalg.norm(drawn_larger, axis=1), 1.0)[:, None], 0.0
    )
    moved = pixels(PAINTED, seen.field_m + 0.03 * outward)
    np.testing.assert_allclose(((moved - usual) * seen.normals).sum(axis=1), moves[:, names.index(compass)], atol=2e-3)


def test_a_tripod_follows_errors_as_it_is_told_to(frames: list[HeadedFrame]) -> None:
    usual = fit(frames)
    assert usual.painters is not None
    names, sd = name_errors(PAINTED), np.sqrt(np.diag(usual.whole_covariance))
    strongest = sorted(usual.painters.by_errors.items(), key=lambda item: -np.abs(item[1]).max())[:3]
    for name, follows in strongest:
        moved = fit([paint_beside(frame, PAINTED, np.eye(len(names))[names.index(name)]) for frame in frames])
        free = sd > 0.0
        np.testing.assert_allclose((moved.mean - usual.mean)[free] / sd[free], follows[free] / sd[free], atol=0.1)
    assert max(np.abs(follows[free] / sd[free]).max() for _, follows in strongest) > 0.4


def test_the_truth_is_off_as_far_as_painters_leave_it_open(frames: list[HeadedFrame]) -> None:
    rng, usual = np.random.default_rng(12), fit(frames)
    drawn = rng.normal(size=(60, len(name_errors(PAINTED))))
    off = [fit([paint_beside(frame, PAINTED, errors) for frame in frames]).mean - usual.mean for errors in drawn]
    at = [PLACE[name] for name in ("axis_x", "axis_y", "axis_z", "crown", "length", "breadth")]
    scatter = np.std(off, axis=0)[at]
    told = scatter / np.sqrt(np.diag(usual.whole_covariance))[at]
    assert told.min() > 0.7 and told.max() < 1.4
    noise_alone = scatter / np.sqrt(np.diag(usual.covariance))[at]
    assert noise_alone.min() > 5.0


def test_no_errors_are_told_of_a_field_whose_painters_make_none(frames: list[HeadedFrame]) -> None:
    drawn = template_curves(load_field("soccer"))
    assert name_errors(drawn) == () and fit(frames, drawn).painters is None
    assert len(name_errors(template_curves(load_field("ice-hockey-nhl")))) > 0


def test_errors_are_known_by_their_names() -> None:
    follows = np.arange(len(COMMON), dtype=np.float64)
    camera = replace(
        tripod(), painters=PaintersShare(tripod().covariance, {"halfway_line y": follows, "rope x": follows})
    )
    found = align_errors(camera, PAINTED)
    assert found.shape == (len(COMMON), len(name_errors(PAINTED)))
    np.testing.assert_array_equal(found[:, name_errors(PAINTED).index("halfway_line y")], follows)
    assert np.count_nonzero(found.any(axis=0)) == 1
    assert not align_errors(None, PAINTED).any() and not align_errors(tripod(), PAINTED).any()


@pytest.fixture(scope="module")
def picture() -> LookedAt:
    return LookedAt.of(draw(HEAD, np.random.default_rng(1)), load_config().mask)


def answer(picture: LookedAt, moved_m: float) -> TrackedFrame:
    """The answer of a frame whose camera is thought to stand farther off, the farther a line is beside its place."""
    follows = np.zeros(len(COMMON))
    follows[PLACE["axis_y"]] = moved_m
    camera = replace(tripod(), painters=PaintersShare(tripod().covariance, {"halfway_line y": follows}))
    place = Place.of(camera, template().model_copy(update={"placement_sd_m": 0.05}))
    look = place.look(picture, HEAD, np.diag(np.square([0.005, 0.002, 0.002])))
    entry = Entry(0, 0.0, SIZE, 0, place, HEAD, np.eye(3) * 1e8, np.zeros(3), np.zeros((3, len(COMMON))))
    entry.take(look, HEAD, np.eye(3))
    (frame,) = answer_shot([entry], 1, SigmaLimits.of(load_config().verdict))
    return frame


def test_painters_widen_an_answer_and_refuse_none(picture: LookedAt) -> None:
    usual = answer(picture, 0.0)
    for moved_m in (0.1, 5.0):
        frame = answer(picture, moved_m)
        assert frame.status == usual.status == "calibrated"
        for check, without in zip(frame.checks, usual.checks, strict=True):
            assert check.value == pytest.approx(without.value, rel=0.01)
        assert frame.view is not None and frame.view.covariance is not None
        assert np.sqrt(frame.view.covariance[INDEX["y"], INDEX["y"]]) == pytest.approx(
            np.hypot(0.01, moved_m), rel=0.05
        )
        assert frame.sigma_m is not None and usual.sigma_m is not None and frame.sigma_m > usual.sigma_m


def problem_of(frames: list[HeadedFrame], prior_sd: float) -> tuple[TripodProblem, TripodState]:
    """Frames of a tripod that is known so well, at the tripod."""
    mean, precision = tripod().mean, np.eye(len(COMMON)) / prior_sd**2
    free = np.array([PLACE[name] for name in ("axis_x", "axis_y", "axis_z", "lean_x", "lever")])
    problem, heads, common = TripodProblem.of(frames, tripod(), PAINTED, mean, precision, free, 1.0)
    return problem, problem.evaluate(heads, common, 2.0)


def test_a_tripod_that_is_known_follows_errors_as_what_is_known_of_it_does(frames: list[HeadedFrame]) -> None:
    known = np.random.default_rng(3).normal(size=(len(COMMON), len(name_errors(PAINTED))))
    problem, at = problem_of(frames, 1e-9)
    follows = problem.follow_errors(at, 2.0, known)
    np.testing.assert_allclose(follows[problem.free], known[problem.free], atol=1e-3)


def test_paint_that_is_off_by_painters_errors_has_no_greater_spread(frames: list[HeadedFrame]) -> None:
    rng, nothing = np.random.default_rng(7), np.zeros((len(COMMON), len(name_errors(PAINTED))))
    spread = []
    for _ in range(20):
        errors = rng.normal(size=len(name_errors(PAINTED)))
        problem, at = problem_of([paint_beside(frame, PAINTED, errors) for frame in frames], 1e-9)
        spread.append([problem.measure_spread(at, 2.0, PART_M, by_errors) for by_errors in (None, nothing)])
    without, told = np.mean(spread, axis=0)
    assert 0.5 * BEYOND_PARTS < told < 2.0 * BEYOND_PARTS
    assert without > 5.0 * told
