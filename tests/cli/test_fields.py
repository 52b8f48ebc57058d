"""``circlecal fields``: the list, and a picture of each template."""

import cv2
import numpy as np
from typer.testing import CliRunner

from circlecal.cli.app import app
from circlecal.field import field_folder, field_names, load_field
from circlecal.overlay.template_picture import PAINT_BGR, draw_template


def test_every_template_is_drawn(tmp_path):
    result = CliRunner().invoke(app, ["fields", "--draw", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert sorted(path.stem for path in tmp_path.glob("*.png")) == field_names()
    assert all(cv2.imread(str(path)).std() > 5 for path in tmp_path.glob("*.png"))


def test_templates_of_one_name_are_drawn_apart(tmp_path, run_circlecal):
    mine = tmp_path / "mine.yaml"
    mine.write_text((field_folder() / "futsal.yaml").read_text())
    assert run_circlecal("fields", mine, "futsal", "--draw", tmp_path / "drawn").code == 0
    assert sorted(path.name for path in (tmp_path / "drawn").iterdir()) == ["futsal-2.png", "futsal.png"]


def test_a_file_in_place_of_the_folder(tmp_path, run_circlecal):
    (tmp_path / "file").touch()
    outcome = run_circlecal("fields", "--draw", tmp_path / "file")
    told = f"circlecal: error: {tmp_path / 'file'}: is a file, not a folder; choose another --draw\n"
    assert (outcome.code, outcome.err) == (2, told)


def test_lines_have_their_own_colour_and_width_and_discs_are_filled():
    rink = draw_template(load_field("ice-hockey-nhl"))
    rows = len(rink)
    across = rink[rows // 2 + rows // 5]
    red = np.count_nonzero((across == PAINT_BGR["red"]).all(axis=-1))
    blue = np.count_nonzero((across == PAINT_BGR["blue"]).all(axis=-1))
    assert 2 * 4 < blue < 2 * 14  # two lines of a foot
    assert red > 4
    house = draw_template(load_field("curling"))
    assert np.count_nonzero((house == PAINT_BGR["blue"]).all(axis=-1)) > 500


def test_what_cannot_be_calibrated_is_listed_as_such():
    result = CliRunner().invoke(app, ["fields"], env={"COLUMNS": "200"})
    line = next(line for line in result.output.splitlines() if "beach-soccer" in line)
    assert "cannot be calibrated" in line


def test_a_template_of_ones_own_is_checked(tmp_path, run_circlecal):
    mine = tmp_path / "mine.yaml"
    mine.write_text((field_folder() / "ice-hockey.yaml").read_text().replace("name: ice-hockey", "name: mine"))
    outcome = run_circlecal("fields", mine, "soccer")
    assert outcome.code == 0
    rows = [line.split("\t") for line in outcome.out.splitlines()]
    assert ["mine", "60 x 30 m", "0.05 m", "ice-hockey", "centre_circle", "4.5 m (outer edge)", "yes"] in rows
    assert {row[0] for row in rows[2:]} == {"mine", "soccer"}
    mine.write_text("name: mine")
    assert run_circlecal("fields", mine).code == 2


def test_all_missing_keys_of_a_template_are_listed_at_once(tmp_path, run_circlecal):
    mine = tmp_path / "mine.yaml"
    mine.write_text("name: mine\nsizes: {length: 10}\n")
    told = run_circlecal("fields", mine).err
    for part in ("title", "length_m", "default_circle", "halfway_line (a line's name, or null)", "circles are missing"):
        assert part in told
    text = (field_folder() / "futsal.yaml").read_text()
    mine.write_text("\n".join(line for line in text.splitlines() if not line.startswith("halfway_line:")))
    assert "mine.yaml: halfway_line (a line's name, or null) is missing" in run_circlecal("fields", mine).err
    assert run_circlecal("fields", "--draw", tmp_path / "drawn", "futsal").code == 0
    assert [path.name for path in (tmp_path / "drawn").iterdir()] == ["futsal.png"]


def test_a_template_with_an_unknown_configuration_is_told_by_its_own_name(tmp_path, run_circlecal):
    mine = tmp_path / "mine.yaml"
    text = (field_folder() / "handball.yaml").read_text()
    mine.write_text("\n".join("config: nosuch" if line.startswith("config:") else line for line in text.split("\n")))
    told = f"circlecal: error: {mine}: config: 'nosuch' is no file and no known name; known: annotations, basketball, "
    for command in (("fields", mine), ("config", "--set", f"field.template={mine}")):
        outcome = run_circlecal(*command)
        assert (outcome.code, outcome.out) == (2, "")
        assert outcome.err.startswith(told)
    mine.write_text(mine.read_text().replace("nosuch", "tribune"))
    assert run_circlecal("fields", mine).code == 0
