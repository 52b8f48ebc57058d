"""Standard streams that are closed, full or read by nobody: no traceback, and no run that ends in its middle."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import circlecal

COMMAND = f"{sys.executable} -m circlecal"
SURROUNDINGS = {**os.environ, "PYTHONPATH": str(Path(circlecal.__file__).parents[1])}
needs_posix = pytest.mark.skipif(os.name != "posix", reason="shells of POSIX close streams")
needs_full_disk = pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")


def run_in_shell(line: str) -> subprocess.CompletedProcess[str]:
    """A command line of bash; its exit code is that of the first command of a pipe."""
    return subprocess.run(
        ["bash", "-c", f"{line}; exit ${{PIPESTATUS[0]}}"],
        check=False,
        capture_output=True,
        text=True,
        env=SURROUNDINGS,
        timeout=300,
    )


@needs_posix
@pytest.mark.parametrize("closed", ["<&-", "<&- >&- 2>&-"])
def test_a_run_without_standard_streams(blank_file, tmp_path, closed):
    """The file of results must not become one of the streams."""
    out = tmp_path / "out"
    ended = run_in_shell(f"{COMMAND} batch {blank_file} --out {out} --workers 1 {closed}")
    assert ended.returncode == 1, ended
    assert "Traceback" not in ended.stderr
    assert (out / "summary.csv").is_file()
    assert len((out / "results.jsonl").read_text().splitlines()) == 1


@needs_posix
def test_json_without_a_standard_output(frame_file, tmp_path):
    ended = run_in_shell(f"{COMMAND} calibrate {frame_file} --out {tmp_path / 'out'} -q --json >&-")
    assert (ended.returncode, ended.stderr) == (0, "")


@needs_full_disk
def test_notes_that_cannot_be_written_end_no_run(blank_file, tmp_path):
    out = tmp_path / "out"
    run = f"{COMMAND} batch {blank_file} --out {out} --workers 1"
    assert run_in_shell(f"{run} 2>/dev/full").returncode == 1
    assert (out / "summary.csv").is_file()
    assert run_in_shell(f"{COMMAND} report {out} 2>/dev/full").returncode == 0
    assert run_in_shell(f"{COMMAND} fields nosuch 2>/dev/full").returncode == 2


@needs_posix
def test_notes_that_nobody_reads_end_no_run(frame_file, tmp_path):
    out = tmp_path / "out"
    ended = run_in_shell(f"{COMMAND} batch {frame_file} --out {out} --workers 1 2>&1 >/dev/null | true")
    assert ended.returncode == 0
    assert (out / "summary.csv").is_file()


@needs_full_disk
@pytest.mark.parametrize("printed", ["fields soccer", "config"])
def test_results_that_cannot_be_printed_are_one_line(printed):
    """Whether they fit into the buffer of the stream or not."""
    ended = run_in_shell(f"{COMMAND} {printed} >/dev/full")
    assert ended.returncode == 2
    assert ended.stderr == "circlecal: error: standard output: cannot be written: no space left on device\n"


@needs_posix
@pytest.mark.parametrize("printed", ["config", "fields", "--help"])
def test_a_reader_who_has_enough_is_no_refused_frame(printed):
    ended = run_in_shell(f"{COMMAND} {printed} | true")
    assert (ended.returncode, ended.stderr) == (141, "")
