"""What one server holds: a search for names ends as soon as something else is asked."""

import json
import re
import threading
import zipfile
from collections import Counter
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from videos import HEIGHT, WIDTH, write_video

from circlecal.config import Config
from circlecal.errors import InputError
from circlecal.formats.annotation import AnnotatedMarking, Annotation, annotation_bytes, find_annotation
from circlecal.formats.paint_list import LIST_NAME
from circlecal.pictures.archives import unpack
from circlecal.pictures.limits import DEFAULT_LIMITS, LimitsConfig
from circlecal.pictures.video import Sampling
from circlecal.workbench import session as module
from circlecal.workbench.frames import UNPACKED_FOLDER, list_frames, take_part, unpack_inputs
from circlecal.workbench.session import Session
from circlecal.workbench.store import LOCK_NAME, AnnotationStore, NewerError
from tests.workbench.conftest import zip_of


def test_parts_hold_every_frame_once_and_keep_it_when_frames_join(folder):
    frames = list_frames([str(folder)], Sampling.parse("1s"), DEFAULT_LIMITS)
    assert take_part(frames, None) == frames
    many = [replace(frames[0], file=replace(frames[0].file, id=f"frame_{k:03d}")) for k in range(200)]
    parts = [take_part(many, f"{k}/3") for k in (1, 2, 3)]
    assert sorted(frame.file.id for part in parts for frame in part) == [frame.file.id for frame in many]
    assert min(map(len, parts)) > 50
    joined = [replace(frames[0], file=replace(frames[0].file, id=f"a_{k}")) for k in range(5)]
    for k, part in enumerate(parts, start=1):
        # in any order, and whatever else is in the folder
        assert [f for f in take_part([*joined, *many[::-1]], f"{k}/3") if f in part] == part


@pytest.mark.parametrize(
    ("part", "told"), [("3/2", "such as 2/4"), ("0/2", "such as"), ("half", "such as"), ("1/99999", "3 frames")]
)
def test_a_part_that_is_none_is_refused(folder, part, told):
    with pytest.raises(InputError, match=told):
        take_part(list_frames([str(folder)], Sampling.parse("1s"), DEFAULT_LIMITS), part)


@pytest.mark.parametrize("asked", ["show", "save", "interpretations"])
def test_a_search_for_names_ends_when_something_else_is_asked(folder, tmp_path, monkeypatch, asked):
    frames = list_frames([str(folder / "open.png")], Sampling.parse("1s"), DEFAULT_LIMITS)
    session = Session(frames, AnnotationStore(tmp_path), Config())
    begun, wanted = session.annotation(0), []

    def interpret(annotation, measured, config, *, is_wanted):
        wanted.append(is_wanted())
        if len(wanted) == 1:
            given = {"show": (), "interpretations": (), "save": (begun, begun.revision)}[asked]
            getattr(session, asked)(0, *given)
            wanted.append(is_wanted())
        return []

    monkeypatch.setattr(module, "interpret", interpret)
    session.interpretations(0)
    assert (wanted[0], wanted[-1]) == (True, False)


def test_few_huge_pictures_are_held(folder, tmp_path, monkeypatch):
    session = Session(
        list_frames([str(folder)], Sampling.parse("1s"), DEFAULT_LIMITS), AnnotationStore(tmp_path), Config()
    )
    monkeypatch.setattr(module, "HELD_PIXELS", 2 * 960 * 540)
    first, *_, last = [session.open(k) for k in range(3)]
    assert session.open(2) is last and session.open(0) is not first


def begin(out: Path, *inputs: Path) -> Session:
    frames = list_frames([str(path) for path in inputs], Sampling.parse("1s"), DEFAULT_LIMITS)
    return Session(frames, AnnotationStore(out), Config())


def number_of(session: Session, name: str) -> int:
    return next(k for k, frame in enumerate(session.frames) if frame.file.id == name)


