"""Many frames: every frame once, whatever happens to the run."""

import csv
import json
import os
import resource
import shutil
import signal
import subprocess
import sys

import cv2
import numpy as np
import pytest

from circlecal.batch import SUMMARY_NAME, BatchProgress, run_batch
from circlecal.batch import run as batch_run
from circlecal.batch.frames import FrameRun
from circlecal.config import Config, config_digest, load_config
from circlecal.errors import InputError
from circlecal.field.loading import field_folder
from circlecal.pictures.files import find_frames
from circlecal.records.index import ResultIndex
from circlecal.records.log import INDEX_NAME, RESULTS_NAME, Finished, ResultLog, read_records
from circlecal.records.writing import failure_record
from circlecal.results import Verdict
from circlecal.synthetic.sampling import render_frame
from tests.conftest import finish_here

from .runs import (
    PATIENCE_S,
    SURROUNDINGS,
    alive,
    assert_every_frame_once,
    batch_command,
    children,
    paint,
    records,
    start_signalling,
    stopped,
    wait_for,
)


def test_all_kinds_of_frames_resume_and_restart(run_circlecal, frame_file, blank_file, tmp_path, monkeypatch):
    folder, out = frame_file.parent, tmp_path / "out"
    (folder / "cut.jpg").write_bytes(cv2.imencode(".jpg", np.zeros((99, 99, 3), np.uint8))[1].tobytes()[:-9])
    outcome = run_circlecal("batch", folder, "--out", out, "--workers", 2, "--json")
    assert outcome.code == 1, outcome
    counts = json.loads(outcome.out)
    assert (counts["total"], counts["calibrated"], counts["refused"], counts["unreadable"]) == (3, 1, 2, 1)
    assert "3/3 frames, 1 calibrated, 2 refused" in outcome.err
    found = {r["id"]: r for r in records(out)}
    assert found["good"]["status"] == "calibrated"
    assert (found["cut"]["status"], found["cut"]["code"]) == ("refused", "unreadable_input")
    assert "truncated" in found["cut"]["reason"]
    assert sorted(p.name for p in out.iterdir()) == [INDEX_NAME, RESULTS_NAME, SUMMARY_NAME]

    before = (out / RESULTS_NAME).read_bytes()
    again = run_circlecal("batch", folder, "--out", out, "--workers", 2)
    assert again.code == 1
    assert again.out.startswith("3 frames: 1 calibrated, 2 refused (1 of them unreadable)")
    # what could not be read is tried again, since it may have been mended
    assert "(2 from before)" in again.err
    assert {r["id"]: r["code"] for r in records(out)} == {key: r["code"] for key, r in found.items()}
    whole = cv2.imencode(".jpg", np.zeros((99, 99, 3), np.uint8))[1].tobytes()
    (folder / "cut.jpg").write_bytes(whole)
    run_circlecal("batch", folder, "--out", out, "--workers", 2)
    mended = {r["id"]: r["code"] for r in records(out)}
    assert len(mended) == 3 and mended["cut"] not in (None, "unreadable_input")
    before = (out / RESULTS_NAME).read_bytes()
    run_circlecal("batch", folder, "--out", out, "--workers", 2)
    assert (out / RESULTS_NAME).read_bytes() == before

    other = run_circlecal("batch", folder, "--out", out, "--seed", 9)
    assert other.code == 2
    assert "another configuration" in other.err
    assert "--restart" in other.err
    assert (out / RESULTS_NAME).read_bytes() == before
    monkeypatch.setattr(batch_run, "_finish_frames", finish_here)
    restarted = run_circlecal("batch", folder, "--out", out, "--workers", 1, "--seed", 9, "--restart", "--quiet")
    assert (restarted.code, restarted.out, restarted.err) == (1, "", "")
    assert {r["seed"] for r in records(out)} == {9}


def test_same_answers_as_calibrate(run_circlecal, in_this_process, frame_file, tmp_path):
    single = run_circlecal("calibrate", frame_file, "--out", tmp_path / "one", "--json", "--no-overlay")
    run_circlecal("batch", frame_file.parent, "--out", tmp_path / "many", "--workers", 1, "--files", "--no-overlay")
    expected = json.loads(single.out)
    for record in (*records(tmp_path / "many"), json.loads((tmp_path / "many" / "good.json").read_text())):
        assert record["H_image_field"] == expected["H_image_field"]
        assert record["config_digest"] == expected["config_digest"]


