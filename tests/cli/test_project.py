"""``circlecal project``: pixels to metres and back."""

import csv
import io
import json

import pytest

import circlecal
from circlecal.api.tables import SEVERAL_CLIPS
from circlecal.config import Config
from circlecal.field import load_field
from circlecal.pipeline import field_of, run
from circlecal.records.json_text import result_line, write_result
from circlecal.records.writing import result_record
from circlecal.tracking.records import RecordForm, record_of_track
from tests.tracking.scripted import LOST_FRAMES, tracked


@pytest.fixture(scope="module")
def result_file(tmp_path_factory, frame_image):
    path = tmp_path_factory.mktemp("result") / "good.json"
    write_result(path, result_record(run(frame_image, Config(), frame_id="good"), load_field("soccer")))
    return path


def test_there_and_back_with_negative_numbers(run_circlecal, result_file, frame_camera):
    outcome = run_circlecal("project", result_file, "--to", "image", "-9.15", "-2.5", 0, 0, "--json")
    assert outcome.code == 0, outcome
    lines = [json.loads(line) for line in outcome.out.splitlines()]
    assert lines[0]["m"] == [-9.15, -2.5]
    assert lines[0]["px"] == pytest.approx(frame_camera.project([-9.15, -2.5]), abs=1.0)
    assert lines[0]["sigma"] > 0
    back = run_circlecal("project", result_file, "--to", "field", *lines[0]["px"], "--json")
    assert json.loads(back.out)["m"] == pytest.approx([-9.15, -2.5], abs=1e-6)


def test_plain_table(run_circlecal, result_file):
    outcome = run_circlecal("project", result_file, "--to", "field", 480, 270, "1e2", 200)
    header, *rows = (line.split("\t") for line in outcome.out.splitlines())
    assert header[:5] == ["x px", "y px", "x m", "y m", "sigma m"]
    assert len(rows) == 2
    assert all(float(row[4]) > 0 for row in rows)


def test_sigma_holds_how_well_the_pixels_are_known_where_that_is_told(run_circlecal, result_file, tmp_path):
    record = json.loads(result_file.read_text())
    (tmp_path / "points.csv").write_text(f"frame,x,y\n{record['id']},480,270\n")

    def sigmas(*told):
        one = run_circlecal("project", result_file, "--to", "field", 480, 270, "--json", *told)
        table = run_circlecal(
            "project", result_file, "--to", "field", "--points", tmp_path / "points.csv", "--json", *told
        )
        return json.loads(one.out)["sigma"], json.loads(table.out)["sigma_m"]

    frame = circlecal.load(result_file)
    alone = float(frame.to_field([480, 270], sigma=True).sigma)
    clicked = float(frame.to_field([480, 270], sigma=True, point_sigma_px=2).sigma)
    assert clicked > 1.5 * alone
    assert sigmas() == pytest.approx((alone, alone))
    assert sigmas("--point-sigma", "2") == pytest.approx((clicked, clicked))
    for wrong, told in (("-1", "greater than"), ("inf", "finite"), ("two", "number")):
        outcome = run_circlecal("project", result_file, "--to", "field", 480, 270, "--point-sigma", wrong)
        assert outcome.code == 2 and told in outcome.err
    outcome = run_circlecal("project", result_file, "--to", "image", 0, 0, "--point-sigma", "2")
    assert outcome.code == 2 and "--to field" in outcome.err


def test_what_lies_outside_the_picture_is_noted(run_circlecal, result_file):
    """As where clicks were made in a larger picture than the one that was calibrated."""
    rows = run_circlecal("project", result_file, "--to", "field", -0.5, 300, 959.9, 300, 962, 300, "--json").out
    assert [json.loads(row).get("note") for row in rows.splitlines()] == [None, None, "outside the picture"]
    (row,) = run_circlecal("project", result_file, "--to", "image", 80, 0, "--json").out.splitlines()
    assert json.loads(row)["note"] == "outside the field and outside the picture"