def test_a_frame_that_others_helped_keeps_its_place_when_it_is_looked_at(folder, tmp_path):
    listed = list_frames([str(folder / "open.png")], Sampling.parse("1s"), DEFAULT_LIMITS)
    assert Session(listed, AnnotationStore(tmp_path), Config()).show(0)["row"][1] == "refused"
    of_run = [replace(frame, state="calibrated", sigma_px=1.5) for frame in listed]
    session = Session(of_run, AnnotationStore(tmp_path), Config())
    assert session.show(0)["row"][1:4] == ["calibrated", None, 1.5]
    begun = session.annotation(0)
    assert session.save(0, begun.model_copy(update={"confirmed": True}), 0)["row"][1] == "refused", (
        "what a person changed"
    )


def annotate(out: Path, name: str, source: Path | None = None) -> Annotation:
    """A saved annotation of a picture of 960 x 540 with one clicked line."""
    ends = AnnotatedMarking(name="side_line_top", kind="line", points_px=[[9, 200], [900, 220]], sigma_px=[0.5, 0.5])
    told = Annotation(id=name, source=source and str(source), width=960, height=540, markings=[ends])
    return AnnotationStore(out).save(told, 0)


def test_an_annotation_of_another_picture_of_the_same_name_is_not_taken(folder, tmp_path, caplog):
    first, second, out = tmp_path / "a" / "x.png", tmp_path / "b" / "x.png", tmp_path / "out"
    for path, name in ((first, "good"), (second, "open")):
        path.parent.mkdir()
        path.write_bytes((folder / f"{name}.png").read_bytes())
    annotate(out, "x", first)
    session = begin(out, second)
    row = session.listing()[0]
    assert (row[1], row[2]) == ("refused", "unusable_annotation")
    with pytest.raises(InputError, match=rf"x\.json: is of {first}, not of {second}; give another --out"):
        session.show(0)
    assert find_annotation(out, "x", second) is None
    assert f"is of {first}, not of {second}, and is not used" in caplog.text
    assert find_annotation(out, "x", first) is not None
    second.write_bytes(first.read_bytes())  # a copy is the same picture
    assert find_annotation(out, "x", second) is not None
    assert begin(out, second).listing()[0][5]


def test_a_damaged_annotation_is_in_the_list_and_the_others_are_exported(folder, tmp_path):
    for name in ("good", "open"):
        annotate(tmp_path, name)
    damaged = tmp_path / "open.json"
    content = damaged.read_bytes()
    damaged.write_bytes(content[:200])
    session = begin(tmp_path, folder)
    index = number_of(session, "open")
    assert session.listing()[index][1:3] == ["refused", "unusable_annotation"]
    with pytest.raises(InputError, match=r"open\.json: .*; mend the file or move it away"):
        session.show(index)
    found = session.export("soccernet")
    with zipfile.ZipFile(BytesIO(found.content)) as archive:
        assert [name for name in archive.namelist() if "open" in name] == []
        assert archive.namelist() == ["good.json", LIST_NAME]
        assert "\ngood.json\n" in archive.read(LIST_NAME).decode()
    assert len(found.left_out) == 1 and "open.json" in found.left_out[0]
    damaged.write_bytes(content)
    assert session.show(index)["row"][2] != "unusable_annotation"


def test_what_was_clicked_stays_when_an_import_brings_the_same_marking(folder, tmp_path):
    annotate(tmp_path, "good")
    session = begin(tmp_path, folder / "good.png")
    line = {"Side line top": [{"x": 0.0, "y": 0.5}, {"x": 1.0, "y": 0.25}]}
    before = session.annotation(0)
    session.store.save(before.model_copy(update={"flag": "no_field"}), before.revision)
    told = session.take_in("good.json", json.dumps(line).encode())
    assert told["warnings"] == [
        "good: side line top: what was clicked here stays in the list, not used",
        "good: stays flagged no field; take the flag away to use it",
    ]
    clicked, imported = session.annotation(0).markings
    assert (clicked.points_px, clicked.used) == ([[9, 200], [900, 220]], False)
    assert (imported.source, imported.used) == ("imported", True)
    session.take_in("good.json", json.dumps(line).encode())
    assert [marking.used for marking in session.annotation(0).markings] == [False, True]


