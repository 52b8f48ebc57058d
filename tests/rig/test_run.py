"""A run's results in, cameras and recalibrated results out, by the command line."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from circlecal.batch import run as batch_run
from circlecal.batch.workers import finish_on_workers
from circlecal.camera.rig_options import RigConfig
from circlecal.cli.app import app
from circlecal.errors import InputError
from circlecal.evaluation.bench.reprojection import mean_reprojection_error, reprojection_grid
from circlecal.observations import Observations
from circlecal.pipeline import run_observations
from circlecal.records.camera_prior import prior_settings
from circlecal.records.json_text import result_line
from circlecal.records.log import OtherRunError, read_records
from circlecal.records.parts import SourceRecord, TrackRecord
from circlecal.records.writing import failure_record, result_record
from circlecal.results import Verdict
from circlecal.rig import run as rig_run
from circlecal.rig.frames import frame_of_record
from circlecal.rig.run import RigTask, read_cameras, run_rig
from circlecal.rig.tripod import PLACE
from circlecal.rig.venue import read_venue

from .scenes import CONFIG, TEMPLATE, main_views, seen_by

SETTINGS = ["--set", "camera.starts=2", "--set", "camera.iterations=30", "--set", "camera.crown_shape=flat",
            "--set", "camera.maximum_points=60", "--set", "camera.model_sigma_px=0",
            "--set", "camera.name_lines=false", "--set", "camera.principal_point_sd_px=5"]  # fmt: skip


def error_px(record, camera):
    grid = reprojection_grid(camera.homography, 1920, 1080, 52.5, 34.0)
    return mean_reprojection_error(camera.homography, np.array(record.H_image_field), grid)


@pytest.fixture(scope="module", autouse=True)
def _in_this_process(module_in_this_process):
    """One test here starts a worker."""


@pytest.fixture(scope="module")
def views():
    return main_views(6, np.random.default_rng(4))


@pytest.fixture(scope="module")
def records(views):
    """Four ordinary frames, one without halfway line, one with a short arc only, one with nothing, one unreadable."""
    rng = np.random.default_rng(9)
    seen = {f"{k}": seen_by(camera, rng) for k, camera in enumerate(views[:4])}
    seen["no-line"] = seen_by(views[4], rng, line=False)
    seen["arc"] = seen_by(views[5], rng, line=False, share=0.3)
    seen["nothing"] = Observations(1920, 1080)
    found = [
        result_record(run_observations(o, CONFIG, frame_id=name, convention="paint"), TEMPLATE)
        for name, o in seen.items()
    ]
    return [
        *found,
        failure_record("bad", "bad.jpg", Verdict("refused", "unreadable_input", "bad.jpg: no", "input"), 0, ""),
    ]


@pytest.fixture
def results(tmp_path, records):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "results.jsonl").write_text("".join(result_line(r) + "\n" for r in records))
    return tmp_path / "run"


@pytest.fixture(scope="module")
def command(records, tmp_path_factory):
    """The folder that ``circlecal rig`` writes, its report, and what it printed."""
    folder, found = tmp_path_factory.mktemp("rig"), []
    (folder / "results.jsonl").write_text("".join(result_line(r) + "\n" for r in records))

    def keep(*given, **named):
        found.append(run_rig(*given, **named))
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_run, "run_rig", keep)
        ended = CliRunner().invoke(app, ["rig", str(folder), "--out", str(folder / "out"), "--json", "-q", *SETTINGS])
    assert ended.exit_code == 1, ended.output
    return folder / "out", *found, ended.stdout


@pytest.fixture(scope="module")
def again(command):
    """The folder of that run, its report and its records."""
    out, report, _ = command
    return out, report, {r.id: r for r in read_records(out)}


def test_the_venue_holds_the_cameras(views, again):
    folder, report, _ = again
    venue = read_venue(folder / "venue.yaml", TEMPLATE)
    (tripod,) = venue.tripods
    assert (tripod.name, tripod.used) == (report.rigs[0].name, report.rigs[0].used)
    position = np.mean([camera.position_m for camera in views], axis=0)
    off = tripod.mean[:3] - position
    assert off @ np.linalg.solve(tripod.covariance[:3, :3], off) < 16.0
    # the views of these frames turn about one point; how far the lens lies before it moves the axis as much
    lever = tripod.mean[PLACE["lever"]]
    assert abs(lever) < 3.0 * tripod.sigma("lever") and tripod.sigma("lever") < RigConfig().lever_sd_m
    both = tripod.covariance[np.ix_([PLACE["lever"], PLACE["axis_y"]], [PLACE["lever"], PLACE["axis_y"]])]
    assert both[0, 1] / both[0, 0] == pytest.approx(0.95, abs=0.15)
    own = tripod.model.own_of(report.rigs[0].state.theta, tripod.mean)
    np.testing.assert_allclose(
        tripod.model.thetas(own, tripod.mean)[:, :7], report.rigs[0].state.theta[:, :7], atol=0.2
    )


def test_frames_refused_alone_succeed_with_the_camera(records, views, again):
    _, report, found = again
    assert {r.id for r in records if r.status == "calibrated"} == {"0", "1", "2", "3"}
    assert report.gained == ["no-line", "arc"]
    assert (report.frames, report.calibrated_alone, report.calibrated) == (8, 4, 6)
    cameras = dict(zip(["0", "1", "2", "3", "no-line", "arc"], views, strict=True))
    for name, camera in cameras.items():
        sigma = found[name].camera.max_sigma_px
        assert error_px(found[name], camera) < min(6.0, sigma), name
        assert found[name].rig.camera == "camera-1"
    assert found["arc"].rig.alone.code == "rotation_free"


def test_frames_that_show_nothing_stay_refused(again):
    _, _, found = again
    for name in ("nothing", "bad"):
        assert found[name].status == "refused"
        assert found[name].rig.camera is None
    assert found["bad"].code == "unreadable_input"


def test_predicted_errors_shrink_and_hold(records, views, again):
    _, _, found = again
    for k, camera in enumerate(views[:4]):
        before, after = records[k].camera or records[k].rejected_estimate.camera, found[f"{k}"]
        assert after.camera.max_sigma_px < 1.05 * before.max_sigma_px
        assert error_px(after, camera) < 3 * after.camera.max_sigma_px


def test_prior_file_is_read_by_calibrate(again, tmp_path):
    out, report, _ = again
    path = out / "camera-1.yaml"
    content = yaml.safe_load(path.read_text())
    assert content["frames"] == list(report.rigs[0].used)
    settings = dict(s.split("=", 1) for s in prior_settings(path))
    assert set(settings) == {"camera.position_m", "camera.position_sd_m", "camera.shared"}
    from circlecal.config import load_config

    assert load_config(None, prior_settings(path)).camera.shared is not None


def test_one_frame_shares_nothing(records, tmp_path, monkeypatch):
    """By a worker, to which the run must go whole."""
    monkeypatch.setattr(batch_run, "_finish_frames", lambda *given: finish_on_workers(*given[:3]))
    (tmp_path / "results.jsonl").write_text(result_line(records[0]) + "\n" + result_line(records[4]) + "\n")
    report = run_rig(tmp_path, CONFIG, tmp_path / "out")
    assert report.rigs == []
    kept = {r.id: r for r in read_records(tmp_path / "out")}
    assert kept["0"].H_image_field == records[0].H_image_field
    assert kept["no-line"].status == "refused"


def test_command_prints_cameras_and_counts(command, run_circlecal, results, tmp_path):
    out, _, printed = command
    told = json.loads(printed)
    assert (told["calibrated_alone"], told["calibrated"]) == (4, 6)
    assert told["cameras"][0]["used"] == 4
    assert (out / "summary.csv").is_file()
    (tmp_path / "none").mkdir()
    (tmp_path / "none" / "results.jsonl").write_text((results / "results.jsonl").read_text().splitlines()[-1] + "\n")
    outcome = run_circlecal("rig", tmp_path / "none", "--out", tmp_path / "out2", *SETTINGS)
    assert outcome.code == 1
    assert "no camera was found" in outcome.out and "no venue.yaml" in outcome.out
    assert not (tmp_path / "out2" / "venue.yaml").exists()


def test_given_cameras(run_circlecal, results, tmp_path):
    named = tmp_path / "cameras.csv"
    named.write_text("id,camera\n0,stand\n1,stand\n2,stand\n")
    outcome = run_circlecal("rig", results, "--out", tmp_path / "out", "--cameras", named, "--json", *SETTINGS)
    assert json.loads(outcome.out)["cameras"][0]["camera"] == "stand"
    found = {r.id: r for r in read_records(tmp_path / "out")}
    assert found["2"].rig.camera == "stand"
    assert found["3"].rig.camera is None
    assert found["arc"].status == "refused"
    # the file of a camera that a new run does not know goes, and what is no prior stays
    assert (tmp_path / "out" / "stand.yaml").is_file()
    (tmp_path / "out" / "mine.yaml").write_text("seed: 1\n")
    named.write_text("id,camera\n0,roof\n1,roof\n2,roof\n")
    run_circlecal("rig", results, "--out", tmp_path / "out", "--cameras", named, "--restart", *SETTINGS)
    assert sorted(path.name for path in (tmp_path / "out").glob("*.yaml")) == ["mine.yaml", "roof.yaml", "venue.yaml"]
    named.write_text("id,camera\n0,stand\nmoon,stand\nsun,stand\n")
    outcome = run_circlecal("rig", results, "--out", tmp_path / "other", "--cameras", named, *SETTINGS)
    assert outcome.code == 2
    assert "a camera is named for moon and 1 more, which are no frames of this run" in outcome.err


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("id,camera\n1,a/b\n", "line 2: camera 'a/b' is no name"),
        ("id,camera\n1,a\n2,.b\n", "line 3: camera '.b' is no name"),
        ("id,camera\n1,a\n2,Venue\n", "line 3: camera 'Venue' is the name of venue.yaml; choose another"),
        ("id,camera\n1,a\n1,b\n", "line 3: 1 is of b here, and of a before"),
        ("id,camera\n1,a\n2\n", "line 3: needs the columns id and camera, both filled"),
        ("id,camera\n1,a\n,a\n", "line 3: needs the columns id and camera, both filled"),
        ("frame\n1\n", "no column 'id'; name the columns id, camera"),
        ("id,camera\n", "names no camera"),
    ],
)
def test_wrong_camera_file(tmp_path, text, named):
    path = tmp_path / "c.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=named):
        read_cameras(path)


def test_wrong_results(run_circlecal, results, records, tmp_path):
    assert run_circlecal("rig", tmp_path / "missing").code == 2
    (tmp_path / "empty").mkdir()
    assert "holds no results.jsonl" in run_circlecal("rig", tmp_path / "empty").err
    outcome = run_circlecal("rig", results, "--field", "futsal", "--out", tmp_path / "o")
    assert outcome.code == 2
    assert "--field" in outcome.err
    with (results / "results.jsonl").open("a") as file:
        file.write('{"schema_version": 1, "id": "torn"')
    assert len(list(read_records(results))) == len(records)
    (results / "results.jsonl").write_text("[]\n")
    with pytest.raises(InputError, match="line 1"):
        list(read_records(results))
    damaged = json.loads(result_line(records[0]))
    damaged["camera"]["covariance"] = {"parameters": ["x"]}
    (results / "results.jsonl").write_text(json.dumps(damaged) + "\n")
    with pytest.raises(InputError, match=r"line 1: is no result: camera\.covariance: matrix is not 1 x 1"):
        list(read_records(results))
    damaged["camera"]["covariance"] = {"parameters": ["x"], "matrix": [[1.0]]}
    (results / "results.jsonl").write_text(json.dumps(damaged) + "\n")
    with pytest.raises(InputError, match="camera of 0 has other parameters"):
        frame_of_record(next(read_records(results)), results)


def test_result_files_serve_as_well(records, tmp_path):
    for record in records[:2]:
        (tmp_path / f"{record.id}.json").write_text(result_line(record))
    assert [r.id for r in read_records(tmp_path)] == ["0", "1"]
    assert [r.id for r in read_records(tmp_path / "0.json")] == ["0"]


def test_a_rig_goes_on_where_it_was_stopped(records, again, tmp_path):
    out = shutil.copytree(again[0].parent, tmp_path, dirs_exist_ok=True) / "out"
    whole = (out / "results.jsonl").read_text().splitlines(keepends=True)
    (out / "results.jsonl").write_text("".join(whole[:3]) + whole[3][:50])
    seen = []
    report = run_rig(tmp_path, CONFIG, out, on_progress=lambda progress: seen.append(progress.resumed))
    assert seen[-1] == 3
    assert report.calibrated == 6
    ids = [json.loads(line)["id"] for line in (out / "results.jsonl").read_text().splitlines()]
    assert sorted(ids) == sorted(r.id for r in records)
    with pytest.raises(InputError, match="choose another --out"):
        run_rig(tmp_path, CONFIG, tmp_path)


def test_a_folder_of_another_run_stays_as_it_is(records, again, tmp_path):
    out = shutil.copytree(again[0].parent, tmp_path, dirs_exist_ok=True) / "out"
    files = "camera-1.yaml", "venue.yaml", "results.jsonl"
    before = {name: (out / name).read_bytes() for name in files}
    other = CONFIG.model_copy(update={"seed": 7})
    with pytest.raises(OtherRunError):
        run_rig(tmp_path, other, out)
    assert {name: (out / name).read_bytes() for name in files} == before
    (out / "camera-9.yaml").write_text("of a run before")
    run_rig(tmp_path, other, out, restart=True)
    assert (out / "camera-1.yaml").is_file() and not (out / "camera-9.yaml").exists()


def test_what_a_person_said_of_a_frame_stands(records, tmp_path):
    flagged = records[0].model_copy(update={"status": "refused", "code": "other_camera", "annotation": "0123"})
    named = records[1].model_copy(update={"annotation": "4567"})
    lines = "".join(result_line(record) + "\n" for record in (flagged, named, *records[2:]))
    (tmp_path / "results.jsonl").write_text(lines)
    run_rig(tmp_path, CONFIG, tmp_path / "out")
    found = {record.id: record for record in read_records(tmp_path / "out")}
    kept, other = found[flagged.id], found[named.id]
    assert (kept.status, kept.code, kept.annotation) == ("refused", "other_camera", "0123")
    assert kept.rig.camera is None and "a person says" in kept.rig.reason
    assert other.status == "calibrated" and other.annotation == "4567"
    task = RigTask(CONFIG, (), None, None, "official", False)
    others = replace(task, mask=tmp_path), replace(task, convention="paint"), replace(task, said=(("0", "0123"),))
    assert len({task.digest, *(other.digest for other in others)}) == 4


def test_a_refused_frame_is_looked_at_with_the_mask_of_its_subfolder(records, frame_image, tmp_path):
    picture, masks = tmp_path / "day" / "s" / "c.png", tmp_path / "masks"
    picture.parent.mkdir(parents=True)
    (masks / "s").mkdir(parents=True)
    cv2.imwrite(str(picture), frame_image)
    cv2.imwrite(str(masks / "s" / "c.png"), np.zeros(frame_image.shape[:2], np.uint8))
    source = SourceRecord(path=str(picture))
    refused = next(r for r in records if r.id == "nothing").model_copy(update={"id": "s__c", "source": source})
    (tmp_path / "results.jsonl").write_text("".join(result_line(r) + "\n" for r in (*records[:4], refused)))
    report = run_rig(tmp_path, CONFIG, tmp_path / "out", mask=masks)
    assert report.missing == []
    found = {record.id: record for record in read_records(tmp_path / "out")}
    assert "the mask is all black" in found["s__c"].rig.reason


def test_refused_frames_whose_pictures_are_not_there_are_told(run_circlecal, results, again, tmp_path):
    assert again[1].missing == again[1].summary()["missing"] == ["bad.jpg"]
    outcome = run_circlecal("rig", results, "--out", tmp_path / "told", *SETTINGS)
    assert "bad.jpg: not there, so frames that were refused were not looked at again" in outcome.err


def test_a_track_shares_its_camera_already(records, tmp_path):
    tracked = records[0].model_copy(update={"track": TrackRecord(frame=0, shot=0)})
    (tmp_path / "results.jsonl").write_text(result_line(tracked) + "\n")
    with pytest.raises(InputError, match=r"0 is of circlecal track, .* its venue\.yaml has that camera"):
        run_rig(tmp_path, CONFIG, tmp_path / "out")


def test_batch_does_both_passes(run_circlecal, frame_image, tmp_path):
    for name in ("a", "b"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), frame_image)
    arguments = ("batch", tmp_path, "--out", tmp_path / "run", "--workers", "1", "--rig", "--json")
    outcome = run_circlecal(*arguments)
    assert outcome.code == 0, outcome
    assert json.loads(outcome.out)["calibrated"] == 2
    found = list(read_records(tmp_path / "run" / "rig"))
    assert {r.rig.camera for r in found} == {"camera-1"}
    alone = {r.id: r for r in read_records(tmp_path / "run")}
    for record in found:
        assert record.camera.max_sigma_px < alone[record.id].camera.max_sigma_px
    # a further frame: other cameras, so the second pass is made anew
    cv2.imwrite(str(tmp_path / "c.png"), np.full_like(frame_image, 90))
    outcome = run_circlecal(*arguments)
    assert outcome.code == 1, outcome
    assert len(list(read_records(tmp_path / "run" / "rig"))) == 3