def test_a_height_in_a_table_is_told_to_be_left_out(run_circlecal, result_file, tmp_path):
    (tmp_path / "points.csv").write_text("frame,x,y,z\nx,0,0,-2.44\n")
    for to, told in (("image", True), ("field", False)):
        outcome = run_circlecal("project", result_file, "--points", tmp_path / "points.csv", "--to", to)
        assert ("the column z is not read" in outcome.err) == told


def test_a_frame_without_the_circle_says_from_where_sigma_counts(run_circlecal, result_file, tmp_path):
    record = json.loads(result_file.read_text())
    size = {"length_m": 105.0, "width_m": 68.1, "length_sd_m": 1.8, "width_sd_m": 0.12}
    record["camera"]["field_size"] = size | {"is_usual": True, "usual_share": 0.9}
    record["camera"]["reference_by_growth"] = [0.5, 0.0]
    path = tmp_path / "goal.json"
    path.write_text(json.dumps(record))
    outcome = run_circlecal("project", path, "--to", "field", 480, 270)
    assert "sigma counts from the centre mark" in outcome.err
    assert "105.0 +- 1.8 x 68.10 +- 0.12 m" in outcome.err
    assert run_circlecal("project", result_file, "--to", "field", 480, 270).err == ""


def test_above_the_horizon_and_behind_the_camera(run_circlecal, result_file):
    outcome = run_circlecal("project", result_file, "--to", "field", 480, "-3000")
    assert outcome.code == 0
    assert "horizon" in outcome.out
    outcome = run_circlecal("project", result_file, "--to", "image", 0, 300, "--json")
    assert json.loads(outcome.out)["px"] is None
    assert "behind" in json.loads(outcome.out)["reason"]


def test_numbers_beyond_every_picture_give_no_warning(run_circlecal, result_file, recwarn):
    for to in ("field", "image"):
        outcome = run_circlecal("project", result_file, "--to", to, "1e308", "3", "-1e200", "1e308")
        assert (outcome.code, outcome.err) == (0, "")
    assert not recwarn.list


@pytest.mark.parametrize(
    ("key", "value"),
    [
        (("image", "width"), 10**400),
        (("case",), 10**400),
        (("case",), 4),
        (("seed",), -1),
        (("camera", "x_focal_length"), 1e200),
        (("camera", "position_meters", 0), -1e300),
    ],
)
def test_a_result_with_huge_numbers_is_damaged(run_circlecal, result_file, tmp_path, key, value):
    record = json.loads(result_file.read_text())
    part = record
    for name in key[:-1]:
        part = part[name]
    part[key[-1]] = value
    path = tmp_path / "huge.json"
    path.write_text(json.dumps(record))
    outcome = run_circlecal("project", path, "--to", "field", 1, 2)
    assert (outcome.code, outcome.out, len(outcome.err.splitlines())) == (2, "", 1)
    assert f"{path}: is no result: {'.'.join(map(str, key))}" in outcome.err


def test_a_refused_result(run_circlecal, blank_file, tmp_path):
    assert run_circlecal("calibrate", blank_file, "--out", tmp_path, "--no-overlay").code == 1
    outcome = run_circlecal("project", tmp_path / "blank.json", "--to", "field", 1, 2)
    assert outcome.code == 1
    assert len(outcome.err.splitlines()) == 1
    assert "refused" in outcome.err


@pytest.mark.parametrize("given", [("1",), ("1", "nan"), ("1", "2", "3")])
def test_odd_or_not_finite_numbers(run_circlecal, result_file, given):
    outcome = run_circlecal("project", result_file, "--to", "field", *given)
    assert outcome.code == 2
    assert "pairs" in outcome.err


def test_wrong_use(run_circlecal, result_file, tmp_path):
    assert run_circlecal("project", result_file, "1", "2").code == 2
    assert run_circlecal("project", result_file, "--to", "moon", "1", "2").code == 2
    assert run_circlecal("project", result_file, "--to", "field", "one", "2").code == 2
    assert run_circlecal("project", tmp_path / "none.json", "--to", "field", 1, 2).code == 2
    (tmp_path / "bad.json").write_text("{")
    assert run_circlecal("project", tmp_path / "bad.json", "--to", "field", 1, 2).code == 2


