"""One rendered frame of known camera, marked as each annotation program writes it: what is read lies where it was.

The files are written here by hand, from what their programs say of them. All but keypoints of COCO and what was read
off a heat map count from the corner of the picture, in which the centre of the first pixel is at (0.5, 0.5).
"""

import json
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from circlecal import load
from circlecal.field import COMPASS, load_field
from circlecal.formats.exports import convert
from circlecal.formats.meaning import SourcesConfig, read_observations
from circlecal.formats.registry import read_annotations
from circlecal.synthetic.renderer import Rendering, render
from circlecal.synthetic.sampling import PROFILE_BY_NAME, sample_scene

WIDTH, HEIGHT = SIZE = (960, 540)
IMAGE = "match/frame 07.png"
CENTRE, CROSSING = "centre_mark", "halfway_line x side_line_top"
ON_CIRCLE = ("centre_circle left", "centre_circle bottom_right")
CURVES = ("Circle central", "Circle left")
STRAIGHT = (
    "Middle line", "Side line top", "Side line left", "Side line bottom", "Big rect. left main", "Big rect. left top",
    "Small rect. left main",
)  # fmt: skip


@pytest.fixture(scope="module")
def rendering() -> Rendering:
    """A frame with a lens that bends the touchline by 6 px, in which much of the left half is seen."""
    rng = np.random.default_rng([5, 1])
    return render(sample_scene(PROFILE_BY_NAME["lens"], rng, *SIZE), rng)


@pytest.fixture(scope="module")
def places(rendering) -> dict[str, np.ndarray]:
    """Where the middle of the paint of each marking is seen, pixels (N, 2) from the centre of the first one."""
    template, view = rendering.truth.painted, rendering.truth.view
    official = {e.class_name: e.name for e in (*template.round_ones, *template.lines)}
    found = {}
    for label in (*CURVES, *STRAIGHT):
        pixels = view.project(template.polylines(1.0)[official[label]])
        found[label] = pixels[view.shows(pixels, margin_px=3.0)][:: 1 if label in CURVES else 2]
    circle = template.circles[0]
    radius = template.radius(circle, "center")
    points = {CENTRE: [0.0, 0.0], CROSSING: template.meet_lines("halfway_line", "side_line_top")}
    points |= {label: radius * COMPASS[label.split()[1]] for label in ON_CIRCLE}
    return found | {label: view.project([point]) for label, point in points.items()}


def is_point(label):
    return label in (CENTRE, CROSSING, *ON_CIRCLE)


def coco(places):
    """Keypoints are indices of pixels, polygons run from 0 to the width."""
    points = [label for label in places if is_point(label)]
    categories = [{"id": 1, "name": "pitch", "keypoints": ["unused", *points], "skeleton": [[1, 2]]}]
    triples = [0, 0, 0] + [v for k in points for v in (*places[k][0].tolist(), 2)]
    common = {"image_id": 12, "iscrowd": 0, "area": 1.0, "bbox": [0.0, 0.0, 1.0, 1.0]}
    annotations = [
        {"id": 1, "category_id": 1, "keypoints": triples, "num_keypoints": len(points), "segmentation": [], **common}
    ]
    for label in (label for label in places if not is_point(label)):
        number = len(categories) + 1
        categories.append({"id": number, "name": label, "supercategory": ""})
        outline = (places[label] + 0.5).ravel().tolist()
        annotations.append({"id": number, "category_id": number, "segmentation": [outline], **common})
    images = [{"id": 12, "file_name": IMAGE, "width": WIDTH, "height": HEIGHT}]
    return json.dumps({"info": {}, "images": images, "categories": categories, "annotations": annotations})


def cvat(places):
    """Two decimals, from the corner."""
    root = ElementTree.Element("annotations")
    ElementTree.SubElement(root, "version").text = "1.1"
    image = ElementTree.SubElement(root, "image", id="0", name=IMAGE, width=str(WIDTH), height=str(HEIGHT))
    for label, pixels in places.items():
        text = ";".join(f"{x:.2f},{y:.2f}" for x, y in pixels + 0.5)
        tag = "points" if is_point(label) else "polyline"
        ElementTree.SubElement(image, tag, label=label, source="manual", occluded="1", points=text, z_order="0")
    return ElementTree.tostring(root, encoding="unicode")


