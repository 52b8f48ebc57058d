"""Files that appear whole or not at all: what killed processes leave of them, and folders that cannot be made."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from circlecal.errors import InputError
from circlecal.files import prepare_folder, remove_left_over, replacement
from circlecal.names import picture_name
from circlecal.records.log import ResultLog

pytest.importorskip("fcntl", reason="files are not locked here")
KILLED = """
import os, sys
from pathlib import Path
from circlecal.files import replacement

with replacement(Path(sys.argv[1])) as temporary:
    temporary.write_bytes(b"half of it")
    os._exit(1)
"""


def leave_half_of(path: Path) -> None:
    """What a process leaves that is killed while it writes a file."""
    subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False, cwd=Path(__file__).parents[1], timeout=300)


@pytest.mark.parametrize("take_up", [lambda folder: ResultLog(folder).__exit__(None, None, None), prepare_folder])
def test_what_killed_processes_left_is_taken_away_and_nothing_else(tmp_path, take_up):
    others = (".overlay.mp4.settings", "notes.circlecal-text")
    for name in others:
        (tmp_path / name).touch()
    leave_half_of(tmp_path / "overlay.mp4")
    [left] = tmp_path.glob(".overlay.mp4.circlecal-*")
    take_up(tmp_path)
    assert left.exists(), "may be new, and not locked yet"
    with replacement(tmp_path / "report.html") as temporary:
        for path in (left, temporary):
            os.utime(path, (0.0, 0.0))
        take_up(tmp_path)
        assert temporary.is_file(), "is still written to"
        temporary.write_text("whole")
    assert not left.exists() and all((tmp_path / name).is_file() for name in others)
    assert (tmp_path / "report.html").read_text() == "whole"
    assert not list(tmp_path.glob(".*circlecal-*"))


def test_a_folder_that_is_not_there_holds_nothing(tmp_path):
    remove_left_over(tmp_path / "nowhere")


@pytest.mark.parametrize(("target", "below"), [("nowhere", ""), ("out", ""), ("nowhere", "deeper")])
@pytest.mark.parametrize("make", [ResultLog, prepare_folder])
def test_a_link_to_no_folder_is_called_one(tmp_path, make, target, below):
    """A link that leads to nothing, or to itself."""
    link = tmp_path / "out"
    link.symlink_to(target)
    with pytest.raises(InputError, match=f"out: is a link to {target}, and no such folder can be reached; make that"):
        make(link / below)
    link.unlink()
    link.touch()
    with pytest.raises(InputError, match=r"out: is a file, not a folder; choose another --out"):
        make(link)


@pytest.mark.parametrize(
    ("frame_id", "path", "time_s", "expected"),
    [
        ("a", "day/a.png", None, "a.png"),
        ("cam1__a", "cam1/a.png", None, "cam1__a.png"),
        ("clip_000001", "clip.mp4", 1.0, "clip_000001.jpg"),
        ("a", "C:\\day\\a.png", None, "a.png"),
        ("a", None, None, None),
    ],
)
def test_the_picture_of_a_frame_has_a_name_for_other_programs(frame_id, path, time_s, expected):
    assert picture_name(frame_id, path, time_s) == expected