def test_another_configuration_at_a_terminal_goes_to_a_folder_of_its_own(
    run_circlecal, in_this_process, tmp_path, monkeypatch
):
    frames, out = paint(tmp_path / "frames", 1), tmp_path / "out"
    run_circlecal("batch", frames, "--out", out, "--workers", 1)
    monkeypatch.setattr("circlecal.cli.console.can_ask", lambda: True)
    monkeypatch.setattr("typer.confirm", lambda question, err: str(tmp_path / "out-2") in question)
    outcome = run_circlecal("batch", frames, "--out", out, "--workers", 1, "--seed", 9)
    assert outcome.code == 1
    assert str(tmp_path / "out-2" / RESULTS_NAME) in outcome.out
    assert [record["seed"] for record in (*records(out), *records(tmp_path / "out-2"))] == [0, 9]
    monkeypatch.setattr("typer.confirm", lambda question, err: False)
    assert run_circlecal("batch", frames, "--out", out, "--seed", 9).code == 2
    assert not (tmp_path / "out-3").exists()


def test_other_inputs_for_all_frames_are_another_run(run_circlecal, in_this_process, frame_file, tmp_path):
    out, masks = tmp_path / "out", tmp_path / "given"
    masks.mkdir()
    cv2.imwrite(str(masks / "good.png"), np.zeros((540, 960), np.uint8))
    assert run_circlecal("batch", frame_file, "--out", out, "--workers", 1).code == 0
    assert config_digest(Config()) == records(out)[0]["config_digest"]
    for given in (["--mask", masks], ["--convention", "paint"], ["--size", "960x540"]):
        outcome = run_circlecal("batch", frame_file, "--out", out, "--workers", 1, *given)
        assert outcome.code == 2
        assert "another configuration or other inputs" in outcome.err
    masked = FrameRun(Config(), mask=masks).digest
    cv2.imwrite(str(masks / "more.png"), np.zeros((540, 960), np.uint8))
    assert FrameRun(Config(), mask=masks).digest != masked


def test_files_that_a_finished_run_does_not_have_are_told(run_circlecal, in_this_process, frame_file, tmp_path):
    command = "batch", frame_file, "--out", tmp_path / "out", "--workers", 1
    run_circlecal(*command)
    outcome = run_circlecal(*command, "--files")
    assert "its frames were done before, without files of their own; --restart writes them" in outcome.err
    assert run_circlecal(*command, "--files", "--restart").code == 0
    assert "done before" not in run_circlecal(*command, "--files").err


def test_another_picture_of_one_name_is_told(run_circlecal, in_this_process, frame_file, tmp_path):
    for folder, step in (("first", 1), ("copy", 1), ("second", 2)):
        (tmp_path / folder).mkdir()
        cv2.imwrite(str(tmp_path / folder / "x.png"), cv2.imread(str(frame_file))[::step, ::step])
    command = "batch", "--out", tmp_path / "out", "--workers", 1
    assert run_circlecal(*command, tmp_path / "first" / "x.png").code == 0
    outcome = run_circlecal(*command, tmp_path / "copy" / "x.png")
    assert outcome.code == 0 and "1 from before" in outcome.err
    outcome = run_circlecal(*command, tmp_path / "second" / "x.png")
    assert outcome.code == 2
    first, second = (tmp_path / folder / "x.png" for folder in ("first", "second"))
    assert f"holds the result of {first}, which has the name of {second}; use another --out" in outcome.err
    # also where the first one is gone, and where its file was replaced
    first.rename(tmp_path / "moved.png")
    assert run_circlecal(*command, second).code == 2
    first.write_bytes(second.read_bytes())
    outcome = run_circlecal(*command, first)
    assert outcome.code == 2 and f"holds the result of {first}, which has changed since; " in outcome.err
    assert run_circlecal(*command, tmp_path / "second" / "x.png", "--restart").code in (0, 1)