def labelstudio(places):
    """Per cent of the width and of the height, from the corner."""
    results = []
    for label, pixels in places.items():
        percent = ((pixels + 0.5) / SIZE * 100.0).tolist()
        kind = "keypointlabels" if is_point(label) else "polygonlabels"
        shape = {"points": percent, "closed": True}
        shape = {"x": percent[0][0], "y": percent[0][1], "width": 0.3} if is_point(label) else shape
        results.append({
            "id": label[:5], "type": kind, "from_name": "tag", "to_name": "image", "original_width": WIDTH,
            "original_height": HEIGHT, "image_rotation": 0, "origin": "manual", "value": {**shape, kind: [label]},
        })  # fmt: skip
    annotation = {"id": 3, "was_cancelled": False, "ground_truth": False, "result": results}
    return json.dumps([{"id": 1, "data": {"image": f"s3://bucket/{IMAGE}"}, "annotations": [annotation]}])


def labelme(places):
    """Widget coordinates over the zoom, from the corner."""
    shapes = []
    for label, pixels in places.items():
        kind = "point" if is_point(label) else "linestrip"
        points = (pixels + 0.5).tolist()
        shapes.append({"label": label, "points": points, "group_id": None, "shape_type": kind, "flags": {}})
    return json.dumps({
        "version": "5.4.1", "flags": {}, "shapes": shapes, "imagePath": IMAGE, "imageData": "iVBORw0KGgo=",
        "imageHeight": HEIGHT, "imageWidth": WIDTH,
    })  # fmt: skip


WRITERS = {"coco": coco, "cvat": cvat, "labelstudio": labelstudio, "labelme": labelme}
NAMES = {"coco": "instances.json", "cvat": "annotations.xml", "labelstudio": "export.json", "labelme": "frame 07.json"}


def write_file(folder, program, places):
    path = folder / NAMES[program]
    path.write_text(WRITERS[program](places), encoding="utf-8")
    return path


def require_equal(found, places):
    assert found.keys() == places.keys()
    for label, pixels in places.items():
        assert np.abs(found[label] - pixels).max() < 0.01, label


def test_the_true_places_lie_on_the_paint_of_the_picture(rendering, places):
    """What everything below is measured against: the profile across the halfway line has its middle there."""
    grey = rendering.image.astype(np.float64).sum(axis=2)
    points = places["Middle line"][1:-1]
    reach = np.arange(-4.0, 4.01, 0.25)
    rows = np.repeat(points[:, 1:], len(reach), axis=1)
    profile = map_coordinates(grey, [rows, points[:, :1] + reach], order=1).mean(axis=0)
    weight = np.clip(profile - np.median(profile), 0.0, None)
    assert abs(weight @ reach / weight.sum()) < 0.2


@pytest.mark.parametrize("program", WRITERS)
def test_points_arrive_at_their_pixels_under_their_names(tmp_path, places, program):
    found, (frame,) = read_annotations(write_file(tmp_path, program, places))
    assert (found.name, frame.id, frame.width, frame.height, frame.warnings) == (program, "frame 07", *SIZE, ())
    require_equal({shape.label: shape.points_px for shape in frame.shapes}, places)


@pytest.mark.parametrize("program", WRITERS)
def test_labels_become_markings_of_the_field(tmp_path, places, program):
    template = load_field("soccer")
    (frame,) = read_observations(write_file(tmp_path, program, places), template, SourcesConfig())
    seen = frame.observations
    official = {line.class_name: line.name for line in template.lines}
    lines = {line.line: line.points_px for line in seen.lines}
    assert lines.keys() == {official[label] for label in STRAIGHT}
    for label in STRAIGHT:
        assert np.abs(lines[official[label]] - places[label]).max() < 0.01
    circles = {circle.circle: circle.points_px for circle in seen.circles}
    assert np.abs(circles["penalty_arc_left"] - places["Circle left"]).max() < 0.01
    along = np.concatenate([places["Circle central"], *(places[label] for label in ON_CIRCLE)])
    assert np.abs(np.sort(circles["centre_circle"], axis=0) - np.sort(along, axis=0)).max() < 0.01
    ((mark, point),) = [(mark.mark, mark.point_px) for mark in seen.marks]
    assert mark == CENTRE and np.abs(point - places[CENTRE]).max() < 0.01
    for keypoint in seen.keypoints:
        assert np.abs(keypoint.point_px - places[keypoint.name][0]).max() < 0.01
    assert {keypoint.name for keypoint in seen.keypoints} == {CROSSING, *ON_CIRCLE}
    crossing = next(point.field_m for point in seen.keypoints if point.name == CROSSING)
    assert crossing == pytest.approx([0.0, -33.94])


