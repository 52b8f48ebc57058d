"""Recognition by content, and every kind of broken file: one line that names the file and the field."""

import json
import struct
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from circlecal.errors import InputError
from circlecal.field import field_folder, load_field
from circlecal.field.view import FieldView
from circlecal.formats import (
    broadtrack,
    coco,
    cvat,
    labelme,
    labelstudio,
    pnlcalib,
    soccernet,
    soccernet_camera,
    tvcalib,
    worldcup,
)
from circlecal.formats.annotation import Annotation, annotation_bytes, markings_of
from circlecal.formats.cameras import CalibratedFrame, CameraFrame
from circlecal.formats.exports import convert, field_of_record
from circlecal.formats.format import json_bytes
from circlecal.formats.meaning import SourcesConfig, read_observations
from circlecal.formats.registry import open_file, read_annotations
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.geometry.projective import apply_homography
from circlecal.observations import CirclePoints, Observations
from circlecal.records.parts import FieldRecord


def format_of(path, name=None):
    found, _ = open_file(path, name)
    return found.name, found.kind


def read_cameras(path, size=None, name=None):
    found, content = open_file(path, name)
    return found.read(path, content.raw, size)


@pytest.fixture
def files(seen, frame_camera, tmp_path):
    camera = CameraFrame("view", 960, 540, frame_camera)
    kp = {"kp": {"51": {"x": 0.5, "y": 0.4, "p": 0.7}}, "lines": {}}
    contents = {
        "soccernet": soccernet.write([seen]),
        "pnlcalib": json_bytes(kp),
        "coco": coco.write([seen]),
        "cvat": cvat.write([seen]),
        "labelstudio": labelstudio.write([seen]),
        "labelme": labelme.write([seen]),
        "camera_soccernet": soccernet_camera.write([camera]),
        "broadtrack": broadtrack.write([camera]),
        "tvcalib": tvcalib.write([camera, camera]),
        "worldcup": worldcup.matrix_bytes(frame_camera.homography, (1280, 720)),
    }
    paths = {}
    for name, content in contents.items():
        paths[name] = tmp_path / "in" / f"{name}.file"
        paths[name].parent.mkdir(exist_ok=True)
        paths[name].write_bytes(content)
    return paths


def test_every_format_is_recognised_by_its_content(files):
    for name, path in files.items():
        camera = name in ("camera_soccernet", "broadtrack", "tvcalib", "worldcup")
        expected = name.removeprefix("camera_"), "camera" if camera else "annotation"
        assert format_of(path) == expected
    pretty = files["tvcalib"].with_name("one.json")
    pretty.write_text(json.dumps(json.loads(files["tvcalib"].read_bytes().splitlines()[0]), indent=2))
    assert format_of(pretty)[0] == "tvcalib"
    named = files["soccernet"].rename(files["soccernet"].with_name("extremities_1.json"))
    assert format_of(named)[0] == "extremities"
    assert format_of(named, "soccernet") == ("soccernet", "annotation")
    assert format_of(files["camera_soccernet"], "soccernet")[1] == "camera"


@pytest.mark.parametrize("content", [b"hello", b"[1, 2]", b'{"a": 5}', b"\xff\xfe\x00", b"1 2 3"])
def test_what_is_no_known_format(tmp_path, content):
    path = tmp_path / "odd.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"odd\.json: "):
        read_annotations(path, (100, 100))


POINT = {"x": 0.5, "y": 0.5}


