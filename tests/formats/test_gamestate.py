"""SoccerNet game states: lines of many frames in one file."""

import json
from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.errors import InputError
from circlecal.formats import gamestate, gamestate_camera
from circlecal.formats.cameras import CameraFrame
from circlecal.formats.exports import Exports, convert
from circlecal.formats.meaning import SourcesConfig, observe, read_observations
from circlecal.formats.registry import annotation_formats, open_file, read_annotations
from circlecal.geometry.camera import Camera, image_center
from circlecal.pipeline import run_observations
from circlecal.records.json_text import result_line
from circlecal.records.writing import result_record


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


@pytest.mark.parametrize("source", ["annotation", "camera"])
def test_an_image_id_that_is_given_twice(tmp_path, source):
    images = [{"image_id": "3001", "file_name": f"00000{k}.jpg", "width": 1920, "height": 1080} for k in (1, 2)]
    path = written(tmp_path, labels({"Side line top": []}, images=images))
    read = gamestate.read if source == "annotation" else gamestate_camera.read
    with pytest.raises(InputError, match=r"Labels-GameState\.json: images\.1\.image_id: 3001 is given twice"):
        read(path, path.read_bytes(), None)


def test_a_class_of_one_point_is_left_out_with_a_warning(tmp_path, soccer):
    path = written(tmp_path, labels({"Side line top": [{"x": 0.5, "y": 0.25}]}))
    frame = read_observations(path, soccer, SourcesConfig())[0]
    assert frame.observations.lines == ()
    assert "Side line top: is a line of one point" in frame.warnings[0]


def test_it_becomes_other_annotations_and_no_annotation_is_written(tmp_path, soccer):
    path = written(tmp_path, labels({"Side line top": [{"x": 0.5, "y": 0.25}, {"x": 0.75, "y": 0.5}]}))
    (made,) = convert([path], None, "soccernet", tmp_path / "out", soccer)
    assert json.loads(made.read_text())["Side line top"][0]["x"] == pytest.approx(0.5)
    assert annotation_formats()["gamestate"].write is None
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


def test_cameras_come_back(tmp_path, soccer):
    camera = Camera(
        1280, 720, np.full(2, 1900.0), image_center(1280, 720), np.radians([12.0, 78.0, 0.5]),
        np.array([0.3, 61.0, -14.0]), np.array([0.02, 0.0]),
    )  # fmt: skip
    path = tmp_path / "Labels-GameState.json"
    path.write_bytes(gamestate_camera.write([CameraFrame("clip_1", 1280, 720, camera)]))
    found, _ = open_file(path)
    assert found is gamestate_camera.FORMAT
    (frame,) = gamestate_camera.read(path, path.read_bytes(), None)
    assert (frame.id, frame.image) == ("clip_1", "clip_1.jpg")
    np.testing.assert_allclose(frame.camera.project(np.eye(3)), camera.project(np.eye(3)), atol=1e-6)
    assert path not in convert([path], None, "broadtrack", tmp_path / "out", soccer)


def test_images_are_numbered_through_refused_frames(tmp_path, seen, soccer):
    circle = soccer.circle_by_name["centre_circle"]
    exports = Exports(["gamestate"], tmp_path, size=(480, 270))
    observed = observe(seen, soccer, SourcesConfig(), "labelme", "view").observations
    config = load_config(None, ["verdict.max_sigma_px=1000", "verdict.max_mean_sigma_px=1000"])
    found = run_observations(observed, config, frame_id="clip")
    assert found.status == "calibrated"
    for number, status in enumerate(("calibrated", "refused", "calibrated")):
        record = result_record(replace(found, id=f"clip_{number}"), soccer)
        exports.add(record.model_copy(update={"status": status}), soccer, circle, f"clip_{number}.jpg")
    exports.finish()
    path = tmp_path / "Labels-GameState.json"
    content = json.loads(path.read_text())
    told = [(image["image_id"][-1], image["file_name"], image["has_labeled_camera"]) for image in content["images"]]
    assert told == [("1", "clip_0.jpg", True), ("2", "clip_1.jpg", False), ("3", "clip_2.jpg", True)]
    assert {(image["width"], image["height"]) for image in content["images"]} == {(480, 270)}
    assert [annotation["image_id"][-1] for annotation in content["annotations"]] == ["1", "3"]
    assert [frame.id for frame in gamestate_camera.read(path, path.read_bytes(), None)] == ["clip_0", "clip_2"]


