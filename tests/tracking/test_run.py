"""Runs over clips: what the folder holds, going on after a stop, and the same answers from several processes."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.errors import InputError
from circlecal.field import load_field
from circlecal.pictures.limits import DEFAULT_LIMITS
from circlecal.pictures.video import Sampling, Video, frame_id, frame_time
from circlecal.records.log import OtherRunError, ResultLog
from circlecal.rig.tripod import COMMON, PLACE, PaintersShare
from circlecal.rig.venue import read_venue_file
from circlecal.tracking import stretches
from circlecal.tracking.frame_times import FrameTimes
from circlecal.tracking.run import run_track, tripod_facts
from circlecal.tracking.stretches import ClipRun, stretches_of

from . import scripted


@pytest.fixture
def engine(monkeypatch):
    monkeypatch.setattr(stretches, "survey_clip", scripted.survey_clip)
    monkeypatch.setattr(stretches, "track_frames", scripted.track_frames)
    return monkeypatch


def clip_run(every: str = "1", **named) -> ClipRun:
    return ClipRun(load_config(), Sampling.parse(every, **named))


def open_clip(folder: Path, name: str = "clip", frames: int = 30) -> Video:
    return Video.open(scripted.write_clip(folder / f"{name}.mp4", frames), name, DEFAULT_LIMITS)


def lines(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines()]


def test_every_frame_has_a_line_and_a_row(tmp_path, engine):
    report = run_track([open_clip(tmp_path)], clip_run(), tmp_path / "out")
    assert (report.progress.total, report.progress.calibrated, report.progress.refused) == (30, 28, 2)
    found = lines(tmp_path / "out")
    assert [round(line["source"]["time_s"] * scripted.RATE) for line in found] == list(range(30))
    assert [line["track"]["shot"] for line in found] == [0] * 20 + [1] * 10
    assert [line["track"]["frame"] for line in found] == list(range(30))
    with (tmp_path / "out" / "cameras.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["status"] for row in rows].count("calibrated") == 28
    assert rows[3]["tripod"] == "camera-1" and rows[3]["carried_by"] == "circle+lines"
    assert float(rows[3]["time_s"]) == pytest.approx(0.3) and float(rows[3]["z_m"]) < -10
    camera, entries = found[3]["camera"], chain(*found[3]["H_image_field"])
    wanted = dict(zip((f"h{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)), entries, strict=True))
    wanted |= dict(zip(("x_m", "y_m", "z_m"), camera["position_meters"], strict=True))
    wanted |= dict(zip(("x_sigma_m", "y_sigma_m", "z_sigma_m"), camera["position_sigma_m"], strict=True))
    wanted |= dict(zip(("radial_k1", "radial_k2"), camera["radial_distortion"][:2], strict=True))
    wanted |= {f"{angle}_deg": camera[f"{angle}_degrees"] for angle in ("pan", "tilt", "roll")}
    wanted |= {f"focal_{axis}_px": camera[f"{axis}_focal_length"] for axis in "xy"}
    assert {name: float(rows[3][name]) for name in wanted} == pytest.approx(wanted, rel=1e-8)
    assert rows[7]["code"] == "lost" and rows[7]["pan_deg"] == ""
    assert (tmp_path / "out" / "summary.csv").is_file()
    venue = read_venue_file(tmp_path / "out" / "venue.yaml")
    assert venue.config_digest == clip_run().digest and venue.tripods[0].frames == ["a", "b"]


@pytest.mark.parametrize(
    ("names", "workers", "told"),
    [
        (["clip"], 2, [("looking at frames", 0, 2), ("looking at frames", 1, 2), ("looking at frames", 2, 2)]),
        (["a", "b"], 1, [(f"{name}: looking at frames", done, 2) for name in "ab" for done in range(3)]),
    ],
)
def test_who_waits_is_told_how_far_a_survey_is(tmp_path, engine, names, workers, told):
    steps: list[tuple[str, int, int]] = []
    videos = [open_clip(tmp_path, name, 12) for name in names]
    run_track(videos, clip_run(), tmp_path / "out", workers=workers, on_step=lambda *step: steps.append(step))
    assert steps == told


def test_every_takes_each_nth_frame_or_one_a_time(tmp_path, engine):
    video = open_clip(tmp_path)
    run_track([video], clip_run("5"), tmp_path / "fifth")
    run_track([video], clip_run("500ms"), tmp_path / "half")
    assert [line["track"]["frame"] for line in lines(tmp_path / "fifth")] == [0, 5, 10, 15, 20, 25]
    assert [line["id"] for line in lines(tmp_path / "half")] == [line["id"] for line in lines(tmp_path / "fifth")]


@pytest.mark.parametrize(("every", "step"), [("5", 5), ("700ms", 7), ("1400ms", 14), ("3", 3)])
def test_frames_between_those_that_are_wanted_are_followed_and_not_written(tmp_path, engine, every, step):
    """They carry the camera, and tell whether a cut lies between; so a stretch begins no later than its last one."""
    engine.setattr(stretches, "STRETCH_S", 1.0)
    engine.setattr(stretches, "MARGIN_S", 0.3)
    video, decoded = open_clip(tmp_path), []
    run_track([video], clip_run(), tmp_path / "whole")
    engine.setattr(
        stretches, "track_frames", lambda frames, *rest: scripted.track_frames(watch(frames, decoded), *rest)
    )
    run_track([video], clip_run(every), tmp_path / "some")
    wanted = lines(tmp_path / "whole")[::step]
    found = lines(tmp_path / "some")
    assert [line["id"] for line in found] == [line["id"] for line in wanted]
    assert [line["track"] for line in found] == [line["track"] for line in wanted]
    assert {round(time_s * scripted.RATE) for time_s in decoded} == set(range(30))


def test_frames_as_near_as_those_of_a_usual_video_are_followed_alone(tmp_path, engine):
    video = replace(open_clip(tmp_path), rate=50.0)
    assert not clip_run("2").follows_all(video) and clip_run("3").follows_all(video)


def test_a_stop_loses_nothing_and_nothing_is_done_twice(tmp_path, engine):
    engine.setattr(stretches, "STRETCH_S", 1.0)
    video, out = open_clip(tmp_path), tmp_path / "out"
    whole = tmp_path / "whole"
    run_track([video], clip_run(), whole)

    def stop(progress):
        if progress.finished == 14:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_track([video], clip_run(), out, on_progress=stop)
    assert len(lines(out)) == 14 and (out / "cameras.csv").is_file()
    with (out / "results.jsonl").open("ab") as file:  # as a power cut leaves it
        file.write(b'{"schema_version": 1, "id": "clip_00')
    decoded = []
    engine.setattr(
        stretches, "track_frames", lambda frames, *rest: scripted.track_frames(watch(frames, decoded), *rest)
    )
    engine.setattr(stretches, "survey_clip", lambda *given: pytest.fail("the venue is known"))
    report = run_track([video], clip_run(), out)
    assert report.progress.resumed == 14 and report.progress.finished == 30
    assert lines(out) == lines(whole)
    assert min(decoded) >= 0.0 and report.venues["clip"].tripods[0].name == "camera-1"
    decoded.clear()
    assert run_track([video], clip_run(), out).progress.finished == 30
    assert not decoded, "a finished clip is not looked at again"


KILLED = """
import os, signal
from pathlib import Path
from circlecal.tracking import run as run_module, stretches
from tests.tracking import scripted
from tests.tracking.test_run import clip_run
from circlecal.pictures.limits import DEFAULT_LIMITS
from circlecal.pictures.video import Video

