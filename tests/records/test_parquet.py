"""The table of a batch."""

import json
import os
import re
import sys

import numpy as np
import pytest

from circlecal.batch.frames import FrameRun
from circlecal.batch.task import finish
from circlecal.config import Config
from circlecal.pictures.files import find_frames
from circlecal.records.log import RESULTS_NAME, ResultLog, read_records
from circlecal.records.parquet import write_parquet
from circlecal.records.parts import EstimateRecord


@pytest.fixture
def results(tmp_path, frame_file, blank_file):
    (frame_file.parent / "cut.jpg").write_bytes(b"\xff\xd8\xff\xe0")
    run = FrameRun(Config())
    with ResultLog(tmp_path / "run") as log:
        finished = [finish(run, frame) for frame in find_frames([frame_file.parent])]
        for frame in finished:
            log.append(frame)
    return tmp_path / "run" / RESULTS_NAME, {frame.row.id: json.loads(frame.line) for frame in finished}


def test_every_frame_is_a_row(run_circlecal, results, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra parquet is not installed")
    path, found = results
    for given in (path, path.parent):
        outcome = run_circlecal("convert", given, "--to", "parquet", "--out", tmp_path / "table")
        assert (outcome.code, outcome.out.strip()) == (0, str(tmp_path / "table" / "results.parquet"))
        rows = {row["id"]: row for row in parquet.read_table(tmp_path / "table" / "results.parquet").to_pylist()}
        assert rows.keys() == found.keys() == {"good", "blank", "cut"}
    good = rows["good"]
    assert good["status"] == "calibrated"
    assert np.allclose(np.reshape(good["H_image_field"], (3, 3)), found["good"]["H_image_field"])
    camera = found["good"]["camera"]
    assert [good[f"position_{axis}_m"] for axis in "xyz"] == camera["position_meters"]
    assert (good["focal_x_px"], good["max_sigma_px"]) == (camera["x_focal_length"], camera["max_sigma_px"])
    assert good["max_sigma_1920_px"] == pytest.approx(camera["max_sigma_px"] * 1920 / good["width"])
    assert (good["crown_shape"], good["crown_radius_m"]) == (camera["crown_shape"], camera["crown_radius_m"])
    size = camera["field_size"]
    assert (good["length_m"], good["width_m"]) == (size["length_m"], size["width_m"])
    assert good["config_digest"] == found["good"]["config_digest"]
    assert rows["blank"]["status"] == "refused"
    assert rows["blank"]["H_image_field"] is rows["blank"]["length_m"] is None
    assert (rows["cut"]["code"], rows["cut"]["width"], rows["cut"]["time_ms"]) == ("unreadable_input", None, None)


def test_a_refused_frame_has_no_number_of_a_camera(results, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra parquet is not installed")
    accepted = next(record for record in read_records(results[0]) if record.id == "good")
    estimate = EstimateRecord(H_image_field=accepted.H_image_field, camera=accepted.camera)
    changes = {"status": "refused", "camera": None, "H_image_field": None, "rejected_estimate": estimate}
    path = write_parquet([accepted.model_copy(update=changes)], tmp_path / "x.parquet")
    (row,) = parquet.read_table(path).to_pylist()
    known = {name for name, value in row.items() if value is not None}
    assert not {name for name in known if name.startswith(("position", "focal", "max_sigma", "H_"))}
    assert path.stat().st_mode & 0o777 == 0o666 & ~current_umask()


def current_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_beside_the_results_of_a_batch(run_circlecal, in_this_process, frame_file, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra parquet is not installed")
    out = tmp_path / "out"
    run_circlecal("batch", frame_file, "--out", out, "--workers", 1, "--to", "parquet", "--to", "soccernet")
    assert parquet.read_table(out / "results.parquet").column("id").to_pylist() == ["good"]
    assert (out / "camera_good.json").is_file()


def test_a_missing_extra_is_told_before_the_first_frame(run_circlecal, frame_file, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    outcome = run_circlecal("batch", frame_file, "--out", tmp_path / "out", "--to", "parquet")
    assert outcome.code == 2
    assert "pip install '.[parquet]'" in outcome.err
    assert not (tmp_path / "out").exists()


def test_a_wrong_format_is_told_with_those_there_are(run_circlecal, results, frame_file, tmp_path):
    run, out = results[0].parent, tmp_path / "out"
    for command in (("batch", frame_file), ("track", frame_file), ("convert", run)):
        outcome = run_circlecal(*command, "--to", "foo", "--out", out)
        assert outcome.code == 2
        assert re.search(r"--to foo: is no format that can be written; known: .*\bparquet, ", outcome.err), outcome.err
    outcome = run_circlecal("convert", run, "--to", "coco", "--out", out)
    assert (outcome.code, "no way from a circlecal result to coco" in outcome.err) == (2, True)


def test_results_become_cameras_too(run_circlecal, results, frame_file, tmp_path):
    path, _ = results
    assert run_circlecal("convert", path, "--to", "soccernet", "--out", tmp_path / "cameras").code == 0
    run_circlecal("calibrate", frame_file, "--to", "soccernet", "--out", tmp_path / "one", "--no-overlay")
    assert [file.name for file in (tmp_path / "cameras").iterdir()] == ["camera_good.json"]
    name = "camera_good.json"
    ours, direct = (json.loads((tmp_path / folder / name).read_text()) for folder in ("cameras", "one"))
    assert list(ours) == list(direct)
    for key, value in direct.items():  # angles are written in degrees: a rounding each way
        assert ours[key] == pytest.approx(value, rel=1e-9), key


def test_of_a_run_its_results_alone_are_converted(run_circlecal, results, tmp_path):
    run, out = results[0].parent, tmp_path / "again"
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / RESULTS_NAME).touch()
    for target in ("soccernet", "tvcalib", "broadtrack", "gamestate"):
        run_circlecal("convert", run, "--to", target, "--out", run)
    outcome = run_circlecal("convert", tmp_path / "empty", run, "--to", "tvcalib", "--out", out)
    assert outcome.code == 0
    assert "holds no accepted frame; left out" in outcome.err
    assert len((out / "per_sample_output.json").read_text().splitlines()) == 1


def test_no_frame(run_circlecal, tmp_path):
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "x.json").write_text("{}")
    outcome = run_circlecal("convert", tmp_path / "other", "--to", "parquet", "--out", tmp_path / "out")
    assert (outcome.code, outcome.out) == (2, "")
    assert f"{tmp_path / 'other'}: holds no frame" in outcome.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("content", [None, "nonsense\n", "[]\n", '{"id": "a"}\n'])
def test_no_results(run_circlecal, tmp_path, content):
    path = tmp_path / "results.jsonl"
    if content is not None:
        path.write_text(content)
    outcome = run_circlecal("convert", path, "--to", "parquet", "--out", tmp_path / "out")
    assert outcome.code == 2
    assert str(path) in outcome.err
    assert len(outcome.err.splitlines()) == 1
