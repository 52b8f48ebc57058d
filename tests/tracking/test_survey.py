"""The survey of a clip whose camera is known from elsewhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from circlecal.config import load_config
from circlecal.field.view import FieldView
from circlecal.formats.annotation import AnnotatedMarking, Annotation
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface, SurfaceShape
from circlecal.observations import Observations
from circlecal.pictures.limits import DEFAULT_LIMITS
from circlecal.pictures.video import Sampling, Video
from circlecal.pipeline import run_observations
from circlecal.rig.tripod import COMMON, TripodEstimate, Venue
from circlecal.tracking import first_look, survey
from circlecal.tracking.frame_paint import PART_M, HeadedFrame
from circlecal.tracking.markings import template_curves
from circlecal.tracking.seen_paint import MeasuredFrame
from circlecal.tracking.stretches import ClipRun, survey_video
from circlecal.tracking.survey import survey_clip
from circlecal.tracking.tripod_fit import common_priors, fit_tripod
from tests.tracking.scenes import HEAD, SIZE, draw, template, tripod, views_of_a_pitch, views_of_a_surface


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
    assert (np.sqrt(np.diag(found.covariance)[:3]) < 0.01 + 1e-6).all()


def test_a_camera_that_ends_beside_what_the_venue_says_is_told(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(survey, "ROUNDS", 1)
    monkeypatch.setattr(survey, "learn_closely", lambda extended, *_: extended)
    pictures = [draw(HEAD + np.array([0.0, 0.004 * k, 0.0]), np.random.default_rng(k)) for k in range(2)]
    known = tripod()
    sd = np.sqrt(np.diag(known.covariance))
    for sigmas, told in ((2.0, []), (4.0, ["camera-1: is not as the venue says: axis_y_m by 4.0 of its standard dev"])):
        moved = replace(known, mean=known.mean + sigmas * sd * (np.arange(len(COMMON)) == 1))
        monkeypatch.setattr(survey, "_learn_from", lambda *_, moved=moved: moved)
        survey_clip(lambda times: iter(pictures[: len(times)]), 1.2, load_config(), Venue("soccer", (known,)))
        assert [message[: len(told[0])] if told else message for message in caplog.messages] == told


def _looked_through(pictures: dict[str, Any]) -> survey.LookedThrough:
    """A clip of which these pictures were looked at."""
    drawn = template_curves(template())
    return survey.LookedThrough(pictures, lambda _: iter(()), None, load_config(), template(), drawn, 0.04)


def _write_clip(path: Path, pictures: list[NDArray[np.uint8]]) -> Video:
    """A clip of ten frames per second."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10, width=SIZE[0], height=SIZE[1], pix_fmt="yuv420p")
        stream.bit_rate = 20_000_000
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode(None))
    return Video.open(path, path.stem, DEFAULT_LIMITS)


