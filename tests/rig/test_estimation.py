"""Which frames belong to one camera, and what they share."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera.priors import SharedPrior
from circlecal.config import Config, suit_pixels
from circlecal.geometry.camera_parameters import INDEX, ProjectionModel, camera_of
from circlecal.geometry.homography import SIDES
from circlecal.geometry.surface import Surface
from circlecal.observations import Keypoint, LinePoints
from circlecal.rig import estimation
from circlecal.rig.estimation import (
    config_with_prior,
    estimate_rigs,
    find_opposite,
    find_opposite_line,
    problem_of_frame,
    restore_names,
    select_frames,
    summarise_shared,
    turn_names,
    with_told_relief,
)
from circlecal.rig.frames import RigFrame
from circlecal.synthetic.cameras import aim_camera

from .scenes import (
    CIRCLE,
    CONFIG,
    TEMPLATE,
    calibrated,
    calibrated_before_touchline,
    displaced,
    goal_views,
    main_views,
)


def rigs_of(frames, config=CONFIG, cameras=None):
    return estimate_rigs(frames, TEMPLATE, CIRCLE, config, cameras)


def position_of(rig):
    """Position (3,) and its standard deviations (3,), metres."""
    values = summarise_shared(rig)
    return np.array([values[name] for name in ("x", "y", "z")]).T


@pytest.fixture(scope="module")
def mixed():
    """Five frames of a main camera and three from behind the goal, and both cameras."""
    rng = np.random.default_rng(0)
    main, goal = main_views(5, rng), goal_views(3, rng)
    frames = [calibrated(f"m{k}", c, rng) for k, c in enumerate(main)]
    frames += [calibrated(f"g{k}", c, rng) for k, c in enumerate(goal)]
    return frames, main[0], goal[0]


@pytest.fixture(scope="module")
def mixed_rigs(mixed):
    """What these frames share."""
    return rigs_of(mixed[0])


def test_two_cameras_are_told_apart(mixed, mixed_rigs):
    frames, main, goal = mixed
    first, second = mixed_rigs
    assert first.members == first.used == tuple(f"m{k}" for k in range(5))
    assert second.used == tuple(f"g{k}" for k in range(3))
    for rig, camera in ((first, main), (second, goal)):
        position, sigma = position_of(rig)
        assert (np.abs(position - camera.position_m) < 4 * sigma + 0.05).all()
        alone = np.mean([np.sqrt(np.trace(f.covariance[4:7, 4:7])) for f in frames if f.id in rig.used])
        assert np.linalg.norm(sigma) < 0.8 * alone


def test_a_wrong_frame_that_is_sure_of_itself_joins_nobody(mixed, mixed_rigs):
    frames = mixed[0]
    wrong = displaced(replace(frames[0], id="w"), (9.0, 30.0, -9.0), 0.05)
    rigs = rigs_of([*frames, wrong])
    assert [rig.used for rig in rigs] == [rig.used for rig in mixed_rigs]
    np.testing.assert_allclose(position_of(rigs[0])[0], position_of(mixed_rigs[0])[0])


def test_a_frame_of_another_camera_that_is_taken_in_does_not_drag_the_others(mixed, mixed_rigs):
    frames, main, _ = mixed
    rng = np.random.default_rng(5)
    near = replace(main, position_m=main.position_m + np.array([5.0, 0.0, 0.0]))
    near = replace(near, angles_rad=near.angles_rad - np.array([np.arctan2(5.0, near.position_m[1]), 0.0, 0.0]))
    vague = displaced(calibrated("w", near, rng), (0.0, 0.0, 0.0), 10.0)
    (first, *_), (clean, *_) = rigs_of([*frames, vague]), mixed_rigs
    assert "w" in first.members
    assert first.left_out == ("w",)
    np.testing.assert_allclose(position_of(first)[0], position_of(clean)[0], atol=1e-3)


def test_too_few_frames_are_no_camera(mixed):
    frames, _, _ = mixed
    assert rigs_of([]) == []
    assert rigs_of(frames[:1]) == []
    assert rigs_of([RigFrame("x", None, None, None)]) == []
    alone = CONFIG.model_copy(update={"rig": CONFIG.rig.model_copy(update={"least_frames": 1})})
    assert [rig.used for rig in rigs_of(frames[:1], alone)] == [("m0",)]


def test_no_more_frames_are_estimated_together_than_are_asked_for(mixed):
    frames, main, _ = mixed
    few = CONFIG.model_copy(update={"rig": CONFIG.rig.model_copy(update={"maximum_frames": 3})})
    (rig,) = rigs_of([frame for frame in frames if frame.id.startswith("m")], few)
    assert len(rig.used) == 3
    assert np.abs(position_of(rig)[0] - main.position_m).max() < 3.0


def test_cameras_that_are_given_are_not_guessed(mixed):
    frames, _, _ = mixed
    rigs = rigs_of(frames, cameras={"m0": "stand", "m1": "stand", "m2": "other", "g0": "goal", "g1": "goal"})
    assert {rig.name: rig.used for rig in rigs} == {"stand": ("m0", "m1"), "goal": ("g0", "g1")}


def test_turned_fields_agree(mixed):
    frames, _, goal = mixed
    own = [f for f in frames if f.id.startswith("g")]
    turned = replace(own[0], theta=own[0].turn_field())
    (rig,) = rigs_of([turned, *own[1:]])
    assert rig.used == ("g0", "g1", "g2")
    position, sigma = position_of(rig)
    apart = np.minimum(np.abs(position - goal.position_m), np.abs(position * [-1, -1, 1] - goal.position_m))
    assert (apart < 4 * sigma + 0.05).all()


def test_everything_that_is_named_turns_with_the_field(mixed):
    """The right camera explains a frame alike from either side, whatever a person has named in it."""
    frame = mixed[0][0]
    camera = camera_of(frame.theta, ProjectionModel(1920, 1080, Surface("flat")))
    place = np.array([6.0, 8.0])
    line = TEMPLATE.line_by_name["side_line_bottom"]
    points = camera.project(np.linspace(*TEMPLATE.line_ends(line), 300))
    points = points[((points > 0) & (points < (1920, 1080))).all(axis=1)]
    seen = replace(
        frame.observations,
        lines=(*frame.observations.lines, LinePoints(line.name, points, np.full(len(points), 0.3))),
        keypoints=(Keypoint("k", place, camera.project(place[None])[0], 0.5, np.ones((3, 2))),),
    )
    frame = replace(frame, observations=seen)

    def cost(turned):
        theta = frame.turn_field() if turned else frame.theta
        problem = problem_of_frame(frame, theta, TEMPLATE, CIRCLE, CONFIG, turned=turned, grown=False)
        return estimation._cost_alone(problem, theta)

    assert cost(True) == pytest.approx(cost(False), rel=1e-3)
    turned = turn_names(seen, TEMPLATE)
    assert turned.lines[-1].line == "side_line_top"
    np.testing.assert_array_equal(turned.keypoints[0].shift, -np.ones((3, 2)))
    assert find_opposite("penalty_arc_left", TEMPLATE) == "penalty_arc_right"
    assert find_opposite("penalty_mark_left", TEMPLATE) == "penalty_mark_right"
    assert find_opposite("nothing", TEMPLATE) == "nothing"


def test_the_best_frames_of_every_zoom_come_first(mixed):
    frame = mixed[0][0]

    def like(zoom, sd):
        theta, covariance = frame.theta.copy(), frame.covariance.copy()
        theta[0], covariance[4:7, 4:7] = zoom, sd**2 * np.eye(3)
        return replace(frame, theta=theta, covariance=covariance)

    frames = [like(7.0, 0.1), like(7.0, 0.2), like(7.01, 0.3), like(9.0, 5.0), like(8.0, 1.0)]
    assert select_frames(frames, 3) == [0, 3, 4]
    assert select_frames(frames, 4) == [0, 1, 3, 4]
    assert select_frames(frames, 9) == [0, 1, 2, 3, 4]


def test_configuration_of_a_frame_knows_the_side(mixed_rigs):
    for rig, side in zip(mixed_rigs, ("main", "left_goal"), strict=True):
        config = config_with_prior(CONFIG, rig.prior(), 1920)
        assert config.correspondences.camera_side == side
        assert side in SIDES
        assert config.camera.shared is not None


def test_lines_of_the_turned_field():
    assert find_opposite_line("halfway_line", TEMPLATE) == "halfway_line"
    other = {find_opposite_line(line.name, TEMPLATE) for line in TEMPLATE.lines}
    assert other == {line.name for line in TEMPLATE.lines}
    for line in TEMPLATE.lines:
        assert find_opposite_line(find_opposite_line(line.name, TEMPLATE), TEMPLATE) == line.name


def test_recognised_lines_get_their_names_back(mixed):
    frame = mixed[0][0]
    seen = frame.observations
    bare = replace(seen, lines=(LinePoints(None, seen.lines[0].points_px, seen.lines[0].sigma_px),))
    model = ProjectionModel(1920, 1080, Surface("flat"))
    assert restore_names(bare, ["halfway_line"], frame.theta, TEMPLATE, model).lines[0].line == "halfway_line"
    far = replace(bare, lines=(replace(bare.lines[0], points_px=bare.lines[0].points_px + 80.0),))
    assert restore_names(far, ["halfway_line"], frame.theta, TEMPLATE, model).lines[0].line is None


@pytest.mark.parametrize("is_turned", [False, True])
def test_two_cameras_side_by_side_are_told_apart(mixed, is_turned):
    frames, main, _ = mixed
    rng = np.random.default_rng(12)
    step = np.array([4.0, 0.0, 0.0])
    views = [replace(c, position_m=c.position_m + step) for c in main_views(3, np.random.default_rng(0))]
    views = [
        replace(c, angles_rad=c.angles_rad - np.array([np.arctan2(step[0], c.position_m[1]), 0.0, 0.0])) for c in views
    ]
    near = [displaced(calibrated(f"n{k}", c, rng), (0.0, 0.0, 0.0), 3.0) for k, c in enumerate(views)]
    if is_turned:
        near[0] = replace(near[0], theta=near[0].turn_field())
    ours = [f for f in frames if f.id.startswith("m")]
    vague = [displaced(f, (0.0, 0.0, 0.0), 3.0) for f in ours]
    rigs = rigs_of([*vague, *near])
    assert [rig.used for rig in rigs] == [tuple(f"m{k}" for k in range(5)), ("n0", "n1", "n2")]
    for rig, camera in zip(rigs, (main, views[0]), strict=True):
        assert position_of(rig)[0] == pytest.approx(camera.position_m, abs=2.5)


@pytest.mark.parametrize(
    ("crown_m", "sd_m", "is_even"), [(0.0, 0.005, True), (0.05, 0.005, False), (0.05, 0.03, False)]
)
def test_marks_lie_on_even_ground_where_the_frames_show_a_flat_field(crown_m, sd_m, is_even):
    frames = SharedPrior(("crown",), (), 7.5, np.array([crown_m]), np.array([[sd_m**2]]), np.zeros(1))
    usual = Config()
    told = with_told_relief(usual, frames)
    assert (told is not usual) == is_even
    assert told.camera.relief_m == pytest.approx(usual.camera.relief_m / 3 if is_even else usual.camera.relief_m)


def test_a_camera_whose_frames_agree_on_uneven_ground_alone_is_kept(mixed, monkeypatch):
    told = CONFIG.model_copy(update={"camera": CONFIG.camera.model_copy(update={"relief_m": 0.0})})
    fit = estimation._fit_problems
    monkeypatch.setattr(estimation, "with_told_relief", lambda config, prior: told)
    monkeypatch.setattr(
        estimation, "_fit_problems", lambda *given: fit(*given) if given[-1].camera.relief_m > 0.0 else None
    )
    assert [rig.used for rig in rigs_of([f for f in mixed[0] if f.id.startswith("g")])] == [("g0", "g1", "g2")]


@pytest.mark.parametrize("first_count", [2, 3])
def test_a_camera_is_that_of_most_frames_whichever_were_left_out_first(first_count, mixed, monkeypatch):
    """Five frames of one camera, of which the joint fit holds some and then the others for the wrong ones."""
    frames = mixed[0][:5]
    first, rest = ("m0", "m1", "m2", "m3", "m4")[:first_count], ("m0", "m1", "m2", "m3", "m4")[first_count:]
    begun = [rigs_of([f for f in frames if f.id in names])[0] for names in (first, rest)]
    answers = iter([replace(begun[0], left_out=rest), begun[1]])
    monkeypatch.setattr(estimation, "_estimate_rig", lambda *given: next(answers))
    (rig,) = rigs_of(frames)
    larger, smaller = (first, rest) if first_count == 3 else (rest, first)
    assert (rig.used, rig.left_out) == (larger, smaller)
    assert rig.members == ("m0", "m1", "m2", "m3", "m4")


@pytest.mark.parametrize("width_m", [50.0, 60.0, 86.0])
def test_a_pitch_of_another_width_is_known_as_such(width_m):
    rng = np.random.default_rng(4)
    place = np.array([2.0, 75.0, -18.0])
    views = [aim_camera(place, np.array([x, -12.0, 0.0]), 2400.0, 0.01, 1920, 1080, 0.03) for x in (-6.0, -2, 2, 6)]
    frames = [calibrated_before_touchline(f"f{k}", view, rng, width_m) for k, view in enumerate(views)]
    (rig,) = rigs_of(frames)
    assert len(rig.used) == 4
    mean, sd = summarise_shared(rig)["breadth"]
    assert abs(mean - (width_m - TEMPLATE.width_m)) < 3 * sd + 0.1
    position, sigma = position_of(rig)
    assert (np.abs(position - place) < 4 * sigma + 0.05).all()


def test_a_pitch_of_the_usual_width_is_kept_where_one_frame_alone_has_another():
    rng = np.random.default_rng(5)
    place = np.array([2.0, 75.0, -18.0])
    views = [aim_camera(place, np.array([x, -12.0, 0.0]), 2400.0, 0.01, 1920, 1080, 0.03) for x in (-6.0, -2, 2, 6)]
    frames = [calibrated_before_touchline(f"f{k}", view, rng, TEMPLATE.width_m) for k, view in enumerate(views)]
    theta = frames[0].theta.copy()
    theta[INDEX["breadth"]] = 5.0
    (rig,) = rigs_of([replace(frames[0], theta=theta), *frames[1:]])
    mean, sd = summarise_shared(rig)["breadth"]
    assert abs(mean) < 1.0
    assert sd <= TEMPLATE.width_sd_m


def test_a_frame_has_pixels_of_the_shape_that_its_file_tells(mixed):
    frame = mixed[0][0]
    stored = replace(frame, aspect=4 / 3)
    for config, aspect in ((CONFIG, 4 / 3), (suit_pixels(CONFIG, 1.2), 1.2)):
        problem = problem_of_frame(stored, frame.theta, TEMPLATE, CIRCLE, config)
        assert problem.priors.mean[INDEX["log_aspect"]] == pytest.approx(np.log(aspect))
        assert problem.priors.sd[INDEX["log_aspect"]] == 0.0
