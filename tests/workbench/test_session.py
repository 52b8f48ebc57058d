"""What one server holds: a search for names ends as soon as something else is asked."""

import pytest

from circlecal.config import Config
from circlecal.errors import InputError
from circlecal.pictures.video import Sampling
from circlecal.workbench import session as module
from circlecal.workbench.frames import list_frames, take_part
from circlecal.workbench.session import Session
from circlecal.workbench.store import AnnotationStore


def test_parts_hold_every_frame_once(folder):
    frames = list_frames([str(folder)], Sampling.parse("1s"))
    parts = [take_part(frames, f"{k}/2") for k in (1, 2)]
    assert sorted(frame.file.id for part in parts for frame in part) == sorted(frame.file.id for frame in frames)
    assert [len(part) for part in parts] == [2, 1]
    assert take_part(frames, None) == frames


@pytest.mark.parametrize(
    ("part", "told"), [("3/2", "such as 2/4"), ("0/2", "such as"), ("half", "such as"), ("4/4", "3 frames")]
)
def test_a_part_that_is_none_is_refused(folder, part, told):
    with pytest.raises(InputError, match=told):
        take_part(list_frames([str(folder)], Sampling.parse("1s")), part)


@pytest.mark.parametrize("asked", ["show", "save", "interpretations"])
def test_a_search_for_names_ends_when_something_else_is_asked(folder, tmp_path, monkeypatch, asked):
    frames = list_frames([str(folder / "open.png")], Sampling.parse("1s"))
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
    session = Session(list_frames([str(folder)], Sampling.parse("1s")), AnnotationStore(tmp_path), Config())
    monkeypatch.setattr(module, "HELD_PIXELS", 2 * 960 * 540)
    first, *_, last = [session.open(k) for k in range(3)]
    assert session.open(2) is last and session.open(0) is not first
