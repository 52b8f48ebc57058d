"""`circlecal bench batch` on next to nothing."""

import json

from circlecal.evaluation.bench.batch import run_scaling


def test_both_tables(run_circlecal):
    outcome = run_circlecal("bench", "batch", "--count", 2, "--repeats", 1, "--tasks", 50, "--json")
    assert outcome.code == 0, outcome
    found = json.loads(outcome.out)
    one, two = found["throughput"]
    assert (one["workers"], one["speedup"], two["workers"]) == (1, 1.0, 2)
    assert min(one["rate"], two["rate"], two["speedup"]) > 0
    assert found["scaling"]["frames"] == 50
    assert len(found["scaling"]["memory_mb"]) == 3


def test_memory_of_simulated_frames_stays(tmp_path):
    found = run_scaling(3000, 1)
    early, late, taken = found.memory_mb
    assert late < early + 20
    assert taken < early + 20
