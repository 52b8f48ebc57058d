"""``circlecal debug``: one picture per stage, for refused frames too."""

import json


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
    (tmp_path / "empty.jpg").touch()
    outcome = run_circlecal("debug", tmp_path / "empty.jpg", "--out", tmp_path)
    assert (outcome.code, "is empty" in outcome.err) == (2, True)
