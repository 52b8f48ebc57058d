"""What is said of wrong use: one line with what was given and the mend, exit code 2."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture
def folder(tmp_path, monkeypatch, frame_file):
    """The working folder, with files that are wrong in one way each."""
    monkeypatch.chdir(tmp_path)
    frame_file.rename(tmp_path / "good.png")
    (tmp_path / "bracket.yaml").write_text("camera:\n  position_m: [1, 2, 3\n  roll_sd_deg: 1\n")
    (tmp_path / "prior.yaml").write_text("position_m: [0, 70, -20\nroll_sd_deg: 1\n")
    (tmp_path / "points.csv").write_text("frame.x.y\ngood.1.2\n")
    (tmp_path / "other.json").write_text('{"circle": [1, 2]}')
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "results.jsonl").write_text("")
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ("calibrate good.png --from coco", "good.png: is a picture, not a coco file; leave --from out"),
        ("calibrate good.png --max-bytes 1MB", "'1MB' is no whole number of bytes, such as 268435456 for 256 MB"),
        ("calibrate good.png --max-pixels 8K", "'8K' is no whole number of pixels, such as 50000000"),
        ("calibrate good.png --max-bytes 1", "error: --max-bytes 1: limits.max_bytes: should be"),
        ("calibrate good.png --max-pixels 10", "error: --max-pixels 10: limits.max_pixels: should be"),
        ("calibrate good.png --seed 99999999999", "error: --seed 99999999999: seed: should be"),
        ("calibrate good.png --set field.sizes.length=-5", "error: --set field.sizes.length=-5: length_m: should be"),
        ("calibrate good.png --config bracket.yaml", "bracket.yaml, line 3: "),
        ("calibrate good.png --config bracket.yaml", "; a bracket opened on line 2 is not closed"),
        ("calibrate good.png --camera-prior prior.yaml", "prior.yaml, line 2: is neither YAML nor JSON: "),
        ("project other.json --to field 640,360", "'640,360' is no number; separate X and Y by a blank"),
        (
            "project run --to field 640 360",
            "run: holds the results of a run; give a result file of circlecal calibrate",
        ),
        ("project run/results.jsonl --to field 640 360", "or --points with a run"),
        ("project run --to field --points points.csv", "separated by commas, semicolons or tabs"),
        ("audit other.json", "other.json: is no keypoint file of PnLCalib, which has the keys kp and lines"),
    ],
)
def test_a_mistake_is_one_line_with_its_mend(run_circlecal, folder, arguments, told):
    outcome = run_circlecal(*arguments.split())
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1), outcome
    assert told in outcome.err


def test_a_size_that_counts_for_nothing_is_told(run_circlecal, folder):
    quick = "calibrate", "good.png", "--no-overlay"
    told = "--eval-size counts for what --to writes, and no --to is given"
    assert told in run_circlecal(*quick, "--eval-size", "960x540").err
    assert told not in run_circlecal(*quick, "--eval-size", "960x540", "--to", "soccernet").err
    assert "--size counts for annotation files" in run_circlecal(*quick, "--size", "960x540").err
    assert "counts" not in run_circlecal(*quick, "--size", "960x540", "--eval-size", "960x540", "--quiet").err


@pytest.mark.parametrize("command", ["calibrate", "batch"])
def test_a_convention_that_counts_for_nothing_is_told(run_circlecal, in_this_process, folder, command):
    points = {"Circle central": [{"x": 0.4, "y": 0.4}, {"x": 0.6, "y": 0.5}]}
    Path("points.json").write_text(json.dumps(points))
    anew = ["--restart"] if command == "batch" else []
    quick = (command, "good.png", "--out", "conventions", "--no-overlay", *anew)
    told = "--convention counts for annotation files of other programs, and none is given"
    for name in ("official", "paint"):
        assert told in run_circlecal(*quick, "--keypoints", "points.json", "--convention", name).err
    assert told not in run_circlecal(*quick).err
    assert told not in run_circlecal(*quick, "points.json", "--size", "960x540", "--convention", "paint").err


@pytest.mark.parametrize("command", ["rig", "annotate", "convert"])
def test_commands_that_must_know_the_field_do_not_offer_to_find_it(run_circlecal, command):
    text = run_circlecal(command, "--help").out
    assert "--field" in text and "auto" not in text


def test_a_folder_that_may_not_be_read_is_told_by_its_permissions(run_circlecal, folder, monkeypatch):
    def refuse(path):
        raise PermissionError(13, "Permission denied", str(path))

    (folder / "run" / "results.jsonl").unlink()
    monkeypatch.setattr("os.access", lambda *arguments, **named: False)
    monkeypatch.setattr("pathlib.Path.iterdir", refuse)
    outcome = run_circlecal("report", "run")
    told = "circlecal: error: run: cannot be read: Permission denied; check its permissions\n"
    assert (outcome.code, outcome.err) == (2, told)


def test_a_full_standard_output_is_told():
    try:
        full = open("/dev/full", "w")  # noqa: SIM115, PTH123
    except OSError:
        pytest.skip("no /dev/full here")
    with full:
        run = subprocess.run(
            [sys.executable, "-m", "circlecal", "fields"], stdout=full, stderr=subprocess.PIPE, text=True
        )
    told = "circlecal: error: standard output: cannot be written: no space left on device\n"
    assert (run.returncode, run.stderr) == (2, told)
