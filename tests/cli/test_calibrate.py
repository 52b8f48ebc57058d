"""``circlecal calibrate``: files written, output, exit codes, and every kind of bad input."""

import json
import shutil

import cv2
import numpy as np
import pytest

from circlecal.refusals import explain
from circlecal.synthetic.sampling import render_frame

QUICK = ("--no-overlay", "--set", "camera.starts=1")


def only_error(outcome, *parts):
    assert outcome.code == 2
    assert outcome.out == ""
    lines = outcome.err.splitlines()
    assert len(lines) == 1, outcome.err
    assert lines[0].startswith("circlecal: error: ")
    for part in parts:
        assert str(part) in lines[0]


def test_files_and_table(run_circlecal, frame_file, tmp_path):
    out = tmp_path / "out"
    outcome = run_circlecal("calibrate", frame_file, "--out", out)
    assert outcome.code == 0, outcome
    record = json.loads((out / "good.json").read_text())
    assert record["status"] == "calibrated"
    assert record["source"]["path"] == str(frame_file)
    height, width = cv2.imread(str(out / "good.overlay.jpg")).shape[:2]
    assert width == 2 * 960 and height > 2 * 540  # enlarged, with a legend
    assert sorted(p.name for p in out.iterdir()) == ["good.json", "good.overlay.jpg"]
    header, row = (line.split("\t") for line in outcome.out.splitlines())
    assert header[:3] == ["id", "verdict", "case"]
    assert row[:3] == ["good", "calibrated", str(record["case"])]
    assert outcome.err == f"circlecal: wrote {out / 'good.json'}, {out / 'good.overlay.jpg'}\n"


def test_radar(run_circlecal, frame_file, tmp_path):
    assert run_circlecal("calibrate", frame_file, "--out", tmp_path / "out", "--radar", "--no-overlay").code == 0
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["good.json", "good.radar.jpg"]
    small = ("--out", tmp_path / "small", "--set", "output.radar=true", "--set", "output.radar_px_per_m=5")
    assert run_circlecal("calibrate", frame_file, *small, "--no-overlay").code == 0
    usual, half = (cv2.imread(str(tmp_path / name / "good.radar.jpg")) for name in ("out", "small"))
    np.testing.assert_allclose(np.array(half.shape[:2]) / usual.shape[:2], 0.5, atol=0.02)


def test_a_refused_frame_is_exit_code_1(run_circlecal, frame_file, blank_file, tmp_path):
    outcome = run_circlecal("calibrate", frame_file.parent, "--out", tmp_path / "out", *QUICK)
    assert outcome.code == 1
    assert [line.split("\t")[:2] for line in outcome.out.splitlines()[1:]] == [
        ["blank", "refused"],
        ["good", "calibrated"],
    ]
    record = json.loads((tmp_path / "out" / "blank.json").read_text())
    assert record["status"] == "refused"
    assert record["reason"] in outcome.out
    assert outcome.out.splitlines()[1].endswith(explain(record["code"]).help)
    assert "2/2 frames" in outcome.err
    assert outcome.err.splitlines()[-1] == f"circlecal: 2 results are in {tmp_path / 'out'} (<id>.json)"


def test_json_lines(run_circlecal, frame_file, blank_file, tmp_path):
    outcome = run_circlecal("calibrate", frame_file, blank_file, "--out", tmp_path / "out", "--json", "-q", *QUICK)
    records = [json.loads(line) for line in outcome.out.splitlines()]
    assert [r["id"] for r in records] == ["good", "blank"]
    assert outcome.err == ""
    assert records[0] == json.loads((tmp_path / "out" / "good.json").read_text())


def test_quiet(run_circlecal, frame_file, tmp_path):
    outcome = run_circlecal("calibrate", frame_file, "--out", tmp_path / "out", "--quiet", *QUICK)
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")


def test_the_default_output_folder_is_not_the_input_folder(run_circlecal, frame_file, tmp_path, monkeypatch):
    monkeypatch.chdir(frame_file.parent)
    assert run_circlecal("calibrate", ".", *QUICK).code == 0
    assert sorted(p.name for p in frame_file.parent.iterdir()) == ["circlecal-out", "good.png"]
    outcome = run_circlecal("calibrate", ".", "--json", *QUICK)
    assert len(outcome.out.splitlines()) == 1


