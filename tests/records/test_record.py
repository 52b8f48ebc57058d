"""Result files: fixed names, finite numbers, whole or not at all, and read back."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel

import circlecal.formats
from circlecal.config import Config
from circlecal.errors import InputError
from circlecal.field import load_field
from circlecal.geometry.camera import camera_from_soccernet
from circlecal.observations import MarkingKey
from circlecal.pipeline import run
from circlecal.records.json_text import parse_record, parse_sound_parts, read_result, result_line, write_result
from circlecal.records.log import read_records
from circlecal.records.record import SCHEMA_VERSION, ResultRecord, ResultRow
from circlecal.records.stored import calibration_of_record
from circlecal.records.summary import summarise
from circlecal.records.writing import failure_record, result_record
from circlecal.results import Verdict

FIXED_NAMES = """
    schema_version version id source image status code stage reason checks H_image_field H_field_image camera case
    ellipses imaged_center vanishing_line correspondences inliers residuals_px timings_ms seed config_digest
    observations alternatives
""".split()  # noqa: SIM905 - shorter to read
SOCCERNET_NAMES = """
    pan_degrees tilt_degrees roll_degrees position_meters x_focal_length y_focal_length principal_point
    radial_distortion tangential_distortion thin_prism_distortion
""".split()  # noqa: SIM905


@pytest.fixture(scope="module")
def calibrated(frame_image):
    return run(frame_image, Config(), frame_id="good")


@pytest.fixture(scope="module")
def refused():
    return run(np.full((120, 160, 3), (60, 130, 70), np.uint8), Config(), frame_id="blank")


@pytest.fixture(scope="module")
def template():
    return load_field("soccer")


def round_trip(record):
    return json.loads(result_line(record))


def test_a_calibrated_frame(calibrated, template, frame_camera):
    record = round_trip(result_record(calibrated, template))
    assert set(FIXED_NAMES) <= set(record)
    assert record["status"] == "calibrated"
    assert record["schema_version"] == SCHEMA_VERSION
    assert record["image"] == {"width": 960, "height": 540}
    product = np.array(record["H_image_field"]) @ np.array(record["H_field_image"])
    assert np.allclose(product / product[2, 2], np.eye(3), atol=1e-9)
    assert record["imaged_center"] == pytest.approx(frame_camera.project([0.0, 0.0]), abs=1.5)
    assert {len(record["correspondences"][kind]) for kind in ("points", "tangents")} == {8}
    assert record["inliers"]["center"]["count"] == len(record["inliers"]["center"]["points_px"])
    assert record["rejected_estimate"] is None


def test_the_camera_has_the_soccernet_keys_at_the_size_of_the_frame(calibrated, template):
    camera = round_trip(result_record(calibrated, template))["camera"]
    assert set(SOCCERNET_NAMES) <= set(camera)
    assert len(camera["radial_distortion"]) == 6
    assert {"crown_m", "crown_shape", "crown_radius_m", "covariance"} <= set(camera)
    again = camera_from_soccernet(camera, 960, 540)
    points = [[0.0, 0.0], [9.0, 3.0], [-9.0, -3.0]]
    assert np.allclose(again.project(points), calibrated.attempt.camera.camera.project(points), atol=1e-9)


def test_a_refused_frame_keeps_its_keys_but_no_homography(refused, template):
    record = round_trip(result_record(refused, template))
    assert set(FIXED_NAMES) <= set(record)
    assert record["status"] == "refused"
    assert record["code"]
    assert record["reason"]
    assert record["H_image_field"] is record["H_field_image"] is record["camera"] is None


def test_what_was_reached_before_the_refusal_is_kept_apart(calibrated, template):
    turned_down = replace(
        calibrated, attempt=replace(calibrated.attempt, verdict=Verdict("refused", "residual", "too large", "verdict"))
    )
    record = round_trip(result_record(turned_down, template))
    assert record["H_image_field"] is record["H_field_image"] is record["camera"] is None
    assert record["rejected_estimate"]["camera"]["pan_degrees"] is not None
    assert record["observations"]["circles"][0]["points_px"]
    assert record["ellipses"]["center"]["rms_px"] > 0


def test_what_is_not_finite_is_null(calibrated, template):
    fit = replace(calibrated.attempt.camera, max_sigma_px=float("nan"), residuals_px={MarkingKey("a"): float("inf")})
    record = round_trip(result_record(replace(calibrated, attempt=replace(calibrated.attempt, camera=fit)), template))
    assert record["camera"]["max_sigma_px"] is None
    assert record["residuals_px"]["camera"] == {"a": None}


def test_written_and_read_back(tmp_path, calibrated, template):
    path = tmp_path / "good.json"
    write_result(path, result_record(calibrated, template))
    stored = read_result(path)
    assert (stored.id, stored.status, stored.width, stored.height) == ("good", "calibrated", 960, 540)
    assert np.array_equal(stored.H_image_field, calibrated.H_image_field)
    given, back = calibrated.attempt.camera.region, calibration_of_record(stored).attempt.camera.region
    assert back.directions == given.directions == 8
    assert back.distance(given.covariance[:3, :3]) == given.distance(given.covariance[:3, :3])
    assert stored.view.surface == calibrated.attempt.camera.surface
    assert stored.view.surface.reference_m == 9.15
    assert np.array_equal(stored.view.covariance, calibrated.attempt.camera.covariance)
    assert [p.name for p in tmp_path.iterdir()] == ["good.json"]


def test_a_refused_result_is_read_back(tmp_path, refused, template):
    write_result(tmp_path / "a.json", result_record(refused, template))
    stored = read_result(tmp_path / "a.json")
    assert stored.status == "refused"
    assert stored.H_image_field is stored.camera is stored.view is None
    record = failure_record("b", "b.jpg", Verdict("refused", "unreadable_input", "b.jpg: is empty", "input"), 0, "0")
    write_result(tmp_path / "b.json", record)
    assert read_result(tmp_path / "b.json").reason == "b.jpg: is empty"


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch, refused, template):
    path = tmp_path / "a.json"
    write_result(path, result_record(refused, template))
    old = path.read_bytes()
    monkeypatch.setattr("os.fsync", lambda descriptor: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(InputError, match=r"a\.json: cannot be written: No space left"):
        write_result(path, result_record(refused, template))
    assert path.read_bytes() == old
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda r: "{", "is no result"),
        (lambda r: "[]", "is no result"),
        (lambda r: json.dumps(r)[:-20], "is no result"),
        (lambda r: json.dumps({k: v for k, v in r.items() if k != "status"}), "status"),
        (lambda r: json.dumps({**r, "H_image_field": [[1, 2], [3, 4]]}), "H_image_field"),
        (lambda r: json.dumps({**r, "image": {"width": 0, "height": 5}}), "image.width"),
        (lambda r: json.dumps({**r, "H_image_field": [[1, 2, float("nan")], [3, 4, 5], [6, 7, 8]]}), "H_image_field"),
        (
            lambda r: json.dumps({**r, "camera": {**r["camera"], "covariance": {"parameters": ["a"], "matrix": []}}}),
            "covariance",
        ),
        (lambda r: json.dumps({**r, "schema_version": 99}), "schema_version 99"),
    ],
)
def test_damaged_results_are_one_line(tmp_path, calibrated, template, change, part):
    path = tmp_path / "a.json"
    path.write_text(change(round_trip(result_record(calibrated, template))))
    with pytest.raises(InputError) as caught:
        read_result(path)
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_results(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_result(tmp_path / "none.json")
    with pytest.raises(InputError, match="cannot be read"):
        read_result(tmp_path)


def test_summary_of_every_kind(calibrated, refused, template):
    row = summarise(result_record(calibrated, template))
    assert (row.id, row.status, row.case) == ("good", "calibrated", calibrated.attempt.correspondences.case)
    assert row.sigma_px > 0
    assert row.rms_px > 0
    assert row.time_ms > 0
    camera, fit = calibrated.attempt.camera.camera, calibrated.attempt.camera
    pan, tilt, roll = np.degrees(camera.angles_rad)
    assert (row.x_m, row.y_m, row.height_m) == pytest.approx(camera.position_m * (1.0, 1.0, -1.0))
    assert (row.pan_deg, row.tilt_deg, row.roll_deg) == pytest.approx((pan, tilt, roll))
    assert (row.focal_px, row.sigma_px) == pytest.approx((camera.focal_px[0], fit.max_sigma_px))
    assert row.sigma_1920_px == pytest.approx(fit.max_sigma_px * 1920 / camera.width)
    assert row.rms_1920_px == pytest.approx(row.rms_px * 1920 / row.width_px)
    row = summarise(result_record(refused, template))
    assert (row.status, row.code, row.case) == ("refused", refused.verdict.code, None)


def test_every_key_is_documented(calibrated, template):
    text = (Path(circlecal.formats.__file__).parent / "README.md").read_text()
    record = round_trip(result_record(calibrated, template))
    for key in (*record, *(set(record["camera"]) - set(SOCCERNET_NAMES))):
        assert f"`{key}`" in text, key


def test_a_row_says_what_the_record_says(calibrated, refused, template):
    for frame in (calibrated, refused):
        line = result_line(result_record(frame, template)).encode()
        row, record = (parse_record(line, model, "line", "") for model in (ResultRow, ResultRecord))
        for name in ResultRow.model_fields:
            part, whole = getattr(row, name), getattr(record, name)
            assert part == (part.__class__.model_validate(whole.model_dump()) if isinstance(part, BaseModel) else whole)
        assert summarise(row) == summarise(record)
    assert not hasattr(row, "observations")


def test_a_record_comes_back_as_it_was(calibrated, refused, template):
    for frame in (calibrated, refused):
        record = result_record(frame, template)
        assert parse_record(result_line(record).encode(), ResultRecord, "line", "") == record


def test_lines_of_json_beside_results_are_none_of_them(tmp_path, calibrated, template):
    """As ``--to tvcalib`` writes them into a folder of results."""
    write_result(tmp_path / "a.json", result_record(calibrated, template))
    (tmp_path / "per_sample_output.json").write_text('{"image_ids": "a.jpg"}\n{"image_ids": "b.jpg"}\n')
    assert [record.id for record in read_records(tmp_path)] == [calibrated.id]
    (tmp_path / "torn.json").write_text('{"schema_version": 1, "status": "calibrated", "id": "b"}\n{"x"\n')
    with pytest.raises(InputError, match="torn"):
        list(read_records(tmp_path))


def test_keys_that_are_not_known_stay(refused, template):
    line = json.dumps(round_trip(result_record(refused, template)) | {"further": {"a": [1, None]}})
    again = parse_record(line.encode(), ResultRecord, "line", "")
    assert round_trip(again.model_copy(update={"seed": 5}))["further"] == {"a": [1, None]}


@pytest.mark.parametrize("name", ["caf\udce9.png", "\ud800"])
def test_names_need_not_be_text(refused, template, name):
    record = result_record(replace(refused, id=name, source=f"{name}.jpg"), template)
    again = parse_record(result_line(record).encode(), ResultRecord, "line", "")
    assert (again.id, again.path) == (name, f"{name}.jpg")
    assert parse_record(result_line(record).encode(), ResultRow, "line", "").id == name


def test_what_is_damaged_is_left_out(calibrated, template):
    whole = round_trip(result_record(calibrated, template))
    sound = parse_sound_parts(json.dumps(whole | {"inliers": [1], "checks": [1]}).encode())
    assert (sound.inliers, sound.checks) == (None, [])
    assert sound.view is not None
    with pytest.raises(ValueError, match="id"):
        parse_sound_parts(json.dumps(whole | {"id": 3}).encode())


def test_a_key_that_is_given_twice_is_named(tmp_path):
    path = tmp_path / "edited.json"
    path.write_text('{"schema_version": 1, "id": "a", "status": "refused", "code": "no_field", "id": "b"}')
    with pytest.raises(InputError, match=r'edited\.json: the key "id" is given twice; keep one of the two$'):
        read_result(path)


@pytest.mark.parametrize(
    ("status", "checks", "near"),
    [
        ("calibrated", [(5.7, 6.0, True), (1.0, 6.0, True)], ["a 5.7 of 6"]),
        ("calibrated", [(6.0, 6.0, True)], []),
        ("refused", [(6.3, 6.0, False), (5.9, 6.0, True)], ["a 6.3 of 6"]),
        ("refused", [(5.9, 6.0, True), (52.9, 21.3, False)], []),
        ("refused", [(6.3, 6.0, False), (52.9, 21.3, False)], []),
        ("refused", [(5.9, 6.0, True)], []),
    ],
)
def test_near_a_limit_is_what_another_verdict_hangs_on(status, checks, near):
    told = [
        {"name": name, "value": value, "limit": limit, "passed": passed}
        for name, (value, limit, passed) in zip("ab", checks, strict=False)
    ]
    assert (
        ResultRecord.model_validate({"schema_version": 1, "id": "x", "status": status, "checks": told}).near_limits
        == near
    )
