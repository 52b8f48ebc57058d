"""What people name goes into runs, and out to other programs."""

import csv
import json

import cv2
import numpy as np
import pytest

from circlecal.batch.frames import examine_frame
from circlecal.config import Config
from circlecal.field import load_field
from circlecal.formats.annotation import annotation_bytes, parse_annotation
from circlecal.formats.registry import read_annotations
from circlecal.geometry.camera import Camera, image_center
from circlecal.pictures.files import PictureFile, find_frames
from circlecal.workbench.interpretations import name_marking
from circlecal.workbench.measuring import begin_annotation
from circlecal.workbench.store import AnnotationStore, NewerError
from tests.workbench.conftest import Path, zip_of


@pytest.fixture
def pictures(tmp_path, open_image) -> Path:
    path = tmp_path / "pictures"
    path.mkdir()
    cv2.imwrite(str(path / "open.png"), open_image)
    return path


@pytest.fixture
def named(open_frame):
    begun = begin_annotation(open_frame, Config(), PictureFile("open", Path("open.png"), "open"))
    line = next(k for k, m in enumerate(begun.markings) if m.kind == "line" and len(m.points_px) > 100)
    return name_marking(begun, line, "side_line_top")


def records(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines()]


def test_a_run_goes_on_with_what_was_named_meanwhile(pictures, named, run_circlecal, in_this_process, tmp_path):
    out = tmp_path / "run"
    command = ("batch", pictures, "--out", out, "--workers", 1, "-q")
    assert run_circlecal(*command).code == 1
    assert [r["status"] for r in records(out)] == ["refused"]
    store = AnnotationStore(out / "annotations")
    saved = store.save(named, 0)
    assert run_circlecal(*command).code == 0
    (record,) = records(out)
    assert record["status"] == "calibrated" and record["annotation"] and record["id"] == "open"
    (row,) = csv.DictReader((out / "summary.csv").open())
    assert row["annotation"] == record["annotation"] and float(row["height_m"]) > 5
    before = (out / "results.jsonl").read_bytes()
    assert run_circlecal(*command).code == 0
    assert (out / "results.jsonl").read_bytes() == before
    store.save(saved.model_copy(update={"flag": "other_camera"}), saved.revision)
    assert run_circlecal(*command).code == 1
    assert [r["code"] for r in records(out)] == ["other_camera"]


def test_annotated_frames_stay_when_others_are_given_and_are_done_once(
    pictures, named, run_circlecal, in_this_process, tmp_path
):
    out, blank = tmp_path / "run", tmp_path / "blank.png"
    cv2.imwrite(str(blank), np.full((96, 128, 3), 90, np.uint8))
    command = ("batch", "--out", out, "--workers", 1, "-q")
    run_circlecal(*command, pictures)
    # an annotation beside its picture that was added meanwhile
    (pictures / "open.json").write_bytes(annotation_bytes(named.model_copy(update={"touched": True})))
    assert run_circlecal(*command, pictures).code == 0
    before = (out / "results.jsonl").read_bytes()
    assert run_circlecal(*command, pictures).code == 0
    assert (out / "results.jsonl").read_bytes() == before
    run_circlecal(*command, blank)
    assert {r["id"]: bool(r.get("annotation")) for r in records(out)} == {"open": True, "blank": False}
    (pictures / "open.json").unlink()
    assert run_circlecal(*command, pictures).code == 1
    assert {r["id"]: r["status"] for r in records(out)} == {"open": "refused", "blank": "refused"}


def test_an_annotation_beside_its_picture_is_taken(pictures, named, run_circlecal, tmp_path):
    (pictures / "open.json").write_bytes(annotation_bytes(named))
    outcome = run_circlecal("calibrate", pictures / "open.png", "--out", tmp_path / "out", "--json")
    assert outcome.code == 0, outcome.err
    assert json.loads(outcome.out)["annotation"]
    assert "is not used" not in outcome.err
    assert run_circlecal("debug", pictures / "open.png", "--out", tmp_path / "debug", "-q").code == 0


def test_stages_of_an_annotated_frame_are_those_of_its_picture_and_its_answer_is_the_persons(pictures, named, tmp_path):
    (frame,) = find_frames([pictures / "open.png"])
    _, alone = examine_frame(frame, Config())
    (pictures / "open.json").write_bytes(annotation_bytes(named))
    picture, told = examine_frame(frame, Config(), annotations=tmp_path)
    assert picture.shape[:2] == (named.height, named.width)
    assert (alone.status, told.status) == ("refused", "calibrated")
    ends = [[line.start.tolist() for line in found.attempt.mask.lines] for found in (told, alone)]
    assert ends[0] == ends[1] != []
    assert told.template == load_field("soccer")


