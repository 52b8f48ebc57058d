"""Runs that are killed and runs that end, with stand-ins for the processes."""

import json
import subprocess

import pytest

from circlecal.evaluation.bench import faults
from circlecal.records.log import RESULTS_NAME


class Run:
    """A batch that is killed while anybody waits for less than a minute, and else refuses all of its two frames."""

    def __init__(self, out, code):
        self.out, self.returncode = out, code

    def communicate(self, timeout=None):
        self.out.mkdir(exist_ok=True)
        lines = [json.dumps({"id": f"f{number:04d}"}) + "\n" for number in range(2)]
        if timeout is not None and timeout < 60.0:
            (self.out / RESULTS_NAME).write_text(lines[0])
            raise subprocess.TimeoutExpired("circlecal", timeout)
        if timeout is not None:
            (self.out / RESULTS_NAME).write_text("".join(lines))
        return b"2 frames: 0 calibrated, 2 refused\n", b""

    def send_signal(self, number):
        pass


@pytest.mark.parametrize(("code", "wrong"), [(1, 0), (2, 1)])
def test_the_run_after_the_last_kill_is_checked_like_any_other(monkeypatch, code, wrong):
    monkeypatch.setattr(faults, "_start", lambda pictures, out, workers: Run(out, code))
    report = faults.run_kills(3, 2, 1, seed=0)
    assert (report.finished_runs, report.wrong_ends) == (1, wrong)
    assert sum(row.kills for row in report.rows) == 3
    assert all((row.lost, row.doubled, row.damaged) == (0, 0, 0) for row in report.rows)


def test_the_batch_that_is_killed_is_one_that_runs(tmp_path):
    """One that did not start would lose nothing either."""
    run = faults._start(faults._paint(tmp_path / "frames", 2), tmp_path / "out", 1)
    said, _ = run.communicate(timeout=60.0)
    assert faults._is_right_end(run.returncode, said, tmp_path / "out", 2)
