"""The survey of a clip whose camera is known from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.config import load_config
from circlecal.field.view import FieldView
from circlecal.formats.annotation import AnnotatedMarking, Annotation
from circlecal.observations import Observations
from circlecal.pictures.video import Sampling, Video
from circlecal.pipeline import run_observations
from circlecal.rig.tripod import PLACE, Venue
from circlecal.tracking import first_look, survey
from circlecal.tracking.head_fit import HeadFit
from circlecal.tracking.looking import Look, LookedAt
from circlecal.tracking.markings import template_curves
from circlecal.tracking.stretches import ClipRun, survey_video
from circlecal.tracking.survey import survey_clip
from circlecal.tracking.tripod_fit import HeadedFrame, common_priors, count_alike, fit_tripod
from tests.tracking.scenes import HEAD, SIZE, draw, measure_ideal, template, tripod


def _marking(view: FieldView, name: str) -> AnnotatedMarking:
    """What a person would click of a line: places of it in the picture, each half a pixel off at most."""
    points = view.project(view.markings(template())[name])
    inside = points[(points > 5.0).all(axis=1) & (points < np.array(SIZE) - 5.0).all(axis=1)]
    clicked = inside[np.linspace(0, len(inside) - 1, 8).astype(int)].round()
    pairs = clicked.tolist()
    return AnnotatedMarking(name=name, kind="line", points_px=pairs, sigma_px=[0.5] * 8, source="clicked")


def test_what_is_known_of_a_camera_stays_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(survey, "ROUNDS", 1)
    pictures = [draw(HEAD + np.array([0.0, 0.004 * k, 0.0]), np.random.default_rng(k)) for k in range(2)]
    venue = survey_clip(lambda times: iter(pictures[: len(times)]), 1.2, load_config(), Venue("soccer", (tripod(),)))
    (found,) = venue.tripods
    assert len(found.used) == 2
    # two views of a penalty area do not tell the axis's place by themselves
    off = np.abs(found.mean[:3] - tripod().mean[:3])
    assert off.max() < 3.0 * 0.01
    assert (np.sqrt(np.diag(found.covariance)[:3]) < 3.0 * 0.01 + 1e-6).all()


def test_tripods_in_one_place_are_one() -> None:
    first, second, other = (replace(tripod(), name=name) for name in ("camera-1", "camera-2", "camera-3"))
    second = replace(second, mean=second.mean + np.eye(len(second.mean))[1] * 0.3, used=("a", "b"))
    other = replace(other, mean=other.mean + np.eye(len(other.mean))[0] * 5.0)
    assert [t.name for t in survey._keep_distinct([first, second, other])] == ["camera-2", "camera-3"]


def test_tripods_that_come_together_once_the_pitch_is_known_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    true = tripod()
    apart = replace(true, name="camera-2", mean=true.mean + np.eye(len(true.mean))[0] * 5.0)
    monkeypatch.setattr(survey, "_tripods", lambda *_: [(true, {}), (apart, {})])
    monkeypatch.setattr(survey, "_extend", lambda found, *_: (found, []))
    monkeypatch.setattr(survey, "_learn_between", lambda found, *_: replace(found, mean=true.mean))
    assert len(survey_clip(lambda times: iter(()), 4.0, load_config()).tripods) == 1


def test_one_frame_that_a_person_named_makes_a_camera(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(survey, "ROUNDS", 1)
    heads = [HEAD + np.array([0.0, 0.004 * k, 0.0]) for k in range(2)]
    pictures = [draw(head, np.random.default_rng(k)) for k, head in enumerate(heads)]
    path = tmp_path / "clip.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10, width=SIZE[0], height=SIZE[1], pix_fmt="yuv420p")
        stream.bit_rate = 20_000_000
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode(None))
    view = tripod().view(heads[1], np.zeros((3, 3)))
    names = ("side_line_left", "big_rect_left_main", "small_rect_left_main", "big_rect_left_top", "side_line_bottom")
    markings = [_marking(view, name) for name in names]
    named = Annotation(id="clip_00-00-00.100", width=SIZE[0], height=SIZE[1], touched=True, markings=markings)
    (tmp_path / "named").mkdir()
    (tmp_path / "named" / "clip_00-00-00.100.json").write_text(named.model_dump_json())
    video = Video.open(path, "clip")
    refused = run_observations(Observations(*SIZE), load_config(), frame_id="refused")
    monkeypatch.setattr(first_look, "calibrate_image", lambda picture, config, frame_id: refused)
    alone = ClipRun(load_config(), Sampling.parse("1"), annotations=tmp_path / "nobody")
    told = replace(alone, annotations=tmp_path / "named")
    assert alone.digest != told.digest
    assert not survey_video(alone, video).tripods
    (found,) = survey_video(told, video).tripods
    assert np.abs(found.mean[:3] - tripod().mean[:3]).max() < 3.0


def _views_of_a_pitch(length_m: float, width_m: float) -> list[HeadedFrame]:
    """Circle and penalty area of a pitch of any size, with the noise of a good picture and nothing that joins them."""
    growth = np.array([length_m - template().length_m, width_m - template().width_m])
    rng = np.random.default_rng(5)
    pans = (0.0, -0.02, -0.42, -0.44)
    heads = [np.array([np.log(2600.0 + 60.0 * k), pan, 1.38]) for k, pan in enumerate(pans)]
    return [HeadedFrame(str(k), head, measure_ideal(head, growth, 0.1, rng)) for k, head in enumerate(heads)]


@pytest.mark.parametrize("size_m", [(117.0, 48.0), (94.8, 70.7), (105.0, 68.0)])
def test_a_pitch_may_have_any_size(size_m: tuple[float, float]) -> None:
    frames = _views_of_a_pitch(*size_m)
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE[0] / 1920.0)
    start = replace(tripod(), mean=tripod().mean + np.where(np.arange(len(mean)) < 3, 0.2, 0.0))
    fit = survey._choose_shape_and_size(frames, start, mean, sd, template_curves(template()))
    found = np.array([template().length_m, template().width_m]) + fit.estimate.growth_m
    off = np.abs(found - size_m)
    sigmas = np.array([fit.estimate.sigma("length"), fit.estimate.sigma("breadth")])
    assert (off < 3.0 * sigmas + 0.01).all()
    assert off.max() < 0.3
    assert abs(fit.estimate.mean[PLACE["lever"]] - tripod().mean[PLACE["lever"]]) < 0.3


def _views_of_badly_painted_markings(seed: int, scatter_px: float) -> list[HeadedFrame]:
    """From one penalty area over the circle to the other, each marking beside its place by the same in all frames."""
    rng = np.random.default_rng(5)
    heads = [np.array([np.log(2000.0 + 30.0 * k), pan, 1.38]) for k, pan in enumerate(np.linspace(0.1, -0.5, 8))]
    seen = [measure_ideal(head, np.zeros(2), 0.1, rng) for head in heads]
    off = np.random.default_rng(seed).normal(0.0, scatter_px, len(template_curves(template()).names))
    moved = [replace(m, points_px=m.points_px + off[m.marking, None] * m.normals) for m in seen]
    return [HeadedFrame(str(k), head, m) for k, (head, m) in enumerate(zip(heads, moved, strict=True))]


@pytest.mark.parametrize("seed", [1, 2])
def test_what_painters_leave_is_not_taken_for_the_size_of_the_pitch(seed: int) -> None:
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE[0] / 1920.0)
    frames = _views_of_badly_painted_markings(seed, 1.4)
    fit = survey._choose_shape_and_size(frames, tripod(), mean, sd, template_curves(template()))
    np.testing.assert_array_equal(fit.estimate.growth_m, 0.0)


def test_boards_behind_a_touchline_do_not_broaden_the_pitch() -> None:
    frames, drawn, rng = [], template_curves(template()), np.random.default_rng(7)
    far = drawn.names.index("side_line_top")
    for k, frame in enumerate(_views_of_badly_painted_markings(1, 0.8)):
        seen = frame.measured
        on_it = np.flatnonzero(seen.marking == far)
        # here and there the foot of the boards is seen instead, 3 m behind the line
        hidden = on_it[rng.random(len(on_it)) > (0.8 if k in (2, 3, 4) else 0.0)]
        kept = np.setdiff1d(np.arange(len(seen.marking)), hidden)
        moved = seen.points_px - np.where(seen.marking == far, 8.0, 0.0)[:, None] * (0.0, 1.0)
        by_place = {"marking": seen.marking, "field_m": seen.field_m, "points_px": moved, "normals": seen.normals,
                    "width_px": seen.width_px, "scale_px_m": seen.scale_px_m, "bias_px": seen.bias_px}  # fmt: skip
        frames.append(replace(frame, measured=replace(seen, **{name: v[kept] for name, v in by_place.items()})))
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE[0] / 1920.0)
    fit = survey._choose_shape_and_size(frames, tripod(), mean, sd, drawn)
    np.testing.assert_array_equal(fit.estimate.growth_m, 0.0)


def test_a_penalty_area_that_comes_into_view_tells_a_length_that_was_open() -> None:
    length, heads = PLACE["length"], [HEAD + np.array([0.0, 0.01 * k, 0.0]) for k in range(2)]
    pictures = [draw(head, np.random.default_rng(k)) for k, head in enumerate(heads)]
    looked_at = {str(k): LookedAt.of(p, load_config().mask) for k, p in enumerate(pictures)}
    members = [HeadedFrame(str(k), head, measure_ideal(head, np.zeros(2), 0.1, np.random.default_rng(k)))
               for k, head in enumerate(heads)]  # fmt: skip
    wrong = tripod()
    wrong.mean[length], wrong.covariance[length, length] = 6.0, 3.0**2
    found = survey._search_length(wrong, members, looked_at, template())
    assert found is not None
    assert abs(found.mean[length]) <= survey.LENGTH_STEP_M / 2.0
    wrong.covariance[length, length] = 0.1**2
    assert survey._search_length(wrong, members, looked_at, template()) is None


def test_what_frames_repeat_does_not_average_out() -> None:
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE[0] / 1920.0)
    sd[PLACE["width"]] = 0.0
    frames, drawn = _views_of_badly_painted_markings(1, 1.4), template_curves(template())
    fit = fit_tripod(frames, tripod(), mean, sd, drawn)
    assert count_alike(fit) == len(frames)
    alike = fit_tripod(frames, tripod(), mean, sd, drawn, alike=count_alike(fit))
    assert alike.estimate.sigma("length") > 1.5 * fit.estimate.sigma("length")
    assert count_alike(fit_tripod(_views_of_a_pitch(105.0, 68.0), tripod(), mean, sd, drawn)) == 1.0


def test_a_lever_arm_points_ahead() -> None:
    rng = np.random.default_rng(3)
    heads = [np.array([np.log(2600.0), pan, 1.38]) for pan in (0.1, 0.0, -0.2, -0.4)]
    frames = [HeadedFrame(str(head[1]), head, measure_ideal(head, np.zeros(2), 0.1, rng, -1.0)) for head in heads]
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE[0] / 1920.0)
    sd[[PLACE["length"], PLACE["breadth"]]] = mean[[PLACE["length"], PLACE["breadth"]]] = 0.0
    fit = fit_tripod(frames, tripod(), mean, sd, template_curves(template()))
    assert fit.estimate.mean[PLACE["lever"]] == 0.0
    # where somebody has measured it, it is taken as it is
    mean[PLACE["lever"]] = -1.0
    fit = fit_tripod(frames, tripod(), mean, sd, template_curves(template()))
    assert fit.estimate.mean[PLACE["lever"]] < -0.5


def test_penalty_areas_alone_do_not_tell_the_size_of_the_pitch() -> None:
    growth, rng = np.array([2.5, 19.9]), np.random.default_rng(4)
    heads = [np.array([8.0, -0.5 + 0.01 * k, 1.40]) for k in range(3)]
    seen = [measure_ideal(head, growth, 0.1, rng) for head in heads]
    frames = [HeadedFrame(str(k), head, m) for k, (head, m) in enumerate(zip(heads, seen, strict=True))]
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE[0] / 1920.0)
    moved = tripod().mean.copy()
    moved[:2] += np.array([growth[0] / 2.0, 0.0])
    fit = survey._choose_shape_and_size(frames, replace(tripod(), mean=moved), mean, sd, template_curves(template()))
    sigma = np.array([fit.estimate.sigma("length"), fit.estimate.sigma("breadth")])
    assert (np.abs(fit.estimate.growth_m - growth)[:1] < 3.0 * sigma[:1]).all()
    assert sigma[0] > 0.3


def test_pictures_between_tell_the_size_of_the_pitch(monkeypatch: pytest.MonkeyPatch) -> None:
    size_m, drawn, rng = (117.0, 48.0), template_curves(template()), np.random.default_rng(6)
    growth = np.array(size_m) - (template().length_m, template().width_m)
    members = [replace(f, name=f"{0.3 * k:.3f}") for k, f in enumerate(_views_of_a_pitch(*size_m))]
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE[0] / 1920.0)
    start = survey._choose_shape_and_size(members, tripod(), mean, sd, drawn).estimate
    nothing = np.zeros((3, 3))

    def look(place: object, picture: object, head: np.ndarray) -> Look:
        return Look(measure_ideal(head, growth, 0.1, rng), HeadFit(head, nothing, nothing, 0.1, 1.0, 99), True)

    monkeypatch.setattr(survey, "_look_twice", look)
    monkeypatch.setattr(survey, "MOST_MORE", 6)
    blank = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    asked: list[float] = []

    def pictures_at(times: Sequence[float]) -> Iterator[NDArray[np.uint8]]:
        asked.extend(times)
        return iter([blank] * len(times))

    found = survey._learn_between(start, members, pictures_at, load_config(), template(), drawn)
    assert asked == pytest.approx([0.1, 0.2, 0.4, 0.5, 0.7, 0.8])
    assert found.sigma("length") < 0.8 * start.sigma("length")
    assert abs(found.growth_m[0] - growth[0]) < 3.0 * found.sigma("length")
    known = replace(start, covariance=0.0 * start.covariance)
    assert survey._learn_between(known, members, pictures_at, load_config(), template(), drawn) is known


def test_a_size_that_frames_left_open_stays_near_the_usual_one(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn, rng, breadth = template_curves(template()), np.random.default_rng(6), PLACE["breadth"]
    members = [replace(f, name=f"{0.3 * k:.3f}") for k, f in enumerate(_views_of_a_pitch(105.0, 68.6))]
    start = tripod()
    start.covariance[breadth, breadth] = survey.USUAL_SD_M**2
    nothing = np.zeros((3, 3))

    def look(place: object, picture: object, head: np.ndarray) -> Look:
        return Look(
            measure_ideal(head, np.array([0.0, 0.6]), 0.1, rng), HeadFit(head, nothing, nothing, 0.1, 1.0, 99), True
        )

    monkeypatch.setattr(survey, "_look_twice", look)
    monkeypatch.setattr(survey, "MOST_MORE", 3)
    blank = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    found = survey._learn_between(start, members, lambda t: iter([blank] * len(t)), load_config(), template(), drawn)
    assert found.growth_m[1] == pytest.approx(0.6, abs=3.0 * found.sigma("breadth"))
    assert 0.0 < found.sigma("breadth") < survey.USUAL_SD_M


def test_boards_behind_a_goal_line_do_not_lengthen_the_pitch() -> None:
    growth, rng, drawn = np.array([7.0, -1.0]), np.random.default_rng(8), template_curves(template())
    heads = [np.array([np.log(2000.0 + 30.0 * k), pan, 1.38]) for k, pan in enumerate(np.linspace(0.1, -0.5, 8))]
    goal_line = drawn.names.index("side_line_left")
    frames = []
    for k, head in enumerate(heads):
        seen = measure_ideal(head, growth, 0.1, rng)
        away = np.where(seen.marking == goal_line, 5.0, 0.0)[:, None] * seen.normals
        frames.append(HeadedFrame(str(k), head, replace(seen, points_px=seen.points_px + away)))
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE[0] / 1920.0)
    sd[PLACE["width"]] = 0.0
    fit = survey._choose_shape_and_size(frames, tripod(), mean, sd, drawn)
    sigma = np.array([fit.estimate.sigma("length"), fit.estimate.sigma("breadth")])
    assert (np.abs(fit.estimate.growth_m - growth) < 3.0 * sigma + 0.02).all()
    assert sigma.max() < 0.2
