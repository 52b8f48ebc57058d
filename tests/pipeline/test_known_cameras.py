"""Frames of a venue with several cameras."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import config_digest, load_config
from circlecal.field import load_field
from circlecal.geometry.surface import Surface
from circlecal.pipeline import run_observations
from circlecal.records.writing import result_record
from circlecal.rig.tripod import PLACE, Venue
from circlecal.rig.venue import venue_settings, write_venue
from circlecal.synthetic.cameras import aim_camera
from tests.rig.scenes import CONFIG, seen_by
from tests.tracking.scripted import tripod

SOCCER = load_field("soccer")


def main_tripod():
    """A main camera over a flat pitch of the template's size."""
    found = tripod((1920, 1080))
    mean = found.mean.copy()
    mean[[PLACE["crown"], PLACE["length"], PLACE["breadth"]]] = 0.0
    return replace(found, mean=mean, surface=Surface("flat", 9.15, 0.0))


def opposite_tripod():
    """A camera across the pitch, and farther from it: at equal places the two would see one picture."""
    main = main_tripod()
    mean, turn = main.mean.copy(), np.array([0.0, np.pi, 0.0])
    mean[PLACE["axis_y"]] = -80.0
    return replace(main, name="opposite", mean=mean, head_low=main.head_low + turn, head_high=main.head_high + turn)


@pytest.fixture
def config(tmp_path):
    write_venue(tmp_path / "venue.yaml", Venue("soccer", (main_tripod(), opposite_tripod())), SOCCER)
    return load_config(CONFIG, venue_settings(tmp_path / "venue.yaml", SOCCER))


def view_from(y_m: float):
    return aim_camera(np.array([1.0, y_m, -15.0]), np.array([1.0, 0.0, 0.0]), 3500.0, 0.0, 1920, 1080, 0.02)


@pytest.mark.parametrize(("y_m", "name"), [(62.0, "camera-1"), (-80.0, "opposite")])
def test_a_frame_of_any_camera_is_calibrated_as_its(config, y_m, name):
    camera = view_from(y_m)
    found = run_observations(seen_by(camera, np.random.default_rng(3)), config, frame_id="f", convention="paint")
    assert found.status == "calibrated" and found.config_digest == config_digest(config)
    record = result_record(found, SOCCER)
    assert record.rig.camera == name
    np.testing.assert_allclose(record.camera.position_meters, camera.position_m, atol=1.0)


def test_a_frame_of_none_of_them_is_refused_as_the_first_ones(config):
    seen = seen_by(view_from(160.0), np.random.default_rng(3))
    found = run_observations(seen, config, frame_id="f", convention="paint")
    only_first = config.model_copy(update={"camera": config.camera.model_copy(update={"others": ()})})
    first = run_observations(seen, only_first, frame_id="f", convention="paint")
    assert (found.status, found.verdict.code) == ("refused", first.verdict.code)
    assert found.camera_name is None and result_record(found, SOCCER).rig is None
