"""The README's commands do what they say, and its tables are there."""

import re
import shlex
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^\$ circlecal (.+)$", README, flags=re.MULTILINE)


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder like the checkout, in which the README's commands may write, each upon what those before it wrote."""
    folder = tmp_path_factory.mktemp("checkout")
    shutil.copytree(ROOT / "samples", folder / "samples")
    return folder


@pytest.mark.xdist_group("readme")
@pytest.mark.parametrize("command", COMMANDS)
def test_command_runs(command, checkout, monkeypatch, run_circlecal):
    monkeypatch.chdir(checkout)
    outcome = run_circlecal(*shlex.split(command))
    # two of the samples cannot be calibrated
    assert outcome.code == (1 if command.startswith("batch samples") else 0), outcome.err


def test_python_example_runs(monkeypatch, capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    monkeypatch.chdir(ROOT)
    exec(compile(example, "README.md", "exec"), {})  # the example itself
    assert capsys.readouterr().out.startswith("calibrated")


def test_every_linked_file_exists():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


@pytest.mark.parametrize("table", ["accuracy", "detect", "ransac"])
def test_tables_are_filled(table):
    body = README.split(f"<!-- {table} -->")[1].split(f"<!-- /{table} -->")[0]
    assert body.count("\n|") >= 4
