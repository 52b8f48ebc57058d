"""Some damaged files for every reader and command; `circlecal bench fuzz` is the long run."""

from functools import partial

import pytest

from circlecal.cli.app import app
from circlecal.cli.invoke import run_command
from circlecal.errors import CirclecalError
from circlecal.evaluation.bench.fuzz import is_supported, run_fuzz
from circlecal.evaluation.bench.fuzz_readers import readers

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


QUICK = ("calibrate", "convert", "convert to cameras", "audit", "project", "project --points", "report", "config")


@pytest.mark.filterwarnings("ignore")
def test_sound_files_are_read_to_their_end(tmp_path):
    """What refuses every file at its first line would be damaged for nothing; masks hold a picture that is none."""
    refused = []
    for reader in readers(partial(run_command, app)):
        name = reader.name.removeprefix("circlecal ")
        if reader.name.startswith("circlecal") and name not in QUICK:
            continue
        for number, seed in enumerate(reader.seeds()):
            folder = tmp_path / name.replace(" ", "_") / str(number)
            folder.mkdir(parents=True)
            path = folder / f"x{seed.suffix}"
            path.write_bytes(seed.content)
            try:
                reader.read(path, folder / "out")
            except CirclecalError as error:
                refused.append(f"{name}{seed.suffix}: {error}")
    assert [told.partition(":")[0] for told in refused] == ["mask.jpg"], refused