def test_an_annotation_is_scaled_to_its_picture_and_one_of_another_aspect_is_refused(
    pictures, named, run_circlecal, in_this_process, tmp_path
):
    store, whole = AnnotationStore(tmp_path / "annotations"), cv2.imread(str(pictures / "open.png"))
    store.save(named, 0)
    command = ("calibrate", pictures / "open.png", "--annotations", store.folder, "--json", "--out", tmp_path / "out")
    told = json.loads(run_circlecal(*command).out)
    cv2.imwrite(str(pictures / "open.png"), cv2.resize(whole, (480, 270), interpolation=cv2.INTER_AREA))
    half = json.loads(run_circlecal(*command).out)
    assert half["annotation"] and half["image"] == {"width": 480, "height": 270}
    assert half["camera"]["position_meters"] == pytest.approx(told["camera"]["position_meters"], abs=1.0)
    debugged = ("--annotations", store.folder, "--out", tmp_path / "debug", "-q")
    assert run_circlecal("debug", pictures / "open.png", *debugged).code == 0
    cv2.imwrite(str(pictures / "open.png"), whole[:, :540])
    refused = run_circlecal(*command)
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "open: the annotation is of 960x540, the picture 540x540, which has another aspect" in refused.err


def test_a_zip_of_annotations_counts_as_its_folder_does(pictures, named, run_circlecal, in_this_process, tmp_path):
    store, given = AnnotationStore(tmp_path / "annotations"), tmp_path / "named.zip"
    saved = store.save(named, 0)
    content = (store.folder / "open.json").read_bytes()
    given.write_bytes(zip_of(theirs__open_dot_json=content, theirs__notes_dot_txt="x"))
    alike = []
    for told in (store.folder, given):
        options = ("--annotations", told, "--out", tmp_path / f"{told.stem}-out", "--json", "--no-overlay")
        outcome = run_circlecal("calibrate", pictures, *options)
        assert outcome.code == 0, outcome.err
        alike.append(json.loads(outcome.out) | {"timings_ms": None})
    assert alike[0] == alike[1] and alike[0]["status"] == "calibrated"
    debugged = ("--annotations", given, "--out", tmp_path / "debug", "-q")
    assert run_circlecal("debug", pictures / "open.png", *debugged).code == 0
    command = ("batch", pictures, "--annotations", given, "--out", tmp_path / "run", "--workers", 1, "-q")
    assert run_circlecal(*command).code == 0
    before = records(tmp_path / "run")
    assert run_circlecal(*command).code == 0
    assert records(tmp_path / "run") == before, "nothing is done anew"
    # another annotation of as many bytes, and one that is no longer there
    changed = saved.model_copy(update={"flag": "other_camera", "note": ""})
    short = annotation_bytes(changed)
    given.write_bytes(zip_of(open_dot_json=short + b" " * (len(content) - len(short))))
    assert run_circlecal(*command).code == 1
    assert [r["code"] for r in records(tmp_path / "run")] == ["other_camera"]
    assert [p.name for p in (tmp_path / "run" / "unpacked").rglob("*.json")] == ["open.json"]


def test_a_zip_of_pictures_or_annotations_is_an_input_as_its_folder_is(
    pictures, named, run_circlecal, in_this_process, tmp_path
):
    content = annotation_bytes(named.model_copy(update={"touched": True}))
    picture, given, alone = (pictures / "open.png").read_bytes(), tmp_path / "day.zip", tmp_path / "named.zip"
    given.write_bytes(zip_of(cam1__open_dot_png=picture, cam1__open_dot_json=content, notes_dot_txt="x"))
    alone.write_bytes(zip_of(open_dot_json=content))
    for name, zipped in (("cam1__open", given), ("open", alone)):
        out = tmp_path / name
        outcome = run_circlecal("calibrate", zipped, "--out", out, "--json", "--no-overlay")
        assert outcome.code == 0, outcome.err
        record = json.loads(outcome.out)
        assert (record["id"], record["status"]) == (name, "calibrated")
        assert ("1 files in it are neither pictures nor annotations" in outcome.err) == (zipped == given)
        command = ("batch", zipped, "--out", tmp_path / f"{name}-run", "--workers", 1, "-q")
        assert [run_circlecal(*command).code for _ in range(2)] == [0, 0]
        assert [r["id"] for r in records(tmp_path / f"{name}-run")] == [name]
    assert Path(records(tmp_path / "cam1__open-run")[0]["source"]["path"]).is_file(), "the report finds it"


_KINDS = ("broken", "encrypted", "large", "empty")


