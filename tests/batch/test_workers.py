"""Ctrl-C while workers are started: kept for this process, kept from them."""

import multiprocessing
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from circlecal.batch import workers
from circlecal.batch.workers import WorkersError, map_on_workers, prepare_surroundings

from .runs import PATIENCE_S, SURROUNDINGS, assert_every_frame_once, paint, wait_for

INTERRUPT_AT_A_HAND_OVER = """
import os, signal, sys
from concurrent.futures import ProcessPoolExecutor
from circlecal.cli import main

plain, calls = ProcessPoolExecutor.submit, iter(range(10**6))

def submit(*given, **named):
    if next(calls) == {at}:
        os.kill(os.getpid(), signal.SIGINT)
    return plain(*given, **named)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    ProcessPoolExecutor.submit = submit
    main(["batch", *sys.argv[1:]])
"""


@pytest.fixture(autouse=True)
def _listening():
    """As at a terminal: what shells run in the background is deaf to Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_while_workers_are_started_is_kept_until_they_are():
    reached = []

    def started_and_interrupted():
        with prepare_surroundings():
            signal.raise_signal(signal.SIGINT)
            reached.append("started")

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        started_and_interrupted()
    assert reached == ["started"]
    assert signal.getsignal(signal.SIGINT) is before
    if hasattr(signal, "pthread_sigmask"):
        assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_an_undisturbed_start_raises_nothing():
    with prepare_surroundings():
        pass
    assert signal.getsignal(signal.SIGINT) is not signal.SIG_IGN


FIRST_WORKER = """
import multiprocessing, signal, sys
from circlecal.batch.workers import prepare_surroundings

with prepare_surroundings():
    process = multiprocessing.get_context("spawn").Process(target=signal.raise_signal, args=(signal.SIGINT,))
    process.start()
process.join()
sys.exit(process.exitcode)
"""


def test_a_worker_never_gets_ctrl_c():
    """Not the first one either, with which multiprocessing starts its own process."""
    run = subprocess.run([sys.executable, "-c", FIRST_WORKER], check=False, env=SURROUNDINGS, timeout=PATIENCE_S)
    assert run.returncode == 0


def test_mapped_in_order_and_without_ctrl_c():
    assert list(map_on_workers(abs, [-3, 2, -1], 2)) == [3, 2, 1]
    assert list(map_on_workers(signal.raise_signal, [signal.SIGINT], 1)) == [None]
    half = map_on_workers(abs, range(100), 1)
    assert next(half) == 0
    half.close()
    wait_for(lambda: not multiprocessing.active_children())  # the pool's own thread may be the one that sees it end


@pytest.mark.parametrize("at", [0, 5])
def test_no_hand_over_of_a_frame_loses_ctrl_c(at, tmp_path):
    script = tmp_path / "interrupted.py"
    script.write_text(INTERRUPT_AT_A_HAND_OVER.format(at=at))
    frames, out = paint(tmp_path / "frames", 10), tmp_path / "out"
    run = subprocess.run(
        [sys.executable, str(script), str(frames), "--out", str(out), "--workers", "1"],
        capture_output=True,
        text=True,
        check=False,
        env=SURROUNDINGS,
        timeout=PATIENCE_S,
    )
    assert run.returncode == 130, run
    assert run.stderr.splitlines()[-1] == "circlecal: interrupted; the same command goes on"


def die_as_it_starts(task):
    """Start a worker, of which the first ones die as if killed."""
    starts, deaths = Path(os.environ["STARTS_OF_WORKERS"]), int(os.environ["DEATHS_OF_WORKERS"])
    with starts.open("a") as file:
        file.write("x")
    if len(starts.read_text()) <= deaths:
        os._exit(1)
    workers._start_worker(task)


@pytest.mark.parametrize("deaths", [1, 100])
def test_workers_that_are_killed_as_they_start(run_circlecal, monkeypatch, tmp_path, deaths):
    """One is started anew; where that does not help, it is one line, and nothing is lost."""
    monkeypatch.setattr(workers, "_start_worker", die_as_it_starts)
    monkeypatch.setenv("STARTS_OF_WORKERS", str(tmp_path / "starts"))
    monkeypatch.setenv("DEATHS_OF_WORKERS", str(deaths))
    command = "batch", paint(tmp_path / "frames", 3), "--out", tmp_path / "out", "--workers", 1
    outcome = run_circlecal(*command)
    if deaths > 1:
        assert outcome.code == 2, outcome
        [told] = [line for line in outcome.err.splitlines() if "error" in line]
        assert told.startswith("circlecal: error: worker processes die as they start")
        monkeypatch.setenv("DEATHS_OF_WORKERS", "0")
        outcome = run_circlecal(*command)
    assert outcome.code == 1 and "worker_died" not in (tmp_path / "out" / "results.jsonl").read_text()
    assert_every_frame_once(tmp_path / "out", 3)


def test_a_mapping_worker_that_dies_is_told_in_one_line():
    with pytest.raises(WorkersError, match="a worker process died"):
        list(map_on_workers(os._exit, [1], 1))