def test_results_of_a_run_are_converted_with_their_refused_frames(tmp_path, seen, soccer):
    """In the order of their ids, as the run itself writes them, however its workers finished."""
    observed = observe(seen, soccer, SourcesConfig(), "labelme", "view").observations
    config = load_config(None, ["verdict.max_sigma_px=1000", "verdict.max_mean_sigma_px=1000"])
    found = run_observations(observed, config, frame_id="clip")
    log = tmp_path / "results.jsonl"

    def write_log(*statuses):
        lines = []
        for number, status in statuses:
            record = result_record(replace(found, id=f"clip_{number}", source=f"clip_{number}.jpg"), soccer)
            camera = {"status": status} | ({} if status == "calibrated" else {"camera": None, "H_image_field": None})
            lines.append(result_line(record.model_copy(update=camera)) + "\n")
        log.write_text("".join(lines))

    write_log((1, "refused"), (0, "calibrated"), (2, "calibrated"))
    (path,) = convert([log], None, "gamestate", tmp_path / "out", soccer)
    content = json.loads(path.read_text())
    told = [(image["image_id"][-1], image["file_name"], image["has_labeled_camera"]) for image in content["images"]]
    assert told == [("1", "clip_0.jpg", True), ("2", "clip_1.jpg", False), ("3", "clip_2.jpg", True)]
    assert {(image["width"], image["height"]) for image in content["images"]} == {(found.width, found.height)}
    assert [annotation["image_id"][-1] for annotation in content["annotations"]] == ["1", "3"]
    (path,) = convert([log], None, "broadtrack", tmp_path / "out", soccer)
    assert "clip_1" not in path.read_text()
    write_log((0, "refused"))
    with pytest.raises(InputError, match="holds no accepted frame; nothing to convert"):
        convert([log], None, "gamestate", tmp_path / "none", soccer)


def test_what_a_run_wrote_of_a_frame_is_gone_when_it_is_refused(tmp_path, seen, soccer):
    circle = soccer.circle_by_name["centre_circle"]
    observed = observe(seen, soccer, SourcesConfig(), "labelme", "view").observations
    config = load_config(None, ["verdict.max_sigma_px=1000", "verdict.max_mean_sigma_px=1000"])
    record = result_record(run_observations(observed, config, frame_id="view"), soccer)
    result = tmp_path / "view.json"
    result.write_text("{}")
    names = ("soccernet", "worldcup", "labelme", "pnlcalib")
    for status in ("calibrated", "refused"):
        exports = Exports(names, tmp_path)
        exports.add(record.model_copy(update={"status": status}), soccer, circle, "view.jpg")
        exports.finish()
        left = {path.name for path in tmp_path.iterdir()}
        gone = {"camera_view.json", "view.homographyMatrix", "view.pnlcalib.json"}
        assert left & gone == (gone if status == "calibrated" else set())
        assert {"view.json", "view.labelme.json"} <= left
    assert result.read_text() == "{}"


def test_a_camera_without_its_image_is_told(tmp_path):
    path = tmp_path / "Labels-GameState.json"
    content = {"images": [], "annotations": [{"image_id": "1", "supercategory": "camera", "parameters": {}}]}
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="1 is not in the file"):
        gamestate_camera.read(path, path.read_bytes(), None)


def test_a_kind_that_is_no_word_is_no_camera(tmp_path):
    path = tmp_path / "Labels-GameState.json"
    path.write_text(json.dumps({"images": [], "annotations": [{"supercategory": ["camera"]}]}))
    assert open_file(path)[0] is not gamestate_camera.FORMAT
