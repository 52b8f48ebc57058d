"""What files, names and disks can do to a command: one line and exit code 2, in a batch a record; never a traceback."""

import csv
import io
import json
import os
import resource
import struct
import subprocess
import sys
import threading
import time
import zlib
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

import circlecal
from circlecal.errors import CirclecalError, ConfigError, InputError
from circlecal.field import load_field
from circlecal.files import read_file
from circlecal.names import as_cell, as_stem, show, show_json
from circlecal.pictures.files import distinct_names, read_image
from circlecal.pictures.inputs import expand_inputs
from circlecal.pictures.limits import LimitsConfig
from circlecal.pictures.remote import read_url
from circlecal.records.camera_prior import prior_settings
from circlecal.yaml_text import YamlError, parse_yaml

SURROUNDINGS = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
LONG = "x" * 300
BILLION_LAUGHS = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 9)
)


def only_line(outcome, *named: str) -> None:
    """Exit code 2 and one line on stderr that names what is wrong."""
    assert outcome.code == 2, outcome
    lines = outcome.err.splitlines()
    assert len(lines) == 1, outcome.err
    assert lines[0].startswith("circlecal: error: ")
    assert all(name in lines[0] for name in named), lines[0]


def run_process(*arguments: object, **surroundings: str) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "circlecal", *map(str, arguments)]
    return subprocess.run(command, check=False, capture_output=True, env={**SURROUNDINGS, **surroundings}, timeout=300)


@pytest.fixture
def pipe(tmp_path: Path):
    """Makes pipes that nobody writes to: opening one waits for ever."""

    def make(name: str) -> Path:
        os.mkfifo(tmp_path / name)
        return tmp_path / name

    return make


# names that no file can have


@pytest.mark.parametrize(
    "name", [LONG, f"{LONG}.jpg", f"{LONG}.json", f"{LONG}.mp4", f"{LONG}.txt", f"@{LONG}", f"{LONG}/a.jpg"]
)
@pytest.mark.parametrize("command", ["calibrate", "batch"])
def test_a_name_longer_than_any_file_has(run_circlecal, tmp_path, command, name):
    only_line(run_circlecal(command, name, "--out", tmp_path / "out"), "xxx")


@pytest.mark.parametrize(
    "arguments",
    [
        ("report", LONG),
        ("rig", LONG, "--out", "r"),
        ("debug", LONG),
        ("convert", LONG, "--to", "coco"),
        ("evaluate", LONG, "--truth", LONG),
        ("audit", LONG, "--size", "960x540"),
        ("project", LONG, "--to", "field", 1, 2),
        ("config", "--config", f"{LONG}.yaml"),
        ("config", "--config", LONG),
        ("config", "--set", f"field.template={LONG}.yaml", "--field", f"{LONG}.yaml"),
        ("calibrate", "samples", "--camera-prior", LONG),
        ("calibrate", "samples/full_circle.jpg", "--mask", LONG),
        ("calibrate", "samples/full_circle.jpg", "--keypoints", LONG),
        ("calibrate", "samples/full_circle.jpg", "--no-overlay", "--out", LONG),
    ],
)
def test_a_long_name_anywhere(run_circlecal, tmp_path, monkeypatch, arguments):
    (tmp_path / "samples").symlink_to(Path(__file__).parents[1] / "samples")
    monkeypatch.chdir(tmp_path)
    assert run_circlecal(*arguments).code == 2


@pytest.mark.parametrize("arguments", [("calibrate", ""), ("batch", ""), ("calibrate", "x.jpg", "--mask", "")])
def test_an_empty_name_is_not_the_working_folder(run_circlecal, arguments):
    only_line(run_circlecal(*arguments), "an argument is empty")


@pytest.mark.parametrize("name", ["a\0b.jpg", "a\0b.json", "a\0b.mp4"])
def test_nul_in_a_name(run_circlecal, tmp_path, name):
    only_line(run_circlecal("calibrate", tmp_path / name, "--out", tmp_path / "out"), "\\x00")
    (tmp_path / "list.txt").write_text(f"{name}\n")
    only_line(run_circlecal("batch", tmp_path / "list.txt", "--out", tmp_path / "out"), "\\x00")