@pytest.mark.parametrize(
    ("content", "field"),
    [
        ('{"Middle line": [{"x": 0.5, "y"', "JSON"),
        ('{"Middle line": [{"x": "0.5", "y": 0.5}]}', "Middle line.0.x: .*not \"0.5\""),
        ('{"Middle line": [{"x": NaN, "y": 0.5}]}', "Middle line.0.x: .*finite"),
        ('{"Middle line": [{"x": 1e999, "y": 0.5}]}', "Middle line.0.x: .*finite"),
        ('{"Middle line": [{"x": null, "y": 0.5}]}', "Middle line.0.x"),
        ('{"Middle line": [{"x": true, "y": 0.5}]}', "Middle line.0.x"),
        ('{"Middle line": [{"y": 0.5}]}', "Middle line.0.x"),
        ('{"Middle line": [[0.5, 0.5]]}', "Middle line.0"),
        ('{"kp": {"51": {"x": 0.5, "y": 0.5, "p": 2}}}', "kp.51.p"),
        ('{"kp": {"51": {"x": [1], "y": 0.5, "p": 1}}}', "kp.51.x"),
        ('{"kp": {}, "lines": {"13": {"x_1": 0.5}}}', "lines.13.y_1"),
        ('{"images": [{"id": 1}], "annotations": [], "categories": []}', "images.0.file_name"),
        ('{"shapes": [{"label": "a", "points": [[1]]}], "imageWidth": 9, "imageHeight": 9}', "shapes.0.points.0"),
        ('{"shapes": [], "imageWidth": -9, "imageHeight": 9}', "imageWidth"),
        ('[{"annotations": [{"result": [{"original_width": 9, "original_height": 9, "type": "keypointlabels", '
         '"value": {"x": "1", "y": 2, "keypointlabels": ["a"]}}]}]}]', "0.annotations.result.0.value.x"),
        ("<annotations><image name='a' width='9' height='nine'/></annotations>", "height: 'nine'"),
        ("<annotations><image name='a' width='9' height='9'><points label='b' points='1,nan'/></image></annotations>",
         "image 'a': b: points"),
        ("<annotations><image", "XML"),
        ('{"a":' * 100_000, ""),
    ],
)  # fmt: skip
def test_broken_files_name_file_and_field(tmp_path, content, field):
    path = tmp_path / "broken.json"
    path.write_text(content)
    with pytest.raises(InputError, match=rf"broken\.json.*{field}") as caught:
        read_annotations(path, (100, 100))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_ten_megabytes_of_points_are_refused(tmp_path, soccer):
    path = tmp_path / "large.json"
    path.write_text(json.dumps({"Circle central": [POINT] * 470_000}))
    assert path.stat().st_size > 10_000_000
    with pytest.raises(InputError, match=r"large\.json: Circle central: .*10000"):
        read_observations(path, soccer, SourcesConfig(), (1920, 1080))