def test_a_venue_of_smaller_pictures_is_compared_with_the_clip_and_refined(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(survey, "ROUNDS", 1)
    heads = [HEAD + np.array([0.0, 0.004 * k, 0.0]) for k in range(4)]
    video = _write_clip(tmp_path / "clip.mp4", [draw(head, np.random.default_rng(k)) for k, head in enumerate(heads)])
    half = tripod().resize((SIZE[0] // 2, SIZE[1] // 2))
    run = ClipRun(load_config(), Sampling.parse("1"), Venue("soccer", (half,)))
    found = survey_video(run, video)
    assert isinstance(found, Venue) and found.tripods[0].size == SIZE and len(found.tripods[0].used) >= 2
    assert not caplog.messages
    moved = replace(half, mean=half.mean + 0.3 * (np.arange(len(COMMON)) == 0))
    found = survey_video(replace(run, known=Venue("soccer", (moved,))), video)
    assert isinstance(found, Venue) and abs(found.tripods[0].mean[0] - half.mean[0]) < 0.1
    assert "camera-1: is not as the venue says: axis_x_m by" in caplog.text
    cut = ClipRun(load_config(), Sampling.parse("1"), Venue("soccer", (replace(half, size=(640, 480)),)))
    refusal = survey_video(cut, video)
    assert isinstance(refusal, str) and refusal.startswith(
        f"{video.path}: camera-1: picture_px [640, 480] of the venue"
    )


def test_what_all_frames_are_off_alike_does_not_make_a_known_camera_surer(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def fit(*given: object, **options: float) -> SimpleNamespace:
        calls.append(options)
        return SimpleNamespace(heads=np.zeros((10, 3)), rms_px=np.full(10, 2.0), estimate=tripod())

    monkeypatch.setattr(survey, "fit_tripod", fit)
    survey._learn_beside(tripod(), [], tripod(), template_curves(template()))
    assert calls == [{}, {"alike": 10.0, "parts_m": PART_M}]


def test_a_tripod_stays_as_it_was_where_its_frames_show_no_paint_any_more(monkeypatch: pytest.MonkeyPatch) -> None:
    members = views_of_a_pitch(105.0, 68.0)
    bare = MeasuredFrame.unseen(members[0].measured.expected)
    look = SimpleNamespace(measured=bare, is_confirmed=False, fit=SimpleNamespace(head=HEAD))
    monkeypatch.setattr(survey, "_look_again", lambda *_: look)
    pictures = {frame.name: SimpleNamespace(size=SIZE, shows_surface=True) for frame in members}
    known = tripod()
    found, kept = survey._extend(known, members, _looked_through(pictures))
    assert (found, kept) == (known, members)


@pytest.mark.parametrize(
    ("asked", "shape", "is_noted"), [("auto", "hip", True), ("auto", "roof", False), ("roof", "hip", False)]
)
def test_a_pitch_that_may_be_hip_is_noted(
    asked: str, shape: SurfaceShape, is_noted: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """It is not taken for one: whoever reads the records must know the shape."""
    frames = views_of_a_surface(Surface(shape, 9.15, 0.08))
    config = load_config(overrides=[f"camera.crown_shape={asked}"])
    survey._note_hips([(tripod(), frames)], replace(_looked_through({}), config=config))
    assert ("camera.crown_shape=hip fits it better" in caplog.text) is is_noted


def test_tripods_in_one_place_are_one() -> None:
    first, second, other = (replace(tripod(), name=name) for name in ("camera-1", "camera-2", "camera-3"))
    second = replace(second, mean=second.mean + np.eye(len(second.mean))[1] * 0.3, used=("a", "b"))
    other = replace(other, mean=other.mean + np.eye(len(other.mean))[0] * 5.0)
    assert [t.name for t in survey._keep_distinct([first, second, other])] == ["camera-2", "camera-3"]


def test_tripods_that_come_together_once_the_pitch_is_known_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    true = tripod()
    apart = replace(true, name="camera-2", mean=true.mean + np.eye(len(true.mean))[0] * 5.0)
    monkeypatch.setattr(survey, "_tripods", lambda *_: [(true, []), (apart, [])])
    monkeypatch.setattr(survey, "_extend", lambda found, *_: (found, []))
    monkeypatch.setattr(survey, "learn_closely", lambda found, *_: replace(found, mean=true.mean))
    assert len(survey_clip(lambda times: iter(()), 4.0, load_config()).tripods) == 1


def test_one_frame_that_a_person_named_makes_a_camera(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(survey, "ROUNDS", 1)
    heads = [HEAD + np.array([0.0, 0.004 * k, 0.0]) for k in range(2)]
    pictures = [draw(head, np.random.default_rng(k)) for k, head in enumerate(heads)]
    video = _write_clip(tmp_path / "clip.mp4", pictures)
    view = tripod().view(heads[1], np.zeros((3, 3)))
    names = ("side_line_left", "big_rect_left_main", "small_rect_left_main", "big_rect_left_top", "side_line_bottom")
    markings = [_marking(view, name) for name in names]
    named = Annotation(id="clip_00-00-00.100", width=SIZE[0], height=SIZE[1], touched=True, markings=markings)
    (tmp_path / "named").mkdir()
    (tmp_path / "named" / "clip_00-00-00.100.json").write_text(named.model_dump_json())
    refused = run_observations(Observations(*SIZE), load_config(), frame_id="refused")
    monkeypatch.setattr(first_look, "calibrate_image", lambda picture, config, frame_id: refused)
    alone = ClipRun(load_config(), Sampling.parse("1"), annotations=tmp_path / "nobody")
    told = replace(alone, annotations=tmp_path / "named")
    assert alone.digest != told.digest
    assert not survey_video(alone, video).tripods
    (found,) = survey_video(told, video).tripods
    assert np.abs(found.mean[:3] - tripod().mean[:3]).max() < 3.0


def _prior() -> tuple[Array, Array]:
    """What is known of any tripod."""
    return common_priors(load_config().camera, load_config().rig, template(), SIZE)


def _know(members: list[HeadedFrame], sigmas: float) -> TripodEstimate:
    """A tripod as frames tell it, its axis so many standard deviations beside, and all that goes with it."""
    told = fit_tripod(members, tripod(), *_prior(), template_curves(template())).estimate
    along = told.covariance[:, 1] / np.sqrt(told.covariance[1, 1])
    return replace(told, mean=told.mean + sigmas * along)


@pytest.mark.parametrize(("sigmas", "is_kept"), [(0.0, True), (1.0, True), (2.5, True), (12.0, False)])
def test_a_venue_that_frames_agree_with_is_known_no_less_than_before(sigmas: float, is_kept: bool) -> None:
    members, drawn = views_of_a_pitch(105.0, 68.0), template_curves(template())
    known, true = _know(members, sigmas), _know(members, 0.0)
    extended = survey._learn_beside(known, members, known, drawn).estimate
    found = survey._keep_known(known, extended, members, _prior(), drawn)
    assert (found is not extended) is is_kept
    variance = np.diag(found.covariance)[:3]
    assert (variance < np.diag(known.covariance)[:3]).all() is np.bool_(is_kept)
    assert abs(found.mean - true.mean)[1] <= abs(known.mean - true.mean)[1] + 0.1 * known.sigma("axis_y")


def test_a_camera_that_was_moved_is_where_the_clip_tells_surely_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    known = replace(tripod(), covariance=np.eye(len(COMMON)) * 0.1**2)
    moved, near = (replace(known, mean=known.mean + shift * (np.arange(len(COMMON)) < 3)) for shift in (0.5, 0.1))
    extended = replace(near, covariance=np.eye(len(COMMON)) * 0.3**2)
    surely, hardly = (replace(moved, covariance=np.eye(len(COMMON)) * sd**2) for sd in (0.05, 0.5))
    monkeypatch.setattr(survey, "_keep_known", lambda known, *_: known)
    for own, expected in ((surely, surely), (hardly, known), (near, known)):
        assert survey._learn_from(known, extended, own, [], _prior(), template_curves(template())) is expected


def test_what_a_clip_tells_surer_than_a_loosened_venue_is_taken_where_both_agree() -> None:
    known = tripod()
    known = replace(known, covariance=np.eye(len(COMMON)) * 0.3**2)
    near, far = (replace(known, mean=known.mean + shift * (np.arange(len(COMMON)) < 3)) for shift in (0.3, 2.0))
    surer, vaguer = (np.eye(len(COMMON)) * sd**2 for sd in (0.1, 0.4))
    own = replace(near, covariance=surer)
    assert survey._choose_surer(known, own) is own
    assert survey._choose_surer(known, replace(near, covariance=vaguer)) is known
    assert survey._choose_surer(known, replace(far, covariance=surer)) is known


def test_a_width_that_later_frames_leave_open_is_searched_for_once_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the frame that was found last, the touchline was taken for a false one, and the pitch held near 68 m."""
    told, open_width, narrow = (SimpleNamespace(state=state) for state in ("told", "open", "narrow"))
    extended = iter([told, open_width])
    monkeypatch.setattr(survey, "_extend", lambda *_: (next(extended), ["members"]))
    monkeypatch.setattr(survey, "search_length", lambda tripod, *_: SimpleNamespace(state="longer"))
    monkeypatch.setattr(survey, "search_width", lambda tripod, *_: narrow if tripod is open_width else None)
    found, members = survey._extend_and_measure(told, [], _looked_through({}))  # type: ignore[arg-type]
    assert found is narrow and members == ["members"]