def test_a_mask_that_comes_changes_or_goes_counts_at_the_next_start(run_circlecal, in_this_process, tmp_path):
    (path,) = paint(tmp_path / "frames", 1).iterdir()
    out = tmp_path / "out"
    command = "batch", path.parent, "--out", out, "--workers", 1

    def start():
        outcome = run_circlecal(*command)
        (record,) = records(out)
        (row,) = csv.DictReader((out / SUMMARY_NAME).open())
        return record["source"]["mask"], row["mask"], "1 from before" in outcome.err

    assert start() == (None, "", False)
    assert start() == (None, "", True)
    beside, inside = path.with_name("f000.mask.png"), path.parent / "masks" / "f000.png"
    inside.parent.mkdir()
    for mask, shown in ((inside, 1), (beside, 1), (beside, 40)):
        cv2.imwrite(str(mask), np.eye(80, 120, dtype=np.uint8)[: 2 * shown].repeat(40 // shown, axis=0) * 255)
        size, name = mask.stat().st_size, mask.relative_to(path.parent).as_posix()
        told = {"path": name, "bytes": size}, f"{name} {size}"
        assert start() == (*told, False)
        assert start() == (*told, True)
    # a mask for all frames is another run; without it those beside count as before
    assert run_circlecal(*command, "--mask", beside).code == 2
    beside.unlink()
    inside.unlink()
    assert start() == (None, "", False)


def test_a_run_of_a_version_that_told_no_masks_goes_on(run_circlecal, in_this_process, tmp_path):
    frames, out = paint(tmp_path / "frames", 2), tmp_path / "out"
    cv2.imwrite(str(frames / "f000.mask.png"), np.eye(80, 120, dtype=np.uint8) * 255)
    command = "batch", frames, "--out", out, "--workers", 1
    run_circlecal(*command)
    lines = records(out)
    for line in lines:
        del line["source"]["mask"]
    (out / RESULTS_NAME).write_text("".join(json.dumps(line) + "\n" for line in lines))
    (out / INDEX_NAME).unlink()
    assert "2 from before" in run_circlecal(*command).err
    assert records(out) == lines


def test_a_picture_keeps_its_name_when_others_of_that_name_come(run_circlecal, in_this_process, frame_file, tmp_path):
    for folder in ("first", "second"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "x.png").write_bytes(frame_file.read_bytes())
    command = "batch", "--out", tmp_path / "out", "--workers", 1
    run_circlecal(*command, tmp_path / "first")
    outcome = run_circlecal(*command, tmp_path / "first", tmp_path / "second")
    assert outcome.code == 0 and outcome.out.startswith("2 frames: 2 calibrated")
    assert {r["id"]: r["source"]["path"] for r in records(tmp_path / "out")} == {
        "x": str(tmp_path / "first" / "x.png"),
        "second__x-png": str(tmp_path / "second" / "x.png"),
    }


@pytest.mark.parametrize("command", ["calibrate", "batch"])
@pytest.mark.parametrize(("name", "to"), [("camera_good", "soccernet"), ("coco", "coco"), ("good.labelme", "labelme")])
def test_a_result_and_a_file_of_another_program_of_one_name(run_circlecal, frame_file, tmp_path, command, name, to):
    frame_file.with_name(f"{name}.png").write_bytes(frame_file.read_bytes())
    files = ["--files"] if command == "batch" else []
    outcome = run_circlecal(command, frame_file.parent, "--out", tmp_path / "out", "--to", to, *files)
    assert outcome.code == 2
    told = f"{name}.json: would hold the result of {name}, and what --to {to} writes of"
    assert told in outcome.err and "rename the picture" in outcome.err
    assert not (tmp_path / "out" / f"{name}.json").exists()


def test_annotations_and_outside_formats_as_calibrate_writes_them(run_circlecal, in_this_process, frame_file, tmp_path):
    one, many, targets = tmp_path / "one", tmp_path / "many", ["soccernet", "labelme", "coco", "broadtrack", "pnlcalib"]
    options = [argument for name in targets for argument in ("--to", name)]
    run_circlecal("calibrate", frame_file, "--out", one, "--no-overlay", *options)
    annotation = tmp_path / "seen.json"
    annotation.write_bytes((one / "good.labelme.json").read_bytes())
    inputs = [frame_file, annotation, "--convention", "paint"]
    run_circlecal("calibrate", *inputs, "--out", one, "--no-overlay", *options)
    run_circlecal("batch", *inputs, "--out", many, "--workers", 1)
    assert run_circlecal("batch", *inputs, "--out", many, "--workers", 1, *options).code == 0
    assert {record["id"] for record in records(many)} == {"good", "seen"}
    written = {path.name for path in one.iterdir()} - {"good.json", "seen.json"}
    assert len(written) == 2 * 3 + 2
    for name in written:
        expected, found = (json.loads((folder / name).read_text()) for folder in (one, many))
        assert same(found, expected), name


def same(found, expected) -> bool:
    """Whether two JSON values agree but for the rounding of numbers."""
    if isinstance(expected, dict):
        return found.keys() == expected.keys() and all(same(found[key], expected[key]) for key in expected)
    if isinstance(expected, list):
        return len(found) == len(expected) and all(map(same, found, expected))
    return found == (pytest.approx(expected, rel=1e-6, abs=1e-6) if isinstance(expected, float) else expected)


def test_outside_formats_of_a_field_of_ones_own_that_pictures_told(run_circlecal, in_this_process, tmp_path):
    own, out = tmp_path / "mine.yaml", tmp_path / "out"
    own.write_text((field_folder() / "futsal.yaml").read_text().replace("name: futsal", "name: hall", 1))
    picture = render_frame("wood", np.random.default_rng(1), 960, 540).image
    cv2.imwrite(str(tmp_path / "hall.png"), picture)
    among = f"field.among=[soccer, {own}]"
    outcome = run_circlecal(
        "batch", tmp_path / "hall.png", "--field", "auto", "--set", among, "--out", out, "--to", "coco", "--quiet"
    )
    assert (outcome.code, outcome.err) == (0, "")
    (record,) = records(out)
    assert record["field"]["template"] == "hall"
    assert json.loads((out / "coco.json").read_text())["annotations"]


def test_keypoints_beside_pictures(run_circlecal, in_this_process, frame_file, tmp_path):
    one, many, keypoints = tmp_path / "one", tmp_path / "many", tmp_path / "keypoints"
    run_circlecal("calibrate", frame_file, "--out", keypoints, "--no-overlay", "--to", "labelme")
    given = [frame_file, "--keypoints", keypoints / "good.labelme.json", "--from", "labelme"]
    alone = run_circlecal("calibrate", *given, "--out", one, "--no-overlay", "--json")
    run_circlecal("batch", *given, "--out", many, "--workers", 1)
    assert records(many)[0]["H_image_field"] == json.loads(alone.out)["H_image_field"]
    assert records(many)[0]["config_digest"] == json.loads(alone.out)["config_digest"]


def test_an_index_that_is_lost_damaged_or_behind_is_made_anew(run_circlecal, in_this_process, tmp_path):
    frames, out = paint(tmp_path / "frames", 5), tmp_path / "out"
    run_circlecal("batch", frames, "--out", out, "--workers", 1)
    index, results = out / INDEX_NAME, out / RESULTS_NAME
    lines = results.read_bytes().splitlines(keepends=True)

    def resumed() -> str:
        outcome = run_circlecal("batch", frames, "--out", out, "--workers", 1)
        assert_every_frame_once(out, 5)
        return outcome.err

    index.unlink()
    assert "(5 from before)" in resumed()
    index.write_bytes(b"no database at all" * 100)
    assert "(5 from before)" in resumed()
    results.write_bytes(b"".join(lines[:2]))  # shorter than the index says
    assert "(2 from before)" in resumed()
    behind = index.read_bytes()
    with ResultLog(out) as log:
        log.index.clear()
    assert "(5 from before)" in resumed()
    results.write_bytes(b"".join(lines[:1]))
    index.unlink()
    assert "(1 from before)" in resumed()
    index.write_bytes(behind)
    assert "(5 from before)" in resumed()


def test_killed_in_the_middle_and_resumed(run_circlecal, in_this_process, tmp_path):
    count, done = 40, 3
    frames, out = paint(tmp_path / "frames", count), tmp_path / "out"
    script = tmp_path / "killed.py"
    run = start_signalling(batch_command(frames, out), script, after=done, number=signal.SIGSTOP, to="os.getpid()")
    wait_for(lambda: stopped(run.pid))
    workers = children(run.pid)
    run.send_signal(signal.SIGKILL)
    run.communicate(timeout=PATIENCE_S)
    wait_for(lambda: not any(alive(pid) for pid in workers))
    assert len(records(out)) == done
    with (out / RESULTS_NAME).open("ab") as file:
        file.write(b'{"id": "f040", "status": "calib')  # a line torn by the kill
    resumed = run_circlecal("batch", frames, "--out", out)
    assert resumed.code == 1, resumed
    assert f"({done} from before)" in resumed.err
    assert_every_frame_once(out, count)


# a terminal sends Ctrl-C to the workers, too; a scheduler asks the command alone to end
@pytest.mark.parametrize(("number", "to", "workers"), [(signal.SIGINT, 0, "2"), (signal.SIGTERM, "os.getpid()", "1")])
def test_interrupted_and_resumed(run_circlecal, in_this_process, tmp_path, number, to, workers):
    count, done = 40, 3
    frames, out = paint(tmp_path / "frames", count), tmp_path / "out"
    command = batch_command(frames, out, "--workers", workers)
    run = start_signalling(command, tmp_path / "interrupted.py", after=done, number=number, to=to)
    _, errors = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 130, errors
    assert "Traceback" not in errors and "leaked" not in errors
    assert errors.splitlines()[-1] == "circlecal: interrupted; the same command goes on"
    assert len(records(out)) == done
    assert (out / SUMMARY_NAME).is_file()
    assert run_circlecal("batch", frames, "--out", out, "-q").code == 1
    assert_every_frame_once(out, count)


def test_a_full_disk_in_the_middle_and_resumed(run_circlecal, in_this_process, tmp_path):
    count = 40
    frames, out = paint(tmp_path / "frames", count), tmp_path / "out"

    def limit_file_size() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (12_000, 12_000))

    full = subprocess.run(
        batch_command(frames, out),
        capture_output=True,
        text=True,
        check=False,
        # compiled modules would be cut off, too, and break whoever imports them next
        env={**SURROUNDINGS, "PYTHONDONTWRITEBYTECODE": "1"},
        preexec_fn=limit_file_size,
    )
    assert full.returncode == 2
    errors = [line for line in full.stderr.splitlines() if line.startswith("circlecal: error: ")]
    assert len(errors) == 1
    assert f"{out / RESULTS_NAME}: cannot be written" in errors[0]
    assert "Traceback" not in full.stderr
    assert 0 < len(records(out)) < count
    assert run_circlecal("batch", frames, "--out", out, "-q").code == 1
    assert_every_frame_once(out, count)


def unreadable(name):
    return failure_record(name, f"{name}.png", Verdict("refused", "unreadable_input", "is empty", "input"), 0, "digest")


def test_a_line_cut_by_a_full_disk_is_taken_back(tmp_path, monkeypatch):
    with ResultLog(tmp_path) as log:
        log.append(Finished.of(unreadable("a")))
        whole = os.write

        def short(descriptor: int, content: bytes) -> int:
            if len(content) > 10:
                return whole(descriptor, content[:10])
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("os.write", short)
        with pytest.raises(InputError, match="No space left"):
            log.append(Finished.of(unreadable("b")))
    assert [record["id"] for record in records(tmp_path)] == ["a"]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_frame_whose_files_cannot_be_written_is_not_finished(run_circlecal, frame_file, tmp_path, workers):
    out = tmp_path / "out"
    (out / "good.json").mkdir(parents=True)  # in the way, as a disk that is full is
    command = ("batch", frame_file, "--out", out, "--files", "--no-overlay", "--workers", workers, "-q")
    outcome = run_circlecal(*command)
    assert outcome.code == 2
    assert "good.json: cannot be written" in outcome.err
    assert records(out) == []
    (out / "good.json").rmdir()
    assert run_circlecal(*command).code == 0
    assert [record["status"] for record in records(out)] == ["calibrated"]


@pytest.mark.parametrize("command", [("batch", "--files", "--workers", 1), ("calibrate",)])
def test_an_annotation_in_the_place_of_a_result_is_kept(run_circlecal, in_this_process, frame_file, command):
    other = frame_file.with_suffix(".json")
    other.write_text('{"shapes": []}')
    outcome = run_circlecal(*command, frame_file, "--out", frame_file.parent, "--no-overlay", "-q")
    assert outcome.code == 2 and "good.json: exists and is no result of circlecal" in outcome.err, outcome
    assert other.read_text() == '{"shapes": []}'


def test_a_damaged_line_in_the_middle_is_an_error(tmp_path):
    digest = config_digest(Config())
    good = json.dumps({"schema_version": 1, "id": "a", "status": "refused", "config_digest": digest})
    (tmp_path / RESULTS_NAME).write_text(f"{good}\nnonsense\n{good}\n")
    with ResultLog(tmp_path) as log, pytest.raises(InputError, match="line 2: is no result"):
        log.take_up(digest)


def test_a_damaged_line_that_the_index_covers_is_told_with_a_mend_that_works(run_circlecal, in_this_process, tmp_path):
    frames, out = paint(tmp_path / "frames", 3), tmp_path / "out"
    command = "batch", frames, "--out", out, "--workers", 1
    run_circlecal(*command)
    first, second, third = (out / RESULTS_NAME).read_bytes().splitlines(keepends=True)
    damaged = b"x" * (len(second) - 1) + b"\n"
    (out / RESULTS_NAME).write_bytes(first + damaged + third)
    outcome = run_circlecal(*command)
    assert outcome.code == 2
    assert "results.jsonl, line 2: is no result" in outcome.err
    assert outcome.err.endswith("; mend or remove that line, or start the run over with --restart\n")
    (out / RESULTS_NAME).write_bytes(first + third)
    assert run_circlecal(*command).code == 1
    assert_every_frame_once(out, 3)
    (out / RESULTS_NAME).write_bytes(first + damaged + third)
    assert run_circlecal(*command, "--restart").code == 1
    assert_every_frame_once(out, 3)


def test_why_nothing_can_be_read_is_told(run_circlecal, in_this_process, frame_file, tmp_path):
    broken = frame_file.with_name("broken.png")
    broken.write_bytes(b"no picture")
    outcome = run_circlecal("batch", broken, "--out", tmp_path / "one", "--workers", 1)
    assert outcome.code == 1
    assert f"circlecal: {broken}: is no JPEG, PNG" in outcome.err
    outcome = run_circlecal("batch", broken, frame_file, "--out", tmp_path / "two", "--workers", 1)
    assert outcome.code == 1 and "is no JPEG" not in outcome.err


def test_a_key_that_is_given_twice_in_a_line_is_named(tmp_path):
    digest = config_digest(Config())
    good = json.dumps({"schema_version": 1, "id": "a", "status": "refused", "config_digest": digest})
    edited = good.replace("{", '{"status": "calibrated", ')
    (tmp_path / RESULTS_NAME).write_text(f"{good}\n{edited}\n")
    words = r'line 2: the key "status" is given twice; keep one of the two$'
    with ResultLog(tmp_path) as log, pytest.raises(InputError, match=words):
        log.take_up(digest)
    with pytest.raises(InputError, match=words):
        list(read_records(tmp_path))


@pytest.mark.parametrize("tail", ['{"id": "b"', '{"id": "b", "status": "refused"}', "[", '"x"'])
def test_a_torn_last_line_is_cut_off(tmp_path, tail):
    digest = config_digest(Config())
    good = json.dumps({"schema_version": 1, "id": "a", "status": "refused", "config_digest": digest})
    (tmp_path / RESULTS_NAME).write_text(f"{good}\n{tail}")
    with ResultLog(tmp_path) as log:
        log.take_up(digest)
        assert [row.id for row in log.index.rows()] == ["a"]
    assert (tmp_path / RESULTS_NAME).read_text() == f"{good}\n"


def test_two_runs_in_one_folder(tmp_path):
    with ResultLog(tmp_path), pytest.raises(InputError, match="another run"):
        ResultLog(tmp_path)


def test_a_folder_that_cannot_be_written(run_circlecal, tmp_path):
    frames = paint(tmp_path / "frames", 1)
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "out"):
        outcome = run_circlecal("batch", frames, "--out", out)
        assert outcome.code == 2
        assert len(outcome.err.splitlines()) == 1
        assert str(out) in outcome.err