def test_missing_and_empty_files(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_annotations(tmp_path / "none.json")
    (tmp_path / "empty.json").write_text(" \n")
    with pytest.raises(InputError, match="is empty"):
        read_annotations(tmp_path / "empty.json")


def test_the_size_of_a_picture_beside_the_file(files, frame_image):
    path = files["soccernet"].rename(files["soccernet"].with_name("a.json"))
    with pytest.raises(InputError, match="--size"):
        read_annotations(path)
    cv2.imwrite(str(path.with_name("a.png")), frame_image)
    assert read_annotations(path)[1][0].width == 960
    assert read_annotations(path, (100, 100))[1][0].width == 100


@pytest.mark.parametrize(("orientation", "size"), [(1, (960, 540)), (3, (960, 540)), (6, (540, 960))])
def test_the_size_of_a_picture_that_is_turned_by_its_exif_orientation(files, frame_image, orientation, size):
    """A wrong camera would come out calibrated: the picture is shown turned, and so it was clicked."""
    path = files["soccernet"].rename(files["soccernet"].with_name("a.json"))
    encoded = cv2.imencode(".jpg", frame_image)[1].tobytes()
    exif = b"Exif\0\0II*\0\x08\0\0\0" + struct.pack("<HHHIHH", 1, 0x0112, 3, 1, orientation, 0) + b"\0" * 4
    content = encoded[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + encoded[2:]
    path.with_name("a.jpg").write_bytes(content)
    (frame,) = read_annotations(path)[1]
    assert (frame.width, frame.height) == size


@pytest.mark.parametrize("target", ["soccernet", "extremities", "coco", "cvat", "labelstudio", "labelme"])
@pytest.mark.parametrize("source", ["soccernet", "coco", "cvat", "labelstudio", "labelme"])
def test_annotations_become_each_other(files, seen, soccer, tmp_path, caplog, source, target):
    (written,) = convert([files[source]], source, target, tmp_path / "out", soccer, (960, 540))
    ((frame,),) = (read_annotations(written, (960, 540), target)[1],)
    found = {shape.label: shape.points_px for shape in frame.shapes}
    assert not caplog.messages
    assert found.keys() == {shape.label for shape in seen.shapes}
    for shape in seen.shapes:
        assert np.abs(found[shape.label] - shape.points_px).max() < 1e-6


def test_what_a_format_cannot_say_is_told(soccer, tmp_path, caplog):
    """PnLCalib's files hold keypoints and straight lines."""
    angle = np.linspace(0.0, 5.0, 9)
    ring = np.stack([480.0 + 200.0 * np.cos(angle), 270.0 + 90.0 * np.sin(angle)], axis=1)
    shapes = (
        Shape("Circle central", "line", ring),
        Shape("Middle line", "line", np.array([[480.0, 10.0], [470.0, 500.0]])),
        Shape("centre_circle top", "points", np.array([[480.0, 180.0]])),
    )
    source = tmp_path / "view.labelme.json"
    source.write_bytes(labelme.write([AnnotatedFrame("view", 960, 540, shapes, "view.jpg")]))
    convert([source], "labelme", "pnlcalib", tmp_path / "out", soccer, (960, 540))
    told = "view: pnlcalib cannot say centre_circle, centre_circle top; left out"
    assert [message.replace("view.labelme:", "view:") for message in caplog.messages] == [told]


def test_doubtful_detections_are_left_out_where_no_confidence_can_be_said(soccer, tmp_path, caplog):
    found = {
        str(number): {"x": 0.1 + 0.02 * number, "y": 0.5, "p": p} for number, p in ((1, 0.9), (2, 0.05), (31, 0.8))
    }
    source = tmp_path / "view.json"
    source.write_text(json.dumps({"kp": found, "lines": {}}))
    for target, count in (("coco", 2), ("pnlcalib", 3)):
        (written,) = convert([source], "pnlcalib", target, tmp_path / target, soccer, (960, 540))
        _, (frame,) = read_annotations(written, (960, 540))
        assert sum(len(shape.points_px) for shape in frame.shapes) == count
    told = [message for message in caplog.messages if "confidences" in message]
    assert told == ["confidences cannot be said; 1 doubtful or computed detections are left out"]


def test_files_that_cannot_be_read_beside_others_are_told_at_the_end(soccer, tmp_path):
    shape = Shape("Middle line", "line", np.array([[480.0, 10.0], [470.0, 500.0]]))
    for name in ("a", "c"):
        (tmp_path / f"{name}.json").write_bytes(
            labelme.write([AnnotatedFrame(name, 960, 540, (shape,), f"{name}.jpg")])
        )
    (tmp_path / "b.json").write_text("{")
    paths, failures = sorted(tmp_path.glob("*.json")), []
    (written,) = convert(paths, None, "coco", tmp_path / "out", soccer, failures=failures)
    assert len(read_annotations(written, None)[1]) == 2
    assert [str(failure).startswith(str(tmp_path / "b.json")) for failure in failures] == [True]
    with pytest.raises(InputError, match=r"b\.json"):
        convert(paths, None, "coco", tmp_path / "out", soccer)


@pytest.mark.parametrize("target", ["cvat", "workbench"])
def test_edges_of_the_paint_that_a_format_cannot_say_are_told(soccer, tmp_path, caplog, target):
    angle = np.linspace(0.0, 5.0, 9)
    ring = np.stack([480.0 + 200.0 * np.cos(angle), 270.0 + 90.0 * np.sin(angle)], axis=1)
    circles = tuple(CirclePoints("centre_circle", edge, ring, np.full(9, 0.2)) for edge in ("outer", "center"))
    markings = markings_of(Observations(960, 540, circles), "measured")
    seen = Annotation(id="view", width=960, height=540, markings=markings)
    source = tmp_path / "view.json"
    source.write_bytes(annotation_bytes(seen))
    convert([source], "workbench", target, tmp_path / "out", soccer)
    told = "view: cvat cannot say the outer edge of centre_circle; drawn as the middle of the paint"
    assert caplog.messages == ([told] if target == "cvat" else [])


def test_the_workbench_takes_a_field_of_ones_own(soccer, tmp_path, caplog):
    own = tmp_path / "hall.yaml"
    own.write_bytes((field_folder() / "futsal.yaml").read_bytes())
    field = load_field(own)
    line = next(line.name for line in field.lines if line.name not in soccer.line_by_name)
    shape = Shape(line, "line", np.array([[480.0, 10.0], [470.0, 500.0]]))
    source = tmp_path / "view.labelme.json"
    source.write_bytes(labelme.write([AnnotatedFrame("view", 960, 540, (shape,), "view.jpg")]))
    (written,) = convert([source], "labelme", "workbench", tmp_path / "out", field, None, str(own))
    told = json.loads(written.read_text())
    assert told["field"] == str(own) and [marking["name"] for marking in told["markings"]] == [line]
    assert not caplog.messages


@pytest.mark.parametrize("target", ["soccernet", "broadtrack", "tvcalib", "worldcup"])
@pytest.mark.parametrize("source", ["camera_soccernet", "broadtrack", "tvcalib"])
def test_cameras_become_each_other(files, frame_camera, soccer, tmp_path, source, target):
    written = convert([files[source]], None, target, tmp_path / "out", soccer)
    (frame, *_) = read_cameras(written[0], None, target)
    H = frame.camera.homography if frame.camera is not None else frame.H_image_field
    image = H @ [9.0, 3.0, 1.0]
    factor = np.array([frame.width / 960, frame.height / 540])
    expected = (frame_camera.project([[9.0, 3.0]])[0] + 0.5) * factor - 0.5
    assert image[:2] / image[2] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("target", ["soccernet", "broadtrack", "tvcalib", "worldcup"])
def test_a_camera_in_the_plane_of_the_field_is_refused_in_one_line(frame_camera, soccer, tmp_path, target):
    path, flat = tmp_path / "camera_flat.json", replace(frame_camera, position_m=np.zeros(3))
    path.write_bytes(soccernet_camera.write([CameraFrame("flat", 960, 540, flat)]))
    with pytest.raises(InputError, match=r"camera_flat\.json: its camera lies in the plane .*position_meters") as told:
        convert([path], None, target, tmp_path / "out", soccer)
    assert "\n" not in str(told.value)


def test_what_a_format_without_a_lens_loses_is_told_once(frame_camera, soccer, tmp_path, caplog):
    paths = []
    for number, kappa in enumerate((0.02, 0.04, 0.0)):
        frame = CameraFrame(f"frame{number}", 960, 540, replace(frame_camera, kappa=np.array([kappa, 0.0])))
        paths.append(tmp_path / f"camera_{number}.json")
        paths[-1].write_bytes(soccernet_camera.write([frame]))
    written = convert(paths, None, "worldcup", tmp_path / "out", soccer)
    (told,) = [record.getMessage() for record in caplog.records]
    assert "worldcup holds no lens" in told
    camera, (read,) = replace(frame_camera, kappa=np.array([0.04, 0.0])), read_cameras(written[1], (960, 540))
    points, pixels = CalibratedFrame(
        "a", 960, 540, FieldView(camera), soccer, soccer.circle_by_name["centre_circle"]
    ).visible_field
    away = np.linalg.norm(apply_homography(read.H_image_field, points) - pixels, axis=1).max()
    assert away > 1.0
    assert f"up to {away:.1f} pixels" in told
    assert "; of 2 frames" in told
    caplog.clear()
    convert(paths[2:], None, "worldcup", tmp_path / "straight", soccer)
    convert(paths, None, "tvcalib", tmp_path / "lens", soccer)
    assert not caplog.records


@pytest.mark.parametrize("is_told", [True, False])
def test_the_circle_of_a_record_is_the_one_that_was_seen(is_told):
    rink, asked = load_field("ice-hockey-nhl"), []
    told = next(name for name in rink.circle_by_name if name != rink.default_circle) if is_told else None
    record = SimpleNamespace(field=FieldRecord(template=rink.name, circle=told))
    template, circle = field_of_record(record, rink, asked.append)
    assert template is rink and not asked
    assert circle.name == (told or rink.default_circle)
    other = load_field("soccer")
    template, circle = field_of_record(SimpleNamespace(field=FieldRecord(template=rink.name)), other, load_field)
    assert (template.name, circle.name) == (rink.name, rink.default_circle)
    template, circle = field_of_record(SimpleNamespace(field=None), other, asked.append)
    assert template is other and circle.name == "centre_circle"


def test_several_files_become_one(files, soccer, tmp_path):
    out = convert([files["labelme"], files["coco"]], None, "cvat", tmp_path / "out", soccer)
    assert [path.name for path in out] == ["cvat.xml"]
    frames = cvat.read(out[0], out[0].read_bytes(), None)
    assert [(frame.id, frame.image) for frame in frames] == [("view", "view.jpg"), ("view-2", "view.jpg")]


def test_there_is_no_way_from_an_annotation_to_a_camera(files, soccer, tmp_path):
    with pytest.raises(InputError, match=r"no way from a coco annotation to broadtrack; annotations go to"):
        convert([files["coco"]], None, "broadtrack", tmp_path, soccer)
    with pytest.raises(InputError, match=r"no way from a worldcup camera to labelme"):
        convert([files["worldcup"]], None, "labelme", tmp_path, soccer)


def test_a_source_is_never_written_over(files, soccer):
    path = files["soccernet"].rename(files["soccernet"].with_name("a.json"))
    content = path.read_bytes()
    with pytest.raises(InputError, match="written over"):
        convert([path], None, "labelme", path.parent, soccer, (960, 540))
    assert path.read_bytes() == content


def test_keypoint_files_keep_what_was_not_ours(files):
    frame = read_annotations(files["pnlcalib"], (960, 540))[1][0]
    assert frame.original == {"kp": {"51": {"x": 0.5, "y": 0.4, "p": 0.7}}, "lines": {}}
    assert json.loads(pnlcalib.write([frame]))["kp"]["51"]["p"] == 0.7
    assert Path(files["pnlcalib"]).name.startswith(frame.id)
