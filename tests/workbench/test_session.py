"""What one server holds: a search for names ends as soon as something else is asked."""

import pytest

from circlecal.config import Config
from circlecal.pictures.video import Sampling
from circlecal.workbench import session as module
from circlecal.workbench.frames import list_frames
from circlecal.workbench.session import Session
from circlecal.workbench.store import AnnotationStore


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