def test_links_in_a_circle(run_circlecal, in_this_process, tmp_path, frame_image):
    for name in ("a.jpg", "b.json", "c.mp4", "d.txt"):
        (tmp_path / name).symlink_to(tmp_path / name)
        only_line(run_circlecal("calibrate", tmp_path / name, "--out", tmp_path / "out"), name, "circle")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "loop").symlink_to(tmp_path / "folder")
    (tmp_path / "folder" / "dead.jpg").symlink_to(tmp_path / "folder" / "dead.jpg")
    cv2.imwrite(str(tmp_path / "folder" / "good.png"), frame_image)
    outcome = run_circlecal("batch", tmp_path / "folder", "--out", tmp_path / "out", "--workers", 1)
    assert (outcome.code, outcome.out[:36]) == (1, "2 frames: 1 calibrated, 1 refused (1")
    with pytest.raises(InputError, match="circle"):
        prior_settings(tmp_path / "a.jpg")


@pytest.mark.parametrize(
    "name", [f"{LONG}.jpg", "\u4e2d" * 150 + ".jpg", "a\0b.jpg", "..", ".", "/", "", "a\nb.jpg", "../../x.jpg"]
)
def test_names_inside_annotation_files(run_circlecal, tmp_path, name):
    point = {"label": "centre_mark", "shape_type": "point", "points": [[500.0, 300.0]]}
    labelme = {"shapes": [point], "imageWidth": 960, "imageHeight": 540, "imagePath": name}
    coco = {
        "images": [{"id": 1, "width": 960, "height": 540, "file_name": name}],
        "annotations": [{"image_id": 1, "category_id": 1, "segmentation": [[1.0, 2, 3, 4, 5, 6]]}],
        "categories": [{"id": 1, "name": "halfway_line"}],
    }
    game = {
        "images": [{"image_id": "1", "file_name": name, "width": 960, "height": 540}],
        "annotations": [{"image_id": "1", "supercategory": "pitch", "lines": {"Middle line": [{"x": 0.1, "y": 0.2}]}}],
    }
    studio = [{"id": 1, "data": {"image": name}, "annotations": [{"result": []}]}]
    shown = name if name.isprintable() else "x"
    cvat = f'<annotations><image id="0" name="{shown}" width="960" height="540"/></annotations>'
    for number, content in enumerate((labelme, coco, game, studio, cvat)):
        suffix, text = (".xml", content) if isinstance(content, str) else (".json", json.dumps(content))
        path = tmp_path / f"{number}{suffix}"
        path.write_text(text)
        out = tmp_path / f"out{number}"
        outcome = run_circlecal("calibrate", path, "--to", "labelme", "--to", "soccernet", "--out", out, "-q")
        assert outcome.code in (1, 2), outcome
        assert "Traceback" not in outcome.err
        inside = [
            file.relative_to(tmp_path) for file in tmp_path.rglob("*") if file.is_file() and file.parent != tmp_path
        ]
        assert all(str(file).startswith("out") for file in inside)


def test_a_deep_folder_gives_an_id_that_a_file_can_have(run_circlecal, tmp_path, frame_image):
    deep = tmp_path / "frames" / ("a" * 120) / ("b" * 120) / ("c" * 120)
    deep.mkdir(parents=True)
    cv2.imwrite(str(deep / "f.png"), frame_image)
    cv2.imwrite(str(deep / "g.png"), frame_image)
    outcome = run_circlecal("calibrate", tmp_path / "frames", "--out", tmp_path / "out", "--no-overlay")
    assert outcome.code == 0, outcome
    assert len(list((tmp_path / "out").glob("*.json"))) == 2


# names that are no text


def test_a_name_that_is_no_utf8(run_circlecal, in_this_process, tmp_path, frame_file):
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / os.fsdecode(b"caf\xe9.png")).write_bytes(frame_file.read_bytes())
    (folder / os.fsdecode(b"broken\xff.png")).write_bytes(b"no picture")
    out = tmp_path / "out"
    outcome = run_circlecal("batch", folder, "--out", out, "--workers", 1, "--files", "--to", "parquet", "--to", "coco")
    assert outcome.code == 1, outcome
    assert "Traceback" not in outcome.err
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(out / "results.parquet")
    assert sorted(table["id"].to_pylist()) == ["broken\\udcff", "caf\\udce9"]
    assert run_circlecal("report", out, "-q").code == 0
    assert run_circlecal("calibrate", folder, "--out", tmp_path / "c", "--json").code == 2
    assert run_circlecal("convert", out, "--to", "parquet", "--out", tmp_path / "p").code == 0