def test_out_may_be_the_input_folder_when_it_says_so(run_circlecal, frame_file):
    folder = frame_file.parent
    for _ in range(2):
        assert run_circlecal("calibrate", folder, "--out", folder).code == 0
    assert sorted(p.name for p in folder.iterdir()) == ["good.json", "good.overlay.jpg", "good.png"]


def test_a_case_that_cannot_be_had_is_told(run_circlecal, frame_file, tmp_path):
    for case, told in ((2, True), (1, False)):
        outcome = run_circlecal(
            "calibrate", frame_file, "--out", tmp_path, "--set", f"correspondences.case={case}", *QUICK
        )
        assert outcome.code == 0
        note = "circlecal: good: no correspondences of case 2: no point of known field position is seen"
        assert (note in outcome.err) is told
        assert ("--keypoints FILE" in outcome.err) is told


def test_seed_field_and_settings_reach_the_result(run_circlecal, frame_file, tmp_path):
    outcome = run_circlecal(
        "calibrate",
        frame_file,
        "--out",
        tmp_path,
        "--seed",
        5,
        "--field",
        "soccer",
        "--set",
        "field.sizes.length=100",
        "--json",
        *QUICK,
    )
    record = json.loads(outcome.out)
    assert record["seed"] == 5
    assert record["field"]["sizes"]["length"] == 100


def test_mask_file_and_folder(run_circlecal, frame_file, frame_camera, tmp_path):
    from circlecal.field import load_field

    template = load_field("soccer")
    mask = np.zeros((540, 960), np.uint8)
    lines = template.polylines(0.1)
    for name, value in (("halfway_line", 18), ("centre_circle", 7)):
        points = frame_camera.project(lines[name])
        inside = points[np.isfinite(points).all(axis=1) & (np.abs(points) < 5000).all(axis=1)]
        cv2.polylines(mask, [np.round(inside).astype(np.int32)], name == "centre_circle", value, 4)
    masks = tmp_path / "given"
    masks.mkdir()
    cv2.imwrite(str(masks / "good.png"), mask)
    for given in (masks, masks / "good.png"):
        outcome = run_circlecal("calibrate", frame_file, "--mask", given, "--out", tmp_path / "out", "--json", *QUICK)
        assert outcome.code == 0, outcome
    shutil.copy(masks / "good.png", frame_file.with_name("good.mask.png"))
    outcome = run_circlecal("calibrate", frame_file.parent, "--out", tmp_path / "out", "--json", *QUICK)
    assert [json.loads(line)["id"] for line in outcome.out.splitlines()] == ["good"]


def test_a_camera_is_known_from_one_place(run_circlecal, frame_file, tmp_path):
    known = "--camera-prior", tmp_path / "a.json", "--venue", tmp_path / "venue.yaml"
    only_error(run_circlecal("calibrate", frame_file, *known, "--out", tmp_path), "--camera-prior and --venue both say")


def test_mask_options_that_do_not_fit(run_circlecal, frame_file, blank_file, tmp_path):
    only_error(
        run_circlecal("calibrate", frame_file, "--mask", tmp_path / "none", *QUICK, "--out", tmp_path), "no such mask"
    )
    mask = tmp_path / "mask.png"
    cv2.imwrite(str(mask), np.zeros((540, 960), np.uint8))
    outcome = run_circlecal("calibrate", frame_file, blank_file, "--mask", mask, "--out", tmp_path)
    only_error(outcome, "one mask for 2 frames")
    outcome = run_circlecal("calibrate", frame_file, "--mask", mask, "--out", tmp_path)
    assert outcome.code == 1 and "the mask is all black: nothing is marked in it" in outcome.out + outcome.err
    cv2.imwrite(str(mask), np.full((540, 960), 255, np.uint8))
    only_error(run_circlecal("calibrate", frame_file, "--mask", mask, "--out", tmp_path), mask, "all white")
    only_error(
        run_circlecal("calibrate", frame_file, "--mask", frame_file.parent / "..", "--out", tmp_path),
        "no mask for good.png",
    )


