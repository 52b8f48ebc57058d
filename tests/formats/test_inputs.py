"""Which frame of an annotation file is a picture's, which picture is a frame's, and which file of a folder."""

import json

import cv2
import numpy as np
import pytest

from circlecal.errors import InputError
from circlecal.field import load_field
from circlecal.formats import coco, labelme, labelstudio, soccernet
from circlecal.formats.format import json_bytes
from circlecal.formats.inputs import AnnotationFile, observations_beside, read_frames
from circlecal.formats.meaning import SourcesConfig
from circlecal.formats.registry import picture_beside, read_annotations
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.pictures.files import PictureFile, find_frames

SIZE = (960, 540)


def frame(image, x=100.0):
    """A frame whose centre mark tells which one it is."""
    return AnnotatedFrame(image or "frame", *SIZE, (Shape("centre_mark", "points", np.array([[x, 200.0]])),), image)


def pictures(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def listing(folder, *images):
    """A COCO file whose n-th picture, from 0, has its centre mark at x = n."""
    path = folder / "coco.json"
    path.write_bytes(coco.write([frame(image, float(x)) for x, image in enumerate(images)]))
    return path


def mark_of(given, picture, format_name=None):
    found = observations_beside(given, picture, load_field("soccer"), SourcesConfig(), SIZE, format_name)
    return found.marks[0].point_px[0]


def read_all(path):
    errors = []
    field = load_field("soccer")
    files = [AnnotationFile(path, path, named=True)]
    found = read_frames(files, field, SourcesConfig(), painted=field, on_error=errors.append)
    return found, [str(error) for error in errors]


@pytest.mark.parametrize("prefix", ["", "pics/", "/elsewhere/pics/", "C:\\pics\\"])
def test_pictures_of_one_name_are_told_apart_by_their_folders(tmp_path, prefix):
    path = listing(tmp_path, f"{prefix}cam1/a.jpg", "b.jpg", f"{prefix}cam2/a.jpg")
    folder = pictures(tmp_path / "pics", "cam1/a.jpg", "cam2/a.jpg", "b.jpg")
    found = {picture.id: mark_of(path, picture) for picture in find_frames([folder])}
    assert found == {"cam1__a": 0, "b": 1, "cam2__a": 2}
    (alone,) = find_frames([folder / "cam2" / "a.jpg"])
    assert mark_of(path, alone) == 2


@pytest.mark.parametrize(("name", "x"), [("cam1__a.jpg", 0), ("/data/upload/7/0123abcd-cam1__a.jpg", 0)])
def test_pictures_by_their_ids(tmp_path, name, x):
    path = listing(tmp_path, name, "b.jpg")
    assert mark_of(path, find_frames([pictures(tmp_path / "pics", "cam1/a.jpg")])[0]) == x
    assert mark_of(path, PictureFile("cam1__a", tmp_path / "clip.mp4", "cam1__a", time_s=1.0)) == x


def test_pictures_of_one_name_by_their_suffixes(tmp_path):
    path = listing(tmp_path, "a.png", "a.jpg")
    found = [mark_of(path, picture) for picture in find_frames([pictures(tmp_path / "pics", "a.jpg", "a.png")])]
    assert found == [1, 0]


def test_what_may_be_several_frames_is_refused(tmp_path):
    (picture,) = find_frames([pictures(tmp_path / "pics", "a.jpg")])
    path = listing(tmp_path, "cam1/a.jpg", "cam2/a.jpg")
    told = r"coco\.json: has 2 frames that may be a \(cam1/a\.jpg, cam2/a\.jpg\); keep one, or name pictures by"
    with pytest.raises(InputError, match=told):
        mark_of(path, picture)


def test_a_picture_of_another_folder_is_not_taken(tmp_path):
    (picture,) = find_frames([pictures(tmp_path / "pics", "cam2/a.jpg")])
    path = listing(tmp_path, "cam1/a.jpg", "b.jpg")
    with pytest.raises(InputError, match=r"coco\.json: has 2 frames, none of them cam2/a, but cam1/a\.jpg; give the"):
        mark_of(path, picture)
    path = listing(tmp_path, "c.jpg", "b.jpg")
    with pytest.raises(InputError, match=r"has 2 frames, none of them cam2/a$"):
        mark_of(path, picture)


def test_the_picture_beside_a_file_is_looked_for_in_the_folders_that_it_names(tmp_path):
    path = listing(tmp_path, "x/cam1/a.jpg", "x/cam2/a.jpg", "x/b.jpg")
    pictures(tmp_path, "a.jpg", "cam1/a.jpg", "b.jpg")
    found, _ = read_all(path)
    assert [f.picture for f in found] == [tmp_path / "cam1" / "a.jpg", None, tmp_path / "b.jpg"]


def test_the_picture_beside_a_file_of_label_studio(tmp_path):
    pictures(tmp_path, "c.jpg", "0123abcd-d.jpg")
    path = tmp_path / "tasks.json"
    assert picture_beside(path, "/data/upload/1/ab12cd34-c.jpg") == tmp_path / "c.jpg"
    assert picture_beside(path, "/data/upload/1/0123abcd-d.jpg") == tmp_path / "0123abcd-d.jpg"
    assert picture_beside(path, "/data/local-files/?d=pics%2Fc.jpg") == tmp_path / "c.jpg"


def test_tasks_of_label_studio_without_annotation_are_told(tmp_path):
    """As the first one of a task that is opened, left and opened again: that is empty."""
    path = tmp_path / "tasks.json"
    tasks = json.loads(labelstudio.write([frame("a.jpg", 1.0), frame("b.jpg", 2.0), frame("c.jpg", 3.0)]))
    tasks[1]["annotations"].insert(0, {"result": []})
    tasks[2]["annotations"] = []
    path.write_bytes(json_bytes(tasks))
    found, errors = read_all(path)
    assert [f.observed.observations.marks[0].point_px[0] for f in found] == pytest.approx([1.0, 2.0])
    assert [w for f in found for w in f.observed.warnings] == [f"{path}: 2: c.jpg has no annotation; left out"]
    assert not errors
    path.write_bytes(json_bytes(tasks[2:]))
    assert read_all(path) == ([], [f"{path}: none of its pictures is annotated; annotate one and export it again"])


def test_what_is_written_of_a_refused_frame_can_be_gone_on_from(tmp_path, frame_image):
    path = tmp_path / "view.soccernet.json"
    path.write_bytes(soccernet.write([frame("view.jpg")]))
    cv2.imwrite(str(tmp_path / "view.jpg"), frame_image)
    (found,) = read_annotations(path)[1]
    assert (found.id, found.width, found.height) == ("view", 960, 540)
    cv2.imwrite(str(tmp_path / "other.jpg"), frame_image)
    (tmp_path / "extremities_other.json").write_bytes(path.read_bytes())
    (found,) = read_annotations(tmp_path / "extremities_other.json")[1]
    assert (found.id, found.width) == ("other", 960)


@pytest.mark.parametrize("name", ["a.json", "a.labelme.json", "extremities_a.json", "a.soccernet.json"])
@pytest.mark.parametrize("below", ["", "cam1"])
def test_files_of_a_folder_by_the_names_that_circlecal_gives_them(tmp_path, name, below):
    folder = tmp_path / "given" / below
    folder.mkdir(parents=True)
    given = frame("a.jpg", 7.0)
    (folder / name).write_bytes(labelme.write([given]) if "labelme" in name else soccernet.write([given]))
    if name != "a.json":  # its result lies there too
        (folder / "a.json").write_text('{"schema_version": 1, "status": "refused", "image": null}')
    if "labelme" not in name:
        (folder / name).write_text('{"Circle central": [{"x": 0.1, "y": 0.2}, {"x": 0.3, "y": 0.2}]}')
    (picture,) = find_frames([pictures(tmp_path / "pics", f"{below}/a.jpg".strip("/"))])
    found = observations_beside(tmp_path / "given", picture, load_field("soccer"), SourcesConfig(), SIZE)
    assert len(found.marks if "labelme" in name else found.circles) == 1


def test_of_several_files_of_a_picture_the_one_of_the_named_format_is_taken(tmp_path):
    (picture,) = find_frames([pictures(tmp_path / "pics", "a.jpg")])
    (tmp_path / "a.labelme.json").write_bytes(labelme.write([frame("a.jpg", 7.0)]))
    (tmp_path / "a.soccernet.json").write_text('{"Circle central": [{"x": 0.1, "y": 0.2}, {"x": 0.3, "y": 0.2}]}')
    assert mark_of(tmp_path, picture, "labelme") == 7