def test_a_table_of_points_over_a_run(run_circlecal, result_file, blank_file, tmp_path, monkeypatch):
    assert run_circlecal("calibrate", blank_file, "--out", tmp_path, "--no-overlay").code == 1
    (tmp_path / "good.json").write_bytes(result_file.read_bytes())
    rows = "frame,x,y\ngood,480,270\ngood,480,60\ngood,480,-3000\nblank,1,2\nnobody,1,2\n"
    (tmp_path / "points.csv").write_text(rows)
    outcome = run_circlecal("project", tmp_path, "--points", tmp_path / "points.csv", "--to", "field", "--json")
    assert outcome.code == 0, outcome.err
    found = [json.loads(line) for line in outcome.out.splitlines()]
    assert found[0]["sigma_m"] > 0 and found[0]["note"] is None
    assert [line["note"] for line in found[1:]] == [
        "outside the field", "on or above the horizon", "refused: no_circle_found", "no such frame"
    ]  # fmt: skip
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(rows.encode())))
    table = run_circlecal("project", tmp_path, "--points", "-", "--to", "field").out.splitlines()
    assert table[0] == "frame,x,y,x_m,y_m,sigma_m,note"
    assert table[2].endswith("outside the field") and len(table) == 6
    (tmp_path / "points.csv").write_text("frame,x,y\ngood,,\ngood,480,270\n'=good,1,2\n")
    outcome = run_circlecal("project", tmp_path, "--points", tmp_path / "points.csv", "--to", "field", "--json")
    seen, nobody, formula = (json.loads(line) for line in outcome.out.splitlines())
    assert (seen["x_px"], seen["note"]) == (None, "no point given") and nobody["sigma_m"] > 0
    assert (formula["frame"], formula["note"]) == ("=good", "no such frame")
    (tmp_path / "points.csv").write_text("frame,x,y\n17,480,270\n")
    outcome = run_circlecal("project", tmp_path, "--points", tmp_path / "points.csv", "--to", "field")
    assert outcome.code == 2 and "has none of its frames; the column frame holds their ids" in outcome.err
    (tmp_path / "points.csv").write_text("frame,x,y\ngood,1,two\n")
    outcome = run_circlecal("project", tmp_path, "--points", tmp_path / "points.csv", "--to", "field")
    assert outcome.code == 2 and "line 2: x and y must be numbers" in outcome.err and not outcome.out
    (tmp_path / "points.csv").write_text("frame,x\ngood,1\n")
    wrong = run_circlecal("project", tmp_path, "--points", tmp_path / "points.csv", "--to", "field")
    assert wrong.code == 2 and "no column 'y'" in wrong.err
    for names, told in (("frame.x.y", "separated by commas"), ("frame,x,y,x", "two columns 'x'")):
        (tmp_path / "points.csv").write_text(f"{names}\ngood,1,2,3\n")
        wrong = run_circlecal("project", tmp_path, "--points", tmp_path / "points.csv", "--to", "field")
        assert wrong.code == 2 and told in wrong.err
    (tmp_path / "points.csv").write_text(f"frame,x,y\ngood,1,2\n{'g' * 200_000},1,2\n")
    endless = run_circlecal("project", tmp_path, "--points", tmp_path / "points.csv", "--to", "field")
    assert endless.code == 2 and "points.csv, line 3: is no CSV table: field larger" in endless.err


def write_track(folder, **clips):
    """A run of tracked clips by their file names without the suffix; of each its numbers of frames."""
    form = RecordForm(*field_of(Config()), 0, "0" * 12)
    records = [
        record_of_track(tracked(index, index / 25.0), f"{clip}_00-00-00.{40 * index:03d}", f"{clip}.mp4", 0, form)
        for clip, indices in clips.items()
        for index in indices
    ]
    (folder / "results.jsonl").write_text("".join(result_line(record) + "\n" for record in records))


