"""The record of a tracked frame: short, and as good as a long one for whoever reads it."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import circlecal
from circlecal.config import load_config
from circlecal.geometry.camera_parameters import INDEX
from circlecal.pipeline import field_of
from circlecal.records.cameras_table import write_cameras
from circlecal.records.json_text import result_line
from circlecal.records.log import Finished
from circlecal.records.parts import SourceRecord
from circlecal.records.record import ResultRecord
from circlecal.tracking.records import RecordForm, record_of_track

from .scripted import LOST_FRAMES, tracked

LONGEST = 4096
POINTS = np.array([[0.0, 0.0], [9.15, 0.0], [0.0, -34.0], [-20.0, 10.0]])


def record_of(index: int, full: bool = False, size: tuple[int, int] = (1920, 1080)) -> ResultRecord:
    form = RecordForm(*field_of(load_config()), 0, "0" * 12, full)
    frame = tracked(index, index / 25.0, size)
    written = record_of_track(frame, f"clip_{index}", "folder/clip.mp4", 2, form)
    return ResultRecord.model_validate_json(result_line(written))


@pytest.mark.parametrize("index", [3, LOST_FRAMES[0]])
def test_a_line_is_short(index: int) -> None:
    assert len(Finished.of(record_of(index)).line) <= LONGEST


@pytest.mark.parametrize("full", [False, True])
def test_points_and_their_sigmas_come_back(full: bool) -> None:
    record, frame = record_of(3, full), tracked(3, 0.12, (1920, 1080))
    found, wanted = record.view.project(POINTS, sigma=True), frame.view.project(POINTS, sigma=True)
    np.testing.assert_allclose(found.points, wanted.points, atol=1e-5)
    np.testing.assert_allclose(found.sigma, wanted.sigma, rtol=1e-3)
    np.testing.assert_allclose(record.view.growth_m, frame.view.growth_m)
    ground = record.view.to_field(found.points, sigma=True)
    np.testing.assert_allclose(ground.points, POINTS, atol=1e-4)


@pytest.mark.parametrize(("growth", "is_usual"), [((0.0, 0.0), True), ((0.0, -1.6), False), ((0.0, -0.3), True)])
def test_a_pitch_that_is_told_to_be_another_is_not_the_usual_one(growth: tuple[float, float], is_usual: bool) -> None:
    frame = tracked(3, 0.12, (1920, 1080))
    covariance = np.array(frame.view.covariance)
    sizes = [INDEX["length"], INDEX["breadth"]]
    covariance[:, sizes] = covariance[sizes] = 0.0
    covariance[sizes, sizes] = 0.14**2
    changed = replace(frame, view=replace(frame.view, growth_m=growth, covariance=covariance))
    form = RecordForm(*field_of(load_config()), 0, "0" * 12, False)
    size = record_of_track(changed, "clip_3", "clip.mp4", 2, form).camera.field_size
    assert (size.is_usual, size.usual_share) == (is_usual, float(is_usual))


def test_everything_that_reads_results_reads_it(tmp_path) -> None:
    file = tmp_path / "clip_3.json"
    file.write_text(result_line(record_of(3)))
    found = circlecal.load(file)
    size = found.to_dict()["camera"]["field_size"]
    assert (size["length_m"], size["width_m"]) == pytest.approx((103.5, 68.7)) and size["length_sd_m"] > 0
    assert found.ok and found.time_s == 0.12 and found.sigma_px == 0.3 and found.sigma_m > 0
    np.testing.assert_allclose(found.to_image(POINTS), tracked(3, 0.12, (1920, 1080)).view.project(POINTS), atol=1e-5)
    identity = found.H_image_field @ found.H_field_image
    np.testing.assert_allclose(identity / identity[2, 2], np.eye(3), atol=1e-6)
    assert found.found.attempt.camera.theta.shape == found.found.attempt.camera.covariance.shape[:1]


def test_full_records_hold_what_follows_from_the_camera() -> None:
    record, short = record_of(3, full=True), record_of(3)
    assert record.H_covariance is not None and short.H_covariance is None
    assert len(record.camera.derived_points) == 8 and not short.camera.derived_points
    assert record.checks and record.alternatives[0].kind == "turned_field"
    # the circle's points lie on the crowned pitch, in pixels without the lens
    view, points = tracked(3, 0.12, (1920, 1080)).view, record.camera.derived_points
    lifted = view.surface.lift([point.field_m for point in points])
    np.testing.assert_allclose([point.image_px for point in points], view.camera.project(lifted, False), atol=1e-5)
    np.testing.assert_allclose(record.camera.covariance.full(), short.camera.covariance.full(), rtol=1e-3, atol=1e-9)


def test_a_lost_frame_says_why() -> None:
    record = record_of(LOST_FRAMES[0])
    assert (record.status, record.code, record.stage) == ("refused", "lost", "track")
    assert record.reason and record.help and record.camera is None and record.view is None
    content = json.loads(result_line(record))
    assert content["track"] == {"frame": LOST_FRAMES[0], "shot": 2, "carried_by": [], "head": None}


def test_an_answered_frame_says_that_it_has_no_reason() -> None:
    content = json.loads(result_line(record_of(3)))
    assert [content[name] for name in ("code", "stage", "reason", "help")] == [None] * 4


def test_a_covariance_that_is_singular_keeps_its_spread() -> None:
    record, frame = record_of(3), tracked(3, 0.12, (1920, 1080))
    covariance, wanted = record.camera.covariance.full(), frame.view.covariance
    np.testing.assert_allclose(np.diag(covariance), np.diag(wanted), rtol=1e-3)
    assert np.linalg.eigvalsh(covariance).min() > -1e-12


def test_the_table_of_cameras_has_what_a_field_is_drawn_with(tmp_path: Path) -> None:
    record = record_of(3)
    write_cameras(tmp_path / "cameras.csv", [record, record.model_copy(update={"camera": None})])
    row, refused = csv.DictReader((tmp_path / "cameras.csv").open())
    camera = record.camera
    assert row["crown_shape"] == camera.crown_shape and float(row["crown_radius_m"]) == camera.crown_radius_m
    sizes = camera.field_size.length_m, camera.field_size.width_m
    assert (float(row["length_m"]), float(row["width_m"])) == pytest.approx(sizes)
    sds = camera.field_size.length_sd_m, camera.field_size.width_sd_m
    assert (float(row["length_sd_m"]), float(row["width_sd_m"])) == pytest.approx(sds) and min(sds) > 0.0
    assert not any(refused[name] for name in ("crown_shape", "crown_radius_m", "length_m", "width_m", "length_sd_m"))


def test_the_table_of_cameras_has_the_sigmas_of_its_angles(tmp_path: Path) -> None:
    record = record_of(3)
    write_cameras(tmp_path / "cameras.csv", [record])
    (row,) = csv.DictReader((tmp_path / "cameras.csv").read_text().splitlines())
    sigmas = np.degrees(np.sqrt(np.diag(record.view.covariance)))
    assert [float(row[f"{name}_sigma_deg"]) for name in ("pan", "tilt", "roll")] == pytest.approx(sigmas[1:4], rel=1e-4)


def test_a_field_that_others_told_is_as_large_as_the_camera_has_it() -> None:
    """Frames that share a camera do not say how large the field is; the camera's parameters do."""
    frame, form = tracked(3, 0.12), RecordForm(*field_of(load_config()), 0, "0" * 12)
    told = record_of_track(replace(frame, view=replace(frame.view, growth_m=np.array([11.6, 2.1]))), "a", "a", 0, form)
    shared = told.model_copy(update={"camera": told.camera.model_copy(update={"field_size": None})})
    assert shared.field_size_m == pytest.approx((116.6, 70.1))


def test_names_are_no_formulas_in_the_table_of_cameras(tmp_path: Path) -> None:
    record = record_of(3).model_copy(update={"id": "=1+1_00-00-00.120", "source": SourceRecord(path="@clip.mp4")})
    write_cameras(tmp_path / "cameras.csv", [record])
    (row,) = csv.DictReader((tmp_path / "cameras.csv").open())
    assert row["id"] == "'=1+1_00-00-00.120" and not any(cell.startswith(("=", "@")) for cell in row.values())
