"""A run killed at any moment: every finished frame is there once, and the file parses when the run is taken up."""

import json
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from circlecal.records.log import INDEX_NAME, RESULTS_NAME, Finished, ResultLog
from circlecal.records.record import ResultRecord
from circlecal.records.writing import failure_record
from circlecal.results import Verdict

from .runs import SURROUNDINGS, alive, assert_every_frame_once, batch_command, children, paint, records, wait_for

DIGEST = "0123456789ab"
COUNT = 12


def record(number: int) -> ResultRecord:
    verdict = Verdict("refused", "unreadable_input", "x" * number, "input")
    return failure_record(f"f{number:03d}", "f.png", verdict, 0, DIGEST)


@pytest.fixture(scope="module")
def states(tmp_path_factory) -> list[tuple[bytes, bytes]]:
    """Results and index as they were on the disk after each frame."""
    folder = tmp_path_factory.mktemp("states")
    kept = []
    with ResultLog(folder) as log:
        log.take_up(DIGEST)
        for number in range(COUNT):
            log.append(Finished.of(record(number)))
            log.index.commit()
            kept.append(((folder / RESULTS_NAME).read_bytes(), (folder / INDEX_NAME).read_bytes()))
    return kept


@given(
    cut=st.floats(0, 1),
    indexed=st.integers(-1, COUNT - 1),
    tail=st.sampled_from([b"", b"\0\0\0", b'{"id"', b'{"id": "x", "status": "refused"}']),
)
def test_results_cut_anywhere_with_an_index_of_any_age(states, tmp_path_factory, cut, indexed, tail):
    folder = tmp_path_factory.mktemp("cut")
    content = states[-1][0]
    left = content[: round(cut * len(content))]
    (folder / RESULTS_NAME).write_bytes(left + tail)
    if indexed >= 0:
        (folder / INDEX_NAME).write_bytes(states[indexed][1])
    whole = left.count(b"\n")
    with ResultLog(folder) as log:
        log.take_up(DIGEST)
        assert [row.id for row in log.index.rows()] == [f"f{number:03d}" for number in range(whole)]
        for number in range(whole, COUNT):
            assert log.index.find(f"f{number:03d}") is None
            log.append(Finished.of(record(number)))
    assert (folder / RESULTS_NAME).read_bytes() == content
    shutil.rmtree(folder)


def test_killed_again_and_again(run_circlecal, in_this_process, tmp_path):
    count = 24
    frames, out = paint(tmp_path / "frames", count), tmp_path / "out"
    generator = np.random.default_rng(7)
    for workers in ("2", "1"):
        before = finished(out)
        command = [*batch_command(frames, out, "-q"), "--workers", workers]
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=SURROUNDINGS)
        wait_for(lambda run=run, before=before: run.poll() is not None or finished(out) > before)
        time.sleep(generator.uniform(0, 0.05))
        started = children(run.pid)
        run.send_signal(signal.SIGKILL)
        run.wait()
        wait_for(lambda started=started: not any(alive(pid) for pid in started))
        lines = (out / RESULTS_NAME).read_bytes().splitlines(keepends=True)
        ids = [json.loads(line)["id"] for line in lines if line.endswith(b"\n")]
        assert len(ids) == len(set(ids)) >= before
    assert run_circlecal("batch", frames, "--out", out, "-q").code == 1
    assert len(records(out)) == count
    assert_every_frame_once(out, count)


def finished(out: Path) -> int:
    path = out / RESULTS_NAME
    return path.read_bytes().count(b"\n") if path.is_file() else 0