# terminals


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_a_terminal_that_lacks_characters(tmp_path, blank_file, encoding):
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "\u4e2d\u00e9.png").write_bytes(blank_file.read_bytes())
    ended = run_process("calibrate", folder, "--out", tmp_path / "out", PYTHONIOENCODING=encoding)
    assert ended.returncode == 1, ended.stderr
    assert b"Traceback" not in ended.stderr
    assert b"\trefused\t" in ended.stdout
    if encoding == "ascii":
        ended = run_process("calibrate", folder, "--out", tmp_path / "out", "--json", PYTHONIOENCODING=encoding)
        assert json.loads(ended.stdout)["id"] == "\u4e2d\u00e9"


def test_names_that_command_a_terminal(run_circlecal, in_this_process, tmp_path, blank_file):
    name = "a\x1b[31m\nred\u202egpj.png"
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / name).write_bytes(blank_file.read_bytes())
    (folder / f"broken{name}").write_bytes(b"no picture")
    for arguments in (("calibrate",), ("calibrate", "--json"), ("batch", "--workers", 1), ("debug", "-v")):
        given = list(folder.iterdir()) if arguments[0] == "debug" else [folder]
        outcome = run_circlecal(arguments[0], *given, *arguments[1:], "--out", tmp_path / "out")
        for text in (outcome.out, outcome.err):
            assert not set(text) & {"\x1b", "\u202e"}, text
            assert not any(line.startswith("red") for line in text.splitlines())
    assert run_circlecal("debug", folder / name, "--out", tmp_path / "debug").code == 1
    assert all(show(str(file)) == str(file) for file in (tmp_path / "debug").rglob("*"))


def test_shown_names():
    assert show("a\x1b[0m\u202eb\nc\td\udce9\x9b") == "a\\x1b[0m\\u202eb\\nc\\td\\udce9\\x9b"
    assert show("caf\u00e9 \u4e2d\u6587 \u05d0") == "caf\u00e9 \u4e2d\u6587 \u05d0"
    value = {"a": "caf\u00e9 \U0001f600 \u202e", "b": "\udce9"}
    for only_ascii in (False, True):
        text = show_json(json.dumps(value, ensure_ascii=False), only_ascii)
        assert json.loads(text) == value
        assert not set(text) & {"\u202e", "\udce9"}
    assert show_json("{}", only_ascii=True).isascii()


def test_stems():
    assert as_stem("f 1.2") == "f 1.2"
    assert as_stem("..") not in ("", ".", "..")
    assert as_stem("a/b\nc\0") == "a_b_c_"
    long = [as_stem(letter * 400) for letter in ("\u4e2d", "x")]
    assert all(len(stem.encode()) <= 200 for stem in long)
    assert as_stem("x" * 300 + "1") != as_stem("x" * 300 + "2")
    names = distinct_names([""] * 20_000)
    assert len(set(names)) == 20_000


# tables


def test_a_spreadsheet_calculates_nothing(run_circlecal, in_this_process, tmp_path, blank_file):
    folder = tmp_path / "in"
    folder.mkdir()
    names = ["=cmd|' C'!A0", "+1+1", "@list", "-2+3", "plain"]
    for name in names:
        (folder / f"{name}.png").write_bytes(blank_file.read_bytes())
    run_circlecal("batch", folder, "--out", tmp_path / "out", "--workers", 1)
    rows = list(csv.reader(io.StringIO((tmp_path / "out" / "summary.csv").read_text())))
    assert sorted(row[0] for row in rows[1:]) == sorted([f"'{name}" for name in names[:4]] + ["plain"])
    assert not [cell for row in rows for cell in row if cell.startswith(("=", "+", "-", "@"))]
    assert as_cell("a=b") == "a=b"


# camera prior