@pytest.mark.parametrize(
    ("command", "is_input", "kind"),
    [
        *((command, True, kind) for command in ("calibrate", "batch") for kind in _KINDS),
        *((command, False, kind) for command in ("calibrate", "batch", "debug") for kind in (*_KINDS, "several")),
    ],
)
def test_a_zip_that_cannot_be_taken_in_the_place_of_a_folder_is_one_line(
    pictures, run_circlecal, in_this_process, tmp_path, monkeypatch, command, is_input, kind
):
    content = bytearray(zip_of(a__x_dot_json=b'{"of": "sound"}', b__y_dot_json=b"{}"))
    if kind == "broken":
        content = bytearray(content.replace(b"sound", b"noise", 1))
    elif kind == "encrypted":
        content[content.index(b"PK\x01\x02") + 8] |= 1
    elif kind == "large":
        monkeypatch.setattr("circlecal.pictures.archives.MOST_BYTES", 10)
    elif kind == "empty":
        content = bytearray(zip_of(notes_dot_txt="x"))
    told = {
        "broken": "is no ZIP archive that can be read",
        "encrypted": "is encrypted; unpack it yourself, and give its folder",
        "large": "that are unpacked; unpack it yourself, and give its folder",
        "empty": "holds no picture, no video and no annotation" if is_input else "holds no file of annotations",
        "several": "holds annotations in 2 folders (a and b); give a ZIP of one of them",
    }
    (tmp_path / "x.zip").write_bytes(content)
    inputs = [tmp_path / "x.zip"] if is_input else [pictures / "open.png", "--annotations", tmp_path / "x.zip"]
    outcome = run_circlecal(command, *inputs, "--out", tmp_path / "out", "-q")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1), outcome
    assert "x.zip: " in outcome.err and told[kind] in outcome.err


@pytest.fixture
def robots(tmp_path) -> Path:
    """An annotation of a robots' field: circle, halfway line and far touchline, clicked."""
    field = load_field("robocup")
    camera = Camera(
        width=960,
        height=540,
        focal_px=np.array([700.0, 700.0]),
        principal_point_px=image_center(960, 540),
        angles_rad=np.radians([4.0, 70.0, 0.0]),
        position_m=np.array([0.5, 4.0, -1.6]),
        kappa=np.zeros(2),
    )
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = field.curve_points(field.circle_by_name["centre_circle"], "center", angle)
    line = np.array([[0.0, -2.0], [0.0, -1.0], [0.0, 1.0], [0.0, 2.0]])
    far = np.array([[x, field.line_by_name["side_line_top"].start[1]] for x in np.linspace(-3.0, 3.0, 8)])
    drawn = (("centre_circle", "curve", ring), ("halfway_line", "line", line), ("side_line_top", "line", far))
    markings = [
        {"name": name, "kind": kind, "points_px": camera.project(p).tolist(), "sigma_px": [0.5] * len(p)}
        for name, kind, p in drawn
    ]
    told = {"annotation_version": 1, "id": "robots", "width": 960, "height": 540, "field": "robocup"}
    path = tmp_path / "robots.json"
    path.write_text(json.dumps({**told, "touched": True, "markings": markings}))
    return path


def test_an_annotation_counts_on_the_field_it_was_made_on(robots, run_circlecal, tmp_path):
    """Where another one is named, it is no wrong camera that is answered, but a clear line."""
    command = ("calibrate", robots, "--json", "--no-overlay", "--out")
    free, named = (
        run_circlecal(*command, tmp_path / name, *given) for name, given in (("a", ()), ("b", ("--field", "robocup")))
    )
    told, again = (json.loads(outcome.out) for outcome in (free, named))
    assert told["field"]["template"] == again["field"]["template"] == "robocup"
    assert (
        told["camera"]["position_meters"]
        == again["camera"]["position_meters"]
        == pytest.approx([0.5, 4.0, -1.6], abs=0.3)
    )
    other = run_circlecal(*command, tmp_path / "c", "--field", "futsal")
    assert other.code == 2
    assert (
        "robots: was annotated on the field robocup, not on futsal; give --field robocup, or move the annotation away"
        in other.err
    )
    cv2.imwrite(str(robots.with_suffix(".png")), np.full((540, 960, 3), 90, np.uint8))
    beside = run_circlecal("calibrate", robots.with_suffix(".png"), "--json", "--no-overlay", "--out", tmp_path / "d")
    told = json.loads(beside.out)
    assert told["field"]["template"] == "robocup" and told["annotation"]
    assert run_circlecal("debug", robots.with_suffix(".png"), "--out", tmp_path / "e", "-q").code == 0


