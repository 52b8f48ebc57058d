"""Progress on a terminal and in a pipe."""

import io
from itertools import pairwise

import pytest
from rich.console import Console

from circlecal.batch import BatchProgress
from circlecal.cli import console
from circlecal.records.summary import FrameSummary
from circlecal.refusals import explain


@pytest.fixture
def clock(monkeypatch):
    now = [1000.0]
    monkeypatch.setattr("circlecal.cli.console.time.monotonic", lambda: now[0])
    return now


def finished(progress: BatchProgress, count: int = 1, code: str | None = None) -> BatchProgress:
    for _ in range(count):
        progress.count("refused" if code else "calibrated", code)
    return progress


def test_lines_in_a_pipe_become_rarer(clock, capsys):
    progress = BatchProgress(total=100_000)
    with console.progress_display(quiet=False) as show:
        show(progress)
        for _ in range(20_000):
            clock[0] += 0.5
            show(finished(progress))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "10/100000 frames, 10 calibrated, 0 refused, 2.0 frames/s, 13:53:15 left"
    assert 150 < len(lines) < 300
    counts = [int(line.split("/")[0]) for line in lines]
    gaps = [later - earlier for earlier, later in pairwise(counts)]
    assert (gaps[0], max(gaps)) == (10, 120)


def test_the_last_line_and_what_was_there_before(clock, capsys):
    progress = finished(BatchProgress(total=4, resumed=2), 2)
    with console.progress_display(quiet=False) as show:
        show(progress)
        clock[0] += 1
        show(finished(progress))
        clock[0] += 1
        show(finished(progress, code="no_circle_found"))
    [line] = capsys.readouterr().err.splitlines()
    assert line == "4/4 frames, 3 calibrated, 1 refused (2 from before), 1.0 frames/s, 0:00 left"


def test_stages_before_frames_are_counted_have_their_names_rates_and_times(clock, capsys):
    """The survey of a clip was a long silence."""
    progress = BatchProgress(total=50)
    with console.progress_display(quiet=False, stage="tracking") as show:
        for done in range(0, 49, 4):
            show.step("looking at frames", done, 48)
            clock[0] += 2
        show.step("camera-1: fitting", 0, 0)
        clock[0] += 5
        show.step("camera-1: fitting", 0, 0)
        show(progress)
        clock[0] += 5
        show(finished(progress, 50))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "looking at frames: 12/48 frames, 2.0 frames/s, 0:18 left"
    assert lines[-2:] == ["camera-1: fitting", "tracking: 50/50 frames, 50 calibrated, 0 refused"]
    with console.count_steps("frame", 1, stage="drawing overlay.mp4") as advance:
        clock[0] += 1
        advance("clip_00-00-00.000")
    assert capsys.readouterr().err.startswith("drawing overlay.mp4: 1/1 frame, clip_00-00-00.000, 1.0 frames/s")


def test_a_bar_names_its_stage(clock, monkeypatch):
    written = io.StringIO()
    terminal = Console(file=written, force_terminal=True, width=140, color_system=None)
    monkeypatch.setattr("circlecal.cli.console.stderr_console", lambda: terminal)
    with console.progress_display(quiet=False, stage="tracking") as show:
        show.step("looking at frames", 0, 48)
        clock[0] += 6
        show.step("looking at frames", 12, 48)
    shown = written.getvalue()
    for text in ("looking at frames", "12/48 frames", "2.0 frames/s", "0:18 left"):
        assert text in shown
    with console.progress_display(quiet=False, stage="tracking") as show:
        show(finished(BatchProgress(total=100)))
    assert "tracking 1/100 frames" in written.getvalue()


def test_one_of_a_thing_is_said_in_the_singular(clock, capsys):
    assert [console.count_of(count, "frame") for count in (0, 1, 2)] == ["0 frames", "1 frame", "2 frames"]
    progress = BatchProgress(total=1)
    with console.progress_display(quiet=False) as show:
        show(progress)
        clock[0] += 1
        show(finished(progress))
    with console.count_steps("camera", 1) as advance:
        advance("a")
    told = capsys.readouterr().err
    assert "1/1 frame, " in told and "1/1 camera, a" in told


def test_a_bar_on_a_terminal(clock, monkeypatch):
    written = io.StringIO()
    terminal = Console(file=written, force_terminal=True, width=140, color_system=None)
    monkeypatch.setattr("circlecal.cli.console.stderr_console", lambda: terminal)
    progress = finished(BatchProgress(total=1000, resumed=100), 100)
    with console.progress_display(quiet=False) as show:
        show(progress)
        clock[0] += 60  # the survey of a clip, which is in no rate
        show(finished(progress, 1, "no_circle_found"))
        clock[0] += 10
        show(finished(progress, 50, "no_circle_found"))
    shown = written.getvalue()
    for text in ("151/1000 frames", "100 calibrated, 51 refused (100 from before)", "5.0 frames/s", "2:50 left"):
        assert text in shown


def test_quiet(capsys):
    with console.progress_display(quiet=True) as show:
        show(finished(BatchProgress(total=1)))
    assert capsys.readouterr() == ("", "")


def test_what_helps_is_told_once_for_each_reason(monkeypatch):
    written = io.StringIO()
    terminal = Console(file=written, force_terminal=True, width=200, color_system=None)
    monkeypatch.setattr("rich.console.Console", lambda: terminal)
    refused = [FrameSummary(f"f{i}", "refused", "no_field", None, None, None, None, "no field") for i in range(5)]
    console.print_summaries([*refused, FrameSummary("ok", "calibrated", None, 1, 0.3, 2.0, 9.0, None)])
    lines = [line for line in written.getvalue().splitlines() if line.startswith("What helps")]
    assert lines == [f"What helps (f0, f1, f2 and 2 more): {explain('no_field').help}"]


def test_a_narrow_terminal_tells_frames_in_sentences(monkeypatch):
    written = io.StringIO()
    terminal = Console(file=written, force_terminal=True, width=40, color_system=None)
    monkeypatch.setattr("rich.console.Console", lambda: terminal)
    wide = {"width_px": 960, "sigma_1920_px": 52.9}
    told = FrameSummary(
        "a_frame", "refused", "too_uncertain", 1, 0.1, 26.45, 9.0, "too little is seen to know it", **wide
    )
    ok = FrameSummary("ok", "calibrated", None, None, None, 1.0, 9.0, None, width_px=960, sigma_1920_px=2.0)
    console.print_summaries([told, ok])
    words = " ".join(written.getvalue().split())
    assert (
        "a_frame: refused, case 1, sigma 52.90 px, rms 0.20 px at 1920 px width: too little is seen to know it" in words
    )
    assert "ok: calibrated, case -, sigma 2.00 px, rms - px at 1920 px width" in words
    assert "What helps (a_frame):" in words
    assert max(map(len, written.getvalue().splitlines())) <= 40