@pytest.mark.parametrize(
    "content",
    [
        b"position_m: 2020-01-01",
        b"position_m: [2020-01-01, 1, 2]",
        b"position_m: !!set {a, b, c}",
        b"position_m: !!binary aGVsbG8=",
        b"position_m: &a [*a]",
        b"position_m: " + b"[" * 5000,
        b'{"position_m": ' + b"[" * 100_000,
        b"position_m: [1, 60, -15]\nposition_sd_m: null",
        b"position_m: [1, 60, -15]\nposition_sd_m: [null, 1, 1]",
        b"position_m: [1, 60, -15]\n1: 2\na: 3",
        b"1: 2",
        b"position_m: [1, 60, -15]\n[1, 2]: 3",
        b"position_m: [" + b"9" * 5000 + b", 1, 2]",
        b"position_m: [1" + b"0" * 400 + b", 1, 2]",
        b"position_m: [.nan, 1, 2]",
        b"position_m: ['1', 1, 2]",
        b"position_m: null",
        b"shared: {}\nposition_m: [1, 2, 3]",
        b"\xff\xfe\x00",
        b"!!python/object/apply:os.system ['true']",
        b'{"schema_version": 1}',
        b'{"schema_version": 1, "status": "calibrated", "id": "a", "camera": {"position_meters": [1, 2, 3], '
        b'"position_sigma_m": [null, null, null]}}',
        b'{"schema_version": "1", "status": 5, "id": null, "camera": []}',
        b"",
        BILLION_LAUGHS.encode(),
    ],
)
def test_a_camera_prior_is_validated(tmp_path, content):
    path = tmp_path / "prior.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        prior_settings(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


# YAML


def test_aliases_that_expand_are_refused_at_once(run_circlecal, tmp_path):
    path = tmp_path / "bomb.yaml"
    path.write_text(BILLION_LAUGHS)
    with pytest.raises(YamlError, match="aliases stand for more than"):
        parse_yaml(BILLION_LAUGHS)
    only_line(run_circlecal("config", "--config", path), "aliases")
    only_line(run_circlecal("calibrate", "x.jpg", "--field", path), "aliases")
    with pytest.raises(ConfigError, match="aliases"):
        load_field(path)
    assert parse_yaml("a: &a [1, 2]\nb: *a") == {"a": [1, 2], "b": [1, 2]}


@pytest.mark.parametrize(
    "text",
    [
        "a: &a {b: *a}",
        "[" * 3000,
        "- " * 100_000,
        "[" * 400_000,
        "? [a]\n: 1",
        "? {a: 1}\n: 1",
        "<<: 1",
        "a: !!float x",
        "a: !!timestamp x",
        "a: !!int ''",
        "- !!omap [1]",
    ],
)
def test_yaml_that_is_none(text):
    with pytest.raises(YamlError):
        parse_yaml(text)


def test_yaml_and_sizes_have_limits(tmp_path):
    path = tmp_path / "large.yaml"
    path.write_text("# " + "x" * 3_000_000)
    with pytest.raises(ConfigError, match="more than 1 MB"):
        load_field(path)
    path.write_text("name: a\nsizes: {a: '" + "-" * 3000 + "1'}\n")
    with pytest.raises(ConfigError, match="at most 200 characters"):
        load_field(path)


# files that are none


@pytest.mark.parametrize("name", ["p.jpg", "p.json", "p.xml", "p.yaml", "p.txt", "p.mp4", "p.ts", "p.jsonl"])
def test_a_pipe_is_no_input(run_circlecal, tmp_path, pipe, name):
    path = pipe(name)
    only_line(run_circlecal("calibrate", path, "--out", tmp_path / "out"), name)


def test_pipes_at_every_option(run_circlecal, tmp_path, pipe, frame_file):
    path = pipe("p.yaml")
    for arguments in (
        ("config", "--config", path),
        ("calibrate", frame_file, "--field", path),
        ("calibrate", frame_file, "--camera-prior", path),
        ("calibrate", frame_file, "--mask", path),
        ("calibrate", frame_file, "--keypoints", path),
        ("calibrate", frame_file, "--set", "mask.source=network", "--set", f"mask.model={path}"),
        ("project", path, "--to", "field", 1, 2),
        ("convert", path, "--to", "coco"),
        ("report", path),
        ("rig", path),
        ("audit", path, "--size", "960x540"),
        ("debug", path),
        ("batch", frame_file, "--mask", path),
    ):
        outcome = run_circlecal(
            *arguments, *(() if arguments[0] in ("config", "project", "audit") else ("--out", tmp_path / "out"))
        )
        assert outcome.code == 2, (arguments, outcome)
        assert len(outcome.err.splitlines()) == 1