@pytest.mark.parametrize("program", WRITERS)
@pytest.mark.parametrize("target", [*WRITERS, "soccernet", "extremities", "workbench"])
def test_what_is_written_for_another_program_is_read_there_at_the_pixels(tmp_path, places, program, target):
    template = load_field("soccer")
    (path,) = convert([write_file(tmp_path, program, places)], None, target, tmp_path / "out", template)
    (frame,) = read_annotations(path, SIZE)[1]
    if target == "workbench":
        seen = frame.observations
        found = {circle.circle: circle.points_px for circle in seen.circles}
        assert np.abs(found["penalty_arc_left"] - places["Circle left"]).max() < 0.01
        return
    require_equal({shape.label: shape.points_px for shape in frame.shapes}, places)


def test_the_camera_is_the_one_that_took_the_picture(tmp_path, rendering, places, run_circlecal):
    """Nothing was clicked, all is exact: what is left is what the priors of lens and ground take from it."""
    truth = rendering.truth
    field = np.concatenate(list(truth.template.polylines(1.0).values()))
    field = field[truth.view.shows(truth.view.project(field))]
    seen = {}
    for program in WRITERS:
        path, out = write_file(tmp_path, program, places), tmp_path / program
        outcome = run_circlecal("calibrate", path, "--convention", "paint", "--out", out, "--no-overlay", "--quiet")
        assert outcome.code == 0
        (found,) = load(out)
        seen[program] = found.to_image(field)
        beside = seen[program] - truth.view.project(field)
        sigma = np.sqrt(np.diagonal(found.image_covariance(field), axis1=1, axis2=2))
        assert np.abs(beside / sigma).max() < 1.0
        assert np.sqrt(np.mean(beside**2)) < 1.2
        assert found.camera.focal_px == pytest.approx(truth.camera.focal_px, rel=0.01)
        assert found.camera.dist[0] == pytest.approx(truth.camera.dist[0], rel=0.2)
        assert found.position_m == pytest.approx(truth.camera.position_m, abs=0.15)
    for program in WRITERS:
        assert np.abs(seen[program] - seen["labelme"]).max() < 0.05, program


def test_what_a_network_read_off_a_heat_map_arrives_at_its_pixels(tmp_path, places):
    """PnLCalib divides by the size of the picture; its numbers are those of pixels, not of their corners."""
    numbers = {"51": CENTRE, "2": CROSSING, "50": ON_CIRCLE[0], "54": ON_CIRCLE[1]}
    points = {k: dict(zip("xyp", (*(places[v][0] / SIZE).tolist(), 0.81), strict=True)) for k, v in numbers.items()}
    keys = ("x_1", "y_1", "p_1", "x_2", "y_2", "p_2")
    ends = {"13": "Middle line", "17": "Side line top", "2": "Big rect. left main", "3": "Big rect. left top"}
    lines = {}
    for number, label in ends.items():
        first, last = (places[label][[0, -1]] / SIZE).tolist()
        lines[number] = dict(zip(keys, (*first, 0.81, *last, 0.64), strict=True))
    path = tmp_path / "frame.json"
    path.write_text(json.dumps({"kp": points, "lines": lines}))
    template = load_field("soccer")
    (frame,) = read_observations(path, template, SourcesConfig(), SIZE)
    official = {line.name: line.class_name for line in template.lines}
    assert {official[line.line] for line in frame.observations.lines} == set(ends.values())
    for line in frame.observations.lines:
        assert np.abs(line.points_px - places[official[line.line]][[0, -1]]).max() < 0.01
        assert line.sigma_px == pytest.approx([2.5 / 2 / 0.9, 2.5 / 2 / 0.8])
    ((mark, point),) = [(m.mark, m.point_px) for m in frame.observations.marks]
    assert mark == CENTRE and np.abs(point - places[CENTRE]).max() < 0.01
    for keypoint in frame.observations.keypoints:
        label = numbers[keypoint.name.removeprefix("kp_")]
        assert np.abs(keypoint.point_px - places[label]).max() < 0.01
        assert keypoint.field_m == pytest.approx(template_place(template, label), abs=1e-6)
    assert len(frame.observations.keypoints) == 3


def template_place(template, label):
    if label == CROSSING:
        return template.meet_lines("halfway_line", "side_line_top")
    return template.radius(template.circles[0], "center") * COMPASS[label.split()[1]]
