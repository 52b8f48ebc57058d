"""The survey of a clip whose camera is known from elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.rig.tripod import Venue
from circlecal.tracking import survey
from circlecal.tracking.survey import survey_clip
from tests.tracking.scenes import HEAD, draw, tripod


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