def test_a_pipe_among_pictures_is_a_record(run_circlecal, in_this_process, tmp_path, pipe, frame_file):
    pipe("frames/p.png")
    outcome = run_circlecal("batch", frame_file.parent, "--out", tmp_path / "out", "--workers", 1)
    assert outcome.code == 1
    assert outcome.out.startswith("2 frames: 1 calibrated, 1 refused (1 of them unreadable)")


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/urandom"])
def test_endless_devices(run_circlecal, tmp_path, device):
    if not Path(device).exists():
        pytest.skip(f"no {device}")
    for suffix in (".jpg", ".json", ".txt", ".yaml"):
        link = tmp_path / f"x{suffix}"
        link.symlink_to(device)
        only_line(run_circlecal("calibrate", link, "--out", tmp_path / "out"), "a pipe or a device")
    with pytest.raises(InputError, match="a pipe or a device"):
        read_file(device)


def test_a_file_larger_than_the_limit(run_circlecal, tmp_path, frame_file):
    large = tmp_path / "large.jpg"
    with large.open("wb") as file:
        file.truncate(1 << 40)  # a hole
    only_line(run_circlecal("calibrate", large, "--out", tmp_path / "out"), "more than 256 MB", "limits.max_bytes")
    only_line(
        run_circlecal("calibrate", frame_file, "--out", tmp_path / "out", "--max-bytes", 2000), "more than 1.953 KB"
    )
    annotation = tmp_path / "large.json"
    with annotation.open("wb") as file:
        file.truncate(1 << 40)
    only_line(run_circlecal("calibrate", annotation, "--out", tmp_path / "out"), "more than 64 MB", "split it")


# pictures that are large once decoded


def png_header(width: int, height: int, bits: int) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, bits, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")


@pytest.mark.parametrize(("side", "bits"), [(10_000, 16), (10_000, 8), (6_000, 16), (65_535, 8)])
def test_a_picture_too_large_once_decoded_is_refused_by_its_header(run_circlecal, tmp_path, side, bits):
    path = tmp_path / "large.png"
    path.write_bytes(png_header(side, side, bits))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    outcome = run_circlecal("calibrate", path, "--out", tmp_path / "out")
    only_line(outcome, f"{side} x {side} pixels of {bits} bit", f"--set limits.max_pixels={side * side * bits // 8})")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KB


def test_max_pixels_is_the_users(run_circlecal, tmp_path, frame_file):
    only_line(run_circlecal("calibrate", frame_file, "--out", tmp_path / "out", "--max-pixels", 500_000), "0.5 million")
    only_line(run_circlecal("calibrate", frame_file, "--max-pixels", 1), "max_pixels")
    tiff = tmp_path / "deep.tiff"
    cv2.imwrite(str(tiff), np.zeros((600, 600, 3), np.uint16))
    with pytest.raises(InputError, match="600 x 600 pixels of 16 bit"):
        read_image(tiff, LimitsConfig(max_pixels=600 * 600))
    read_image(tiff, LimitsConfig(max_pixels=2 * 600 * 600))


def test_sixteen_bit_pictures_take_no_more_memory_than_needed(tmp_path):
    path = tmp_path / "deep.png"
    values = np.arange(1 << 16, dtype=np.uint16).reshape(256, 256)
    cv2.imwrite(str(path), np.repeat(values[:, :, None], 3, axis=2))
    assert np.array_equal(read_image(path)[:, :, 1], np.round(values * (255.0 / 65535)).astype(np.uint8))


# addresses


@pytest.mark.parametrize(
    "url",
    [
        "http://[::1/x.jpg",
        "reference://x",
        "dir://x",
        "generic://x",
        "tar://x::file:///etc/passwd",
        "https://a/b.tar::file:///etc/passwd",
        "ssh://host/x.jpg",
        "memory://x.jpg",
        "http:///x.jpg",
        "https://host:port/x.jpg",
        "http://host/a b.jpg",
    ],
)
def test_addresses_that_are_not_read(run_circlecal, tmp_path, url):
    only_line(run_circlecal("batch", url, "--out", tmp_path / "out"), url[:8])
    (tmp_path / "list.txt").write_text(f"{url}\n")
    only_line(run_circlecal("batch", tmp_path / "list.txt", "--out", tmp_path / "out"), url[:8])


