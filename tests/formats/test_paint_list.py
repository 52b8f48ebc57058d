"""Files say that their points lie on the middle of the paint, and are read so without an option."""

import json

import numpy as np
import pytest

from circlecal.errors import InputError
from circlecal.formats.annotation import AnnotatedMarking, Annotation, annotation_bytes
from circlecal.formats.paint_list import LIST_NAME, change_list, is_listed
from circlecal.formats.registry import annotation_formats, read_annotations

WRITABLE = sorted(name for name, found in annotation_formats().items() if found.write is not None)
SIZE = (960, 540)


def ring(radius: float) -> list[list[float]]:
    angle = np.linspace(0.0, 2.0 * np.pi, 30, endpoint=False)
    return np.stack([480 + 2 * radius * np.cos(angle), 270 + radius * np.sin(angle)], axis=-1).tolist()


def annotation(frame_id: str = "a") -> Annotation:
    """A circle, the halfway line and the far touchline, as somebody clicked them."""
    shapes = {
        "centre_circle": ("curve", ring(80.0)),
        "halfway_line": ("line", [[480.0, 60.0], [480.0, 300.0], [480.0, 500.0]]),
        "side_line_top": ("line", [[20.0, 60.0], [480.0, 60.0], [940.0, 60.0]]),
    }
    markings = [
        AnnotatedMarking(name=name, kind=kind, points_px=points, sigma_px=[0.5] * len(points))
        for name, (kind, points) in shapes.items()
    ]
    return Annotation(id=frame_id, width=SIZE[0], height=SIZE[1], touched=True, markings=markings)


@pytest.mark.parametrize("target", WRITABLE)
def test_what_is_converted_from_the_workbench_says_that_it_lies_on_the_paint(run_circlecal, tmp_path, target):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.json").write_bytes(annotation_bytes(annotation()))
    out = tmp_path / "out"
    assert run_circlecal("convert", tmp_path / "in" / "a.json", "--to", target, "--out", out).code == 0
    (path,) = [path for path in out.iterdir() if path.name != LIST_NAME]
    (frame,) = read_annotations(path, SIZE)[1]
    assert frame.on_paint
    files = ["calibrate", out, "--from", target, "--size", "960x540", "--out", tmp_path / "found", "--no-overlay"]
    run_circlecal(*files, "--set", "camera.starts=1")
    record = json.loads((tmp_path / "found" / "a.json").read_text())
    assert record["field"]["sizes"]["marking"] == 0.12
    assert "none is given that leaves it open" in run_circlecal(*files, "--convention", "official").err


@pytest.mark.parametrize("target", WRITABLE)
def test_what_says_nothing_is_left_to_the_user(tmp_path, target):
    frame = annotation().frame()
    found = annotation_formats()[target]
    path = tmp_path / found.file_name.format(id="a")
    path.write_bytes(found.write([frame]))
    text = path.read_text()
    if target == "workbench":
        return
    for told in ('"circlecal": {"convention": "paint"}', 'circlecal="paint"'):
        text = text.replace(told, '"other": 0' if told.startswith('"') else "")
    path.write_text(text)
    assert not read_annotations(path, SIZE)[1][0].on_paint


def test_a_list_names_the_files_that_are_written_on_the_paint_and_forgets_others(tmp_path):
    a, b = (tmp_path / f"{name}.json" for name in "ab")
    for path, content in change_list(tmp_path, [a, b], [a, b]).items():
        path.write_bytes(content)
    assert is_listed(a) and is_listed(b) and not is_listed(tmp_path / "c.json")
    (changed,) = change_list(tmp_path, [b], []).values()
    assert b"a.json" in changed and b"b.json" not in changed
    assert change_list(tmp_path, [a], [a]) == {} == change_list(tmp_path / "none", [a], [])
    (tmp_path / LIST_NAME).unlink()
    (tmp_path / LIST_NAME).mkdir()
    assert not is_listed(a)
    (tmp_path / LIST_NAME).rmdir()
    (tmp_path / LIST_NAME).write_bytes(b"# \xff\na\xff.json\n")
    assert is_listed(tmp_path / b"a\xff.json".decode("utf-8", "surrogateescape"))


def test_a_list_that_is_far_too_large_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("circlecal.formats.paint_list.MOST_BYTES", 10)
    (tmp_path / LIST_NAME).write_text("a.json\n" * 10)
    with pytest.raises(InputError, match=LIST_NAME):
        is_listed(tmp_path / "a.json")
