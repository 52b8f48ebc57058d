"""A real Dask scheduler with two worker processes: every frame once, whatever happens to a worker."""

import contextlib
import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from circlecal.batch import cluster as cluster_module
from circlecal.errors import InputError

from .runs import (
    PATIENCE_S,
    SURROUNDINGS,
    assert_every_frame_once,
    batch_command,
    paint,
    records,
    start_signalling,
    wait_for,
)

pytest.importorskip("distributed", reason="the extra distributed is not installed")


class DaskCluster:
    """A scheduler and workers, each a process of its own, started as `dask scheduler` and `dask worker` do."""

    def __init__(self, folder: Path, workers: int) -> None:
        self.folder = folder
        self.workers: list[subprocess.Popen] = []
        self.processes: list[subprocess.Popen] = []
        file = folder / "scheduler.json"
        options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
        self.scheduler = self.start("distributed.cli.dask_scheduler", *options)
        wait_for(lambda: file.is_file() and file.read_text().strip().endswith("}"))
        self.address = json.loads(file.read_text())["address"]
        for _ in range(workers):
            self.add_worker()

    def start(self, module: str, *arguments: str) -> subprocess.Popen:
        with (self.folder / "dask.log").open("a") as log:
            command = [sys.executable, "-m", module, *arguments]
            process = subprocess.Popen(command, stdout=log, stderr=log, env=SURROUNDINGS, cwd=self.folder)
        self.processes.append(process)
        return process

    def add_worker(self) -> None:
        """Start one more."""
        options = ["--no-nanny", "--no-dashboard", "--nthreads=1"]
        self.workers.append(self.start("distributed.cli.dask_worker", self.address, *options))

    def joined(self, count: int) -> bool:
        """Whether so many workers have told the scheduler that they are there."""
        return (self.folder / "dask.log").read_text().count("Registered to:") >= count

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    """One with two workers, of which the first test kills one, and the last test everything."""
    started = DaskCluster(tmp_path_factory.mktemp("dask"), 2)
    yield started
    started.close()


def cluster_command(cluster: DaskCluster, frames: Path, out: Path) -> list[str]:
    return batch_command(frames, out, "--scheduler", cluster.address)


def test_a_killed_worker_loses_nothing(cluster, tmp_path):
    count = 40
    frames, out = paint(tmp_path / "frames", count), tmp_path / "out"
    command, script = cluster_command(cluster, frames, out), tmp_path / "killing.py"
    wait_for(lambda: cluster.joined(2))
    run = start_signalling(command, script, after=5, number=signal.SIGKILL, to=cluster.workers[0].pid)
    _, errors = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 1, errors
    assert cluster.workers.pop(0).poll() == -signal.SIGKILL
    assert_every_frame_once(out, count)
    assert not [record for record in records(out) if record["code"] in ("worker_died", "internal_error")]


def only_error(errors: str) -> str:
    """The one line that a command that ended with an error has said."""
    assert "Traceback" not in errors
    [told] = [line for line in errors.splitlines() if line.startswith("circlecal: error: ")]
    return told


def test_interrupted(cluster, tmp_path):
    frames, out = paint(tmp_path / "frames", 40), tmp_path / "out"
    command = cluster_command(cluster, frames, out)
    run = start_signalling(command, tmp_path / "interrupted.py", after=3, number=signal.SIGINT)
    _, errors = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 130, errors
    assert len(records(out)) == 3
    assert "Traceback" not in errors
    assert all(process.poll() is None for process in (cluster.scheduler, *cluster.workers))