stretches.track_frames, stretches.survey_clip = scripted.track_frames, scripted.survey_clip
stretches.STRETCH_S = 1.0
kill = lambda progress: progress.finished == 14 and os.kill(os.getpid(), signal.SIGKILL)
run_module.run_track([Video.open(Path("{clip}"), "clip", DEFAULT_LIMITS)], clip_run(), Path("{out}"), on_progress=kill)
"""


def test_a_kill_loses_nothing_and_nothing_is_done_twice(tmp_path, engine):
    engine.setattr(stretches, "STRETCH_S", 1.0)
    video, out = open_clip(tmp_path), tmp_path / "out"
    run_track([video], clip_run(), tmp_path / "whole")
    script = KILLED.format(clip=video.path, out=out)
    killed = subprocess.run([sys.executable, "-c", script], cwd=Path(__file__).parents[2], check=False)
    assert killed.returncode == -signal.SIGKILL
    left = lines(out)
    assert 0 < len(left) <= 14
    report = run_track([video], clip_run(), out)
    assert report.progress.resumed == len(left) and lines(out) == lines(tmp_path / "whole")


def watch(frames, times):
    for frame in frames:
        times.append(frame.time_s)
        yield frame


def test_stretches_change_no_answer(tmp_path, engine):
    video = open_clip(tmp_path)
    run_track([video], clip_run(), tmp_path / "one")
    engine.setattr(stretches, "STRETCH_S", 0.7)
    engine.setattr(stretches, "MARGIN_S", 0.2)
    run_track([video], clip_run(), tmp_path / "many")
    assert lines(tmp_path / "many") == lines(tmp_path / "one")


def test_stretches_lie_where_time_says(tmp_path):
    video = open_clip(tmp_path)
    long = Video(video.path, "long", *scripted.SIZE, 25.0, 150.0, None)
    run = clip_run(start="50", end="140")
    for frames in (FrameTimes(25.0), FrameTimes(25.0, tuple(k / 25.0 for k in range(3750)))):
        assert [(s.start_s, s.end_s) for s in stretches_of(long, run, frames)] == [(50, 60), (60, 120), (120, 140)]
        assert {s.origin for s in stretches_of(long, run, frames)} == {1250}
        assert stretches_of(long, run, frames, 119.96)[0].start_s == 60
        assert stretches_of(long, run, frames, 139.97) == []
        last = stretches_of(long, clip_run(), frames)[-1]
        assert (last.start_s, last.end_s) == (120, float("inf"))


def test_another_configuration_is_another_run(tmp_path, engine):
    video = open_clip(tmp_path, frames=12)
    run_track([video], clip_run(), tmp_path / "out")
    other = ClipRun(load_config(None, {"seed": 1}), Sampling.parse("1"))
    with pytest.raises(OtherRunError):
        run_track([video], other, tmp_path / "out")
    run_track([video], other, tmp_path / "out", restart=True)
    assert {line["seed"] for line in lines(tmp_path / "out")} == {1}
    assert read_venue_file(tmp_path / "out" / "venue.yaml").config_digest == other.digest


def test_another_part_of_a_clip_is_another_run(tmp_path, engine):
    """Frames before the first one that is written would never be looked at, and the venue would be that of the part."""
    video = open_clip(tmp_path, frames=30)
    run_track([video], clip_run(start="0.4", end="0.8"), tmp_path / "out")
    for span in ({}, {"start": "0.2", "end": "0.8"}, {"start": "0.4"}):
        with pytest.raises(OtherRunError):
            run_track([video], clip_run(**span), tmp_path / "out")


def test_whole_records_are_another_run(tmp_path, engine):
    video = open_clip(tmp_path, frames=12)
    run_track([video], clip_run(), tmp_path / "out")
    with pytest.raises(OtherRunError):
        run_track([video], replace(clip_run(), full=True), tmp_path / "out")


def test_clips_tracked_one_after_the_other_into_one_folder_have_venues_of_their_own(tmp_path, engine):
    asked = []
    for name in ("first", "second", "first"):
        run_track([open_clip(tmp_path, name, 12)], clip_run(), tmp_path / "out", on_survey=asked.append)
    assert asked == ["first", "second"]
    clips = {path.name: read_venue_file(path).clip for path in (tmp_path / "out").glob("*.yaml")}
    assert clips == {"venue.yaml": "first", "second.venue.yaml": "second"}
    assert {line["id"].split("_")[0] for line in lines(tmp_path / "out")} == {"first", "second"}
    run_track([open_clip(tmp_path, "second", 12)], clip_run(), tmp_path / "out", restart=True)
    assert read_venue_file(tmp_path / "out" / "venue.yaml").clip == "second"


def test_another_clip_of_one_name_is_told(tmp_path, engine):
    video = open_clip(tmp_path, frames=12)
    run_track([video], clip_run(), tmp_path / "out")
    (tmp_path / "other").mkdir()
    other = open_clip(tmp_path / "other", frames=24)
    with pytest.raises(InputError, match=r"out: holds frames of .*, which has the name of .*other"):
        run_track([other], clip_run(), tmp_path / "out")
    # by another way to it, or moved, it is the same clip
    again = replace(video, path=Path(os.path.relpath(video.path)))
    assert run_track([again], clip_run(), tmp_path / "out").progress.resumed == 12
    video.path.rename(tmp_path / "moved.mp4")
    moved = replace(video, path=tmp_path / "moved.mp4")
    assert run_track([moved], clip_run(), tmp_path / "out").progress.resumed == 12


def test_a_clip_that_was_replaced_is_told(tmp_path, engine):
    video = open_clip(tmp_path, frames=12)
    run_track([video], clip_run(), tmp_path / "out")
    assert {line["source"]["bytes"] for line in lines(tmp_path / "out")} == {video.path.stat().st_size}
    before = (tmp_path / "out" / "results.jsonl").read_bytes()
    longer = open_clip(tmp_path, frames=24)
    with pytest.raises(OtherRunError, match=r"out: holds frames of .*clip.mp4, which has changed since; use another"):
        run_track([longer], clip_run(), tmp_path / "out")
    assert (tmp_path / "out" / "results.jsonl").read_bytes() == before


@pytest.mark.parametrize("is_told", [True, False])
def test_a_survey_of_a_clip_before_it_was_replaced_is_made_again(tmp_path, engine, is_told):
    """Where the run was stopped before the first frame; a survey of an earlier version tells no size, and holds."""
    out, asked = tmp_path / "out", []
    run_track([open_clip(tmp_path, frames=12)], clip_run(), out)
    for name in ("results.jsonl", "results.index"):
        (out / name).unlink()
    if not is_told:
        venue = (out / "venue.yaml").read_text().splitlines(keepends=True)
        (out / "venue.yaml").write_text("".join(line for line in venue if not line.startswith("clip_bytes")))
    run_track([open_clip(tmp_path, frames=24)], clip_run(), out, on_survey=asked.append)
    assert asked == ["clip"] * is_told
    assert len(lines(out)) == 24


def test_starting_over_looks_for_the_cameras_again(tmp_path, engine):
    video, asked = open_clip(tmp_path, frames=12), []
    for restart, surveys in ((False, 1), (False, 1), (True, 2)):
        run_track([video], clip_run(), tmp_path / "out", restart=restart, on_survey=asked.append)
        assert len(asked) == surveys


def test_one_bad_clip_does_not_stop_the_others(tmp_path, engine):
    videos = [open_clip(tmp_path, "first"), open_clip(tmp_path, "second", 12)]
    done = scripted.CUT_FRAME + 5

    def fail(frames, venue, config):
        for count, frame in enumerate(scripted.track_frames(frames, venue, config)):
            if count == done and fail.armed:
                fail.armed = False
                raise ZeroDivisionError("mistake")
            yield frame

    fail.armed = True
    engine.setattr(stretches, "track_frames", fail)
    errors: list[Exception] = []
    run_track(videos, clip_run(), tmp_path / "out", on_error=errors.append)
    assert [str(e) for e in errors] and "first.mp4: internal error after 00:00:02.4" in str(errors[0])
    found = [line["id"].split("_")[0] for line in lines(tmp_path / "out")]
    assert found == ["first"] * done + ["second"] * 12
    engine.setattr(stretches, "track_frames", scripted.track_frames)
    run_track(videos, clip_run(), tmp_path / "out")
    run_track(videos, clip_run(), tmp_path / "whole")
    assert sorted(lines(tmp_path / "out"), key=lambda line: line["id"]) == lines(tmp_path / "whole")


def test_a_clip_whose_name_begins_that_of_another_is_tracked_beside_it(tmp_path, engine):
    for name in ("cam_2", "cam"):
        run_track([open_clip(tmp_path, name, 12)], clip_run(), tmp_path / "out")
    found = [line["id"].rpartition("_")[0] for line in lines(tmp_path / "out")]
    assert found == ["cam_2"] * 12 + ["cam"] * 12


def test_clips_of_which_one_name_begins_the_other_are_taken_up_behind_their_own_last_frames(tmp_path, engine):
    engine.setattr(stretches, "STRETCH_S", 1.0)
    engine.setattr(stretches, "MARGIN_S", 0.0)
    videos = [open_clip(tmp_path, "cam"), open_clip(tmp_path, "cam_2")]
    run_track(videos, clip_run(), tmp_path / "whole")
    left = iter((4, 30, 30, 5))

    def fail(frames, venue, config):
        end = next(left)
        for count, frame in enumerate(scripted.track_frames(frames, venue, config)):
            if count == end:
                raise ZeroDivisionError("mistake")
            yield frame

    engine.setattr(stretches, "track_frames", fail)
    errors: list[Exception] = []
    run_track(videos, clip_run(), tmp_path / "out", on_error=errors.append)
    assert len(errors) == 2 and len(lines(tmp_path / "out")) == 4 + 25
    engine.setattr(stretches, "track_frames", scripted.track_frames)
    run_track(videos, clip_run(), tmp_path / "out")
    found = sorted(lines(tmp_path / "out"), key=lambda line: line["id"])
    assert found == sorted(lines(tmp_path / "whole"), key=lambda line: line["id"])


def test_a_full_disk_ends_the_run_at_once_and_it_is_taken_up(tmp_path, engine):
    videos, out, whole = (
        [open_clip(tmp_path, name, 12) for name in ("first", "second")],
        tmp_path / "out",
        tmp_path / "whole",
    )
    append, decoded = ResultLog.append, []
    run_track(videos, clip_run(), whole)

    def fill(log, finished):
        if len(log.index) == 5:
            raise InputError("no space left")
        append(log, finished)

    engine.setattr(ResultLog, "append", fill)
    engine.setattr(
        stretches, "track_frames", lambda frames, *rest: scripted.track_frames(watch(frames, decoded), *rest)
    )
    with pytest.raises(InputError, match="no space left"):
        run_track(videos, clip_run(), out, on_error=lambda error: pytest.fail(f"told as one of a clip: {error}"))
    assert len(lines(out)) == 5 and len(decoded) < 12, "nothing is tracked in vain"
    engine.setattr(ResultLog, "append", append)
    run_track(videos, clip_run(), out)
    assert lines(out) == lines(whole) and (out / "cameras.csv").read_text() == (whole / "cameras.csv").read_text()


def test_the_results_of_several_processes_are_those_of_one(tmp_path):
    """With the real engine on clips that show nothing, since other processes know no scripted one."""
    videos = [open_clip(tmp_path, name, 2) for name in ("first", "second")]
    run_track(videos, clip_run(), tmp_path / "one")
    run_track(videos, clip_run(), tmp_path / "two", workers=2)
    assert lines(tmp_path / "one") == lines(tmp_path / "two")
    assert {path.name for path in (tmp_path / "two").glob("*.yaml")} == {"first.venue.yaml", "second.venue.yaml"}


def test_a_known_venue_is_part_of_the_digest(tmp_path, engine):
    known = scripted.survey_clip(None, 1.0, load_config())
    run = ClipRun(load_config(), Sampling.parse("1"), known)
    assert run.digest != clip_run().digest
    report = run_track([open_clip(tmp_path, frames=12)], run, tmp_path / "out")
    assert report.venues["clip"].tripods[0] is known.tripods[0]


def test_what_painters_leave_open_is_part_of_the_digest_and_of_what_is_told():
    known = scripted.survey_clip(None, 1.0, load_config())
    (tripod,) = known.tripods
    follows = np.zeros(len(COMMON))
    follows[PLACE["axis_y"]] = 0.3
    painters = PaintersShare(tripod.covariance, {"blue_line_left y": follows})
    painted = replace(known, tripods=(replace(tripod, painters=painters),))
    usual, other = (ClipRun(load_config(), Sampling.parse("1"), venue) for venue in (known, painted))
    assert usual.digest != other.digest
    (without,), (told,) = (list(tripod_facts(venue, load_field("soccer"))) for venue in (known, painted))
    assert told["x_m"] == pytest.approx(without["x_m"]) and told["y_m"][0] == without["y_m"][0]
    assert told["y_m"][1] == pytest.approx(np.hypot(without["y_m"][1], 0.3))


def test_times_come_back_from_names():
    assert frame_time(frame_id("a_00-00-01.000_b", 3723.4567)) == pytest.approx(3723.457)
    with pytest.raises(ValueError, match="names no time"):
        frame_time("picture")


def test_a_folder_that_cannot_be_written_is_told(tmp_path, engine):
    (tmp_path / "out").write_text("a file")
    with pytest.raises(InputError, match="is a file"):
        run_track([open_clip(tmp_path)], clip_run(), tmp_path / "out")
