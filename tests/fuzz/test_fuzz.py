"""Some damaged files for every reader and command; `circlecal bench fuzz` is the long run."""

from functools import partial

import pytest

from circlecal.cli.app import app
from circlecal.cli.invoke import run_command
from circlecal.evaluation.bench.fuzz import is_supported, run_fuzz

COUNT = 300


@pytest.mark.skipif(not is_supported(), reason="no timers")
@pytest.mark.filterwarnings("ignore")
def test_no_damaged_file_ends_in_a_traceback_a_hang_or_a_wrong_exit_code():
    rows = run_fuzz(COUNT, 1, partial(run_command, app))
    wrong = [f"{row.name}: {example}" for row in rows for example in row.examples]
    assert not wrong, "\n".join(wrong)
    assert sum(row.inputs for row in rows) == COUNT
    assert all(row.inputs for row in rows)
    assert 0.3 * COUNT < sum(row.refused for row in rows) < COUNT