@pytest.fixture
def project_rows(run_circlecal, tmp_path):
    """Takes a table to the field with the run of the folder; lines of JSON."""

    def project(text):
        table = tmp_path / "points.csv"
        table.write_bytes(text if isinstance(text, bytes) else text.encode())
        outcome = run_circlecal("project", tmp_path, "--points", table, "--to", "field", "--json")
        assert outcome.code == 0, outcome.err
        return [json.loads(line) for line in outcome.out.splitlines()]

    return project


def test_frames_of_a_tracked_clip_are_named_by_their_numbers_too(project_rows, tmp_path):
    def project(*frames):
        return project_rows("frame,x,y\n" + "".join(f"{frame},160,120\n" for frame in frames))

    write_track(tmp_path, first=(3, 4, LOST_FRAMES[0]))
    by_number, as_float, other, lost, beyond, by_id = project(3, "4.0", 4, 7, 5, "first_00-00-00.120")
    assert by_number["x_m"] == by_id["x_m"] != other["x_m"] == as_float["x_m"]
    assert (by_number["frame"], as_float["frame"]) == ("3", "4.0")
    assert (lost["note"], beyond["note"]) == ("refused: lost", "no such frame")
    write_track(tmp_path, first=(3, 4), second=(3, 4, 6))
    both, longer, by_id = project(3, 6, "second_00-00-00.120")
    assert (both["x_m"], both["note"]) == (longer["x_m"], longer["note"]) == (None, SEVERAL_CLIPS)
    assert by_id["x_m"] == by_number["x_m"]


def test_a_column_names_the_clip_of_a_number(project_rows, tmp_path):
    write_track(tmp_path, **{"first": (3,), "second": (4,), "half/second": (4,)})
    rows = project_rows(
        "frame,x,y,video\n3,1,2,first.mp4\n4,1,2,first.mp4\n4,1,2,half/second.mp4\n4,1,2,second.mp4\n3,1,2,\n3,1,2,none\n"
    )
    no_frame = "no such frame"
    # the mere name of two files in two folders is that of both
    assert [row["note"] for row in rows] == [
        "outside the field",
        no_frame,
        "outside the field",
        *[SEVERAL_CLIPS] * 2,
        no_frame,
    ]
    assert rows[2]["video"] == "half/second.mp4"


@pytest.mark.parametrize(
    "missing", ["nan,nan", "NA,NA", "1,", ",1", "null,2", "-nan,-nan", " , ", "<NA>,1.5", "None,None"]
)
def test_a_row_that_lacks_a_number_has_no_point(project_rows, result_file, tmp_path, missing):
    (tmp_path / "good.json").write_bytes(result_file.read_bytes())
    none, seen = project_rows(f"frame,x,y\ngood,{missing}\ngood,480,270\n")
    assert (none["x_px"], none["y_px"], none["x_m"], none["note"]) == (None, None, None, "no point given")
    assert seen["sigma_m"] > 0


@pytest.mark.parametrize(
    "table",
    [
        b"\xef\xbb\xbfframe,x,y,who\ngood,480,270,M\xc3\xbcller\n",
        "frame\tx\ty\twho\ngood\t480\t270\tM\u00fcller\n".encode("utf-16"),
        "frame;x;y;who\r\ngood;480;270;M\u00fcller\r\n".encode(),
        'Frame,"X", Y ,who\ngood,480,270,M\u00fcller\n'.encode(),
    ],
)
def test_tables_as_spreadsheets_write_them(project_rows, run_circlecal, result_file, tmp_path, monkeypatch, table):
    (tmp_path / "good.json").write_bytes(result_file.read_bytes())
    (row,) = project_rows(table)
    assert (row["frame"], row["x_px"], row["who"]) == ("good", 480.0, "M\u00fcller") and row["sigma_m"] > 0
    assert list(row)[:3] == ["frame", "who", "x_px"]
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(table), encoding="ascii"))
    piped = run_circlecal("project", tmp_path, "--points", "-", "--to", "field", "--json")
    assert json.loads(piped.out) == row


