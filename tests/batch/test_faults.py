"""Disks that fill up, folders that go away, frames that do not end, clocks that go back: nothing finished is lost."""

import errno
import json
import os
import shutil
import sqlite3
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from circlecal.batch import SUMMARY_NAME, run_batch
from circlecal.batch.limits import TimeLimitError, limit_memory, limit_time
from circlecal.batch.task import record_failure
from circlecal.errors import InputError
from circlecal.pictures.limits import LimitsConfig
from circlecal.records.index import ResultIndex
from circlecal.records.log import RESULTS_NAME
from circlecal.records.record import ResultRecord

COUNT = 12
SHORT = LimitsConfig(frame_seconds=0.5)


@dataclass(frozen=True)
class Frame:
    id: str


@dataclass(frozen=True)
class Action:
    """A task that does something at some frames, and takes no time."""

    at: str = ""
    what: str = ""
    digest: str = "0" * 12
    seed: int = 0
    limits: LimitsConfig = SHORT

    def source(self, frame: Frame) -> str:
        return f"{frame.id}.jpg"

    def record(self, frame: Frame) -> ResultRecord:
        if frame.id == self.at:
            if self.what == "sleep":
                for _ in range(1000):
                    time.sleep(0.01)
            if self.what == "stick":
                import ctypes

                ctypes.CDLL(None).sleep(100)
            if self.what == "memory":
                np.ones(10**9)
            if self.what == "exit":
                os._exit(1)
            if self.what == "opencv":
                raise cv2.error("Insufficient memory (Failed to allocate 1000 bytes)")
            if self.what == "os":
                raise OSError(errno.EIO, "Input/output error")
        return record_failure(self, frame, "unreadable_input", "nothing")


def frames(count: int = COUNT) -> list[Frame]:
    return [Frame(f"f{number:03d}") for number in range(count)]


def ids(out: Path) -> list[str]:
    lines = (out / RESULTS_NAME).read_bytes().splitlines()
    return [json.loads(line)["id"] for line in lines]


def act_after(count, action):
    def on_progress(progress):
        if progress.finished == count:
            action()

    return on_progress


# the output


@pytest.mark.parametrize("when", [5, COUNT])
@pytest.mark.parametrize("how", ["rename", "remove", "unlink", "replace"])
def test_results_that_go_away_during_the_run_are_noticed(tmp_path, in_this_process, when, how):
    out = tmp_path / "out"

    def go_away():
        if how == "rename":
            out.rename(tmp_path / "moved")
        elif how == "remove":
            shutil.rmtree(out)
        else:
            (out / RESULTS_NAME).unlink()
        if how == "replace":
            (out / RESULTS_NAME).write_text("")

    with pytest.raises(InputError, match=f"removed, renamed or replaced during the run, and its {when} results"):
        run_batch(frames(), Action(), out, workers=1, on_progress=act_after(when, go_away))
    assert not (out / SUMMARY_NAME).exists()
    if how in ("rename", "remove"):
        assert not out.exists()
    if how == "rename":
        assert len(ids(tmp_path / "moved")) == when
    run_batch(frames(), Action(), out, workers=1)
    assert ids(out) == [frame.id for frame in frames()]


def test_the_input_goes_away_during_the_run(run_circlecal, tmp_path, frame_file, in_this_process):
    for name in ("b", "c"):
        shutil.copy(frame_file, frame_file.with_name(f"{name}.png"))
    from circlecal.batch.frames import FrameRun
    from circlecal.config import load_config
    from circlecal.pictures.files import find_frames

    task = FrameRun(load_config())
    found = find_frames([frame_file.parent])
    remove = act_after(1, lambda: shutil.rmtree(frame_file.parent))
    counts = run_batch(found, task, tmp_path / "out", workers=1, on_progress=remove)
    assert (counts.finished, counts.calibrated, counts.unreadable) == (3, 1, 2)


# the disk


def full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("at", ["results", "index", "summary"])
def test_a_full_disk_at_every_kind_of_write_of_a_batch(tmp_path, in_this_process, at):
    out = tmp_path / "out"
    done = 0
    with pytest.MonkeyPatch.context() as patch, pytest.raises(InputError, match="free space") as caught:

        def fill():
            if at == "results":
                patch.setattr(os, "write", full)
            if at == "index":

                def add(*_):
                    raise sqlite3.OperationalError("database or disk is full")

                patch.setattr(ResultIndex, "add", add)
            if at == "summary":
                patch.setattr(os, "fsync", full)
                patch.setattr("circlecal.files.os.fsync", full)

        when = COUNT if at == "summary" else 5
        run_batch(frames(), Action(), out, workers=1, on_progress=act_after(when, fill))
    assert str(out) in str(caught.value)
    assert "\n" not in str(caught.value)
    done = len(ids(out))
    assert done == {"results": 5, "index": 6, "summary": COUNT}[at]
    assert not [file for file in out.iterdir() if file.name.startswith(".")]
    run_batch(frames(), Action(), out, workers=1)
    assert ids(out) == [frame.id for frame in frames()]


