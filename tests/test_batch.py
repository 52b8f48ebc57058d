"""Many frames: every frame once, whatever happens to the run."""

import csv
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest

import circlecal
from circlecal.batch import RESULTS_NAME, SUMMARY_NAME, BatchProgress, ResultLog, run_batch
from circlecal.config import Config, config_digest, load_config
from circlecal.errors import InputError
from circlecal.formats.images import find_frames

COMMAND = [sys.executable, "-m", "circlecal.cli", "batch"]
SURROUNDINGS = {**os.environ, "PYTHONPATH": str(Path(circlecal.__file__).parents[1])}


def paint(folder: Path, count: int) -> Path:
    """Small pictures without a field, so that a frame takes milliseconds."""
    folder.mkdir(parents=True, exist_ok=True)
    for index in range(count):
        cv2.imwrite(str(folder / f"f{index:03d}.png"), np.full((80, 120, 3), index, np.uint8))
    return folder


def records(out: Path) -> list[dict]:
    text = (out / RESULTS_NAME).read_text()
    assert text == "" or text.endswith("\n")
    return [json.loads(line) for line in text.splitlines()]


def assert_every_frame_once(out: Path, count: int) -> None:
    assert Counter(r["id"] for r in records(out)) == Counter(f"f{index:03d}" for index in range(count))
    with (out / SUMMARY_NAME).open() as file:
        assert [row["id"] for row in csv.DictReader(file)] == [f"f{index:03d}" for index in range(count)]


def batch_command(frames: Path, out: Path, *options: str) -> list[str]:
    return [*COMMAND, str(frames), "--out", str(out), "--workers", "2", *options]


def test_all_kinds_of_frames_resume_and_restart(run_circlecal, frame_file, blank_file, tmp_path):
    folder, out = frame_file.parent, tmp_path / "out"
    (folder / "cut.jpg").write_bytes(cv2.imencode(".jpg", np.zeros((99, 99, 3), np.uint8))[1].tobytes()[:-9])
    outcome = run_circlecal("batch", folder, "--out", out, "--workers", 2, "--json")
    assert outcome.code == 1, outcome
    counts = json.loads(outcome.out)
    assert (counts["total"], counts["calibrated"], counts["refused"], counts["unreadable"]) == (3, 1, 2, 1)
    assert "3/3 frames, 1 calibrated, 2 refused" in outcome.err
    found = {r["id"]: r for r in records(out)}
    assert found["good"]["status"] == "calibrated"
    assert (found["cut"]["status"], found["cut"]["code"]) == ("refused", "unreadable_input")
    assert "truncated" in found["cut"]["reason"]
    assert sorted(p.name for p in out.iterdir()) == [RESULTS_NAME, SUMMARY_NAME]

    before = (out / RESULTS_NAME).read_bytes()
    again = run_circlecal("batch", folder, "--out", out, "--workers", 2)
    assert again.code == 1
    assert again.out.startswith("3 frames: 1 calibrated, 2 refused (1 of them unreadable)")
    assert "(3 from before)" in again.err
    assert (out / RESULTS_NAME).read_bytes() == before

    other = run_circlecal("batch", folder, "--out", out, "--seed", 9)
    assert other.code == 2
    assert "another configuration" in other.err
    assert "--restart" in other.err
    assert (out / RESULTS_NAME).read_bytes() == before
    restarted = run_circlecal("batch", folder, "--out", out, "--workers", 2, "--seed", 9, "--restart", "--quiet")
    assert (restarted.code, restarted.out, restarted.err) == (1, "", "")
    assert {r["seed"] for r in records(out)} == {9}


def test_same_answers_as_calibrate_whatever_the_workers(run_circlecal, frame_file, tmp_path):
    single = run_circlecal("calibrate", frame_file, "--out", tmp_path / "one", "--json", "--no-overlay")
    run_circlecal("batch", frame_file.parent, "--out", tmp_path / "many", "--workers", 1, "--files", "--no-overlay")
    expected = json.loads(single.out)
    for record in (*records(tmp_path / "many"), json.loads((tmp_path / "many" / "good.json").read_text())):
        assert record["H_image_field"] == expected["H_image_field"]
        assert record["config_digest"] == expected["config_digest"]


