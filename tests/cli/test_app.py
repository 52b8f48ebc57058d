"""The command line as a whole: help, version, start-up time, and the small commands."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from circlecal import __version__
from circlecal.cli.app import app
from circlecal.config import Config
from circlecal.formats.registry import annotation_formats, calibration_formats, camera_formats
from circlecal.pictures.files import OWN_FOLDERS
from circlecal.solvers import solver_names

ROOT = Path(__file__).parents[2]
COMMANDS = [command.name or command.callback.__name__ for command in app.registered_commands]
COMMANDS += [group.name for group in app.registered_groups]
HEAVY = ("numpy", "cv2", "scipy", "pydantic", "skimage", "yaml")


def test_commands():
    assert {"calibrate", "batch", "debug", "project", "config", "fields"} <= set(COMMANDS)


def test_every_command_is_in_the_help(run_circlecal):
    text = run_circlecal("--help").out
    assert [command for command in COMMANDS if f" {command} " not in text] == []


def test_help_names_formats_solvers_and_defaults(run_circlecal, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    read, cameras = annotation_formats(), camera_formats()
    written = {name for name, form in read.items() if form.write is not None} | set(cameras)
    named = {"calibrate": {*read, *calibration_formats(), *solver_names()}, "convert": {*written, "parquet"}}
    named["batch"] = named["calibrate"] | {"parquet"}
    for command, names in named.items():
        words = set(re.findall(r"[\w]+", run_circlecal(command, "--help").out))
        assert names <= words, f"{command} --help lacks {sorted(names - words)}"
    text = " ".join(run_circlecal("calibrate", "--help").out.split())
    config = Config()
    for default in (config.field.template, config.seed, "50 million", "256 MB"):
        assert f"(default: {default})" in text
    defaults = {
        "calibrate": ["OUT/annotations, and x.json beside x.jpg"],
        "annotate": ["RUN/annotations, else circlecal-annotations", "the first to do", "1s"],
        "synth": ["all", "12, or one clip of each kind"],
    }
    for command, told in defaults.items():
        text = " ".join(run_circlecal(command, "--help").out.split())
        assert all(f"(default: {default})" in text for default in told), text
    audit = run_circlecal("audit", "--help").out
    assert audit.count("default: annotations") == 1
    assert "default: default" not in audit


@pytest.mark.parametrize("command", ["", "calibrate", "bench", "bench detect"])
def test_switches_take_no_value_in_help(run_circlecal, command):
    text = run_circlecal(*command.split(), "--help").out
    assert "--help" in text
    assert "<bool>" not in text


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_every_command_has_help_of_its_own_and_h_is_help(run_circlecal, command):
    named = command.split()
    short, long = run_circlecal(*named, "-h"), run_circlecal(*named, "--help")
    assert (short.code, short.out) == (long.code, long.out) == (0, long.out)
    assert f"circlecal {command}".strip() in long.out


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("circlecal cal", ["calibrate"]),
        ("circlecal calibrate --config bro", ["broadcast"]),
        ("circlecal batch --field fut", ["futsal"]),
        ("circlecal bench sol", ["solvers"]),
    ],
)
def test_the_shell_completes_commands_and_names(typed, completed):
    request = {"_CIRCLECAL_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" "))}
    run = subprocess.run(
        [sys.executable, "-m", "circlecal"], capture_output=True, text=True, env={**os.environ, **request}
    )
    assert run.stdout.split() == completed, run.stderr


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_is_in_the_readme(command):
    readme = ROOT / "README.md"
    if not readme.is_file():
        pytest.skip("no README here")
    assert f"circlecal {command}" in readme.read_text()


@pytest.mark.parametrize("command", ["calibrate", "batch", "track", "rig", "annotate"])
def test_many_options_stand_in_named_groups(run_circlecal, command):
    text = run_circlecal(command, "--help").out
    titles = re.findall(r"^╭─ ([^─]+) ─", text, flags=re.MULTILINE)
    assert titles == ["Arguments", "Input", "Camera and field", "Output", "Running"]
    _, camera, output, running = re.split(r"╭─ (?:Camera and field|Output|Running) ─", text)
    assert "--config" in camera
    assert "--out" in output
    assert "--quiet" in running and "--help" in running


def test_few_options_stand_in_one_group(run_circlecal):
    titles = re.findall(r"^╭─ ([^─]+) ─", run_circlecal("convert", "--help").out, flags=re.MULTILINE)
    assert titles == ["Arguments", "Options"]


def test_the_help_says_how_to_begin_and_what_the_exit_codes_are(run_circlecal):
    told = " ".join(run_circlecal("--help").out.split())
    assert "To begin: circlecal calibrate PICTURE" in told
    assert "Exit code: 0 all calibrated" in told


def test_version(run_circlecal):
    assert run_circlecal("--version").out == f"circlecal {__version__}\n"
    project = ROOT / "pyproject.toml"
    if project.is_file() and "version" in (content := tomllib.loads(project.read_text())["project"]):
        assert content["version"] == __version__


def test_ctrl_c_outside_a_command_is_one_line(run_circlecal, monkeypatch):
    def interrupted(**named: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("circlecal.cli.app.app", interrupted)
    assert run_circlecal("fields") == (130, "", "circlecal: interrupted\n")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--moon"], "No such option: --moon"),
        (["moon"], "No such command 'moon'"),
        (["bench", "moon"], "No such command 'moon'"),
        (["calibrate"], "Missing argument 'INPUT'"),
        (["calibrate", "x.jpg", "--seed", "-1"], "'--seed'"),
        (["bench", "detect", "--count", "0"], "'--count'"),
        (["bench", "accuracy", "--seed", "-1"], "'--seed'"),
        (["synth", "out", "--profile", "moon"], "'moon' is not one of 'easy', 'broadcast'"),
        (["project", "x.json", "--to", "field", "a", "b"], "'X Y'"),
        (["project", "x.json", "1", "2"], "Missing option '--to'. Choose from: field, image"),
    ],
)
def test_wrong_use_is_one_line_that_names_the_help(run_circlecal, arguments, told):
    outcome = run_circlecal(*arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert len(outcome.err.splitlines()) == 1
    assert outcome.err.startswith("circlecal: error: ")
    assert told in outcome.err
    assert outcome.err.endswith(" --help\n")


@pytest.mark.parametrize("command", ["project", "report", "rig", "convert"])
def test_a_url_where_a_file_is_meant_is_told_whole(run_circlecal, command):
    outcome = run_circlecal(command, "https://server/x.json")
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err == "circlecal: error: https://server/x.json: is a URL; save what it names, and give the file\n"


def test_help_imports_nothing_heavy():
    code = f"import sys, circlecal.cli.app; print([m for m in {HEAVY} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_import_of_the_package_is_cheap():
    code = f"import sys, circlecal; circlecal.__version__; print([m for m in {HEAVY} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_public_names():
    import circlecal

    assert {"calibrate", "Config", "load_config", "Calibration", "__version__"} <= set(dir(circlecal))
    offered = {name for name in dir(circlecal) if not name.startswith("__")}
    assert offered <= set(circlecal.__all__), "a shell completes what is public only"
    assert circlecal.load_config() == circlecal.Config()
    with pytest.raises(AttributeError, match="nothing_like_it"):
        _ = circlecal.nothing_like_it


def test_config(run_circlecal, tmp_path):
    outcome = run_circlecal("config", "--set", "seed=3")
    assert yaml.safe_load(outcome.out)["seed"] == 3
    (tmp_path / "mine.yaml").write_text(outcome.out)
    assert run_circlecal("config", "--config", tmp_path / "mine.yaml").out == outcome.out
    assert run_circlecal("config", "--config", "broadcast").code == 0
    assert json.loads(run_circlecal("config", "--schema").out)["title"] == "Config"
    assert run_circlecal("config", "--set", "sed=3").code == 2


def test_fields(run_circlecal):
    outcome = run_circlecal("fields")
    assert outcome.code == 0
    for name in ("soccer", "futsal", "ice-hockey", "basketball", "robocup", "faceoff_left_top", "9.15 m"):
        assert name in outcome.out


def test_interrupted(run_circlecal, frame_file, tmp_path, monkeypatch):
    def interrupt(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("circlecal.batch.frames.calibrate_frame", interrupt)
    outcome = run_circlecal("calibrate", frame_file, "--out", tmp_path)
    assert outcome.code == 130
    assert outcome.err.splitlines() == ["circlecal: interrupted"]


def test_errors_of_the_system_are_one_line(run_circlecal, frame_file, tmp_path, monkeypatch):
    def refuse(*arguments):
        raise PermissionError(13, "Permission denied", "/somewhere")

    monkeypatch.setattr("circlecal.batch.frames.calibrate_frame", refuse)
    outcome = run_circlecal("calibrate", frame_file, "--out", tmp_path)
    assert (outcome.code, outcome.err) == (2, "circlecal: error: /somewhere: Permission denied\n")


@pytest.mark.parametrize(("given", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")])
def test_one_thread_of_linear_algebra_unless_more_are_wanted(given, threads):
    script = "import os, circlecal.cli as cli\ntry: cli.main(['--version'])\nexcept SystemExit: pass\n"
    script += "print(os.environ['OPENBLAS_NUM_THREADS'])"
    surroundings = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, env={**surroundings, **given}
    )
    assert run.stdout.splitlines()[-1] == threads


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("field: {sizes: {lenght: 100}}", "field.sizes.lenght is unknown; known in"),
        (
            "field: {sizes: {length: 100000}}",
            "field.sizes.length=100000: length_m: should be less than",
        ),
        ("field: {template: nosuch}", "field 'nosuch' is unknown"),
        ("field: {circle: nosuch}", "field.circle: 'nosuch' is not a circle of soccer"),
    ],
)
def test_what_a_file_says_of_the_field_is_refused_with_the_name_of_that_file(run_circlecal, tmp_path, content, told):
    file = tmp_path / "own.yaml"
    file.write_text(content)
    outcome = run_circlecal("config", "--config", file)
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert outcome.err.startswith(f"circlecal: error: {file}: ") and told in outcome.err
    file.write_text("seed: 3")
    outcome = run_circlecal("config", "--config", file, "--set", "field.sizes.lenght=100")
    assert outcome.code == 2 and str(file) not in outcome.err


@pytest.mark.parametrize(
    ("command", "folder"),
    [("calibrate", "circlecal-out"), ("batch", "circlecal-run"), ("simulate", "circlecal-simulate")],
)
def test_commands_write_into_folders_of_their_own(run_circlecal, monkeypatch, command, folder):
    monkeypatch.setenv("COLUMNS", "200")
    assert f"[default: {folder}]" in run_circlecal(command, "--help").out
    assert folder in OWN_FOLDERS


def test_commands_and_benchmarks_say_what_they_do(run_circlecal, monkeypatch):
    """By a verb at the beginning, which is no noun with an article, a number or an adjective before it."""
    monkeypatch.setenv("COLUMNS", "200")
    for command in ("", "bench"):
        shown = run_circlecal(*command.split(), "--help").out.split("Commands")[1]
        first = re.findall(r"│ [\w-]+ +(\w+)", shown) or re.findall(r"^ +[\w-]+  +(\w+)", shown, flags=re.MULTILINE)
        assert len(first) > 10
        assert not set(first) & {
            "A",
            "The",
            "Every",
            "What",
            "Whole",
            "Real",
            "Error",
            "Distance",
            "Annotated",
            "Clicks",
        }
