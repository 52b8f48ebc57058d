"""The layers lie where the camera projects the field."""

import re

import cv2
import numpy as np
import pytest

from circlecal.report.details import frame_details
from circlecal.report.drawings import draw_on_thumbnail, plan_layer, points_layer, scene_of, template_layer
from circlecal.report.reading import read_run
from tests.report.conftest import refused, sound, write_run


def numbers(svg: str, color: str) -> np.ndarray:
    """Points (N, 2) of the paths of a colour."""
    outlines = re.findall(rf'<path d="([^"]*)"[^>]*stroke="{color}"', svg)
    return np.array([float(n) for n in re.findall(r"-?\d+\.?\d*", " ".join(outlines))]).reshape(-1, 2)


CIRCLE, REFUSED = "#f0e442", "#e15e14"


def test_the_template_lies_on_the_projected_circle(good_record):
    scene = scene_of(sound(good_record))
    drawn = numbers(template_layer(scene), CIRCLE) - 0.5
    angle = np.linspace(0, 2 * np.pi, 7200)
    radius = 9.15 - 0.06
    exact = sound(good_record).view.project(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    distance = np.linalg.norm(drawn[:, None] - exact[None], axis=2).min(axis=1)
    assert len(drawn) > 20
    assert distance.max() < 0.15


def test_layers_have_the_size_of_the_frame(good_record):
    scene = scene_of(sound(good_record))
    for layer in (template_layer(scene), points_layer(scene)):
        assert 'viewBox="0 0 960 540"' in layer
    inliers = sum(len(edge["points_px"]) for edge in good_record["inliers"].values())
    assert points_layer(scene).count("h0") > min(inliers, 300)


def test_a_refused_estimate_is_dashed(good_record):
    estimate = {name: good_record[name] for name in ("H_image_field", "camera")}
    record = good_record | {"status": "refused", "H_image_field": None, "camera": None, "rejected_estimate": estimate}
    layer = template_layer(scene_of(sound(record)))
    assert len(numbers(layer, REFUSED)) > 20
    assert layer.count("<path") == layer.count("stroke-dasharray")
    assert plan_layer(scene_of(sound(record))) is None


def test_without_an_estimate_the_ellipse_is_drawn(good_record):
    record = good_record | {"status": "refused", "H_image_field": None, "camera": None, "rejected_estimate": None}
    ellipse = numbers(template_layer(scene_of(sound(record))), CIRCLE) - 0.5
    circle = numbers(template_layer(scene_of(sound(good_record))), CIRCLE) - 0.5
    distance = np.linalg.norm(ellipse[:, None] - circle[None], axis=2).min(axis=1)
    assert np.median(distance) < 8.0
    assert template_layer(scene_of(sound(refused("a")))) is None


def test_a_homography_alone_is_enough(good_record):
    layer = template_layer(scene_of(sound(good_record | {"camera": None})))
    assert len(numbers(layer, CIRCLE)) > 20


def test_the_plan_outlines_what_the_frame_shows(good_record):
    scene = scene_of(sound(good_record))
    svg = plan_layer(scene)
    outline = re.search(r'<path d="([^"]*)" fill="#fff"', svg).group(1)
    polygon = np.array([float(n) for n in re.findall(r"-?\d+\.?\d*", outline)]).reshape(-1, 2) / 10
    stored = sound(good_record)
    rng = np.random.default_rng(4)
    points = rng.uniform([-50, -33], [50, 33], (300, 2))
    pixels = stored.view.project(points)
    inside = ((pixels >= 0) & (pixels <= [959, 539])).all(axis=1)
    distance = np.array([cv2.pointPolygonTest(polygon.astype(np.float32), p, True) for p in points.tolist()])
    clear = np.abs(distance) > 1.0
    assert 10 < inside[clear].sum() < clear.sum()
    np.testing.assert_array_equal(distance[clear] > 0, inside[clear])


def test_the_thumbnail_shows_the_circle(good_record, frame_image):
    small = cv2.resize(frame_image, (320, 180), interpolation=cv2.INTER_AREA)
    drawn = draw_on_thumbnail(small, scene_of(sound(good_record)))
    yellow = (drawn[..., 2] > 200) & (drawn[..., 0] < 120)
    assert yellow.sum() > 100
    assert np.shares_memory(small, drawn) is False


@pytest.mark.parametrize(
    "change",
    [
        {"image": None}, {"image": {"width": "x", "height": 3}}, {"field": None}, {"camera": {"pan_degrees": "x"}},
        {"field": {"template": "no such field", "circle": "c", "sizes": {}}},
        {"inliers": {"outer": {"points_px": "x"}}},
        {"correspondences": {"points": [{"image_px": [1]}]}}, {"imaged_center": [None, None]},
        {"ellipses": [1]}, {"checks": [1, {"name": 3}], "timings_ms": {"mask": 1.0}},
    ],
    ids=lambda change: "-".join(change),
)  # fmt: skip
def test_damaged_records_are_drawn_as_far_as_they_go(good_record, tmp_path, change):
    record = good_record | change
    scene = scene_of(sound(record))
    if scene is not None:
        for layer in (template_layer, points_layer, plan_layer):
            layer(scene)
    if "ellipses" not in change and "camera" not in change:
        (row,) = read_run(write_run(tmp_path, [record])).rows
        assert frame_details(sound(record), row, scene)["facts"]


def test_details_name_what_failed_first(good_record, tmp_path):
    checks = [{"name": "sigma_px", "value": 99.0, "limit": 60.0, "passed": False}]
    record = good_record | {"checks": good_record["checks"] + checks}
    (row,) = read_run(write_run(tmp_path, [record])).rows
    told = frame_details(sound(record), row, None)
    assert told["checks"][0] == ["sigma px", "99", "60", False]
    facts = dict(told["facts"])
    assert facts["picture"] == "960 x 540 px"
    assert "m high" in facts["camera"]


def test_the_sigma_map_counts_from_what_was_seen_as_the_frames_own_sigma_does(good_record, tmp_path):
    known = good_record["camera"]["covariance"]
    x, length = known["parameters"].index("x"), known["parameters"].index("length")
    matrix = np.array(known["matrix"])
    matrix[[x, length], [x, length]] += [25.0, 100.0]
    matrix[[x, length], [length, x]] += 50.0
    size = {"length_m": 104.0, "width_m": 68.1, "length_sd_m": 10.0, "width_sd_m": 0.12, "is_usual": False}
    camera = good_record["camera"] | {
        "covariance": known | {"matrix": matrix.tolist()}, "field_size": size | {"usual_share": 0.1},
    }  # fmt: skip
    record = good_record | {"camera": camera | {"reference_by_growth": [0.5, 0.0]}}
    (row,) = read_run(write_run(tmp_path, [record])).rows
    told = frame_details(sound(record), row, scene_of(sound(record)))
    assert ("104 ± 10 x 68.10 ± 0.12 m") in dict(told["facts"])["field"]
    old = good_record | {"camera": {k: v for k, v in camera.items() if k != "reference_by_growth"}}
    from_middle = frame_details(sound(old), row, scene_of(sound(old)))
    middle = 16 * 5 + 8
    assert told["sigma"]["px"][middle] < 0.2 * from_middle["sigma"]["px"][middle]
    assert told["sigma"]["m"][middle] < 0.2 * from_middle["sigma"]["m"][middle]


def test_what_rounds_to_nothing_has_no_sign(good_record, tmp_path):
    nearly = {"position_meters": [-0.01, 62.0, -15.5], "pan_degrees": 0.0, "tilt_degrees": -0.001, "roll_degrees": -0.1}
    record = good_record | {"camera": good_record["camera"] | nearly}
    (row,) = read_run(write_run(tmp_path, [record])).rows
    facts = dict(frame_details(sound(record), row, None)["facts"])
    assert facts["camera"] == "x 0.0, y 62.0, 15.5 m high"
    assert facts["pan, tilt, roll"] == "0.00°, 0.00°, -0.10°"
