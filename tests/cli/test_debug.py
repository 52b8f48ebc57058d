"""``circlecal debug``: one picture per stage, for refused frames too."""

import json

import cv2
import numpy as np
import pytest

from circlecal.refusals import explain


def test_pictures_of_a_calibrated_frame(run_circlecal, frame_file, tmp_path):
    outcome = run_circlecal("debug", frame_file, "--out", tmp_path / "debug")
    assert outcome.code == 0, outcome
    names = sorted(p.name for p in (tmp_path / "debug" / "good").iterdir())
    assert names[0].startswith("01-mask")
    assert len([n for n in names if n[:2].isdigit()]) >= 8
    assert "contact-sheet.jpg" in names
    assert "result.json" in names
    assert str(tmp_path / "debug" / "good" / "contact-sheet.jpg") in outcome.out


def test_pictures_of_a_refused_frame(run_circlecal, blank_file, tmp_path):
    outcome = run_circlecal("debug", blank_file, "--out", tmp_path / "debug")
    assert outcome.code == 1
    folder = tmp_path / "debug" / "blank"
    assert (folder / "contact-sheet.jpg").is_file()
    assert json.loads((folder / "result.json").read_text())["status"] == "refused"


def test_several_pictures(run_circlecal, frame_file, blank_file, tmp_path):
    outcome = run_circlecal("debug", frame_file, blank_file, "--out", tmp_path / "debug")
    assert outcome.code == 1
    assert [line.split("\t")[0] for line in outcome.out.splitlines()[1:3]] == ["good", "blank"]
    assert {path.parent.name for path in (tmp_path / "debug").rglob("contact-sheet.jpg")} == {"good", "blank"}


def test_a_folder_or_a_bad_picture(run_circlecal, frame_file, tmp_path):
    outcome = run_circlecal("debug", frame_file.parent, "--out", tmp_path)
    assert (outcome.code, "takes pictures" in outcome.err) == (2, True)
    outcome = run_circlecal("debug", "https://127.0.0.1:1/x.jpg", "--out", tmp_path)
    assert (
        outcome.code,
        "https://127.0.0.1:1/x.jpg: is a URL; circlecal batch --files --set output.debug=true takes it" in outcome.err,
    ) == (2, True)
    (tmp_path / "clip.mp4").touch()
    outcome = run_circlecal("debug", tmp_path / "clip.mp4", frame_file, "--out", tmp_path / "beside")
    told = "clip.mp4: is a video; circlecal batch --files --set output.debug=true takes it"
    assert (outcome.code, told in outcome.err) == (2, True)
    assert (tmp_path / "beside" / "good" / "contact-sheet.jpg").is_file()
    (tmp_path / "empty.jpg").touch()
    outcome = run_circlecal("debug", tmp_path / "empty.jpg", frame_file, "--out", tmp_path / "debug")
    assert (outcome.code, "is empty" in outcome.err) == (2, True)
    assert (tmp_path / "debug" / "good" / "contact-sheet.jpg").is_file()


@pytest.fixture
def lines_picture(tmp_path):
    """Grass with two lines and no circle."""
    picture = np.full((540, 960, 3), (60, 130, 70), np.uint8)
    for start, end in (((0, 180), (960, 120)), ((100, 540), (700, 120))):
        cv2.line(picture, start, end, (240, 240, 240), 6, cv2.LINE_AA)
    return picture


def refused_record(run_circlecal, folder, picture):
    """Result of a refused picture and the names of what ``circlecal debug`` wrote."""
    cv2.imwrite(str(folder / "x.png"), picture)
    assert run_circlecal("debug", folder / "x.png", "--out", folder / "debug").code == 1
    return json.loads((folder / "debug" / "x" / "result.json").read_text()), {
        path.name for path in (folder / "debug" / "x").iterdir()
    }


def test_a_picture_without_a_circle_says_so(run_circlecal, lines_picture, tmp_path):
    """In words, and not with eight dark panels."""
    record, files = refused_record(run_circlecal, tmp_path, lines_picture)
    assert (record["code"], record["reason"]) == ("no_circle_found", "no circle is seen")
    assert record["help"] == explain("no_circle_found").help
    assert files == {"01-mask.jpg", "09-verdict.jpg", "contact-sheet.jpg", "result.json"}


def test_the_best_candidate_tells_its_gates(run_circlecal, frame_image, tmp_path):
    part = frame_image.copy()
    part[:, 250:] = np.clip(np.random.default_rng(0).normal((60, 130, 70), 2, part[:, 250:].shape), 0, 255)
    record, _ = refused_record(run_circlecal, tmp_path, part)
    failed = {check["name"]: check for check in record["checks"] if not check["passed"]}
    assert failed["painted_share"]["value"] < 0.5 < failed["painted_share"]["limit"]
