"""A clip whose field nobody named: its frames tell it, or the user is asked to."""

from types import SimpleNamespace

import pytest

import circlecal
from circlecal.config import load_config
from circlecal.errors import ConfigError
from circlecal.field import load_field
from circlecal.pictures.limits import DEFAULT_LIMITS
from circlecal.pictures.video import Sampling, Video
from circlecal.rig.tripod import Venue
from circlecal.rig.venue import write_venue
from circlecal.tracking import calls, field_of_clip
from tests.tracking import scripted

UNKNOWN = load_config(None, ["field.template=auto"])


@pytest.fixture
def clip(tmp_path):
    return scripted.write_clip(tmp_path / "clip.mp4")


@pytest.fixture
def tell(monkeypatch):
    """Makes frame after frame tell these fields, None where it is refused; returns what was looked at."""

    def script(*fields):
        looked_at = []

        def calibrate(picture, config, *, frame_id):
            name = fields[len(looked_at) % len(fields)]
            looked_at.append(picture.shape)
            return SimpleNamespace(status="refused" if name is None else "calibrated", field_name=name)

        monkeypatch.setattr(field_of_clip, "calibrate_image", calibrate)
        return looked_at

    return script


def test_three_frames_that_agree_name_the_field_with_its_options(clip, tell):
    looked_at = tell("ice-hockey", None, "soccer", "ice-hockey", "ice-hockey", "soccer")
    named = field_of_clip.name_field([Video.open(clip, "clip", DEFAULT_LIMITS)], Sampling.parse(), UNKNOWN)
    assert (named.field.template, named.mask.detector.one_paint) == ("ice-hockey", False)
    assert len(looked_at) == 5


def test_a_field_that_is_named_stays_and_no_frame_is_looked_at(clip, tell):
    looked_at = tell("ice-hockey")
    config = load_config(None, ["field.template=futsal"])
    assert field_of_clip.name_field([Video.open(clip, "clip", DEFAULT_LIMITS)], Sampling.parse(), config) is config
    assert not looked_at


@pytest.mark.parametrize("field", [None, "auto"])
def test_a_venue_names_the_field_and_no_frame_is_looked_at(clip, tell, tmp_path, monkeypatch, field):
    looked_at, rink = tell("futsal"), load_field("ice-hockey-nhl")
    write_venue(tmp_path / "venue.yaml", Venue(rink.name, (scripted.tripod(),)), rink)
    runs = []
    monkeypatch.setattr(calls, "track_video", lambda run, *_: runs.append(run) or [])
    list(circlecal.track(clip, field=field, venue=tmp_path / "venue.yaml"))
    assert (runs[0].config.field.template, looked_at) == (rink.name, [])


def test_frames_that_do_not_agree_are_one_line_with_what_they_told(clip, tell):
    looked_at = tell("futsal", "handball", None, None, None, None)
    with pytest.raises(ConfigError, match=r"\(futsal in 2, handball in 2\); name it, e\.g\. --field futsal"):
        field_of_clip.name_field([Video.open(clip, "clip", DEFAULT_LIMITS)], Sampling.parse(), UNKNOWN)
    assert len(looked_at) == field_of_clip.MOST_LOOKED_AT


def test_commands_and_calls_name_it_first(clip, tell, tmp_path, run_circlecal):
    tell(None)
    outcome = run_circlecal("track", clip, "--out", tmp_path / "out", "--field", "auto")
    assert outcome.code == 2 and "--field" in outcome.err and len(outcome.err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
    with pytest.raises(ConfigError, match="name it"):
        circlecal.track(clip, field="auto")
