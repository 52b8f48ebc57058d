"""SoccerNet game states: lines of many frames in one file."""

import json

import numpy as np
import pytest

from circlecal.errors import InputError
from circlecal.formats.exports import convert
from circlecal.formats.meaning import SourcesConfig, read_observations
from circlecal.formats.registry import calibration_formats, read_annotations


def labels(*lines, images=({"image_id": "3001", "file_name": "000001.jpg", "width": 1920, "height": 1080},)):
    others = [
        {"id": "1", "image_id": "3001", "supercategory": "object", "category_id": 1, "bbox_image": {"x": 3}},
        {"id": "2", "image_id": "3001", "supercategory": "camera", "category_id": 6, "parameters": {"pan": 3}},
    ]
    pitch = [
        {"id": str(9 + k), "image_id": "3001", "supercategory": "pitch", "category_id": 5, "lines": line}
        for k, line in enumerate(lines)
    ]
    return {"info": {}, "images": list(images), "annotations": others + pitch, "categories": []}


def written(tmp_path, content):
    path = tmp_path / "Labels-GameState.json"
    path.write_text(json.dumps(content))
    return path


def test_frames_with_and_without_lines(tmp_path, soccer):
    points = [{"x": 0.5, "y": 0.25}, {"x": 0.75, "y": 1.0}]
    images = [{"image_id": "3001", "file_name": "000001.jpg", "width": 1920, "height": 1080},
              {"image_id": "3002", "file_name": "000002.jpg", "width": 1920, "height": 1080}]  # fmt: skip
    content = labels({"Circle central": points * 4, "Goal left post left": points, "Side line top": []}, images=images)
    found, frames = read_annotations(written(tmp_path, content))
    assert found.name == "gamestate"
    assert [frame.id for frame in frames] == ["000001", "000002"]
    assert [shape.label for shape in frames[0].shapes] == ["Circle central", "Goal left post left"]
    np.testing.assert_allclose(frames[0].shapes[0].points_px[1], [0.75 * 1919, 1079.0])
    assert frames[1].shapes == ()
    seen = read_observations(written(tmp_path, content), soccer, SourcesConfig())[0].observations
    assert seen.circles[0].circle == "centre_circle"


def test_a_class_of_one_point_is_left_out_with_a_warning(tmp_path, soccer):
    path = written(tmp_path, labels({"Side line top": [{"x": 0.5, "y": 0.25}]}))
    frame = read_observations(path, soccer, SourcesConfig())[0]
    assert frame.observations.lines == ()
    assert "Side line top: is a line of one point" in frame.warnings[0]


def test_it_becomes_other_annotations_but_is_not_written(tmp_path, soccer):
    path = written(tmp_path, labels({"Side line top": [{"x": 0.5, "y": 0.25}, {"x": 0.75, "y": 0.5}]}))
    (made,) = convert([path], None, "soccernet", tmp_path / "out", soccer)
    assert json.loads(made.read_text())["Side line top"][0]["x"] == pytest.approx(0.5)
    assert "gamestate" not in calibration_formats()
    with pytest.raises(InputError, match="no way from"):
        convert([made], None, "gamestate", tmp_path / "out", soccer)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["annotations"][2].update(image_id="77"), r"annotations.2.image_id: 77 is not in the file"),
        (
            lambda c: c["annotations"][2].update(lines={"Side line top": [{"x": "a", "y": 1}]}),
            r"lines.Side line top.0.x",
        ),
        (lambda c: c["images"][0].pop("width"), "give --size"),
        (lambda c: c["images"][0].update(file_name=3), "images.0.file_name"),
    ],
)
def test_damage_is_one_line(tmp_path, change, words):
    content = labels({"Side line top": [{"x": 0.5, "y": 0.25}]})
    change(content)
    with pytest.raises(InputError, match=words) as raised:
        read_annotations(written(tmp_path, content))
    assert "\n" not in str(raised.value)