def test_the_same_answers_as_on_this_machine(run_circlecal, cluster, frame_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    here = json.loads(run_circlecal("calibrate", frame_file, "--out", "here", "--no-overlay", "--json").out)
    outcome = run_circlecal("batch", "frames", "--out", "there", "--scheduler", cluster.address, "--files")
    assert outcome.code == 0, outcome
    assert records(Path("there"))[0]["H_image_field"] == here["H_image_field"]
    assert {path.name for path in Path("there").iterdir()} >= {"good.json", "good.overlay.jpg"}


def test_workers_of_this_machine_listen_on_the_loopback_only_and_leave_nothing(
    run_circlecal, tmp_path, monkeypatch, recwarn
):
    temporary, out = tmp_path / "tmp", tmp_path / "out"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    start, started = cluster_module._local_cluster, []

    def look_at_it(scheduler, stack):
        local = start(scheduler, stack)
        started.append(local)
        assert local.scheduler_address.startswith("tcp://127.0.0.1:")
        assert all(address.startswith("tcp://127.0.0.1:") for address in local.scheduler.workers)
        port = int(local.scheduler_address.rpartition(":")[2])
        other = socket.gethostbyname(socket.gethostname())
        if not other.startswith("127."):
            with pytest.raises(OSError), socket.create_connection((other, port), timeout=2):
                pass
        return local

    monkeypatch.setattr(cluster_module, "_local_cluster", look_at_it)
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # as another run does that was started before
            stack.enter_context(socket.create_server(("127.0.0.1", 8787)))
        outcome = run_circlecal("batch", paint(tmp_path / "frames", 3), "--out", out, "--scheduler", "local:1")
    assert not [warning for warning in recwarn if "8787" in str(warning.message)]
    assert (outcome.code, outcome.out[:9]) == (1, "3 frames:")
    assert_every_frame_once(out, 3)
    assert len(started) == 1
    assert not list(temporary.iterdir())


@pytest.mark.parametrize("scheduler", ["local:0", "local:many", "somewhere", "nonsense://a:1"])
def test_a_wrong_scheduler_is_one_line(run_circlecal, tmp_path, scheduler):
    frames = paint(tmp_path / "frames", 1)
    outcome = run_circlecal("batch", frames, "--out", tmp_path / "out", "--scheduler", scheduler)
    assert outcome.code == 2
    assert len(outcome.err.splitlines()) == 1
    assert f"--scheduler {scheduler}" in outcome.err


def test_a_missing_extra_is_one_line(run_circlecal, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    frames = paint(tmp_path / "frames", 1)
    outcome = run_circlecal("batch", frames, "--out", tmp_path / "out", "--scheduler", "local:1")
    assert outcome.code == 2
    assert "pip install '.[distributed]'" in outcome.err


@pytest.mark.parametrize(
    "scheduler",
    ["tcp://127.0.0.1", "http://a:1", "inproc://a/1", "tls://a:1", "ucx://a:1", "ws://a:1", "tcp://a b:1", "tcp://:1"],
)
def test_an_address_is_checked_before_connecting(run_circlecal, tmp_path, scheduler):
    frames = paint(tmp_path / "frames", 1)
    outcome = run_circlecal("batch", frames, "--out", tmp_path / "out", "--scheduler", scheduler)
    assert outcome.code == 2
    assert "must be local:N with the number of workers, or tcp://host:port" in outcome.err
    assert len(outcome.err.splitlines()) == 1


def test_what_was_finished_and_lost_with_all_workers_is_not_waited_for(monkeypatch):
    class Lost:
        status = "finished"

        def result(self, timeout: float | None = None) -> None:
            assert timeout is not None
            raise TimeoutError

    class Alone:
        status = "running"

        def nthreads(self) -> dict[str, int]:
            return {}

    patience = cluster_module._Patience(Alone(), "tcp://a:1", 0.0)
    with pytest.raises(InputError, match="all workers are lost"):
        cluster_module._result(Lost(), None, None, patience)


def test_all_workers_lost_then_the_scheduler_lost_are_one_line_each_and_the_run_goes_on(
    cluster, run_circlecal, in_this_process, tmp_path
):
    """One run, interrupted by both losses one after the other and ended on this machine: nothing of it is lost or done
    twice. It comes last, since little of the cluster is left.
    """
    count = 40
    frames, out = paint(tmp_path / "frames", count), tmp_path / "out"
    command = cluster_command(cluster, frames, out)
    impatient, script = [*command, "--set", "limits.server_seconds=2"], tmp_path / "killing.py"
    run = start_signalling(impatient, script, after=5, number=signal.SIGKILL, to=cluster.workers[0].pid)
    _, errors = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 2, errors
    assert "all workers are lost" in only_error(errors)
    cluster.workers.clear()
    first = len(records(out))
    assert 5 <= first < count - 5

    cluster.add_worker()
    run = start_signalling(command, script, after=5, number=signal.SIGKILL, to=cluster.scheduler.pid)
    _, errors = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 2, errors
    assert "run the same command again" in only_error(errors)
    assert first + 5 <= len(records(out)) < count

    again = run_circlecal("batch", frames, "--out", out)
    assert again.code == 1, again
    assert_every_frame_once(out, count)
