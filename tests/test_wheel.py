"""The built wheel holds all that a calibration needs, configurations included."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder with nothing of circlecal but its wheel's content."""
    pytest.importorskip("hatchling", reason="hatchling builds the wheel; it comes with the extra dev")
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = folder.glob("circlecal-*.whl")
    target = folder / "site"
    install = [sys.executable, "-m", "pip", "install", "--no-deps", "--quiet", "--target", str(target), str(wheel)]
    subprocess.run(install, check=True, capture_output=True)
    return target


def _run(site, folder, *arguments):
    environment = {**os.environ, "PYTHONPATH": str(site), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-m", "circlecal.cli", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_wheel_calibrates(installed, tmp_path):
    where = "import circlecal; print(circlecal.__file__)"
    environment = {**os.environ, "PYTHONPATH": str(installed), "PYTHONSAFEPATH": "1"}
    found = subprocess.run(
        [sys.executable, "-c", where], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert found.stdout.startswith(str(installed))
    outcome = _run(installed, tmp_path, "calibrate", str(ROOT / "samples" / "full_circle.jpg"), "--config", "broadcast")
    assert outcome.returncode == 0, outcome.stderr
    assert json.loads((tmp_path / "circlecal-out" / "full_circle.json").read_text())["status"] == "calibrated"


def test_wheel_knows_the_fields(installed, tmp_path):
    outcome = _run(installed, tmp_path, "fields")
    assert outcome.returncode == 0, outcome.stderr
    for path in (ROOT / "configs" / "fields").glob("*.yaml"):
        assert path.stem in outcome.stdout


def test_wheel_writes_a_report(installed, tmp_path):
    refused = {"schema_version": 1, "id": "a", "status": "refused", "code": "no_field", "source": {"path": "a.jpg"}}
    (tmp_path / "results.jsonl").write_text(json.dumps(refused) + "\n")
    outcome = _run(installed, tmp_path, "report", ".")
    assert outcome.returncode == 0, outcome.stderr
    report = tmp_path / "circlecal-report"
    assert {"index.html", "report.css", "report.js", "frames.js"} <= {p.name for p in report.iterdir()}