def test_a_worker_that_dies_costs_one_frame(tmp_path):
    frames = paint(tmp_path / "frames", 6)
    script = tmp_path / "script.py"
    script.write_text(
        "import os, sys\n"
        "from pathlib import Path\n"
        "import circlecal.batch.frames\n"
        "calibrate = circlecal.batch.frames.calibrate_frame\n"
        "def dying(frame, config, *more):\n"
        "    if frame.id == 'f003':\n"
        "        os._exit(9)\n"
        "    if frame.id == 'f001':\n"
        "        raise ValueError('a mistake of ours')\n"
        "    return calibrate(frame, config, *more)\n"
        "circlecal.batch.frames.calibrate_frame = dying\n"
        "if __name__ == '__main__':\n"
        "    from circlecal.cli import main\n"
        "    main(sys.argv[1:])\n"
    )
    out = tmp_path / "out"
    run = subprocess.run(
        [sys.executable, script, *batch_command(frames, out)[3:]],
        capture_output=True,
        text=True,
        check=False,
        env=SURROUNDINGS,
    )
    assert run.returncode == 1, run.stderr
    assert_every_frame_once(out, 6)
    assert [r["id"] for r in records(out) if r["code"] == "worker_died"] == ["f003"]
    assert [r["id"] for r in records(out) if r["code"] == "internal_error"] == ["f001"]


