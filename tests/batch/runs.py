"""Runs of `circlecal batch` as processes, and what must hold after them."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import cv2
import numpy as np

import circlecal
from circlecal.batch import SUMMARY_NAME
from circlecal.records.log import RESULTS_NAME

COMMAND = [sys.executable, "-m", "circlecal", "batch"]
SURROUNDINGS = {**os.environ, "PYTHONPATH": str(Path(circlecal.__file__).parents[1])}


PATIENCE_S = 300.0
"""Limit of every wait, far beyond what a loaded machine needs: only what hangs reaches it."""

SIGNALLING = """
import os
from circlecal.records.log import ResultLog
from circlecal.cli import main

whole = ResultLog.append
lines = 0

def append(log, finished):
    global lines
    whole(log, finished)
    lines += 1
    if lines == {after}:
        os.kill({to}, {number})

if __name__ == "__main__":
    ResultLog.append = append
    main()
"""


def start_signalling(
    command: list[str], script: Path, *, after: int, number: int, to: int | str = 0
) -> subprocess.Popen[str]:
    """Start a batch that sends a signal right after it has written some lines, by default to itself and its workers.

    Sent from outside, a signal meets a run that is further, on a loaded machine even one that has ended.
    """
    script.write_text(SIGNALLING.format(after=after, to=to, number=int(number)))
    return subprocess.Popen(
        [sys.executable, str(script), *command[command.index("batch") :]],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=SURROUNDINGS,
        start_new_session=True,
        preexec_fn=_listen_to_ctrl_c,
    )


def _listen_to_ctrl_c() -> None:
    """Shells start what runs in the background deaf to Ctrl-C, and children inherit that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def paint(folder: Path, count: int) -> Path:
    """Small pictures without a field, so that a frame takes milliseconds."""
    folder.mkdir(parents=True, exist_ok=True)
    for index in range(count):
        cv2.imwrite(str(folder / f"f{index:03d}.png"), np.full((80, 120, 3), index % 256, np.uint8))
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
    return [*COMMAND, str(frames), "--out", str(out), "--workers", "1", *options]


def wait_for(condition) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "timed out"
        time.sleep(0.02)


def children(pid: int) -> list[int]:
    listed = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in listed.read_text().split()] if listed.is_file() else []


def alive(pid: int) -> bool:
    return _state(pid) not in ("", "Z")


def stopped(pid: int) -> bool:
    return _state(pid) == "T"


def _state(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return ""
