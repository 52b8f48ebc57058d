"""Many frames from Python: what the command line does, and what is wrong told in one line."""

import json
import logging

import numpy as np
import pytest
from videos import write_video

import circlecal
from circlecal.errors import ConfigError, InputError
from circlecal.field import field_folder
from circlecal.records.log import RESULTS_NAME, read_records

from .runs import paint

pytestmark = pytest.mark.usefixtures("in_this_process")


def test_a_batch_is_that_of_the_command_line(run_circlecal, frame_file, blank_file, tmp_path):
    (frame_file.parent / "broken.png").write_bytes(b"no picture")
    counts = []
    run = circlecal.calibrate_batch(
        frame_file.parent, tmp_path / "here", set={"seed": 3}, on_progress=lambda done: counts.append(done.finished)
    )
    assert sorted(run.ids) == ["blank", "broken", "good"]
    assert (run["good"].ok, run["blank"].ok, run["broken"].code) == (True, False, "unreadable_input")
    assert counts[0] == 0 and counts[-1] == 3
    assert run_circlecal("batch", frame_file.parent, "--out", tmp_path / "there", "--set", "seed=3").code == 1
    there = {record.id: record for record in read_records(tmp_path / "there")}
    assert (run["good"].H_image_field == np.array(there["good"].H_image_field)).all()
    before = {record.id: record for record in read_records(tmp_path / "here")}
    again = circlecal.calibrate_batch([frame_file, blank_file], tmp_path / "here", set={"seed": 3})
    after = {record.id: record for record in read_records(tmp_path / "here")}
    assert (after["good"], after["blank"]) == (before["good"], before["blank"]), "with the times that they took"
    assert sorted(again.ids) == ["blank", "good"], "what could not be read is looked at anew where it is given"


def test_a_batch_of_a_video_and_files_of_each_frame(tmp_path):
    video = write_video(tmp_path / "clip.avi", "MJPG", 50)
    run = circlecal.calibrate_batch(video, tmp_path / "out", every="1s", files=True)
    assert len(run) == 2
    assert {f"{name}.json" for name in run.ids} <= {path.name for path in (tmp_path / "out").iterdir()}


def test_a_field_of_ones_own_is_read_back(frame_file, tmp_path):
    own, shipped = tmp_path / "own.yaml", field_folder() / "soccer.yaml"
    own.write_text(shipped.read_text(encoding="utf-8").replace("name: soccer", "name: own", 1), encoding="utf-8")
    run = circlecal.calibrate_batch(frame_file, tmp_path / "out", field=own)
    assert run["good"].ok and run["good"].field.name == "own"


def test_what_cannot_be_read_is_logged_and_left_out(frame_file, tmp_path, caplog):
    (tmp_path / "broken.mp4").write_bytes(b"\x00" * 64)
    with caplog.at_level(logging.WARNING):
        run = circlecal.calibrate_batch([frame_file, tmp_path / "broken.mp4"], tmp_path / "out")
    assert run.ids == ["good"]
    assert any("broken.mp4" in record.getMessage() for record in caplog.records)


def test_wrong_use_is_told_before_a_frame(tmp_path):
    frames = paint(tmp_path / "frames", 1)
    with pytest.raises(InputError, match="nowhere"):
        circlecal.calibrate_batch(tmp_path / "nowhere", tmp_path / "out")
    with pytest.raises(InputError, match="every, start and end choose frames of videos, and no video is given"):
        circlecal.calibrate_batch(frames, tmp_path / "out", every="1s")
    with pytest.raises(InputError, match="no such folder of annotations"):
        circlecal.calibrate_batch(frames, tmp_path / "out", annotations=tmp_path / "none")
    with pytest.raises(ConfigError, match="'no-sport' is unknown"):
        circlecal.calibrate_batch(frames, tmp_path / "out", field="no-sport")
    assert not (tmp_path / "out").exists()
    circlecal.calibrate_batch(frames, tmp_path / "out")
    with pytest.raises(InputError, match="another"):
        circlecal.calibrate_batch(frames, tmp_path / "out", set={"seed": 4})
    assert len(circlecal.calibrate_batch(frames, tmp_path / "out", set={"seed": 4}, restart=True)) == 1


def test_a_rig_is_that_of_the_command_line(run_circlecal, frame_file, tmp_path):
    circlecal.calibrate_batch(frame_file, tmp_path / "run")
    run = circlecal.calibrate_rig(tmp_path / "run", tmp_path / "rig", cameras={"good": "main"})
    assert run.ids == ["good"]
    (tmp_path / "cameras.csv").write_text("id,camera\ngood,main\n")
    told = run_circlecal(
        *("rig", tmp_path / "run", "--out", tmp_path / "there", "--cameras", tmp_path / "cameras.csv", "--json")
    )
    assert json.loads(told.out)["frames"] == 1
    here, there = (json.loads((tmp_path / name / RESULTS_NAME).read_text()) for name in ("rig", "there"))
    assert here["H_image_field"] == there["H_image_field"]
    with pytest.raises(InputError, match="choose another"):
        circlecal.calibrate_rig(tmp_path / "run", tmp_path / "run")
    with pytest.raises(InputError, match="none"):
        circlecal.calibrate_rig(tmp_path / "none", tmp_path / "rig")