def test_a_name_that_is_no_text(run_circlecal, tmp_path):
    frames, out = paint(tmp_path / "frames", 1), tmp_path / "out"
    content = (frames / "f000.png").read_bytes()
    for name in (b"caf\xe9.png", b"th\xe9.jpg"):
        (frames / os.fsdecode(name)).write_bytes(content[: 900 if b"caf" in name else 9])
    for _ in range(2):
        assert run_circlecal("batch", frames, "--out", out, "--workers", 1, "-q").code == 1
        assert len(records(out)) == 3
    assert "caf\\udce9,refused" in (out / SUMMARY_NAME).read_text()


def test_ctrl_c_while_the_summary_is_written_leaves_the_old_one(run_circlecal, in_this_process, tmp_path, monkeypatch):
    frames, out = paint(tmp_path / "frames", 2), tmp_path / "out"
    run_circlecal("batch", frames, "--out", out, "--workers", 1)
    before, rows = (out / SUMMARY_NAME).read_bytes(), ResultIndex.rows

    def interrupted(index):
        yield next(rows(index))
        raise KeyboardInterrupt

    monkeypatch.setattr(ResultIndex, "rows", interrupted)
    paint(tmp_path / "frames", 3)
    outcome = run_circlecal("batch", frames, "--out", out, "--workers", 1)
    assert (outcome.code, outcome.err.splitlines()[-1]) == (130, "circlecal: interrupted; the same command goes on")
    assert (out / SUMMARY_NAME).read_bytes() == before
    assert sorted(p.name for p in out.iterdir()) == [INDEX_NAME, RESULTS_NAME, SUMMARY_NAME]
    monkeypatch.undo()
    run_circlecal("batch", frames, "--out", out, "--workers", 1)
    assert_every_frame_once(out, 3)


