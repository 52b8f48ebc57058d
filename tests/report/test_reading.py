"""What is read of a run, and what is said of folders that hold none."""

import json

import pytest

from circlecal.errors import InputError
from circlecal.pictures.files import REPORT_FOLDER
from circlecal.records.log import RESULTS_NAME
from circlecal.report.reading import read_run
from tests.report.conftest import refused, write_run


def test_pictures_in_the_order_of_their_numbers_then_videos_by_time(tmp_path, named):
    video = [named(f"v{t}", source={"path": "match.mp4", "time_s": t}) for t in (90.0, 5.0)]
    run = read_run(write_run(tmp_path, [*video, named("f10"), named("f2"), refused("f1")]))
    assert [row.id for row in run.rows] == ["f1", "f2", "f10", "v5.0", "v90.0"]
    assert [row.time_s for row in run.rows[3:]] == [5.0, 90.0]
    assert run.digests == {"abc": 1, named("x")["config_digest"]: 4}


def test_a_row_has_the_figures_of_its_record(tmp_path, good_record):
    (row,) = read_run(write_run(tmp_path, [good_record])).rows
    assert row.sigma_px == pytest.approx(2.0 * good_record["camera"]["max_sigma_px"])  # 960 px wide
    assert row.sigma_m == good_record["camera"]["max_sigma_m"]
    assert row.case == 1
    assert row.rms_px == pytest.approx(2.0 * good_record["ellipses"][good_record["ellipses"]["primary"]]["rms_px"])


def test_pictures_of_several_sizes_are_compared_at_one_width(tmp_path, named):
    """A frame of 960 px width, and one of twice the size that is known equally well: its sigma has twice the pixels."""
    large = named("large", 8.0, image={"width": 1920, "height": 1080, "aspect": 1.0})
    rows = read_run(write_run(tmp_path, [named("small", 4.0), large])).rows
    assert [row.sigma_px for row in rows] == [8.0, 8.0]


def test_a_record_that_does_not_say_its_picture_size_has_that_of_its_lens(tmp_path, named):
    old = named("old", 4.0)
    middle = old["camera"]["principal_point"][0]
    del old["image"]
    nowhere = named("nowhere", 4.0, camera={**old["camera"], "principal_point": [1e30, None]}) | {"image": None}
    rows = {row.id: row for row in read_run(write_run(tmp_path, [old, nowhere])).rows}
    assert rows["old"].sigma_px == pytest.approx(4.0 * 1920.0 / round(2.0 * middle + 1.0))
    assert middle == pytest.approx(479.5, abs=10.0) and rows["nowhere"].sigma_px is None


def test_records_are_found_again(tmp_path, named):
    run = read_run(write_run(tmp_path, [named("ä"), named("b"), named("c", 7.5)]))
    for row in run.rows:
        assert run.record(row).id == row.id
    (tmp_path / RESULTS_NAME).write_text("")
    with pytest.raises(InputError, match="changed while"):
        run.record(run.rows[0])


def test_the_last_record_of_an_id_counts(tmp_path, named):
    run = read_run(write_run(tmp_path, [refused("a"), named("a")]))
    assert [row.status for row in run.rows] == ["calibrated"]


def test_a_folder_of_result_files(tmp_path, named):
    for name in ("b", "a"):
        (tmp_path / f"{name}.json").write_text(json.dumps(named(name)))
    (tmp_path / "camera_a.json").write_text('{"pan_degrees": 1.0}')
    (tmp_path / "coco.json").write_text("[]")
    assert [row.id for row in read_run(tmp_path).rows] == ["a", "b"]


def test_a_torn_last_line_is_left_out(tmp_path, named, caplog):
    write_run(tmp_path, [named("a")])
    with (tmp_path / RESULTS_NAME).open("a") as file:
        file.write('{"id": "b", "sta')
    assert [row.id for row in read_run(tmp_path).rows] == ["a"]
    assert "torn last line" in caplog.text


BROKEN = {
    "not JSON": ("{{\n", "line 2: is no result"),
    "no record": ("[1]\n", "line 2: is no result"),
    "no id": ('{"schema_version": 1, "status": "refused"}\n', "line 2: is no result: id is missing"),
    "unknown verdict": ('{"schema_version": 1, "id": "b", "status": "fine"}\n', "line 2: is no result: status"),
    "text for a number": (
        '{"schema_version": 1, "id": "b", "status": "refused", "case": "x"}\n',
        "line 2: is no result: case",
    ),
    "list for a mapping": (
        '{"schema_version": 1, "id": "b", "status": "refused", "camera": [1]}\n',
        "line 2: is no result",
    ),
    "newer version": ('{"schema_version": 99}\n', "line 2: has schema_version 99"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_line_is_named(tmp_path, run_circlecal, name):
    line, said = BROKEN[name]
    write_run(tmp_path, [refused("a")])
    with (tmp_path / RESULTS_NAME).open("a") as file:
        file.write(line)
    outcome = run_circlecal("report", tmp_path)
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1
    assert f"{RESULTS_NAME}, {said}" in outcome.err
    assert not (tmp_path / REPORT_FOLDER).exists()


def test_nothing_to_report(tmp_path, run_circlecal):
    (tmp_path / "empty").mkdir()
    (tmp_path / "none").mkdir()
    (tmp_path / "none" / RESULTS_NAME).write_text("")
    for folder, said in (("absent", "no such folder"), ("empty", "holds no results"), ("none", "holds no results")):
        outcome = run_circlecal("report", tmp_path / folder)
        assert (outcome.code, outcome.err.count("\n")) == (2, 1), outcome
        assert said in outcome.err