def test_names_that_the_field_does_not_have_and_points_without_noise_are_told(robots, run_circlecal, tmp_path):
    said = json.loads(robots.read_text())
    command = ("calibrate", robots, "--no-overlay", "--out", tmp_path / "a")
    moon = {"name": "moon", "kind": "line", "points_px": [[350.0, 299.0], [450.0, 310.0]], "sigma_px": [0.5, 0.5]}
    robots.write_text(json.dumps({**said, "markings": [*said["markings"], moon]}))
    told = run_circlecal(*command)
    assert "moon: is no marking of the field 'robocup'; left out" in " ".join(told.err.split())
    robots.write_text(json.dumps({**said, "markings": [{**moon, "sigma_px": [0.5, 1e-300]}]}))
    told = run_circlecal(*command)
    assert (told.code, told.err.count("\n")) == (2, 1)
    assert "markings.0.sigma_px.1: should be greater than or equal to 0.0001, not 1e-300" in told.err


@pytest.mark.parametrize("sigma_px", [0.2, 20.0])
def test_a_clicked_point_has_its_own_standard_deviation(robots, run_circlecal, tmp_path, sigma_px):
    said = json.loads(robots.read_text())
    mark = {"name": "centre_mark", "kind": "point", "points_px": [[350.0, 299.0]], "sigma_px": [sigma_px]}
    robots.write_text(json.dumps({**said, "markings": [*said["markings"], mark]}))
    outcome = run_circlecal("calibrate", robots, "--json", "--no-overlay", "--out", tmp_path / "a")
    (told,) = json.loads(outcome.out)["observations"]["marks"]
    assert told["sigma_px"] == sigma_px


def test_what_a_person_said_of_a_frame_counts_in_its_file_alone(robots, run_circlecal, tmp_path):
    said = json.loads(robots.read_text())
    robots.write_text(json.dumps({**said, "flag": "other_camera"}))
    outcome = run_circlecal("calibrate", robots, "--json", "--no-overlay", "--out", tmp_path / "a")
    assert outcome.code == 1 and json.loads(outcome.out)["code"] == "other_camera"
    robots.write_text(json.dumps({**said, "field": "nowhere.yaml"}))
    outcome = run_circlecal("calibrate", robots, "--no-overlay", "--out", tmp_path / "b")
    assert outcome.code == 2
    assert "robots: its field cannot be read" in outcome.err
    # of several pictures the others are shown
    for name in ("robots", "plain"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((540, 960, 3), 90, np.uint8))
    pictures = tmp_path / "robots.png", tmp_path / "plain.png"
    outcome = run_circlecal("debug", *pictures, "--out", tmp_path / "c")
    assert outcome.code == 2
    assert "robots: its field cannot be read" in outcome.err
    assert (tmp_path / "c" / "plain" / "result.json").is_file()


def test_annotations_of_other_programs_beside_pictures_are_said_to_be_ignored(pictures, run_circlecal, tmp_path):
    (pictures / "open.json").write_text('{"Side line top": [{"x": 0.1, "y": 0.2}, {"x": 0.9, "y": 0.2}]}')
    command = ("calibrate", pictures / "open.png", "--out", tmp_path / "out", "--no-overlay")
    told = run_circlecal(*command)
    assert told.code == 1
    assert f"{pictures / 'open.json'}: an annotation beside its picture is not used" in told.err.replace("\n", "")
    assert "is not used" not in run_circlecal(*command, "--keypoints", pictures).err


@pytest.mark.parametrize("name", ["cvat", "labelstudio", "coco", "labelme", "soccernet"])
def test_a_refused_frame_goes_out_with_what_was_measured(pictures, run_circlecal, tmp_path, name):
    out = tmp_path / "out"
    assert run_circlecal("calibrate", pictures / "open.png", "--out", out, "--to", name, "-q", "--no-overlay").code == 1
    (path,) = [p for p in out.iterdir() if name in p.name]
    (frame,) = read_annotations(path, (960, 540), name)[1]
    assert {shape.label for shape in frame.shapes} == {"Circle central", "Line unknown"}


@pytest.mark.parametrize("program", ["cvat", "labelstudio", "labelme"])
def test_label_sets(run_circlecal, tmp_path, program):
    outcome = run_circlecal("convert", "--labels", program, "--out", tmp_path)
    assert outcome.code == 0, outcome.err
    (path,) = tmp_path.iterdir()
    assert "Small rect. right bottom" in path.read_text() and "Line unknown" in path.read_text()
    assert run_circlecal("convert", "--labels", "paper", "--out", tmp_path).code == 2
    for arguments in ((tmp_path,), ("--to", "coco")):
        assert run_circlecal("convert", *arguments, "--labels", program, "--out", tmp_path / "none").code == 2
    assert not (tmp_path / "none").exists()


def test_saved_annotations_are_whole_and_newer_ones_stay(named, tmp_path):
    store = AnnotationStore(tmp_path)
    saved = store.save(named, 0)
    assert parse_annotation(tmp_path / "open.json", (tmp_path / "open.json").read_bytes()) == saved
    with pytest.raises(NewerError):
        store.save(named, 0)
    assert store.path("../../etc/passwd").parent == tmp_path
    assert store.read("nobody") is None
