"""``circlecal calibrate`` on annotations and with keypoints beside pictures, ``--to``, and ``circlecal convert``."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.formats import soccernet_camera

QUICK = ("--set", "camera.starts=1")


def read_camera(path):
    return soccernet_camera.read(path, path.read_bytes(), None)[0].camera


def classes(camera, size=(960, 540)):
    """Line annotation of what a camera sees of an official field."""
    template = load_field("soccer", {"marking": 1e-6})
    found = {}
    for element, count in (("centre_circle", 40), ("halfway_line", 6)):
        pixels = camera.project(template.polylines(0.25)[element])
        inside = pixels[((pixels >= 0) & (pixels <= np.array(size) - 1)).all(axis=1)]
        chosen = inside[np.linspace(0, len(inside) - 1, count).astype(int)] / (np.array(size) - 1)
        name = {"centre_circle": "Circle central", "halfway_line": "Middle line"}[element]
        found[name] = [{"x": x, "y": y} for x, y in chosen.tolist()]
    return found


@pytest.fixture
def side_camera(frame_camera):
    """A camera that stands aside of the halfway line, which determines it better."""
    angles = np.radians([-19.5, 76.5, 0.3])
    return replace(frame_camera, angles_rad=angles, position_m=np.array([22.0, 62.0, -15.5]))


@pytest.fixture
def annotation_file(tmp_path, side_camera):
    path = tmp_path / "annotated" / "00042.json"
    path.parent.mkdir()
    path.write_text(json.dumps(classes(side_camera)))
    return path


def only_error(outcome, *parts):
    assert outcome.code == 2, outcome
    lines = outcome.err.splitlines()
    assert len(lines) == 1, outcome.err
    assert lines[0].startswith("circlecal: error: ")
    for part in parts:
        assert str(part) in lines[0]


def test_an_annotation_becomes_a_camera(run_circlecal, annotation_file, side_camera, tmp_path):
    out = tmp_path / "out"
    outcome = run_circlecal(
        "calibrate", annotation_file, "--size", "960x540", "--out", out, *QUICK,
        "--to", "soccernet", "--to", "pnlcalib",
        "--set", "camera.crown_shape=flat", "--set", "camera.k1_mean=0", "--set", "camera.k1_sd=0",
    )  # fmt: skip
    assert outcome.code == 0, outcome
    assert sorted(p.name for p in out.iterdir()) == ["00042.json", "00042.pnlcalib.json", "camera_00042.json"]
    record = json.loads((out / "00042.json").read_text())
    assert record["source"]["path"] == str(annotation_file)
    camera = read_camera(out / "camera_00042.json")
    points = [[0.0, 0.0], [9.15, 0.0], [0.0, 9.15]]
    assert np.abs(camera.project(points) - side_camera.project(points)).max() < 0.5


def test_the_size_is_asked_for_or_read_off_the_picture(run_circlecal, annotation_file, frame_image, tmp_path):
    only_error(
        run_circlecal("calibrate", annotation_file, "--out", tmp_path / "o", *QUICK),
        annotation_file,
        "--size WIDTHxHEIGHT",
    )
    only_error(run_circlecal("calibrate", annotation_file, "--size", "960", "--out", tmp_path / "o"), "--size '960'")
    only_error(run_circlecal("calibrate", annotation_file, "--size", "1x1", "--out", tmp_path / "o"), "from 2 to 65535")
    cv2.imwrite(str(annotation_file.with_suffix(".png")), frame_image)
    assert run_circlecal("calibrate", annotation_file, "--out", tmp_path / "out", *QUICK).code == 0
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["00042.json", "00042.overlay.jpg"]


def test_a_folder_of_annotations(run_circlecal, annotation_file, tmp_path):
    folder = annotation_file.parent
    (folder / "cut.json").write_text('{"Circle central": [{"x"')
    (folder / "camera_1.json").write_text(json.dumps({"pan_degrees": 1.0, "x_focal_length": 2.0}))
    (folder / "nothing.json").write_text(
        json.dumps({"Tree": [{"x": 0.1, "y": 0.1}], "Middle line": [{"x": 0, "y": 0}]})
    )
    outcome = run_circlecal("calibrate", folder, "--size", "960x540", "--out", tmp_path / "out", *QUICK)
    assert outcome.code == 2
    rows = [line.split("\t")[:2] for line in outcome.out.splitlines()[1:]]
    assert rows == [["00042", "calibrated"], ["nothing", "refused"]]
    assert outcome.err.count("circlecal: error: ") == 1
    assert "cut.json" in outcome.err
    flat = " ".join(outcome.err.split())
    assert "Tree: is no marking" in flat
    assert "is a line of one point" in flat


def test_of_several_annotations_only_the_files_that_there_are_are_named(run_circlecal, annotation_file, tmp_path):
    annotation_file.with_name("00043.json").write_bytes(annotation_file.read_bytes())
    outcome = run_circlecal("calibrate", annotation_file.parent, "--size", "960x540", "--out", tmp_path / "out")
    assert f"2 results are in {tmp_path / 'out'} (<id>.json)" in outcome.err.replace("\n", "")


def test_a_byte_order_mark_is_passed_over(run_circlecal, annotation_file, tmp_path):
    annotation_file.write_bytes(b"\xef\xbb\xbf" + annotation_file.read_bytes())
    outcome = run_circlecal("calibrate", annotation_file, "--size", "960x540", "--out", tmp_path / "out")
    assert outcome.code in (0, 1), outcome.err
    assert (tmp_path / "out" / "00042.json").is_file()


def test_a_folder_of_pictures_leaves_other_files_alone(run_circlecal, frame_file, tmp_path):
    frame_file.with_name("notes.json").write_text("{}")
    outcome = run_circlecal("calibrate", frame_file.parent, "--out", tmp_path / "out", "--no-overlay", *QUICK)
    assert outcome.code == 0
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["good.json"]


@pytest.mark.parametrize(
    ("content", "part"),
    [
        ('{"Middle line": [{"x": "1", "y": 2}]}', "Middle line.0.x"),
        ('{"Middle line": [{"x": NaN, "y": 2}]}', "Middle line.0.x"),
        ('{"Middle line": [{"x": 1', "JSON"),
        ("", "is empty"),
        ("[]x", "JSON"),
    ],
)
def test_broken_files_are_one_line(run_circlecal, tmp_path, content, part):
    path = tmp_path / "bad.json"
    path.write_text(content)
    only_error(run_circlecal("calibrate", path, "--size", "960x540", "--out", tmp_path / "out"), path, part)


def test_a_result_never_takes_the_place_of_its_annotation(run_circlecal, annotation_file):
    content = annotation_file.read_bytes()
    outcome = run_circlecal("calibrate", annotation_file, "--size", "960x540", "--out", annotation_file.parent)
    only_error(outcome, annotation_file, "--out")
    assert annotation_file.read_bytes() == content


def test_wrong_formats(run_circlecal, annotation_file, tmp_path):
    arguments = ("calibrate", annotation_file, "--size", "960x540", "--out", tmp_path / "o")
    only_error(run_circlecal(*arguments, "--to", "vhs"), "--to vhs", "soccernet")
    only_error(run_circlecal(*arguments, "--from", "vhs"), "--from vhs", "labelme")
    only_error(run_circlecal(*arguments, "--from", "labelme"), annotation_file, "shapes")
    only_error(
        run_circlecal("calibrate", annotation_file, "--keypoints", annotation_file, "--out", tmp_path), "--keypoints"
    )


def test_refused_frames_write_no_camera(run_circlecal, tmp_path):
    path = tmp_path / "few.json"
    path.write_text(json.dumps({"Middle line": [{"x": 0.5, "y": 0.1}, {"x": 0.5, "y": 0.9}]}))
    formats = ("soccernet", "worldcup", "tvcalib", "broadtrack", "pnlcalib", "labelme", "coco", "cvat", "labelstudio")
    chosen = [option for name in formats for option in ("--to", name)]
    outcome = run_circlecal("calibrate", path, "--size", "960x540", "--out", tmp_path / "out", *chosen)
    assert outcome.code == 1
    names = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert names == [
        "broadtrack.json", "coco.json", "cvat.xml", "few.json", "few.labelme.json", "few.soccernet.json",
        "labelstudio.json", "per_sample_output.json",
    ]  # fmt: skip
    assert json.loads((tmp_path / "out" / "broadtrack.json").read_text()) == {}
    coco = json.loads((tmp_path / "out" / "coco.json").read_text())
    assert len(coco["images"]) == 1 and [c["name"] for c in coco["categories"][1:]] == ["Middle line"]


def test_every_format_from_a_picture(run_circlecal, frame_file, tmp_path):
    out = tmp_path / "out"
    formats = ("soccernet", "worldcup", "tvcalib", "broadtrack", "pnlcalib", "labelme", "coco", "cvat", "labelstudio")
    chosen = [option for name in formats for option in ("--to", name)]
    outcome = run_circlecal("calibrate", frame_file, "--out", out, *chosen, "--eval-size", "1920x1080", "--no-overlay")
    assert outcome.code == 0, outcome
    assert sorted(p.name for p in out.iterdir()) == [
        "broadtrack.json", "camera_good.json", "coco.json", "cvat.xml", "good.homographyMatrix", "good.json",
        "good.labelme.json", "good.pnlcalib.json", "labelstudio.json", "per_sample_output.json",
    ]  # fmt: skip
    assert read_camera(out / "camera_good.json").width == 1920
    assert "good.png" in (out / "coco.json").read_text()
    assert outcome.err.startswith("circlecal: wrote ")
    assert sorted(outcome.err.split("wrote ")[1].strip().split(", ")) == sorted(str(path) for path in out.iterdir())


def test_keypoints_beside_a_picture(run_circlecal, frame_file, frame_camera, tmp_path):
    x, y = (frame_camera.project([[-9.09, 0.0]])[0] / [960, 540]).tolist()
    keypoints = {"kp": {"50": {"x": x, "y": y, "p": 0.8}, "47": {"x": 0.9, "y": 0.1, "p": 0.8}}, "lines": {}}
    folder = tmp_path / "kp"
    folder.mkdir()
    arguments = ("calibrate", frame_file, "--out", tmp_path / "out", "--json", "--no-overlay", *QUICK, "--keypoints")
    only_error(run_circlecal(*arguments, folder), folder, "good.json")
    (folder / "good.json").write_text(json.dumps(keypoints))
    for given in (folder, folder / "good.json"):
        record = json.loads(run_circlecal(*arguments, given).out)
        assert record["status"] == "calibrated", record["reason"]
        assert [k["name"] for k in record["observations"]["keypoints"]] == ["kp_50", "kp_47"]
        assert record["camera"]["rejected_observations"] == ["kp_47"]
    only_error(run_circlecal(*arguments, tmp_path / "none"), "no such file")


def test_keypoints_of_one_picture_are_not_taken_for_those_of_another(run_circlecal, frame_file, tmp_path):
    pictures, given = tmp_path / "pictures", tmp_path / "kp"
    given.mkdir()
    for folder in ("cam1", "cam2"):
        (pictures / folder).mkdir(parents=True)
        shutil.copy(frame_file, pictures / folder)
    (given / "good.json").write_text(json.dumps({"kp": {"50": {"x": 0.4, "y": 0.5, "p": 0.8}}, "lines": {}}))
    arguments = ("batch", pictures, "--keypoints", given, "--out", tmp_path / "out", *QUICK)
    only_error(
        run_circlecal(*arguments), "good.json: holds one frame", "of cam1/good and cam2/good;",
        "put it in a folder named like that of its picture",
    )  # fmt: skip
    (given / "cam2").mkdir()
    (given / "good.json").rename(given / "cam2" / "good.json")
    run_circlecal(*arguments)
    records = [json.loads(line) for line in (tmp_path / "out" / "results.jsonl").read_text().splitlines()]
    reasons = {record["id"]: record["reason"] for record in records}
    assert "nothing for good.png" in reasons["cam1__good"]
    assert reasons["cam2__good"] is None


def test_the_paint_convention(run_circlecal, annotation_file, tmp_path):
    found = []
    for convention in ("official", "paint"):
        outcome = run_circlecal(
            "calibrate", annotation_file, "--size", "960x540", "--out", tmp_path / convention, "--json", *QUICK,
            "--convention", convention,
        )  # fmt: skip
        found.append(np.array(json.loads(outcome.out)["camera"]["position_meters"]))
    assert np.linalg.norm(found[1]) / np.linalg.norm(found[0]) == pytest.approx(9.09 / 9.15, abs=2e-3)


def test_convert(run_circlecal, annotation_file, tmp_path):
    out = tmp_path / "out"
    outcome = run_circlecal("convert", annotation_file, "--to", "labelme", "--size", "960x540", "--out", out)
    assert (outcome.code, outcome.out.split()) == (0, [str(out / "00042.json")])
    back = run_circlecal("convert", out, "--from", "labelme", "--to", "soccernet", "--out", tmp_path / "back", "-q")
    assert (back.code, back.out, back.err) == (0, "", "")
    first, second = (json.loads((p / "00042.json").read_text()) for p in (annotation_file.parent, tmp_path / "back"))
    assert first.keys() == second.keys()
    for name, points in first.items():
        assert [p["x"] for p in second[name]] == pytest.approx([p["x"] for p in points], abs=1e-12)


def test_convert_tells_what_a_file_says_that_is_not_read(run_circlecal, tmp_path):
    box = {"id": 1, "image_id": 1, "category_id": 1, "bbox": [1, 2, 30, 40], "segmentation": []}
    ring = {"id": 2, "image_id": 1, "category_id": 1, "segmentation": [[100.0, 90.0, 160.0, 70.0, 200.0, 100.0]]}
    dataset = {
        "images": [{"id": 1, "file_name": "a.jpg", "width": 960, "height": 540}],
        "categories": [{"id": 1, "name": "Circle central"}],
        "annotations": [box, ring],
    }
    (tmp_path / "coco.json").write_text(json.dumps(dataset))
    outcome = run_circlecal("convert", tmp_path / "coco.json", "--to", "labelme", "--out", tmp_path / "out")
    assert outcome.code == 0
    assert "annotations.0.bbox: 'Circle central' is a box" in outcome.err


def test_convert_a_result(run_circlecal, annotation_file, tmp_path):
    run_circlecal("calibrate", annotation_file, "--size", "960x540", "--out", tmp_path / "out", *QUICK, "-q")
    outcome = run_circlecal(
        "convert", tmp_path / "out" / "00042.json", "--to", "soccernet", "--out", tmp_path / "cameras"
    )
    assert outcome.code == 0, outcome
    assert (tmp_path / "cameras" / "camera_00042.json").is_file()


def test_convert_of_another_sport_to_a_format_of_soccer(run_circlecal, annotation_file, tmp_path):
    run_circlecal("calibrate", annotation_file, "--size", "960x540", "--out", tmp_path / "out", *QUICK, "-q")
    file = tmp_path / "out" / "00042.json"
    record = json.loads(file.read_text())
    record["field"] = {"template": "ice-hockey-nhl", "circle": "centre_circle"}
    file.write_text(json.dumps(record))
    arguments = ("convert", file, "--out", tmp_path / "cameras", "--to")
    only_error(run_circlecal(*arguments, "worldcup"), "00042", "soccer pitch", "'ice-hockey-nhl'")
    assert run_circlecal(*arguments, "tvcalib").code == 0


def test_convert_where_there_is_no_way(run_circlecal, annotation_file, tmp_path):
    arguments = ("convert", annotation_file, "--size", "960x540", "--out", tmp_path / "out", "--to")
    only_error(run_circlecal(*arguments, "broadtrack"), "no way from a soccernet annotation to broadtrack")
    only_error(run_circlecal(*arguments, "vhs"), "vhs")
    only_error(run_circlecal(*arguments, "coco", "--from", "vhs"), "--from vhs")
    (tmp_path / "void").mkdir()
    only_error(run_circlecal("convert", tmp_path / "void", "--to", "coco"), "nothing to convert")
    shutil.copy(annotation_file, tmp_path / "00042.json")
    only_error(
        run_circlecal("convert", tmp_path / "00042.json", "--size", "9x9", "--to", "labelme", "--out", tmp_path),
        "written over",
    )