def test_two_servers_on_one_folder_never_save_over_each_other(tmp_path):
    annotation = annotate(tmp_path, "x")
    stores = [AnnotationStore(tmp_path) for _ in range(2)]
    for base in range(1, 41):
        outcomes = []
        changed = annotation.model_copy(update={"note": str(base)})

        def save(store: AnnotationStore, base: int = base, outcomes: list[str] = outcomes, changed=changed) -> None:
            try:
                store.save(changed, base)
                outcomes.append("saved")
            except NewerError:
                outcomes.append("newer")

        threads = [threading.Thread(target=save, args=(store,)) for store in stores]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(outcomes) == ["newer", "saved"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [LOCK_NAME, "x.json"]


def circles_of(width, names):
    """A COCO file of pictures without a size, with a circle in each."""
    angle = [0.1 * k for k in range(40)]
    ring = [v for a in angle for v in (width * (0.5 + 0.2 * np.cos(a)), width * (0.28 + 0.1 * np.sin(a)))]
    shape = {"category_id": 1, "segmentation": [ring]}
    return {
        "images": [{"id": k, "file_name": f"{stem}.png"} for k, stem in enumerate(names, start=1)],
        "annotations": [{"id": k, "image_id": k, **shape} for k in range(1, len(names) + 1)],
        "categories": [{"id": 1, "name": "centre_circle"}],
    }


def test_frames_of_a_file_that_does_not_say_how_large_they_are_have_their_own_sizes(folder, tmp_path):
    session = begin(tmp_path, folder)
    told = session.take_in("two.json", json.dumps(circles_of(960, ["good", "open"])).encode())
    assert told["taken"] == 2
    for name in ("good", "open"):
        (circle,) = [m for m in session.annotation(number_of(session, name)).markings if m.source == "imported"]
        assert np.ptp(circle.points, axis=0)[0] == pytest.approx(0.4 * 960, rel=0.02)


def test_the_workbench_exports_what_its_files_hold_and_no_flagged_frame_elsewhere(folder, tmp_path):
    for name in ("good", "open"):
        annotate(tmp_path, name)
    session = begin(tmp_path, folder)
    before = session.annotation(number_of(session, "open"))
    session.store.save(before.model_copy(update={"flag": "no_field", "note": "dark"}), before.revision)
    with zipfile.ZipFile(BytesIO(session.export("workbench").content)) as archive:
        assert archive.read("open.json") == (tmp_path / "open.json").read_bytes()
    found = session.export("coco")
    assert found.left_out == ["open: is flagged no field; left out"]
    assert [Path(image["file_name"]).stem for image in json.loads(found.content)["images"]] == ["good"]


def test_a_nameless_line_that_is_imported_again_is_there_once(folder, tmp_path):
    annotate(tmp_path, "good")
    session = begin(tmp_path, folder / "good.png")
    before = session.annotation(0)
    line = before.markings[0].model_copy(update={"name": None, "kind": "line"})
    content = annotation_bytes(before.model_copy(update={"markings": [*before.markings, line]}))
    for _ in range(3):
        session.take_in("good.json", content)
    assert [marking.name for marking in session.annotation(0).markings].count(None) == 1


def test_a_video_and_a_picture_beyond_the_limits_are_refused(folder, tmp_path):
    clip, small = write_video(tmp_path / "clip.avi", "MJPG", 2), LimitsConfig(max_pixels=WIDTH * HEIGHT - 1)
    with pytest.raises(InputError, match=rf"clip\.avi.*limits\.max_pixels={WIDTH * HEIGHT}"):
        list_frames([str(clip)], Sampling.parse("1s"), small)
    inputs, config = [str(clip), str(folder / "open.png")], Config(limits=small)
    session = Session(list_frames(inputs, Sampling.parse("1s"), DEFAULT_LIMITS), AnnotationStore(tmp_path), config)
    for index in range(2):
        with pytest.raises(InputError, match=r"limits\.max_pixels"):
            session.open(index)


def names(annotation):
    return [marking.name for marking in annotation.markings]


def test_only_a_change_of_the_content_makes_a_frame_annotated(folder, tmp_path):
    session = begin(tmp_path, folder / "good.png")
    begun = session.annotation(0)
    assert not session.save(0, begun, 0)["row"][5]
    assert not (tmp_path / "good.json").exists(), "nothing was said"
    wrong = begun.model_copy(update={"markings": begun.markings[:-1]})
    told = session.save(0, wrong, 0)
    assert told["row"][5] and told["annotation"]["touched"]
    told = session.save(0, wrong, 1)
    assert told["annotation"]["revision"] == 1, "the file stays as it is"
    told = session.save(0, begun, 1)
    assert not told["row"][5] and find_annotation(tmp_path, "good") is None, "it was undone"
    told = session.save(0, begun.model_copy(update={"confirmed": True}), 2)
    assert told["row"][5] and told["annotation"]["touched"]
    assert session.save(0, begun.model_copy(update={"confirmed": True, "note": "x"}), 3)["row"][5]
    assert session.save(0, begun.model_copy(update={"confirmed": True}), 4)["row"][5], "it was confirmed before"


def test_who_annotated_a_frame_and_when_is_in_its_file(folder, tmp_path):
    session = begin(tmp_path, folder / "good.png")
    begun = session.annotation(0)
    session.save(0, begun.model_copy(update={"note": "dark", "author": "Ada"}), 0)
    stored = json.loads((tmp_path / "good.json").read_text())
    assert stored["author"] == "Ada"
    assert re.fullmatch(r"20\d\d-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", stored["changed_at"])


def test_a_zip_of_annotations_is_taken_and_what_is_refused_leaves_nothing(folder, tmp_path):
    annotate(tmp_path / "other", "good")
    theirs = AnnotationStore(tmp_path / "other")
    saved = theirs.read("good")
    content = annotation_bytes(saved.model_copy(update={"note": "theirs", "author": "Bob"}))
    line = json.dumps({"Side line top": [{"x": 0.0, "y": 0.5}, {"x": 1.0, "y": 0.25}]})
    session = begin(tmp_path / "out", folder)
    given = zip_of(a__good_dot_json=content, b__open_dot_json=line, b__bad_dot_json="{", readme_dot_txt="x")
    told = session.take_in("both.zip", given)
    assert (told["taken"], told["unknown"]) == (2, 0)
    assert told["warnings"][0].startswith("b/bad.json: is not JSON")
    assert "1 other files" in told["warnings"][1]
    good, opened = (session.annotation(number_of(session, name)) for name in ("good", "open"))
    assert (good.note, good.author, names(good)) == ("theirs", "Bob", ["side_line_top"]), "as the other one made it"
    assert "side_line_top" in names(opened)
    assert [path.name for path in (tmp_path / "out" / "imported").iterdir()] == ["both.zip"]
    for name, broken in (("bad.json", b"{"), ("x.zip", b"PK not"), ("none.zip", zip_of(a_dot_txt="x"))):
        with pytest.raises(InputError, match=f"^{name}: "):
            session.take_in(name, broken)
    assert [path.name for path in (tmp_path / "out" / "imported").iterdir()] == ["both.zip"]


def test_a_zip_of_pictures_is_an_input_and_leads_nowhere_else(folder, tmp_path):
    pictures = zip_of(**{"..____..__cam1__good_dot_png": (folder / "good.png").read_bytes(), "notes_dot_txt": "x"})
    (tmp_path / "day.zip").write_bytes(pictures)
    out, told = tmp_path / "out", []
    for _ in range(2):
        given, annotated = unpack_inputs(
            [str(tmp_path / "day.zip"), "other"], out / UNPACKED_FOLDER, tmp_path / "aside", told.append
        )
    assert (given, annotated) == ([str(out / "frames" / "day"), "other"], [])
    assert "the path ..//../cam1/good.png leads out of the archive" in told[0]
    assert "day.zip: 1 files in it are neither pictures nor annotations" in told[1] and len(told) == 4
    assert [str(p.relative_to(tmp_path)) for p in out.rglob("*") if p.is_file()] == ["out/frames/day/cam1/good.png"]
    assert begin(out, Path(given[0])).listing()[0][0] == "cam1__good"
    (tmp_path / "empty.zip").write_bytes(zip_of(a_dot_txt="x"))
    with pytest.raises(InputError, match="holds no picture, no video and no annotation"):
        unpack_inputs([str(tmp_path / "empty.zip")], out, tmp_path / "aside", told.append)


def test_a_zip_is_read_in_one_pass(folder, tmp_path, monkeypatch):
    """Its pictures and its annotations together, and each of two archives of one name into a folder of its own."""
    opened, asked = [], Counter()
    monkeypatch.setattr(
        "circlecal.workbench.frames.may_be_annotation", lambda path: asked.update([path]) or path.suffix == ".json"
    )
    read = zipfile.ZipFile.infolist
    monkeypatch.setattr(zipfile.ZipFile, "infolist", lambda archive: opened.append(archive.filename) or read(archive))
    for day in ("1", "2"):
        (tmp_path / day).mkdir()
        content = zip_of(a_dot_png=(folder / "good.png").read_bytes(), a_dot_json="{}", b_dot_txt=day)
        (tmp_path / day / "day.zip").write_bytes(content)
    archives = [str(tmp_path / day / "day.zip") for day in ("1", "2")]
    given, annotated = unpack_inputs(archives, tmp_path / "frames", tmp_path / "aside", lambda _: None)
    assert opened == archives and len(set(given)) == 2
    assert set(asked.values()) == {2}, "each file of either archive is looked at once"
    assert [[path.name for path in one.files] for one in annotated] == [["a.json"], ["a.json"]]


def test_annotations_in_a_zip_of_the_command_line_are_imported_once(
    folder, tmp_path, run_circlecal, in_this_process, monkeypatch
):
    annotate(tmp_path / "other", "good")
    content = (tmp_path / "other" / "good.json").read_bytes()
    pictures = {f"{name}_dot_png": (folder / f"{name}.png").read_bytes() for name in ("good", "open")}
    given, out = tmp_path / "day.zip", tmp_path / "out"
    given.write_bytes(
        zip_of(a__good_dot_json=content, b__gone_dot_json=content.replace(b'"good"', b'"gone"'), **pictures)
    )
    monkeypatch.setattr("circlecal.workbench.server.serve", lambda *_: None)

    def start():
        outcome = run_circlecal("annotate", given, "--out", out, "--no-browser")
        assert outcome.code == 0, outcome.err
        return " ".join(outcome.err.split())

    assert "day.zip: 1 annotations imported; 1 in it are of no frame here" in start()
    store = AnnotationStore(out)
    saved = store.read("good")
    assert names(saved) == ["side_line_top"] and saved.touched
    later = store.save(saved.model_copy(update={"note": "later"}), saved.revision)
    assert "day.zip: 0 annotations imported" in (told := start()) and "1 here are annotated already and stay" in told
    assert store.read("good") == later, "later work stays"


@pytest.mark.parametrize("kind", ["broken", "encrypted", "large", "not pictures"])
def test_a_zip_that_cannot_be_taken_is_one_line(folder, tmp_path, run_circlecal, in_this_process, monkeypatch, kind):
    content = bytearray(zip_of(good_dot_png=(folder / "good.png").read_bytes()))
    central = content.rindex(b"PK\x01\x02")
    told = {"broken": "make it again", "encrypted": "is encrypted; unpack it yourself", "large": "unpack it yourself"}
    if kind == "broken":
        content = bytearray(content.replace(b"PNG", b"PNX", 1))
    elif kind == "encrypted":
        content[central + 8] |= 1
    elif kind == "large":
        monkeypatch.setattr("circlecal.pictures.archives.MOST_BYTES", 1000)
    else:
        content = bytearray(zip_of(good_dot_json=b"{}"))
    (tmp_path / "x.zip").write_bytes(content)
    outcome = run_circlecal("annotate", tmp_path / "x.zip", "--out", tmp_path / "out", "--no-browser")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1), outcome
    assert told.get(kind, "give their pictures too") in outcome.err and "x.zip: " in outcome.err


def test_a_damaged_stream_in_a_zip_is_no_traceback(tmp_path):
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.png", bytes(range(256)) * 40)
    content = bytearray(stream.getvalue())
    content[40:60] = b"\xff" * 20
    with pytest.raises(InputError, match="make it again"):
        unpack(BytesIO(content), "a.zip", lambda _: tmp_path)


def test_a_frame_that_two_ask_for_is_measured_once(folder, tmp_path, monkeypatch):
    session = begin(tmp_path, folder / "good.png")
    measured, before = [], module.measure_picture

    def measure(*given):
        measured.append(given)
        return before(*given)

    monkeypatch.setattr(module, "measure_picture", measure)
    threads = [threading.Thread(target=session.open, args=(0,)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(measured) == 1
