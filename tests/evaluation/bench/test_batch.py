"""`circlecal bench batch` on next to nothing."""

import json

from circlecal.batch import run as batch_run
from circlecal.evaluation.bench import batch
from tests.conftest import finish_here


def test_both_tables_and_memory_stays(run_circlecal, monkeypatch):
    """Workers take the pictures; what takes no time needs none."""
    scale = batch.run_scaling

    def scale_here(*given):
        with monkeypatch.context() as patch:
            patch.setattr(batch_run, "_finish_frames", finish_here)
            return scale(*given)

    monkeypatch.setattr(batch, "run_scaling", scale_here)
    monkeypatch.setattr(batch, "_PICTURES", 1)
    monkeypatch.setattr(batch, "_WARM_UP_FRAMES", 2)
    outcome = run_circlecal("bench", "batch", "--count", 2, "--repeats", 1, "--tasks", 2000, "--json")
    assert outcome.code == 0, outcome
    found = json.loads(outcome.out)
    one, two = found["throughput"]
    assert (one["workers"], one["speedup"], two["workers"]) == (1, 1.0, 2)
    assert min(one["rate"], two["rate"], two["speedup"]) > 0
    assert found["scaling"]["frames"] == 2000
    early, late, taken = found["scaling"]["memory_mb"]
    assert late < early + 20
    assert taken < early + 20
