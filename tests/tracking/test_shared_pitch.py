"""One pitch before the tripods of a clip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.geometry.surface import Surface
from circlecal.rig.tripod import COMMON, PLACE, TripodEstimate
from circlecal.tracking import survey
from circlecal.tracking.frame_paint import PART_M, HeadedFrame
from circlecal.tracking.looking import LookedAt
from circlecal.tracking.markings import template_curves
from circlecal.tracking.pitch import SIZE as SIZES
from circlecal.tracking.shared_pitch import PITCH, KnownPitch, tell_pitch
from circlecal.tracking.tripod_fit import common_priors, fit_tripod
from tests.tracking.scenes import SIZE, measure_ideal, template, tripod

GROWTH = np.array([3.0, -2.0])


def _views(pans: Sequence[float], seed: int) -> list[HeadedFrame]:
    """Frames of a pitch of 108 by 66 m."""
    rng = np.random.default_rng(seed)
    heads = [np.array([np.log(2600.0 + 60.0 * k), pan, 1.38]) for k, pan in enumerate(pans)]
    return [HeadedFrame(f"{0.4 * k:.3f}", head, measure_ideal(head, GROWTH, 0.1, rng)) for k, head in enumerate(heads)]


def _fit(name: str, frames: list[HeadedFrame]) -> TripodEstimate:
    mean, sd = common_priors(load_config().camera, load_config().rig, template(), SIZE)
    found = fit_tripod(frames, tripod(), mean, sd, template_curves(template()), parts_m=PART_M).estimate
    return replace(found, name=name)


def _share(
    tripods: dict[str, tuple[TripodEstimate, list[HeadedFrame]]], monkeypatch: pytest.MonkeyPatch
) -> list[TripodEstimate]:
    """The tripods before one pitch, as the paint tells it that was measured."""
    pictures: dict[str, LookedAt] = {}
    drawn, config = template_curves(template()), load_config()
    clip = survey.LookedThrough(pictures, lambda _: iter(()), None, config, template(), drawn)

    def learn(
        found: TripodEstimate, members: list[HeadedFrame], clip: survey.LookedThrough, pitch: KnownPitch
    ) -> TripodEstimate:
        mean, sd = pitch.tell(*clip.prior_of(found, [frame.measured for frame in members]))
        return fit_tripod(members, found, mean, sd, drawn, parts_m=PART_M).estimate

    monkeypatch.setattr(survey, "_extend", lambda found, members, *_, **__: (found, members))
    monkeypatch.setattr(survey, "_learn_closely", learn)
    monkeypatch.setattr(survey, "SAME_PLACE_M", 0.0)
    return survey._share_pitch([found for found, _ in tripods.values()], tripods, clip)


def test_two_cameras_of_a_clip_have_one_pitch(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that shows the circle alone had a pitch of another length."""
    frames = {"camera-1": _views((0.0, -0.02, -0.2, -0.42, -0.44), 5), "camera-2": _views((0.0, 0.05, -0.08), 7)}
    tripods = {name: (_fit(name, seen), seen) for name, seen in frames.items()}
    wide, blind = (tripods[name][0] for name in frames)
    assert wide.sigma("length") < 0.5 < 2.0 < blind.sigma("length")
    found = {camera.name: camera for camera in _share(tripods, monkeypatch)}
    assert set(found) == set(frames)
    first, second = (found[name] for name in frames)
    assert first.mean[PITCH] == pytest.approx(second.mean[PITCH], abs=1e-9)
    assert np.abs(second.growth_m - GROWTH).max() < 0.3
    assert min(np.linalg.eigvalsh(camera.covariance).min() for camera in found.values()) > -1e-9
    assert np.abs(second.mean[:3] - blind.mean[:3]).max() < 3.0 * np.sqrt(np.diag(blind.covariance)[:3].max())


def test_a_camera_that_loses_its_frames_before_the_pitch_of_another_keeps_its_own(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    frames = {"camera-1": _views((0.0, -0.02, -0.2, -0.42, -0.44), 5), "camera-2": _views((0.0, 0.05, -0.08), 7)}
    tripods = {name: (_fit(name, seen), seen) for name, seen in frames.items()}
    drawn = template_curves(template())
    clip = survey.LookedThrough({}, lambda _: iter(()), None, load_config(), template(), drawn)
    monkeypatch.setattr(survey, "_extend", lambda found, members, *_, **__: (found, members[:1]))
    monkeypatch.setattr(survey, "SAME_PLACE_M", 0.0)
    found = {t.name: t for t in survey._share_pitch([t for t, _ in tripods.values()], tripods, clip)}
    assert found == {name: t for name, (t, _) in tripods.items()}
    assert caplog.messages == ["camera-2: its pitch does not seem to be that of camera-1"]


def test_what_the_last_tripod_tells_of_the_pitch_is_told_to_the_first() -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(len(COMMON), len(COMMON)))
    first = replace(tripod(), covariance=root @ root.T / len(COMMON))
    told = first.covariance[np.ix_(PITCH, PITCH)]
    last = replace(tripod(), mean=first.mean.copy(), covariance=np.zeros_like(first.covariance))
    last.mean[PITCH] += (0.3, -0.2, 0.01)
    # as surely as two of the first would tell it: what all else follows is what Bayes makes of it
    last.covariance[np.ix_(PITCH, PITCH)] = told / 2.0
    found = tell_pitch(first, last)
    by_pitch = np.zeros((len(PITCH), len(COMMON)))
    by_pitch[np.arange(len(PITCH)), PITCH] = 1.0
    expected = np.linalg.inv(np.linalg.inv(first.covariance) + by_pitch.T @ np.linalg.inv(told) @ by_pitch)
    assert found.covariance == pytest.approx(expected, abs=1e-6)
    assert found.mean[PITCH] == pytest.approx(last.mean[PITCH])
    assert found.surface.crown_m == pytest.approx(found.mean[PLACE["crown"]])
    settled = replace(first, covariance=0.0 * first.covariance)
    assert (tell_pitch(settled, last).mean == settled.mean).all()


def test_a_size_that_is_settled_is_held_before_the_other_camera() -> None:
    known = KnownPitch(
        Surface("roof", 9.15, 0.04),
        np.array([3.0, -2.0, 0.04]),
        np.array([0.2, 0.3, 0.01]),
        np.array([True, False, False]),
    )
    mean, sd = known.tell(np.zeros(len(COMMON)), np.ones(len(COMMON)))
    assert mean[PITCH] == pytest.approx([3.0, -2.0, 0.04]) and sd[PITCH] == pytest.approx([0.0, 0.3, 0.01])
    _, loose_sd = known.tell_loosely(np.zeros(len(COMMON)), np.ones(len(COMMON)))
    assert loose_sd[SIZES] == pytest.approx([0.2, 0.3])
    # who fixes the surface knows better
    fixed = np.ones(len(COMMON))
    fixed[PLACE["crown"]] = 0.0
    mean, sd = known.tell(np.zeros(len(COMMON)), fixed)
    assert mean[PLACE["crown"]] == sd[PLACE["crown"]] == 0.0
