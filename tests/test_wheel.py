"""The built wheel holds all that a calibration needs, configurations included."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder with nothing of circlecal but its wheel's content."""
    pytest.importorskip("hatchling", reason="hatchling builds the wheel; it comes with the extra dev")
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = folder.glob("circlecal-*.whl")
    zipfile.ZipFile(wheel).extractall(folder / "site")
    return folder / "site"


COMMANDS = """
import json, sys
import circlecal
from circlecal.cli import main

codes = []
for arguments in json.loads(sys.argv[1]):
    try:
        main(arguments)
    except SystemExit as ended:
        codes.append(ended.code or 0)
print(json.dumps([circlecal.__file__, codes]))
"""


@pytest.fixture(scope="module")
def ran(installed, tmp_path_factory):
    """Folder in which a process that knows the wheel alone has run commands, and what it printed, line by line."""
    folder = tmp_path_factory.mktemp("ran")
    refused = {"schema_version": 1, "id": "a", "status": "refused", "code": "no_field", "source": {"path": "a.jpg"}}
    (folder / "results.jsonl").write_text(json.dumps(refused) + "\n")
    sample = ROOT / "samples" / "full_circle.jpg"
    commands = ["calibrate", str(sample), "--config", "broadcast"], ["fields"], ["report", "."]
    environment = {**os.environ, "PYTHONPATH": str(installed), "PYTHONSAFEPATH": "1"}
    found = subprocess.run(
        [sys.executable, "-c", COMMANDS, json.dumps(commands)],
        cwd=folder, env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return folder, found.stdout.splitlines()


def test_wheel_calibrates(installed, ran):
    folder, told = ran
    file, codes = json.loads(told[-1])
    assert file.startswith(str(installed))
    assert codes == [0, 0, 0]
    assert json.loads((folder / "circlecal-out" / "full_circle.json").read_text())["status"] == "calibrated"


def test_wheel_knows_the_fields(ran):
    told = "\n".join(ran[1])
    for path in (ROOT / "configs" / "fields").glob("*.yaml"):
        assert path.stem in told


def test_wheel_writes_a_report(ran):
    report = ran[0] / "circlecal-report"
    assert {"index.html", "report.css", "report.js", "frames.js"} <= {p.name for p in report.iterdir()}
