"""Paths of pictures as annotation files name them."""

import pytest

from circlecal.formats.format import ids_of_pictures, stem_of
from circlecal.formats.picture_paths import path_endings, picture_path, shared_depth, shared_endings


@pytest.mark.parametrize(
    ("name", "path", "stem"),
    [
        ("/data/upload/1/ab12cd34-c.jpg", "/data/upload/1/c.jpg", "c"),
        ("/data/local-files/?d=c.jpg", "c.jpg", "c"),
        ("/data/local-files/?d=pics%2Fhidden%20mark.jpg", "pics/hidden mark.jpg", "hidden mark"),
        ("s3://bucket/x.jpg?X-Amz=1&sig=a/b.c", "s3://bucket/x.jpg", "x"),
        ("pics\\ab12cd34-c.jpg", "pics/ab12cd34-c.jpg", "ab12cd34-c"),
        ("/data/upload/1/ab12cd3-c.jpg", "/data/upload/1/ab12cd3-c.jpg", "ab12cd3-c"),
        ("why?.jpg", "why?.jpg", "why_"),
    ],
)
def test_what_is_put_round_the_name_of_a_picture_is_taken_off(name, path, stem):
    assert picture_path(name) == path
    assert stem_of(name) == stem


def test_endings_lead_out_of_no_folder():
    assert path_endings("../pics/./cam1/a.jpg") == ["pics/cam1/a.jpg", "cam1/a.jpg", "a.jpg"]
    assert path_endings("C:\\pics\\a.jpg") == ["pics/a.jpg", "a.jpg"]
    assert path_endings("..") == []


def test_endings_of_several_pictures():
    assert shared_endings(["x/cam1/a.jpg", "x/cam2/a.jpg", "x/cam2/b.jpg", "x/cam2/b.jpg"]) == {"a.jpg"}


def test_depths():
    assert shared_depth(("x", "cam1", "a"), ("y", "cam1", "a")) == 2
    assert shared_depth(("a",), ("cam1", "a")) == 1
    assert shared_depth(("b",), ("a",)) == 0
    assert shared_depth((), ("a",)) == 0


def test_pictures_of_one_name_are_told_apart_by_their_folders():
    assert ids_of_pictures(["x/a.jpg", "x/b.jpg"]) == ["a", "b"]
    assert ids_of_pictures(["x/cam1/a.jpg", "x/cam2/a.jpg", "x/cam2/b.jpg"]) == ["cam1__a", "cam2__a", "b"]
    assert ids_of_pictures(["m1/left/a.jpg", "m2/left/a.jpg"]) == ["m1__left__a", "m2__left__a"]
    assert ids_of_pictures(["a.jpg", "x/a.jpg"]) == ["a", "x__a"]
    assert ids_of_pictures(["a.jpg", "a.png", ""]) == ["a", "a-2", "frame"]
