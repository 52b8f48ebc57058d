"""Damaged annotation files of every format: an error of one line, or a frame that is calibrated or refused."""

import json

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.errors import InputError
from circlecal.formats.meaning import read_observations
from circlecal.formats.registry import annotation_formats, read_annotations
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.pipeline import field_of, run_observations
from circlecal.records.json_text import result_line
from circlecal.records.writing import result_record
from circlecal.synthetic.cameras import aim_camera

SIZE = (1280, 720)
CONFIG = load_config("annotations", ["camera.starts=2", "camera.iterations=15"])
TEMPLATE, _ = field_of(CONFIG)
BOX = aim_camera(np.array([3.0, 62.0, -17.0]), np.array([-40.0, -4.0, 0.0]), 1250.0, 0.01, *SIZE)
FORMATS = ("soccernet", "extremities", "pnlcalib", "coco", "labelstudio", "labelme", "gamestate")
WRONG = ("text", float("nan"), None, [], {}, 1e308, -3, True, [[]], "x" * 300)


def box() -> AnnotatedFrame:
    """Penalty area without the centre circle: lines by their ends, the arc, and keypoints."""
    shapes = []
    for name, polyline in TEMPLATE.polylines(1.0).items():
        pixels = BOX.project(polyline)
        pixels = pixels[((pixels > 0) & (pixels < np.array(SIZE) - 1)).all(axis=1)]
        line = TEMPLATE.line_by_name.get(name)
        if len(pixels) > 1 and name != "centre_circle":
            label = (line or TEMPLATE.circle_by_name[name]).class_name
            shapes.append(Shape(label, "line", pixels if line is None else pixels[[0, -1]]))
    keypoints = {"kp_4": (-52.5, -20.16), "kp_5": (-36.0, -20.16), "kp_45": (-41.5, 0.0)}
    shapes += [Shape(name, "points", BOX.project(np.array([place]))) for name, place in keypoints.items()]
    return AnnotatedFrame("f", *SIZE, tuple(shapes), "f.jpg")


def content_of(name, folder):
    if name != "gamestate":
        return json.loads(annotation_formats()[name].write([box()]))
    lines = {
        shape.label: [{"x": x / (SIZE[0] - 1), "y": y / (SIZE[1] - 1)} for x, y in shape.points_px.tolist()]
        for shape in box().shapes
        if shape.kind == "line"
    }
    images = [{"image_id": "1", "file_name": "f.jpg", "width": SIZE[0], "height": SIZE[1]}]
    return {"images": images, "annotations": [{"image_id": "1", "supercategory": "pitch", "lines": lines}]}


def places(value, path=()):
    """Paths to every value of a JSON tree."""
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in children:
        yield (*path, key)
        yield from places(child, (*path, key))


def put(value, path, new):
    for key in path[:-1]:
        value = value[key]
    value[path[-1]] = new


def outcome(path) -> str:
    """Code of the verdict, or ``"error"`` for an error of one line that names the file."""
    try:
        frame = read_observations(path, TEMPLATE, CONFIG.sources, SIZE)[0]
    except InputError as error:
        assert "\n" not in str(error)
        assert path.name in str(error)
        return "error"
    found = run_observations(frame.observations, CONFIG, frame_id=frame.id)
    json.loads(result_line(result_record(found, TEMPLATE)))
    return found.verdict.code or found.status


def file_of(name, folder):
    return folder / ("extremities_f.json" if name == "extremities" else "f.json")


@pytest.mark.parametrize("name", FORMATS)
def test_a_penalty_area_is_calibrated_from_every_format(name, tmp_path):
    path = file_of(name, tmp_path)
    path.write_text(json.dumps(content_of(name, tmp_path)))
    assert outcome(path) == "calibrated"


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.filterwarnings("error")
def test_wrong_values_anywhere(name, tmp_path):
    rng = np.random.default_rng(len(name))
    path = file_of(name, tmp_path)
    seen = set()
    for _ in range(60):
        content = content_of(name, tmp_path)
        found = list(places(content))
        put(content, found[rng.integers(len(found))], WRONG[rng.integers(len(WRONG))])
        path.write_text(json.dumps(content))
        seen.add(outcome(path))
    assert "error" in seen


@pytest.mark.parametrize("name", FORMATS)
def test_truncated_files(name, tmp_path):
    path = file_of(name, tmp_path)
    text = json.dumps(content_of(name, tmp_path))
    for share in (0.0, 0.3, 0.9, 0.999):
        path.write_text(text[: int(share * len(text))])
        assert outcome(path) == "error"


def test_more_shapes_than_anybody_draws(tmp_path):
    path = tmp_path / "f.json"
    point = {"label": "centre_mark", "shape_type": "point", "points": [[5.0, 6.0]]}
    path.write_text(json.dumps({"shapes": [point] * 2001, "imageWidth": 1280, "imageHeight": 720}))
    with pytest.raises(InputError, match="has 2001 shapes; at most 2000"):
        read_annotations(path)


def test_nothing_known_is_refused_without_the_circle(tmp_path):
    path = tmp_path / "f.json"
    path.write_text(json.dumps({"Line unknown": [{"x": 0.1, "y": 0.2}, {"x": 0.4, "y": 0.3}], "Nonsense": [], "z": [
        {"x": 0.1, "y": 0.1}]}))  # fmt: skip
    assert outcome(path) == "no_circle"


def test_a_key_given_twice_is_named(tmp_path):
    """A reader would take the last one, and half of the clicks be lost in silence."""
    path = tmp_path / "f.json"
    middle = '"Middle line": [{"x": 0.4, "y": 0.2}, {"x": 0.41, "y": 0.7}]'
    path.write_text("{" + f'"Circle central": [{{"x": 0.3, "y": 0.5}}], {middle}, {middle}' + "}")
    with pytest.raises(InputError, match=r'f\.json: the key "Middle line" is given twice; keep one of the two$'):
        read_observations(path, TEMPLATE, CONFIG.sources, SIZE)
    path.write_text("{" + middle + "}")
    assert len(read_observations(path, TEMPLATE, CONFIG.sources, SIZE)) == 1