# every reader says one line


def test_every_reader_names_the_file(tmp_path):
    path = tmp_path / "x.json"
    path.write_bytes(b"\0" * 100)
    for read in (read_image, prior_settings, load_field):
        with pytest.raises(CirclecalError) as caught:
            read(path if read is not load_field else path.rename(tmp_path / "x.yaml"))
        assert "x." in str(caught.value)
        assert "\n" not in str(caught.value)


# what damaged files showed


def test_a_result_with_ragged_matrices_is_damaged(run_circlecal, tmp_path, frame_file):
    assert run_circlecal("calibrate", frame_file, "--out", tmp_path, "--no-overlay").code == 0
    path = tmp_path / "good.json"
    content = json.loads(path.read_text())
    for change in ("H_covariance", "ellipse"):
        damaged = json.loads(path.read_text())
        if change == "ellipse":
            damaged["ellipses"]["center"]["covariance"][0] = [1.0]
        else:
            damaged["H_covariance"].pop()
        path.write_text(json.dumps(damaged))
        only_line(run_circlecal("project", path, "--to", "field", 1, 2), "is no square matrix")
        path.write_text(json.dumps(content))


def test_a_line_longer_than_any_path(tmp_path):
    path = tmp_path / "list.txt"
    path.write_text("[" * 100_000)
    with pytest.raises(InputError, match="than any path"):
        expand_inputs([path])


# small pictures


def test_small_pictures_are_calibrated_or_refused(frame_image):
    rng = np.random.default_rng(3)
    config = circlecal.load_config(None, {"camera.starts": 2, "camera.iterations": 10})
    for _ in range(8):
        width, height = rng.integers(64, 221, 2).tolist()
        x, y = int(rng.integers(0, 960 - width)), int(rng.integers(0, 540 - height))
        small = cv2.resize(frame_image, (width, height), interpolation=cv2.INTER_AREA)
        for picture in (frame_image[y : y + height, x : x + width], small):
            assert circlecal.calibrate(picture, config).status in ("calibrated", "refused")


# the same picture under two names


def test_a_name_changes_no_answer_wherever_it_is_asked(run_circlecal, tmp_path, frame_file):
    other = tmp_path / "other" / "another name.png"
    other.parent.mkdir()
    other.write_bytes(frame_file.read_bytes())
    assert run_circlecal("calibrate", frame_file, other, "--out", tmp_path / "c", "--no-overlay").code == 0
    batch = ("batch", frame_file, other, "--out", tmp_path / "b", "--workers", 2)
    assert run_circlecal(*batch).code == 0
    lines = [json.loads(line) for line in (tmp_path / "b" / "results.jsonl").read_text().splitlines()]
    files = [json.loads((tmp_path / "c" / f"{name}.json").read_text()) for name in ("good", "another name")]
    own = json.loads(json.dumps(circlecal.calibrate(str(frame_file)).to_dict()))
    answers = []
    for found in (*lines, *files, own):
        answers.append({key: value for key, value in found.items() if key not in ("id", "source", "timings_ms")})
    assert all(answer == answers[0] for answer in answers[1:])


def test_a_verdict_near_a_limit_says_so(run_circlecal, tmp_path, frame_file):
    found = circlecal.calibrate(str(frame_file))
    check = next(c for c in found.to_dict()["checks"] if c["name"] == "sigma_m")
    near = circlecal.calibrate(str(frame_file), set={"verdict.max_sigma_m": check["value"] * 1.05})
    assert any(text.startswith("sigma_m ") for text in near.near_limits)
    assert not any(text.startswith("sigma_m ") for text in found.near_limits)
    setting = f"verdict.max_sigma_m={check['value'] * 1.05}"
    outcome = run_circlecal("calibrate", frame_file, "--set", setting, "--out", tmp_path / "o", "--no-overlay")
    assert "good: calibrated, near a limit: " in outcome.err