@pytest.mark.parametrize("call", ["mkstemp", "fsync", "replace"])
@pytest.mark.parametrize("command", ["calibrate", "debug", "convert", "report"])
def test_a_full_disk_at_every_file_of_a_command(run_circlecal, tmp_path, blank_file, monkeypatch, command, call):
    first, out = tmp_path / "first", tmp_path / "out"
    run_circlecal("calibrate", blank_file, "--out", first)
    annotation = tmp_path / "f.json"
    point = {"label": "centre_mark", "shape_type": "point", "points": [[5.0, 6.0]]}
    annotation.write_text(json.dumps({"shapes": [point], "imageWidth": 960, "imageHeight": 540}))
    if call == "replace":
        monkeypatch.setattr(Path, "replace", full)
    else:
        monkeypatch.setattr("tempfile.mkstemp" if call == "mkstemp" else "os.fsync", full)
    if command == "report":
        monkeypatch.setattr(Path, "write_bytes", full)
    arguments = {
        "calibrate": ("calibrate", blank_file),
        "debug": ("debug", blank_file),
        "convert": ("convert", annotation, "--to", "coco"),
        "report": ("report", first),
    }[command]
    outcome = run_circlecal(*arguments, "--out", out)
    assert outcome.code == 2, outcome
    assert "cannot be written: No space left on device; free space" in outcome.err
    assert not [file for file in out.rglob("*") if file.is_file() and file.name != "index.html"]


# frames that take too much


def test_a_frame_that_takes_too_long_is_a_record(tmp_path, in_this_process):
    counts = run_batch(frames(3), Action("f001", "sleep"), tmp_path, workers=1)
    assert counts.finished == 3
    found = {json.loads(line)["id"]: json.loads(line) for line in (tmp_path / RESULTS_NAME).read_text().splitlines()}
    assert found["f001"]["code"] == "time_limit"
    assert "f001.jpg: took longer than 0.5 s" in found["f001"]["reason"]


@pytest.mark.parametrize(("what", "code"), [("stick", "worker_died"), ("memory", "out_of_memory")])
def test_a_worker_that_hangs_or_takes_too_much_memory(tmp_path, what, code):
    limits = LimitsConfig(frame_seconds=5.0 if what == "memory" else 1.0, memory_mb=1000)
    counts = run_batch(frames(3), Action("f001", what, limits=limits), tmp_path, workers=1)
    assert counts.finished == 3
    codes = {json.loads(line)["id"]: json.loads(line)["code"] for line in (tmp_path / RESULTS_NAME).open()}
    assert codes == {"f000": "unreadable_input", "f001": code, "f002": "unreadable_input"}


@pytest.mark.parametrize(("what", "code"), [("opencv", "out_of_memory"), ("os", "unreadable_input")])
def test_what_libraries_and_the_system_say(tmp_path, in_this_process, what, code):
    run_batch(frames(1), Action("f000", what), tmp_path, workers=1)
    assert json.loads((tmp_path / RESULTS_NAME).read_text())["code"] == code


def test_calibrate_leaves_out_what_takes_too_long(run_circlecal, tmp_path, frame_file):
    outcome = run_circlecal("calibrate", frame_file, "--set", "limits.frame_seconds=0.01", "--out", tmp_path / "out")
    assert outcome.code == 2
    assert "took longer than 0.01 s" in outcome.err


def test_a_block_within_its_time_is_left_alone():
    over = 0
    for number in range(60):
        end = time.monotonic() + 0.0001 * number
        try:
            with limit_time(0.003):
                while time.monotonic() < end:
                    pass
        except TimeLimitError:
            over += 1
    time.sleep(0.05)  # one that came too late would arrive here
    assert over < 60
    with pytest.raises(TimeLimitError), limit_time(0.01):
        while True:
            time.sleep(0.001)
    assert callable(limit_memory)


# clocks


def test_a_clock_that_is_set_back(tmp_path, in_this_process, monkeypatch):
    now = [1e9]

    def earlier():
        now[0] -= 3600.0
        return now[0]

    monkeypatch.setattr(time, "time", earlier)
    monkeypatch.setattr(time, "time_ns", lambda: int(earlier() * 1e9))
    run_batch(frames(5), Action(), tmp_path, workers=1)
    run_batch(frames(), Action(), tmp_path, workers=1)
    assert ids(tmp_path) == [frame.id for frame in frames()]


def test_two_runs_into_one_folder(tmp_path, in_this_process):
    def second():
        with pytest.raises(InputError, match="another run is writing"):
            run_batch(frames(), Action(), tmp_path, workers=1)

    run_batch(frames(), Action(), tmp_path, workers=1, on_progress=act_after(3, second))
    assert ids(tmp_path) == [frame.id for frame in frames()]
