"""``circlecal.track``: a clip from Python."""

from __future__ import annotations

import numpy as np
import pytest

import circlecal
from circlecal.errors import InputError
from circlecal.tracking import stretches

from . import scripted


@pytest.fixture
def clip(tmp_path, monkeypatch):
    monkeypatch.setattr(stretches, "survey_clip", scripted.survey_clip)
    monkeypatch.setattr(stretches, "track_frames", scripted.track_frames)
    return scripted.write_clip(tmp_path / "clip.mp4")


def test_frames_come_in_order_and_answer(clip):
    frames = list(circlecal.track(clip))
    assert [frame.time_s for frame in frames] == pytest.approx([k / scripted.RATE for k in range(30)])
    assert [frame.ok for frame in frames].count(False) == 2
    wanted = scripted.tracked(3, 0.3).view.project([[9.15, 0.0]])
    np.testing.assert_allclose(frames[3].to_image([[9.15, 0.0]]), wanted, atol=1e-5)
    assert frames[7].code == "lost" and np.isnan(frames[7].to_image([0.0, 0.0])).all()
    assert frames[3].image.shape == (scripted.SIZE[1], scripted.SIZE[0], 3)


def test_a_part_of_a_clip(clip):
    frames = list(circlecal.track(clip, every=2, start=1.0, end="0:02"))
    assert [round(frame.time_s * scripted.RATE) for frame in frames] == [10, 12, 14, 16, 18]


def test_a_venue_is_taken(clip, tmp_path, run_circlecal):
    run_circlecal("track", clip, "--out", tmp_path / "out", "--quiet")
    assert next(circlecal.track(clip, venue=tmp_path / "out" / "venue.yaml")).ok


def test_wrong_arguments_are_told_at_once(clip, tmp_path):
    with pytest.raises(InputError, match=r"none\.mp4"):
        circlecal.track(tmp_path / "none.mp4")
    with pytest.raises(InputError, match=r"^every often"):
        circlecal.track(clip, every="often")
    with pytest.raises(InputError, match=r"none\.yaml"):
        circlecal.track(clip, venue=tmp_path / "none.yaml")
    with pytest.raises(InputError, match=r"nosuch: no such folder of annotations"):
        circlecal.track(clip, annotations=tmp_path / "nosuch")


@pytest.mark.parametrize("content", ['{"annotation_version": 1, "id": "clip_0000', '{"annotation_version": 1}'])
def test_a_damaged_annotation_is_told_and_other_json_is_passed_over(clip, tmp_path, run_circlecal, content):
    (tmp_path / "named").mkdir()
    (tmp_path / "named" / "other.json").write_text('{"kp": {}}')
    assert next(circlecal.track(clip, annotations=tmp_path / "named")).ok
    damaged = tmp_path / "named" / "damaged.json"
    damaged.write_text(content)
    with pytest.raises(InputError, match=r"damaged\.json"):
        next(circlecal.track(clip, annotations=tmp_path / "named"))
    told = run_circlecal("track", clip, "--annotations", tmp_path / "named", "--out", tmp_path / "out")
    assert (told.code, str(damaged) in told.err, "Traceback" in told.err) == (2, True, False)
    (tmp_path / "out" / "annotations").mkdir(parents=True)
    damaged.rename(tmp_path / "out" / "annotations" / "damaged.json")
    told = run_circlecal("track", clip, "--out", tmp_path / "out")
    assert (told.code, "damaged.json" in told.err) == (2, True)
