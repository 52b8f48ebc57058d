"""What may help refused pictures and videos, and doubt of calibrated ones, said once at the end of a run."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from circlecal.cli.sport_hints import SportHints
from circlecal.config import Config
from circlecal.records.parts import SourceRecord
from circlecal.records.record import ResultRow

WOOD, TURF = (110, 160, 200), (60, 130, 70)
NOTHING_KNOWN = {"is_chosen": False, "camera_prior": None, "venue": None}


def paint_ground(path: Path, colour: tuple[int, int, int]) -> Path:
    cv2.imwrite(str(path), np.full((120, 160, 3), colour, np.uint8))
    return path


def row(path: Path, status: str = "refused", time_s: float | None = None, code: str | None = "no_circle") -> ResultRow:
    source = SourceRecord(path=str(path), time_s=time_s)
    return ResultRow(schema_version=1, id=path.stem, source=source, status=status, code=code)


def hint(capsys: pytest.CaptureFixture[str], *rows: ResultRow, **known: object) -> str:
    files = SportHints()
    for one in rows:
        files.add(one)
    files.print_hint(Config(), **{**NOTHING_KNOWN, **known})
    return capsys.readouterr().err


def test_the_ground_of_pictures_is_looked_at(capsys, tmp_path):
    floor, turf = paint_ground(tmp_path / "floor.png", WOOD), paint_ground(tmp_path / "turf.png", TURF)
    told = "circlecal: floor: the ground is no turf; --field auto tries other sports\n"
    assert hint(capsys, row(floor), row(turf)) == told
    assert "what was refused was taken for soccer; --field auto" in hint(capsys, row(turf), row(tmp_path / "gone.png"))


def test_a_video_with_a_calibrated_frame_is_no_refused_file(capsys, tmp_path):
    clip = tmp_path / "clip.avi"
    size = 160, 120
    writer = cv2.VideoWriter(str(clip), cv2.VideoWriter_fourcc(*"MJPG"), 5.0, size)
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no MJPG into .avi")
    for _ in range(5):
        writer.write(np.full((*size[::-1], 3), WOOD, np.uint8))
    writer.release()
    refused = [row(clip, time_s=0.0), row(clip, time_s=0.2)]
    assert "clip: the ground is no turf" in hint(capsys, *refused)
    right = row(clip, "calibrated", 0.4, None)
    doubted = "circlecal: clip: taken for soccer, but the ground is no turf; --field auto tries other sports\n"
    assert hint(capsys, *refused, right) == doubted
    assert hint(capsys, right, *refused) == doubted


def test_a_calibrated_picture_on_a_floor_is_doubted_where_no_field_was_named(capsys, tmp_path):
    floor, turf = paint_ground(tmp_path / "floor.png", WOOD), paint_ground(tmp_path / "turf.png", TURF)
    told = "circlecal: floor: taken for soccer, but the ground is no turf; --field auto tries other sports\n"
    assert hint(capsys, row(turf, "calibrated"), row(floor, "calibrated")) == told
    assert hint(capsys, row(turf, "calibrated")) == ""
    assert hint(capsys, row(floor, "calibrated"), is_chosen=True) == ""
    assert hint(capsys, row(floor, "calibrated"), venue=tmp_path) == ""


def test_what_is_no_picture_or_damaged_tells_nothing(capsys, tmp_path):
    floor = paint_ground(tmp_path / "floor.png", WOOD)
    assert hint(capsys, row(tmp_path / "lines.json"), row(floor, code="unreadable_input")) == ""


def test_a_known_camera_may_be_left_out_and_a_chosen_field_is_believed(capsys, tmp_path):
    floor = row(paint_ground(tmp_path / "floor.png", WOOD))
    for known in ("camera_prior", "venue"):
        told = hint(capsys, floor, is_chosen=True, **{known: tmp_path})
        assert told.startswith(f"circlecal: leave --{known.replace('_', '-')} out for frames that another camera took")
    assert hint(capsys, floor, is_chosen=True) == ""


def test_batch_says_it_too(run_circlecal, in_this_process, tmp_path):
    floor = paint_ground(tmp_path / "floor.png", WOOD)
    outcome = run_circlecal("batch", floor, "--workers", 1, "--out", tmp_path / "out")
    assert "circlecal: floor: the ground is no turf; --field auto tries other sports" in outcome.err
    for silent in (("--field", "futsal"), ("--config", "broadcast"), ("--quiet",)):
        outcome = run_circlecal("batch", floor, "--workers", 1, "--out", tmp_path / silent[-1], *silent)
        assert "other sports" not in outcome.err


def test_batch_doubts_a_run_of_which_nothing_was_refused(run_circlecal, in_this_process, tmp_path):
    command = "batch", paint_ground(tmp_path / "floor.png", WOOD), "--workers", 1, "--out", tmp_path / "out"
    run_circlecal(*command)
    log = tmp_path / "out" / "results.jsonl"
    record = json.loads(log.read_text())
    log.write_text(json.dumps({**record, "status": "calibrated", "code": None}) + "\n")
    outcome = run_circlecal(*command)
    assert outcome.code == 0
    assert "circlecal: floor: taken for soccer, but the ground is no turf; --field auto" in outcome.err