@pytest.mark.parametrize(
    ("name", "content", "part"),
    [
        ("empty.jpg", b"", "empty"),
        ("text.jpg", b"hello", "no JPEG"),
        ("one.png", cv2.imencode(".png", np.zeros((1, 1, 3), np.uint8))[1].tobytes(), "1 x 1"),
        ("cut.jpg", cv2.imencode(".jpg", np.zeros((99, 99, 3), np.uint8))[1].tobytes()[:-9], "truncated"),
    ],
)
def test_bad_pictures_are_one_line(run_circlecal, tmp_path, name, content, part):
    path = tmp_path / name
    path.write_bytes(content)
    only_error(run_circlecal("calibrate", path, "--out", tmp_path / "out"), path, part)


def test_a_bad_picture_does_not_stop_the_others(run_circlecal, frame_file, tmp_path):
    frame_file.with_name("bad.jpg").write_bytes(b"")
    outcome = run_circlecal("calibrate", frame_file.parent, "--out", tmp_path / "out", *QUICK)
    assert outcome.code == 2
    assert outcome.err.count("circlecal: error: ") == 1
    assert "good\tcalibrated" in outcome.out
    assert (tmp_path / "out" / "good.json").is_file()


def test_videos_and_urls_among_pictures_are_named_and_left_out(run_circlecal, frame_file, tmp_path):
    for name in ("first.mp4", "second.mp4"):
        (frame_file.parent / name).touch()
    outcome = run_circlecal("calibrate", frame_file.parent, "https://127.0.0.1:1/x.jpg", "--out", tmp_path / "out")
    assert outcome.code == 2
    assert "first.mp4: is a video; circlecal batch takes it (and 1 more like it)" in outcome.err
    assert "https://127.0.0.1:1/x.jpg: is a URL; circlecal batch takes it" in outcome.err
    assert (tmp_path / "out" / "good.json").is_file()


def test_wrong_use(run_circlecal, frame_file, tmp_path):
    only_error(run_circlecal("calibrate", tmp_path / "none.jpg", "--out", tmp_path), "no such file")
    (tmp_path / "nothing").mkdir()
    only_error(run_circlecal("calibrate", tmp_path / "nothing", "--out", tmp_path), "no pictures")
    only_error(run_circlecal("calibrate", frame_file, "--config", tmp_path / "none.yaml"), "none.yaml")
    only_error(run_circlecal("calibrate", frame_file, "--set", "edges.smothing_px=1"), "mean edges.smoothing_px?")
    only_error(run_circlecal("calibrate", frame_file, "--set", "edges.smoothing_px=.nan"), "finite")
    only_error(run_circlecal("calibrate", frame_file, "--field", "quidditch"), "quidditch", "soccer")
    only_error(run_circlecal("calibrate", frame_file, "--set", "field.circle=moon"), "moon", "centre_circle")
    only_error(run_circlecal("calibrate", frame_file, "--field", frame_file), str(frame_file), "end in .yaml")
    for command in ("calibrate", "batch", "debug"):
        outcome = run_circlecal(command, frame_file, "--annotations", tmp_path / "none", "--out", tmp_path / "out")
        only_error(outcome, "none: no such folder of annotations")
    assert run_circlecal("calibrate").code == 2
    assert run_circlecal("calibrate", frame_file, "--bogus").code == 2


def test_an_output_folder_that_cannot_be_written(run_circlecal, frame_file, tmp_path):
    (tmp_path / "file").touch()
    only_error(run_circlecal("calibrate", frame_file, "--out", tmp_path / "file"), tmp_path / "file", "is a file")
    only_error(run_circlecal("calibrate", frame_file, "--out", tmp_path / "file" / "out"), "cannot be written")


