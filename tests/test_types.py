"""What a type checker says of programs that use the package."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
WRONG = """
import circlecal

circlecal.calibrate_vido("match.mp4")
circlecal.load("run").K
camera = circlecal.calibrate("picture.jpg").require_camera()
camera.K + camera.dist
"""
"""Two misuses, and what is right, whose type must be known."""


def test_the_readme_is_typed_and_misspelt_names_are_found(tmp_path, request):
    pytest.importorskip("mypy")
    examples = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    (tmp_path / "readme.py").write_text("".join(examples), encoding="utf-8")
    (tmp_path / "wrong.py").write_text(WRONG, encoding="utf-8")
    cache = request.config.cache.mkdir("mypy-readme")  # what it learnt of the package counts until a module changes
    options = ("--strict", "--config-file=", f"--cache-dir={cache}", "--follow-imports=silent")
    told = subprocess.run(
        [sys.executable, "-m", "mypy", *options, "readme.py", "wrong.py"],
        cwd=tmp_path,
        env={"MYPYPATH": str(ROOT), "PATH": ""},
        capture_output=True,
        text=True,
    )
    errors = [line for line in told.stdout.splitlines() if ": error: " in line]
    assert len(errors) == 2, told.stdout + told.stderr
    assert "calibrate_vido" in errors[0] and 'wrong.py:5: error: Item "Run"' in errors[1], told.stdout