def test_progress_counts(in_this_process, tmp_path):
    frames = find_frames([paint(tmp_path / "frames", 3)])
    config = load_config(None, ["output.overlay=false"])
    seen: list[int] = []
    run = FrameRun(config)
    counts = run_batch(frames, run, tmp_path / "out", workers=1, on_progress=lambda p: seen.append(p.finished))
    assert seen == [0, 1, 2, 3]
    assert isinstance(counts, BatchProgress)
    assert (counts.total, counts.refused, counts.resumed) == (3, 3, 0)
    counts = run_batch(frames, run, tmp_path / "out", workers=1)
    assert (counts.finished, counts.resumed) == (3, 3)


def test_workers_of_a_cluster_find_annotations_from_another_folder(run_circlecal, frame_file, tmp_path, monkeypatch):
    """They run elsewhere, so a path that counts from here would be looked for there, and missed in silence."""
    shutil.copy(field_folder() / "soccer.yaml", tmp_path / "mine.yaml")
    given = []

    def take(frames, run, out, **options):
        given.append((run.annotations, out, run.config.field.template))
        raise InputError("far enough")

    monkeypatch.setattr("circlecal.batch.run_batch", take)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "named").mkdir()
    command = "batch", frame_file, "--annotations", "named", "--out", "out", "--field", "mine.yaml"
    run_circlecal(*command, "--scheduler", "tcp://127.0.0.1:1")
    assert given == [(tmp_path / "named", tmp_path / "out", str(tmp_path / "mine.yaml"))]