def test_a_full_disk(run_circlecal, frame_file, tmp_path, monkeypatch):
    monkeypatch.setattr("os.fsync", lambda descriptor: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    only_error(run_circlecal("calibrate", frame_file, "--out", tmp_path / "out", *QUICK), "No space left", "good.json")
    assert list((tmp_path / "out").iterdir()) == []


def test_what_the_field_looks_like_is_said(run_circlecal, tmp_path):
    hall = tmp_path / "hall.png"
    cv2.imwrite(str(hall), render_frame("wood", np.random.default_rng(1), 640, 360).image)
    outcome = run_circlecal(
        "calibrate", hall, "--out", tmp_path, "--no-overlay", "--field", "auto", "--set", "field.among=[soccer, futsal]"
    )
    assert outcome.code == 0, outcome
    assert "circlecal: hall: looks like futsal; --field futsal" in outcome.err
    floor = tmp_path / "floor.png"
    cv2.imwrite(str(floor), np.full((120, 160, 3), (110, 160, 200), np.uint8))
    told = run_circlecal("calibrate", floor, "--out", tmp_path, "--no-overlay", "--field", "auto")
    assert "circlecal: floor: refused; nothing tells which sport it shows" in told.err
    assert json.loads((tmp_path / "floor.json").read_text())["sport"]["name"] is None
    turf = tmp_path / "turf.png"
    cv2.imwrite(str(turf), np.full((120, 160, 3), (60, 130, 70), np.uint8))
    outcome = run_circlecal("calibrate", floor, turf, "--out", tmp_path, "--no-overlay")
    assert "circlecal: floor: the ground is no turf; --field auto tries other sports\n" in outcome.err
    outcome = run_circlecal("calibrate", turf, "--out", tmp_path, "--no-overlay")
    assert "what was refused was taken for soccer; --field auto tries other sports" in outcome.err
    for named in (("--field", "futsal"), ("--config", "broadcast")):
        assert "other sports" not in run_circlecal("calibrate", turf, *named, "--out", tmp_path, "--no-overlay").err
    only_error(run_circlecal("convert", floor, "--field", "auto", "--to", "tvcalib"), "name the field")


@pytest.mark.parametrize("command", ["calibrate", "batch"])
def test_a_format_without_names_for_the_field_is_told_before_the_first_frame(
    run_circlecal, frame_file, tmp_path, command
):
    out = tmp_path / "out"
    outcome = run_circlecal(command, frame_file, "--field", "handball", "--to", "pnlcalib", "--out", out)
    assert outcome.code == 2
    assert "keypoints of PnLCalib need a soccer pitch; the field 'handball' has no" in outcome.err
    assert not out.exists()


def test_a_size_of_television_is_noted_with_the_pixels_that_it_may_have(run_circlecal, frame_file, tmp_path):
    file = tmp_path / "pal.png"
    cv2.imwrite(str(file), cv2.resize(cv2.imread(str(frame_file)), (720, 576), interpolation=cv2.INTER_AREA))
    note = "set camera.aspect=1.422 if it shows 16:9, 1.067 if 4:3"
    outcome = run_circlecal("calibrate", file, "--out", tmp_path / "out", *QUICK)
    assert any(
        line.startswith("circlecal: pal: 720 x 576") and line.endswith(note) for line in outcome.err.splitlines()
    )
    for aspect in ("1.422", "1"):
        told = run_circlecal("calibrate", file, "--out", tmp_path / "told", *QUICK, "--set", f"camera.aspect={aspect}")
        assert "camera.aspect" not in told.err


def test_a_run_and_result_files_in_one_folder_are_told(run_circlecal, blank_file, tmp_path):
    """Other commands read the run alone, so that results which lay there before seem to be gone."""
    run, files = tmp_path / "run", tmp_path / "files"
    for _ in range(2):  # a run that goes on has nothing to tell
        assert "read" not in run_circlecal("batch", blank_file, "--out", run, "--workers", 1).err
        assert "read" not in run_circlecal("calibrate", blank_file, "--out", files).err
    assert f"{run}: holds a run" in run_circlecal("calibrate", blank_file, "--out", run).err
    assert (
        f"{files}: holds results of circlecal calibrate"
        in run_circlecal("batch", blank_file, "--out", files, "--workers", 1).err
    )
    assert run_circlecal("calibrate", blank_file, "--out", run, "--quiet").err == ""
