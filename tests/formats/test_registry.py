"""The registry: what it knows follows from the files of the formats, and one more file is one more format."""

import json
from pathlib import Path

import numpy as np
import pytest

import circlecal.formats
from circlecal.config import load_config
from circlecal.errors import ConfigError
from circlecal.formats import registry
from circlecal.formats.format import AnnotationFormat
from circlecal.formats.meaning import SourcesConfig

TOY = '''
"""A toy: one line per point, ``label x y`` in pixels, after a first line ``TOY width height name``."""

import numpy as np

from circlecal.formats.cameras import derive_shapes
from circlecal.formats.format import AnnotationFormat
from circlecal.formats.shapes import AnnotatedFrame, Shape


def read(path, content, size):
    first, *rows = content.decode().splitlines()
    width, height = map(int, first.split()[1:3])
    words = [row.rsplit(" ", 2) for row in rows]
    shapes = [Shape(label, "line", np.array([[float(x), float(y)]])) for label, x, y in words]
    return [AnnotatedFrame(path.stem, width, height, tuple(shapes))]


def write(frames):
    (frame,) = frames
    rows = [f"{s.label} {x!r} {y!r}" for s in frame.shapes for x, y in s.sample().tolist()]
    return "\\n".join([f"TOY {frame.width} {frame.height} {frame.id}", *rows]).encode()


FORMAT = AnnotationFormat(
    name="toy",
    recognises=lambda content: content.raw.startswith(b"TOY "),
    read=read,
    write=write,
    derive=derive_shapes,
    file_name="{id}.txt",
    sigma_px=1.25,
)
'''


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """A further format: its file, and its word in the registry."""
    folder = tmp_path / "further"
    folder.mkdir()
    (folder / "toy.py").write_text(TOY)
    monkeypatch.setattr(circlecal.formats, "__path__", [*circlecal.formats.__path__, str(folder)])
    monkeypatch.setattr(registry, "MODULES", ("toy", *registry.MODULES))
    registry.formats.cache_clear()
    yield
    monkeypatch.undo()
    registry.formats.cache_clear()


@pytest.fixture
def marks(tmp_path, seen):
    """What is seen in a view as a file of the toy."""
    rows = [f"{s.label} {x!r} {y!r}" for s in seen.shapes for x, y in s.points_px.tolist()]
    path = tmp_path / "view.toy"
    path.write_text("\n".join(["TOY 960 540 view", *rows]))
    return path


def test_one_file_is_one_format(toy, marks, run_circlecal, tmp_path):
    out = tmp_path / "out"
    outcome = run_circlecal("calibrate", marks, "--from", "toy", "--to", "toy", "--out", out, "--json")
    assert outcome.code == 0, outcome.err
    record = json.loads(outcome.out)
    assert record["observations"]["circles"][0]["sigma_px"][0] == pytest.approx(1.25 / 2)
    assert "centre_circle top" in (out / "view.toy.txt").read_text()
    converted = run_circlecal("convert", marks, "--to", "coco", "--out", tmp_path / "coco")
    assert converted.code == 0, converted.err
    back = run_circlecal("convert", tmp_path / "coco" / "coco.json", "--to", "toy", "--out", tmp_path / "back")
    assert back.code == 0, back.err
    (again,) = registry.read_annotations(tmp_path / "back" / "view.txt")[1]
    (first,) = registry.read_annotations(marks)[1]
    assert {s.label for s in again.shapes} == {s.label for s in first.shapes}
    points = [np.sort(np.concatenate([s.points_px for s in f.shapes]), axis=0) for f in (again, first)]
    assert points[0] == pytest.approx(points[1])


def test_its_noise_is_an_option_and_its_name_is_in_the_messages(toy, marks, run_circlecal, tmp_path):
    config = load_config(None, ["sources.sigma_px.toy=3"])
    assert config.sources.sigma_px == {**SourcesConfig().sigma_px, "toy": 3.0}
    assert SourcesConfig().sigma_px["toy"] == 1.25
    for option in ("--from", "--to"):
        assert "toy" in run_circlecal("calibrate", marks, option, "vhs", "--out", tmp_path / "o").err


def test_only_formats_have_noise():
    with pytest.raises(ConfigError, match=r"sources\.sigma_px: vhs is no annotation format; known: coco"):
        load_config(None, ["sources.sigma_px.vhs=3"])
    with pytest.raises(ConfigError, match=r"sources\.sigma_px\.coco: should be greater than 0"):
        load_config(None, ["sources.sigma_px.coco=0"])


def rows():
    """Cells of the README's table of formats, by name."""
    text = (Path(circlecal.formats.__file__).parent / "README.md").read_text()
    table = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("| `")]
    return {cells[0].strip().strip("`"): [cell.strip() for cell in cells[1:]] for cells in table if len(cells) == 5}


def test_the_table_of_formats_is_the_registry():
    table = rows()
    assert table.keys() == {f.name for f in registry.formats() if f is not registry.RESULT}
    written = registry.calibration_formats()
    for name, (_, file, refused, _) in table.items():
        known = written.get(name) or registry.annotation_formats()[name]
        if name in written:
            stem = f"<id>.{name}" if isinstance(known, AnnotationFormat) else "<id>"
            assert file == f"`{known.file_name.format(id=stem)}`"
            annotation = registry.annotation_formats().get(name)
            measured = annotation is not None and annotation.draws_measured
            assert measured == refused.startswith("what was measured")
            assert measured or known.per_frame == (refused == "no file")
        else:
            assert file == ("(by `convert`)" if known.write else "(read only)")


def test_every_file_of_a_format_is_registered():
    folder = Path(circlecal.formats.__file__).parent
    files = {path.stem for path in folder.glob("*.py") if "\nFORMAT = " in path.read_text()}
    assert files == set(registry.MODULES)


def test_names_are_unique_within_a_kind():
    found = [(known.kind, known.name) for known in registry.formats()]
    assert len(found) == len(set(found))