def test_killed_in_the_middle_and_resumed(tmp_path):
    count = 80
    frames, out = paint(tmp_path / "frames", count), tmp_path / "out"
    run = subprocess.Popen(
        batch_command(frames, out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=SURROUNDINGS
    )
    wait_for(lambda: (out / RESULTS_NAME).is_file() and len((out / RESULTS_NAME).read_bytes().splitlines()) >= 3)
    workers = children(run.pid)
    run.send_signal(signal.SIGKILL)
    run.wait()
    done = (out / RESULTS_NAME).read_bytes().count(b"\n")
    assert 3 <= done < count
    wait_for(lambda: not any(alive(pid) for pid in workers))
    with (out / RESULTS_NAME).open("ab") as file:
        file.write(b'{"id": "f140", "status": "calib')  # a line torn by the kill
    resumed = subprocess.run(batch_command(frames, out), capture_output=True, text=True, check=False, env=SURROUNDINGS)
    assert resumed.returncode == 1, resumed.stderr
    assert f"({done} from before)" in resumed.stderr
    assert_every_frame_once(out, count)


def test_interrupted_and_resumed(tmp_path):
    count = 80
    frames, out = paint(tmp_path / "frames", count), tmp_path / "out"
    run = subprocess.Popen(
        batch_command(frames, out),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=SURROUNDINGS,
    )
    wait_for(lambda: (out / RESULTS_NAME).is_file() and len((out / RESULTS_NAME).read_bytes().splitlines()) >= 3)
    os.killpg(run.pid, signal.SIGINT)  # as a terminal does: to the workers, too
    _, errors = run.communicate(timeout=20)
    assert run.returncode == 130
    assert "Traceback" not in errors
    assert errors.splitlines()[-1] == "circlecal: interrupted"
    assert len(records(out)) < count
    assert (out / SUMMARY_NAME).is_file()
    assert subprocess.run(batch_command(frames, out, "-q"), check=False, env=SURROUNDINGS).returncode == 1
    assert_every_frame_once(out, count)


def test_a_full_disk_in_the_middle_and_resumed(tmp_path):
    count = 40
    frames, out = paint(tmp_path / "frames", count), tmp_path / "out"

    def limit_file_size() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (12_000, 12_000))

    full = subprocess.run(
        batch_command(frames, out),
        capture_output=True,
        text=True,
        check=False,
        env=SURROUNDINGS,
        preexec_fn=limit_file_size,
    )
    assert full.returncode == 2
    errors = [line for line in full.stderr.splitlines() if line.startswith("circlecal: error: ")]
    assert len(errors) == 1
    assert f"{out / RESULTS_NAME}: cannot be written" in errors[0]
    assert "Traceback" not in full.stderr
    assert 0 < len(records(out)) < count
    assert subprocess.run(batch_command(frames, out, "-q"), check=False, env=SURROUNDINGS).returncode == 1
    assert_every_frame_once(out, count)


def test_a_line_cut_by_a_full_disk_is_taken_back(tmp_path, monkeypatch):
    with ResultLog(tmp_path) as log:
        log.append({"id": "a"})
        whole = os.write

        def short(descriptor: int, content: bytes) -> int:
            if len(content) > 10:
                return whole(descriptor, content[:10])
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("os.write", short)
        with pytest.raises(InputError, match="No space left"):
            log.append({"id": "b", "reason": "long enough"})
    assert records(tmp_path) == [{"id": "a"}]


def test_a_damaged_line_in_the_middle_is_an_error(tmp_path):
    digest = config_digest(Config())
    good = json.dumps({"id": "a", "status": "refused", "config_digest": digest})
    (tmp_path / RESULTS_NAME).write_text(f"{good}\nnonsense\n{good}\n")
    with ResultLog(tmp_path) as log, pytest.raises(InputError, match="line 2: is no result"):
        log.finished(digest)


@pytest.mark.parametrize("tail", ['{"id": "b"', '{"id": "b", "status": "refused"}', "[", '"x"'])
def test_a_torn_last_line_is_cut_off(tmp_path, tail):
    digest = config_digest(Config())
    good = json.dumps({"id": "a", "status": "refused", "config_digest": digest})
    (tmp_path / RESULTS_NAME).write_text(f"{good}\n{tail}")
    with ResultLog(tmp_path) as log:
        assert list(log.finished(digest)) == ["a"]
    assert (tmp_path / RESULTS_NAME).read_text() == f"{good}\n"


def test_two_runs_in_one_folder(tmp_path):
    with ResultLog(tmp_path), pytest.raises(InputError, match="another run"):
        ResultLog(tmp_path)


def test_a_folder_that_cannot_be_written(run_circlecal, tmp_path):
    frames = paint(tmp_path / "frames", 1)
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "out"):
        outcome = run_circlecal("batch", frames, "--out", out)
        assert outcome.code == 2
        assert len(outcome.err.splitlines()) == 1
        assert str(out) in outcome.err


def test_a_worker_that_dies_costs_one_frame(tmp_path):
    frames = paint(tmp_path / "frames", 6)
    script = tmp_path / "script.py"
    script.write_text(
        "import os, sys\n"
        "from pathlib import Path\n"
        "import circlecal.api\n"
        "calibrate = circlecal.api.calibrate_frame\n"
        "def dying(frame, config, mask):\n"
        "    if frame.id == 'f003':\n"
        "        os._exit(9)\n"
        "    if frame.id == 'f001':\n"
        "        raise ValueError('a mistake of ours')\n"
        "    return calibrate(frame, config, mask)\n"
        "circlecal.api.calibrate_frame = dying\n"
        "if __name__ == '__main__':\n"
        "    from circlecal.cli import main\n"
        "    main(sys.argv[1:])\n"
    )
    out = tmp_path / "out"
    run = subprocess.run(
        [sys.executable, script, *batch_command(frames, out)[3:]],
        capture_output=True,
        text=True,
        check=False,
        env=SURROUNDINGS,
    )
    assert run.returncode == 1, run.stderr
    assert_every_frame_once(out, 6)
    assert [r["id"] for r in records(out) if r["code"] == "worker_died"] == ["f003"]
    assert [r["id"] for r in records(out) if r["code"] == "internal_error"] == ["f001"]


def test_progress_counts(tmp_path):
    frames = find_frames([paint(tmp_path / "frames", 3)])
    config = load_config(None, ["output.overlay=false"])
    seen: list[int] = []
    counts = run_batch(frames, config, tmp_path / "out", workers=1, on_progress=lambda p: seen.append(p.finished))
    assert seen == [0, 1, 2, 3]
    assert isinstance(counts, BatchProgress)
    assert (counts.total, counts.refused, counts.resumed) == (3, 3, 0)
    counts = run_batch(frames, config, tmp_path / "out", workers=1)
    assert (counts.finished, counts.resumed) == (3, 3)


def wait_for(condition, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "timed out"
        time.sleep(0.02)


def children(pid: int) -> list[int]:
    listed = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in listed.read_text().split()] if listed.is_file() else []


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
