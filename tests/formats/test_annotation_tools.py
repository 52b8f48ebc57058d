"""COCO, CVAT, Label Studio and LabelMe: their pixel mappings, what they leave out, exact round trips."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from circlecal.errors import InputError
from circlecal.formats import coco, cvat, labelme, labelstudio
from circlecal.formats.cameras import derive_shapes
from circlecal.formats.format import json_bytes
from circlecal.formats.shapes import AnnotatedFrame, Shape

FILE = Path("marks.json")
ELLIPSE = Shape("Circle central", "ellipse", np.array([[480.0, 270.0], [780.0, 280.0], [477.0, 360.0]]))


def test_labelme_counts_from_the_corner(seen, close):
    record = json.loads(labelme.write([seen]))
    assert record["shapes"][2]["points"][0] == pytest.approx((seen.shapes[2].points_px[0] + 0.5).tolist())
    assert (record["imageWidth"], record["imageHeight"], record["imagePath"]) == (960, 540, "view.jpg")
    close(labelme.read(FILE, json_bytes(record), None)[0], seen)


def test_labelme_kinds():
    shapes = [
        {"label": "Middle line", "shape_type": "line", "points": [[0.5, 0.5], [1.5, 0.5]]},
        {"label": "Circle central", "shape_type": "circle", "points": [[5, 5], [9, 5]]},
        {"label": "Circle central", "points": [[5, 5], [9, 5], [9, 9]]},
        {"label": "Side line top", "shape_type": "linestrip", "points": []},
    ]
    content = json_bytes({"shapes": shapes, "imageWidth": 90, "imageHeight": 80})
    (frame,) = labelme.read(FILE, content, None)
    assert [(s.label, s.kind, len(s.points_px)) for s in frame.shapes] == [
        ("Middle line", "line", 2),
        ("Circle central", "line", 3),
    ]
    assert frame.shapes[0].points_px[0].tolist() == [0.0, 0.0]
    assert "shapes.1.shape_type" in frame.warnings[0]


def test_labelme_without_a_size_needs_one():
    content = json_bytes({"shapes": []})
    with pytest.raises(InputError, match="--size"):
        labelme.read(FILE, content, None)
    assert labelme.read(FILE, content, (64, 65))[0].height == 65


def test_cvat_round_trip(seen, close):
    frame = replace(seen, shapes=(*seen.shapes, ELLIPSE))
    content = cvat.write([frame, AnnotatedFrame("empty", 64, 65, ())])
    again, empty = cvat.read(FILE, content, None)
    close(again, frame)
    assert (empty.id, empty.width, empty.height, empty.shapes) == ("empty", 64, 65, ())
    assert again.image == "view.jpg"


def test_cvat_counts_from_the_corner_and_knows_skeletons():
    content = b"""<annotations><version>1.1</version><meta/><image id="0" name="x/a.jpg" width="192" height="108">
        <skeleton label="pitch"><points label="centre_mark" outside="0" points="10.5,20.5"/>
        <points label="penalty_mark_left" outside="1" points="1,1"/></skeleton>
        <box label="player" xtl="0" ytl="0" xbr="1" ybr="1"/><tag label="t"/></image></annotations>"""
    (frame,) = cvat.read(FILE, content, None)
    assert frame.id == "a"
    assert [(s.label, s.points_px.tolist()) for s in frame.shapes] == [("centre_mark", [[10.0, 20.0]])]
    assert len(frame.warnings) == 1
    assert "box" in frame.warnings[0]


def test_cvat_turns_ellipses_clockwise_in_the_picture():
    ellipse = '<ellipse label="Circle central" cx="50" cy="40" rx="20" ry="10" rotation="30.00"/>'
    content = f'<annotations><image name="a.jpg" width="100" height="90">{ellipse}</image></annotations>'
    (frame,) = cvat.read(FILE, content.encode(), None)
    center, first, second = frame.shapes[0].points_px
    assert center == pytest.approx([49.5, 39.5])
    assert first - center == pytest.approx([20 * np.sqrt(0.75), 10.0])
    assert second - center == pytest.approx([-5.0, 10 * np.sqrt(0.75)])


def test_cvat_never_expands_entities():
    bomb = b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "bbbb"><!ENTITY c "&b;&b;">]><annotations>&c;</annotations>'
    outside = b'<!DOCTYPE a [<!ENTITY f SYSTEM "file:///etc/hostname">]><annotations>&f;</annotations>'
    for content in (bomb, outside):
        with pytest.raises(InputError, match="DOCTYPE"):
            cvat.read(FILE, content, None)


def test_cvat_for_video_is_named():
    with pytest.raises(InputError, match="CVAT for images"):
        cvat.read(FILE, b"<annotations><track id='0'/></annotations>", None)


def test_label_studio_round_trip(seen, close):
    frame = replace(seen, shapes=(*seen.shapes, ELLIPSE))
    (again,) = labelstudio.read(FILE, labelstudio.write([frame]), None)
    close(again, frame)


def test_label_studio_is_in_per_cent_and_turns_in_the_picture():
    value = {"x": 50, "y": 50, "radiusX": 10, "radiusY": 10, "rotation": 90, "ellipselabels": ["Circle central"]}
    result = {"type": "ellipselabels", "original_width": 200, "original_height": 100, "value": value}
    tasks = [
        {
            "data": {"image": "/upload/3/a%20b.jpg"},
            "annotations": [{"result": [result, {"type": "choices", "value": {}}]}],
        }
    ]
    (frame,) = labelstudio.read(FILE, json_bytes(tasks), None)
    assert frame.id == "a%20b"
    center, first, second = frame.shapes[0].points_px
    assert center == pytest.approx([99.5, 49.5])
    assert first - center == pytest.approx([0, 20])
    assert second - center == pytest.approx([-10, 0])
    assert not frame.warnings


def label_studio(*results):
    sizes = {"original_width": 200, "original_height": 100}
    tasks = [{"annotations": [{"result": [{"type": kind, "value": value, **sizes} for kind, value in results]}]}]
    (frame,) = labelstudio.read(FILE, json_bytes(tasks), None)
    return frame


def test_label_studio_regions_that_are_labelled_by_a_tag_of_their_own():
    """With ``<Labels>`` and ``<Polygon>`` every region is two results: its shape, and the shape with its labels."""
    regions = {
        "polygon": {"points": [[10, 20], [30, 40]]},
        "vector": {"vertices": [{"x": 10, "y": 20}, {"x": 30, "y": 40}]},
        "ellipse": {"x": 50, "y": 50, "radiusX": 10, "radiusY": 20, "rotation": 0},
        "keypoint": {"x": 10, "y": 20, "width": 0.4},
        "rectangle": {"x": 1, "y": 2, "width": 3, "height": 4, "rotation": 5},
    }
    both = [result for kind, v in regions.items() for result in ((kind, v), ("labels", {**v, "labels": [kind]}))]
    for frame in (label_studio(*both), label_studio(*((k, {**v, "labels": [k]}) for k, v in regions.items()))):
        found = {shape.label: (shape.kind, shape.points_px.tolist()) for shape in frame.shapes}
        assert found == {
            "polygon": ("line", [[19.5, 19.5], [59.5, 39.5]]),
            "vector": ("line", [[19.5, 19.5], [59.5, 39.5]]),
            "ellipse": ("ellipse", [[99.5, 49.5], [119.5, 49.5], [99.5, 69.5]]),
            "keypoint": ("points", [[19.5, 19.5]]),
        }
        assert len(frame.warnings) == 1


def test_label_studio_regions_of_several_labels_and_what_is_no_region():
    point = {"x": 10, "y": 20, "width": 0.4, "keypointlabels": ["Middle line", "Side line top"]}
    frame = label_studio(("keypointlabels", point), ("choices", {"choices": ["sunny"]}), ("rating", {"rating": 4}))
    assert [(s.label, s.points_px.tolist()) for s in frame.shapes] == [
        ("Middle line", [[19.5, 19.5]]),
        ("Side line top", [[19.5, 19.5]]),
    ]
    assert not frame.warnings


def test_label_studio_takes_the_first_annotation_that_counts():
    def annotation(x, cancelled=False):
        value = {"x": x, "y": 0, "keypointlabels": ["centre_mark"]}
        keys = {"type": "keypointlabels", "original_width": 100, "original_height": 100, "value": value}
        return {"result": [keys], "was_cancelled": cancelled}

    tasks = [{"annotations": [annotation(10, True), annotation(20), annotation(30)]}, {"annotations": []}]
    (frame,) = labelstudio.read(FILE, json_bytes(tasks), None)
    assert frame.shapes[0].points_px.tolist() == [[19.5, -0.5]]
    assert "several" in frame.warnings[0]


def test_coco_round_trip(seen, close):
    content = coco.write([seen, AnnotatedFrame("empty", 64, 65, ())])
    again, empty = coco.read(FILE, content, None)
    order = (seen.shapes[2], *seen.shapes[:2])
    close(again, replace(seen, shapes=order))
    assert empty.shapes == ()


def test_coco_keeps_all_points_of_one_label():
    points = np.array([[100.0, 200.0], [150.0, 180.0], [210.0, 190.0]])
    single = tuple(Shape("Circle central", "points", point[None]) for point in points)
    mark = Shape("centre_mark", "points", np.array([[160.0, 240.0]]))
    content = coco.write([AnnotatedFrame("a", 640, 360, (*single, mark))])
    (again,) = coco.read(Path("coco.json"), content, None)
    found = {shape.label: shape.points_px for shape in again.shapes}
    np.testing.assert_array_equal(found["Circle central"], points)
    np.testing.assert_array_equal(found["centre_mark"], mark.points_px)


def test_coco_keypoints_that_are_not_there():
    dataset = {
        "images": [{"id": 5, "file_name": "a.jpg", "width": 100, "height": 90}],
        "categories": [{"id": 1, "name": "pitch", "keypoints": ["centre", "kp_32", "kp_35"]}],
        "annotations": [{"image_id": 5, "category_id": 1, "keypoints": [10.0, 20, 2, 0, 0, 0, 30, 40, 1]}],
    }
    (frame,) = coco.read(FILE, json_bytes(dataset), None)
    assert [(s.label, s.points_px.tolist()) for s in frame.shapes] == [
        ("centre", [[10.0, 20.0]]),
        ("kp_35", [[30.0, 40.0]]),
    ]
    for change, part in (
        ({"image_id": 6}, "annotations.0.image_id"),
        ({"category_id": 6}, "annotations.0.category_id"),
        ({"keypoints": [1, 2]}, "annotations.0.keypoints"),
        ({"keypoints": [1, 2, 2] * 4}, "annotations.0.keypoints"),
        ({"segmentation": [[1, 2, 3]]}, "annotations.0.segmentation.0"),
    ):
        broken = {**dataset, "annotations": [{**dataset["annotations"][0], **change}]}
        with pytest.raises(InputError, match=part):
            coco.read(FILE, json_bytes(broken), None)


def test_a_coco_box_alone_is_told(seen):
    dataset = json.loads(coco.write([seen]))
    count = len(dataset["annotations"])
    dataset["annotations"].append(
        {"id": 9, "image_id": 1, "category_id": 2, "bbox": [1, 2, 30, 40], "segmentation": []}
    )
    (frame,) = coco.read(FILE, json_bytes(dataset), None)
    assert len(frame.shapes) == len(seen.shapes)
    told = f"marks.json: annotations.{count}.bbox: 'Circle central' is a box, neither keypoints nor a polygon; left out"
    assert frame.warnings == (told,)


@pytest.mark.parametrize("kind", ["images", "categories"])
def test_coco_ids_that_are_given_twice(seen, kind):
    """Two pictures would each get the markings of both."""
    dataset = json.loads(coco.write([seen, replace(seen, id="other", image="other.jpg")]))
    dataset[kind][1]["id"] = 1
    with pytest.raises(InputError, match=rf"marks\.json: {kind}\.1\.id: 1 is given twice"):
        coco.read(FILE, json_bytes(dataset), None)


@pytest.mark.parametrize("radius", ["-5", "0"])
def test_cvat_radii_are_greater_than_zero(radius):
    ellipse = f'<ellipse label="Circle central" cx="50" cy="50" rx="{radius}" ry="9"/>'
    content = f'<annotations><image name="a.jpg" width="100" height="100">{ellipse}</image></annotations>'
    with pytest.raises(InputError, match=f"image 'a.jpg': Circle central: rx: {radius} is no radius"):
        cvat.read(FILE, content.encode(), None)


def test_derived_points_and_tangents_for_every_tool(calibrated, frame_camera, close):
    frame = derive_shapes(calibrated)
    points = {s.label: s.points_px[0] for s in frame.shapes if s.kind == "points"}
    assert points["centre_circle centre"] == pytest.approx(frame_camera.project([[0.0, 0.0]])[0])
    assert points["centre_circle top"] == pytest.approx(frame_camera.project([[0.0, -9.15]])[0])
    tangents = {s.label.split()[-1]: s.points_px for s in frame.shapes if " tangent " in s.label}
    assert len(tangents) == 8
    # half a radius to both sides of where it touches
    radius_m = calibrated.template.radius(calibrated.circle, "center")
    ends = frame_camera.project(radius_m * np.array([[-0.5, -1.0], [0.5, -1.0]]))
    assert tangents["top"][[0, -1]] == pytest.approx(ends)
    close(labelme.read(FILE, labelme.write([frame]), None)[0], frame)
    close(cvat.read(FILE, cvat.write([frame]), None)[0], frame)
    close(labelstudio.read(FILE, labelstudio.write([frame]), None)[0], frame)
    again = coco.read(FILE, coco.write([frame]), None)[0]
    assert {s.label for s in again.shapes} == {s.label for s in frame.shapes}
    assert b"NaN" not in coco.write([frame])