@pytest.mark.parametrize("from_pipe", [False, True])
def test_a_table_that_is_no_unicode_is_refused_with_its_line(
    run_circlecal, result_file, tmp_path, monkeypatch, from_pipe
):
    content = "frame,x,y,who\ngood,480,270,a\ngood,480,270,M\u00fcller\n".encode("latin-1")
    points = tmp_path / "points.csv"
    points.write_bytes(content)
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(content)))
    outcome = run_circlecal("project", result_file, "--points", "-" if from_pipe else points, "--to", "field")
    name = "standard input" if from_pipe else points
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1)
    assert f"{name}, line 3: is not UTF-8 text (invalid start byte, 0xfc); save the table as UTF-8" in outcome.err


def test_the_rows_of_a_table_come_out_as_they_are(run_circlecal, result_file, tmp_path):
    points = tmp_path / "points.csv"
    points.write_text('player,frame,x,y,team\n7,good,480.123456789,270.0,"A, B"\n007,good,,\n8,\'=good,+1,2e2,=1+1\n')
    command = "project", result_file, "--points", points, "--to", "field"
    head, *rows = run_circlecal(*command).out.splitlines()
    assert head == "player,frame,x,y,team,x_m,y_m,sigma_m,note"
    assert rows[0].startswith('7,good,480.123456789,270.0,"A, B",') and rows[0].count(",") == 9
    assert rows[1:] == ["007,good,,,,,,,no point given", "8,'=good,+1,2e2,=1+1,,,,no such frame"]
    first, *_ = (json.loads(line) for line in run_circlecal(*command, "--json").out.splitlines())
    assert list(first) == ["player", "frame", "team", "x_px", "y_px", "x_m", "y_m", "sigma_m", "note"]
    assert (first["player"], first["team"], first["x_px"]) == ("7", "A, B", 480.123456789)


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_a_terminal_alone_gets_escapes(run_circlecal, result_file, tmp_path, monkeypatch, delimiter):
    odd = ["tab\there", "two\nlines", "two\r\nlines", "right\u200fleft", 'a "b"', "a,b;c"]
    text = io.StringIO(newline="")
    csv.writer(text, delimiter=delimiter).writerows([["frame", "x", "y", *"abcdef"], ["good", "1", "2", *odd]])
    (tmp_path / "points.csv").write_bytes(text.getvalue().encode())
    command = "project", result_file, "--points", tmp_path / "points.csv", "--to", "field"
    _, row = csv.reader(io.StringIO(run_circlecal(*command).out, newline=""), delimiter=delimiter)
    assert row[3:9] == odd
    monkeypatch.setattr("_pytest.capture.CaptureIO.isatty", lambda self: True)
    _, row = csv.reader(io.StringIO(run_circlecal(*command).out, newline=""), delimiter=delimiter)
    assert row[3:9] == [r"tab\there", r"two\nlines", r"two\r\nlines", r"right\u200fleft", *odd[4:]]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("frame,x,y,note\ngood,1,2,a\n", "points.csv, line 1: has a column 'note', which is written here; rename it"),
        ("frame,x,y\ngood,1,2,3\n", "points.csv, line 2: has 4 cells for 3 columns; quote cells that hold a comma"),
    ],
)
def test_a_table_to_whose_rows_nothing_can_be_added(run_circlecal, result_file, tmp_path, text, told):
    (tmp_path / "points.csv").write_text(text)
    outcome = run_circlecal("project", result_file, "--points", tmp_path / "points.csv", "--to", "field")
    assert (outcome.code, outcome.out) == (2, "") and told in outcome.err


def test_a_calibrated_record_without_its_picture_size_says_which_key_is_missing(run_circlecal, result_file, tmp_path):
    record = json.loads(result_file.read_text())
    del record["image"]
    path, points = tmp_path / "bare.json", tmp_path / "points.csv"
    path.write_text(json.dumps(record))
    points.write_text("frame,x,y\ngood,1,2\n")
    outcome = run_circlecal("project", path, "--to", "field", 1, 2)
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "good is calibrated, but the key image is missing; calibrate the frame again" in outcome.err
    assert "the key image is missing" in run_circlecal("project", path, "--points", points, "--to", "field").out
