"""Patterns, numbered sequences, lists and videos among the inputs."""

from pathlib import Path

import pytest

from circlecal.errors import InputError
from circlecal.pictures.inputs import expand_inputs


def touch(folder: Path, *names: str) -> Path:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"G")
    return folder


def names(folder: Path, *inputs: str) -> list[str]:
    found = expand_inputs([folder / name for name in inputs])
    return [path.relative_to(folder).as_posix() for path in (*found.paths, *found.videos)]


def test_a_pattern(tmp_path):
    touch(tmp_path, "f1.jpg", "f10.jpg", "f2.jpg", "a/f3.jpg", "g.png")
    assert names(tmp_path, "f*.jpg") == ["f1.jpg", "f2.jpg", "f10.jpg"]
    assert names(tmp_path, "**/f[1-3].jpg") == ["a/f3.jpg", "f1.jpg", "f2.jpg"]
    assert names(tmp_path, "f?.jpg", "f1.jpg") == ["f1.jpg", "f2.jpg"]
    with pytest.raises(InputError, match="no file fits this pattern"):
        names(tmp_path, "x*.jpg")


def test_a_pattern_in_a_folder_that_cannot_be_read(tmp_path, monkeypatch):
    """A search passes over it in silence; a user with all rights is refused nothing, so it is played here."""
    touch(tmp_path, "shut/deep/f1.jpg")
    plain = Path.iterdir

    def refuse(folder):
        if folder.name == "shut":
            raise PermissionError(13, "Permission denied", str(folder))
        return plain(folder)

    monkeypatch.setattr(Path, "iterdir", refuse)
    for pattern in ("shut/g*.jpg", "shut/*/g.jpg", "shut/f%04d.png"):
        with pytest.raises(InputError, match="shut: cannot be read: Permission denied; check its permissions"):
            names(tmp_path, pattern)
    with pytest.raises(InputError, match="no file fits this pattern"):
        names(tmp_path, "open/*.jpg")


def test_a_file_whose_name_looks_like_a_pattern(tmp_path):
    touch(tmp_path, "f[1].jpg", "f1.jpg", "f%02d.jpg")
    assert names(tmp_path, "f[1].jpg", "f%02d.jpg") == ["f[1].jpg", "f%02d.jpg"]


def test_a_sequence(tmp_path):
    touch(tmp_path, "f0001.png", "f0003.png", "f10000.png", "f2.png", "g0001.png")
    assert names(tmp_path, "f%04d.png") == ["f0001.png", "f0003.png", "f10000.png"]
    assert names(tmp_path, "f%d.png") == ["f0001.png", "f2.png", "f0003.png", "f10000.png"]
    with pytest.raises(InputError, match="no file fits this sequence"):
        names(tmp_path, "h%04d.png")


@pytest.mark.parametrize("named", ["list.txt", "@list"])
def test_a_list(tmp_path, monkeypatch, named):
    touch(tmp_path, "day/a.jpg", "day/b 1.jpg", "day/m.mp4", "here.jpg")
    (tmp_path / "day" / named.removeprefix("@")).write_text("# frames\n\n b 1.jpg \na.jpg\nm.mp4\nhere.jpg\n*.jpg\n")
    monkeypatch.chdir(tmp_path)
    given = f"@day/{named[1:]}" if named.startswith("@") else f"day/{named}"
    found = expand_inputs([Path(given)])
    assert [path.as_posix() for path in found.paths] == ["day/b 1.jpg", "day/a.jpg", "here.jpg"]
    assert [path.as_posix() for path in found.videos] == ["day/m.mp4"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a.jpg\nmissing.jpg\n", "list.txt, line 2: missing.jpg: no such file"),
        (b"\n# nothing\n", "lists nothing"),
        (b"\xff\xfe\x00", "not UTF-8"),
        (b"list.txt\n", "list inside a list"),
    ],
)
def test_a_wrong_list(tmp_path, monkeypatch, content, message):
    touch(tmp_path, "a.jpg")
    (tmp_path / "list.txt").write_bytes(content)
    with pytest.raises(InputError, match=message):
        names(tmp_path, "list.txt")
    monkeypatch.chdir(tmp_path)  # in which a name is the same path beside the list and by itself
    with pytest.raises(InputError, match=message):
        expand_inputs(["list.txt"])


def test_videos_in_folders(tmp_path):
    touch(tmp_path, "only/m.mp4", "only/n.TS", "both/m.mkv", "both/x.jpg", "none/x.jpg", "none/circlecal-out/m.mp4")
    (tmp_path / "none" / "code.ts").write_text("let x = 1")
    assert names(tmp_path, "only") == ["only/m.mp4", "only/n.TS"]
    assert names(tmp_path, "both") == ["both", "both/m.mkv"]
    assert names(tmp_path, "none", "only/m.mp4", "only") == ["none", "only/m.mp4", "only/n.TS"]


def test_missing_files_are_left_to_the_reader(tmp_path):
    assert names(tmp_path, "missing.jpg") == ["missing.jpg"]
