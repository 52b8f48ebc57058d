"""The README's commands do what they say, and its tables are there."""

import re
import shlex
import shutil
from fnmatch import fnmatch
from pathlib import Path

import pytest

from circlecal.checks import CHECKS
from circlecal.config import Config
from circlecal.overlay.quality import SCALE
from circlecal.refusals import REFUSALS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
TABLES = (ROOT / "circlecal" / "evaluation" / "bench" / "README.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^(?:\$| .*&&) circlecal (.+)$", README, flags=re.MULTILINE)


def test_commands_run_in_order(tmp_path, monkeypatch, run_circlecal, in_this_process):
    """In one folder, since later commands read what earlier ones wrote."""
    shutil.copytree(ROOT / "samples", tmp_path / "samples")
    monkeypatch.chdir(tmp_path)
    assert len(COMMANDS) > 8
    for command in COMMANDS:
        outcome = run_circlecal(*shlex.split(command))
        # one of the samples is refused as long as nobody names its markings
        refused = command.startswith("batch samples ")
        assert outcome.code == (1 if refused else 0), f"{command}: {outcome.err}"
    ignored = (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
    written = [path for path in tmp_path.iterdir() if path.name != "samples"]
    kept = [path.name for path in written if not any(fnmatch(f"{path.name}/", pattern) for pattern in ignored)]
    assert written
    assert not kept, "git would list what the commands write"


def test_python_examples_run(in_this_process, tmp_path, monkeypatch, capsys):
    examples = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    shutil.copytree(ROOT / "samples", tmp_path / "samples")
    monkeypatch.chdir(tmp_path)
    known = {"__name__": "__main__"}
    for example in examples:
        exec(compile(example, "README.md", "exec"), known)  # the example itself
    assert len(examples) > 1
    told = re.search(r"print\(frame\)  # (.*)", README)[1]
    assert capsys.readouterr().out == f"{told}\n"
    assert known["frame"].ok and known["clicked"].ok
    assert known["run"].ids == known["again"].ids == ["full_circle"]
    assert known["run"]["full_circle"].ok


def test_the_scale_of_sigma_is_that_of_the_overlays():
    assert SCALE in README


READMES = sorted(path for path in ROOT.rglob("README.md") if not any(part.startswith(".") for part in path.parts))


@pytest.mark.parametrize("file", READMES, ids=lambda file: str(file.relative_to(ROOT)))
def test_every_linked_file_exists(file):
    for target in re.findall(r"\]\(([^)#]+)\)", file.read_text(encoding="utf-8")):
        assert "://" in target or (file.parent / target).exists(), target


@pytest.mark.parametrize("table", ["accuracy", "detect", "annotations", "ransac", "solvers"])
def test_tables_are_filled(table):
    body = TABLES.split(f"<!-- {table} -->")[1].split(f"<!-- /{table} -->")[0]
    assert body.count("\n|") >= 4


def test_every_section_of_the_configuration_is_explained():
    text = (ROOT / "configs" / "README.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^\| `(\w+)` \|", text, flags=re.MULTILINE)) == sorted(Config.model_fields)


def refusal_rows():
    """The table of refusals as a page shows it."""
    rows = ["| code | reason | meaning | what helps |", "|---|---|---|---|"]
    rows += [f"| `{r.code}` | {r.words} | {r.meaning} | {r.help} |" for r in REFUSALS.values()]
    return "\n".join(rows)


def check_rows():
    """The table of checks as a page shows it."""
    rows = ["| check | its value is | must be | limit set by | refuses as |", "|---|---|---|---|---|"]
    for name, gate in CHECKS.items():
        option = ", ".join(f"`{one}`" for one in gate.option.split(", ") if one)
        bound = "at least" if gate.at_least else "at most"
        rows.append(f"| `{name}` | {gate.measures} | {bound} | {option} | `{gate.code}` |")
    return "\n".join(rows)


def test_the_page_of_checks_is_the_table():
    page = ROOT / "circlecal" / "stages" / "README.md"
    shown = page.read_text(encoding="utf-8").split("<!-- checks -->\n")[1].split("\n<!-- /checks -->")[0]
    assert shown == check_rows(), "write check_rows() between the marks"


def test_options_that_set_limits_exist():
    options = {one for gate in CHECKS.values() for one in gate.option.split(", ") if one}
    for option in options:
        section = Config()
        for key in option.split("."):
            section = getattr(section, key)


def test_the_page_of_refusals_is_the_table():
    page = ROOT / "circlecal" / "stages" / "README.md"
    shown = page.read_text(encoding="utf-8").split("<!-- refusals -->\n")[1].split("\n<!-- /refusals -->")[0]
    assert shown == refusal_rows(), "write refusal_rows() between the marks"
