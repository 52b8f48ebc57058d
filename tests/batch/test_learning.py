"""What the calibrated frames of a run tell those that were refused."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from circlecal.batch import learning, run_batch
from circlecal.batch.frames import FrameRun
from circlecal.batch.learning import Lesson, learn, learn_from
from circlecal.config import load_config
from circlecal.errors import InputError
from circlecal.pictures.files import find_frames
from circlecal.records.parts import FieldRecord, PaintRecord, SourceRecord
from circlecal.records.record import ResultRecord, ResultRow
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import sample_scene

from .runs import records

FLOOR, PAINT = (150.0, 180.0, 210.0), (60.0, 165.0, 190.0)
"""Yellow lines that are nearly as light as their wooden floor."""
CLEAR, NOISY = (10, 4), (9, 11)
"""Views of a hall: two by a camera with little noise, two by one with much."""


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    """Pictures of one hall, and where the middle and four points of the circle are in each."""
    folder, seen = tmp_path_factory.mktemp("hall"), {}
    points = np.array([[0.0, 0.0], [3.0, 0.0], [-3.0, 0.0], [0.0, 3.0], [0.0, -3.0]])
    for number in (*CLEAR, *NOISY):
        rng = np.random.default_rng([77, number])
        scene = sample_scene("wood", rng, 640, 360)
        look = {"turf_bgr": FLOOR, "paint_bgr": PAINT, "gloss": 0.1, "patchiness": 0.02, "texture": 0.015}
        noise = 0.6 if number in CLEAR else 6.0
        scene = replace(scene, config=scene.config.model_copy(update={**look, "noise": noise}), extras=())
        cv2.imwrite(str(folder / f"f{number}.png"), render(scene, rng).image)
        seen[f"f{number}"] = points, scene.camera.project(scene.surface.lift(points))
    return folder, seen


def run_hall(folder: Path, out: Path, *settings: str, backwards: bool = False) -> dict[str, dict]:
    frames = find_frames([folder])
    # the frames' own look at the colours of the floor would find these lines, too
    config = load_config("futsal", ["learning.least_frames=2", "mask.tell_paints=false", *settings])
    again: list[tuple[int, int]] = []
    is_new = not (out / "results.jsonl").exists()
    told = frames[::-1] if backwards else frames
    counts = run_batch(told, FrameRun(config), out, workers=1, on_again=lambda *step: again.append(step))
    found = {record["id"]: record for record in records(out)}
    assert (counts.finished, counts.calibrated) == (4, sum(r["status"] == "calibrated" for r in found.values()))
    # calibrating refused frames again has its own count
    assert again == [(k + 1, len(again)) for k in range(len(again))]
    if is_new:
        assert len(again) == sum(r.get("learnt") is not None for r in found.values())
    return found


@pytest.fixture(scope="module", autouse=True)
def _in_this_process(module_in_this_process):
    """No test here starts a worker."""


@pytest.fixture(scope="module")
def told_folder(hall, tmp_path_factory):
    """Where the hall was run once; no test writes to it."""
    folder = tmp_path_factory.mktemp("told")
    run_hall(hall[0], folder)
    return folder


@pytest.fixture(scope="module")
def told(told_folder):
    return {record["id"]: record for record in records(told_folder)}


def test_frames_that_fail_alone_pass_with_the_paint_of_the_others(hall, told, tmp_path):
    alone = run_hall(hall[0], tmp_path / "alone", "learning.enabled=false")
    assert {name for name, r in alone.items() if r["status"] == "calibrated"} == {f"f{k}" for k in CLEAR}
    assert {r["status"] for r in told.values()} == {"calibrated"}
    for number in CLEAR:
        assert told[f"f{number}"].get("learnt") is None
        assert told[f"f{number}"]["H_image_field"] == alone[f"f{number}"]["H_image_field"]
    for number in NOISY:
        name, learnt = f"f{number}", told[f"f{number}"]["learnt"]
        assert (learnt["taken"], learnt["frames"], learnt["field"]) == (True, 2, "futsal")
        assert learnt["alone"] == {key: alone[name][key] for key in ("status", "code", "reason")}
        blue, green, red = learnt["added_bgr"]
        assert blue < -40 < min(green, red)
        points, there = hall[1][name]
        view = ResultRecord.model_validate_json(json.dumps(told[name])).view
        off = np.linalg.norm(view.project(points) - there, axis=1)
        assert off.max() < 4.0 * max(told[name]["camera"]["max_sigma_px"], 0.5)


def test_files_of_frames_say_what_these_were_told(hall, told, tmp_path):
    config = load_config("futsal", ["learning.least_frames=2", "mask.tell_paints=false"])
    run_batch(find_frames([hall[0]]), FrameRun(config, out=tmp_path), tmp_path, workers=1)
    for record in records(tmp_path):
        file = json.loads((tmp_path / f"{record['id']}.json").read_text())
        assert file == record
        assert file["source"]["bytes"] == (hall[0] / f"{record['id']}.png").stat().st_size
        assert (tmp_path / f"{record['id']}.overlay.jpg").is_file()


def test_neither_order_nor_a_stop_changes_what_is_learnt(hall, told, told_folder, tmp_path):
    def answers(found):
        return {name: {k: v for k, v in r.items() if k != "timings_ms"} for name, r in found.items()}

    out = Path(shutil.copytree(told_folder, tmp_path / "told"))
    before = (out / "results.jsonl").read_bytes()
    assert answers(run_hall(hall[0], out)) == answers(told)
    assert (out / "results.jsonl").read_bytes() == before  # nothing was calibrated a third time
    # a run that was stopped before its last frames: they come back, and change what the others are told
    lines = before.splitlines(keepends=True)
    few = [line for line in lines if json.loads(line)["id"] in ("f4", "f5")]
    (out / "results.jsonl").write_bytes(b"".join(few))
    (out / "results.index").unlink()
    assert answers(run_hall(hall[0], out, backwards=True)) == answers(told)


def row(name: str, added: tuple[float, float, float], path: str = "hall/a.png", field: str = "futsal") -> ResultRow:
    paint = PaintRecord(added_bgr=added, polarity="light")
    template = FieldRecord(template=field, circle="centre_circle", sizes={})
    source = SourceRecord(path=path, time_s=None)
    return ResultRow(schema_version=1, id=name, status="calibrated", field=template, source=source, paint=paint)


HALL = str(Path("hall").absolute())


def test_only_frames_that_agree_tell_something():
    config = load_config("futsal")
    yellow = [row(str(k), (-60.0 - k, -10.0, -12.0)) for k in range(3)]
    assert learn(yellow, config) == {HALL: Lesson("futsal", (-61.0, -10.0, -12.0), 3)}
    assert learn(yellow[::-1], config) == learn(yellow, config)
    assert learn(yellow[:2], config) == {}
    assert learn([*yellow, row("odd", (80.0, -30.0, 10.0))], config)[HALL].frames == 3
    assert learn([*yellow, *(row(f"odd{k}", (80.0, -30.0, 10.0)) for k in range(2))], config) == {}
    assert learn([*yellow[:2], row("elsewhere", (-60.0, -10.0, -12.0), "other/a.png")], config) == {}
    # a start from the folder's own place, and one that names it whole
    whole = [row(str(k), (-60.0 - k, -10.0, -12.0), f"{HALL}/a.png" if k else "hall/a.png") for k in range(3)]
    assert learn(whole, config) == learn(yellow, config)
    # brightness shows white lines as well
    assert learn([row(str(k), (90.0, 80.0, 85.0)) for k in range(5)], config) == {}


def test_with_auto_the_field_of_the_run_is_learnt_too():
    auto = load_config(None, ["field.template=auto"])
    white = [row(str(k), (90.0, 80.0, 85.0)) for k in range(3)]
    assert learn(white, auto)[HALL].field == "futsal"
    assert learn([*white, row("other", (90.0, 80.0, 85.0), field="handball")], auto) == {}
    assert learn([row(str(k), (90.0, 80.0, 85.0), field="soccer") for k in range(3)], auto) == {}


def test_a_mask_or_a_colour_that_is_given_leaves_nothing_to_learn(tmp_path):
    yellow = [row(str(k), (-60.0, -10.0, -12.0)) for k in range(3)]
    config = load_config("futsal")
    assert learn_from(FrameRun(config), yellow) is not None
    assert learn_from(FrameRun(config, mask=tmp_path), yellow) is None
    assert learn_from(FrameRun(load_config("futsal", ["mask.paint_bgr=[1,2,3]"])), yellow) is None
    assert learn_from(FrameRun(load_config("futsal", ["learning.enabled=false"])), yellow) is None


def test_what_cannot_be_read_again_keeps_its_record(hall, told_folder, tmp_path, monkeypatch):
    lost = []

    def lose(record):
        lost.append(record.id)
        raise InputError(f"{record.id}: is gone")

    monkeypatch.setattr(learning, "picture_of_record", lose)
    # the frames that tell the colour are finished, the others come now
    lines = (told_folder / "results.jsonl").read_bytes().splitlines(keepends=True)
    clear = [line for line in lines if json.loads(line)["id"] in {f"f{k}" for k in CLEAR}]
    (tmp_path / "results.jsonl").write_bytes(b"".join(clear))
    found = run_hall(hall[0], tmp_path)
    assert set(lost) == {f"f{k}" for k in NOISY}
    for number in NOISY:
        assert found[f"f{number}"]["code"] not in (None, "unreadable_input")
