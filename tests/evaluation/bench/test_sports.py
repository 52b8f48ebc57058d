"""Frames whose field nobody names, against what truth files say of them."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from circlecal.cli.app import app
from circlecal.errors import InputError
from circlecal.evaluation.bench import sports
from circlecal.evaluation.bench.sports import SportFrame, run_frames, sport_of, summarise_sports


def frame(sport, told, error_px=None, status="calibrated", expect="calibrate"):
    return SportFrame("x", sport, expect, status, None, told, told, error_px, None, 1.0, ())


def test_a_soccer_frame_is_told_and_kept(frame_file, frame_camera):
    truth = frame_file.parent / "truth"
    truth.mkdir()
    grid = [[-5.0, -3.0], [4.0, 6.0], [9.0, -4.0]]
    content = {"sport": "soccer", "reference": {"camera": frame_camera.soccernet()}, "grid": grid}
    (truth / "good.json").write_text(json.dumps(content))
    (found,) = run_frames(frame_file.parent, truth)
    assert (found.told, found.template, found.kept) == ("soccer", "soccer", True)
    assert found.error_px < 2.0
    (truth / "good.json").write_text("[]")
    with pytest.raises(InputError, match="must be a mapping"):
        run_frames(frame_file.parent, truth)
    with pytest.raises(InputError, match="no truth file"):
        run_frames(frame_file.parent, frame_file.parent)


def test_the_frames_of_several_folders_are_one_table(tmp_path, monkeypatch):
    """Each folder has its own truth beside it."""
    folders = [tmp_path / name / "images" for name in ("halls", "pitches")]
    for folder in folders:
        folder.mkdir(parents=True)
        (folder / "a.png").touch()
    asked = []

    def find(pictures, truth, advance):
        asked.append((pictures, truth))
        return [frame("soccer", "soccer")]

    monkeypatch.setattr(sports, "run_frames", find)
    told = CliRunner().invoke(app, ["bench", "sports", *map(str, folders), "--json"])
    assert told.exit_code == 0, told.output
    assert json.loads(told.stdout)["sports"][-1]["frames"] == 2
    assert asked == [(folder, folder.parent / "truth") for folder in folders]


def test_what_counts():
    frames = [
        frame("basketball", "basketball", 3.0),
        frame("basketball", "handball", 50.0),
        frame("basketball", "basketball", expect="refuse"),
        frame("soccer", "soccer", status="refused"),
    ]
    basketball, soccer, everything = summarise_sports(frames)
    assert (basketball.answered, basketball.right_sport, basketball.good, basketball.wrong) == (3, 2, 1, 2)
    assert (soccer.frames, soccer.answered) == (1, 0)
    assert (everything.frames, everything.wrong) == (4, 2)
    assert (basketball.sport_told, soccer.sport_told) == (2, 1)
    assert np.isclose(everything.median_s, 1.0)


@pytest.mark.parametrize(
    ("told", "expect", "is_told"),
    [("basketball", "refuse", True), (None, "refuse", True), (None, "calibrate", False), ("futsal", "refuse", False)],
)
def test_a_frame_that_shows_no_field_need_not_be_told(told, expect, is_told):
    assert frame("basketball", told, status="refused", expect=expect).is_told is is_told


def test_sports_are_named_as_templates_name_them():
    path = Path("truth") / "a.json"
    assert sport_of(path, {"field": "ice-hockey"}) == sport_of(path, {"sport": "ice-hockey"}) == "ice hockey"
    assert sport_of(path, {"sport": "robocup"}) == "robot soccer"
    assert sport_of(path, {"field": {"length": 28}}) == "soccer"
    with pytest.raises(InputError, match=r"a\.json: sport: 'chess' is unknown; known: .*basketball"):
        sport_of(path, {"sport": "chess"})