# writing


def test_simulate_tries_to_write_first(run_circlecal, tmp_path, monkeypatch):
    from circlecal.evaluation.bench import simulation

    def never(*_, **__):
        raise AssertionError("it computed first")

    monkeypatch.setattr(simulation, "simulate", never)
    (tmp_path / "file").write_text("")
    only_line(run_circlecal("simulate", "--no-plots", "--out", tmp_path / "file"), "is a file")


# servers


class Server(BaseHTTPRequestHandler):
    """Hangs, drips, sends elsewhere, or ends early, as the path says."""

    content = b"0123456789" * 1000

    def do_GET(self) -> None:
        if self.path == "/hang":
            time.sleep(3)
        elif self.path == "/drip":
            self.send_response(200)
            self.end_headers()
            for _ in range(30):
                self.wfile.write(b"x")
                self.wfile.flush()
                time.sleep(0.1)
        elif self.path == "/early":
            start = int((self.headers.get("Range") or "bytes=0-")[6:-1])
            self.send_response(206 if start else 200)
            self.send_header("Content-Length", str(len(self.content) - start))
            self.end_headers()
            self.wfile.write(self.content[start : start + 4000])
        elif self.path == "/large":
            self.send_response(200)
            self.send_header("Content-Length", str(1 << 40))
            self.end_headers()
        else:
            self.send_response(302)
            self.send_header("Location", self.path[1:])
            self.end_headers()

    def log_message(self, *details: object) -> None:
        pass


@pytest.fixture(scope="module")
def server():
    running = ThreadingHTTPServer(("127.0.0.1", 0), Server)
    threading.Thread(target=running.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{running.server_address[1]}"
    running.shutdown()


LIMITS = LimitsConfig(server_seconds=0.7)


@pytest.mark.parametrize("path", ["hang", "drip"])
def test_a_server_that_hangs_has_a_limit_that_is_said(server, monkeypatch, path):
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    with pytest.raises(InputError, match=r"after 0\.7 s; raise limits\.server_seconds"):
        read_url(f"{server}/{path}", LIMITS)


def test_what_a_server_may_not_do(server, monkeypatch):
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    assert read_url(f"{server}/early") == Server.content
    with pytest.raises(InputError, match="more than 256 MB"):
        read_url(f"{server}/large")
    with pytest.raises(InputError, match="not allowed"):  # urllib says it by itself
        read_url(f"{server}/file:///etc/passwd")
    with pytest.raises(InputError, match="neither http nor https"):
        read_url(f"{server}/ftp://127.0.0.1/x")
    assert read_url(f"{server}/{server}/early") == Server.content  # private to private
    monkeypatch.setattr("circlecal.pictures.remote._is_private", lambda host: host.startswith("10."))
    with pytest.raises(InputError, match="a private address"):
        read_url(f"{server}/http://10.0.0.1/x")


def test_another_kernel_of_linear_algebra_gives_the_same_answer(run_circlecal, tmp_path):
    if (
        b"Core"
        not in subprocess.run(
            [sys.executable, "-c", "import numpy"],
            env={**os.environ, "OPENBLAS_VERBOSE": "2", "OPENBLAS_CORETYPE": "Nehalem"},
            capture_output=True,
            check=False,
        ).stderr
    ):
        pytest.skip("this linear algebra has no kernels to choose from")
    sample = Path(__file__).parents[1] / "samples" / "full_circle.jpg"
    run_circlecal("calibrate", sample, "--out", tmp_path, "--no-overlay")
    mine = json.loads((tmp_path / "full_circle.json").read_text())
    done = run_process("calibrate", sample, "--out", tmp_path / "n", "--no-overlay", OPENBLAS_CORETYPE="Nehalem")
    assert done.returncode == 0, done.stderr
    other = json.loads((tmp_path / "n" / "full_circle.json").read_text())
    points = np.array([[x, y, 1.0] for x in (-9.0, 0.0, 9.0) for y in (-9.0, 0.0, 9.0)])
    pixels = [points @ np.array(found["H_image_field"]).T for found in (mine, other)]
    first, second = (lifted[:, :2] / lifted[:, 2:] for lifted in pixels)
    np.testing.assert_allclose(second, first, atol=1e-6)
