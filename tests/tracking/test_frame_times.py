"""Numbers of frames where their rate varies, and that none of them is lost."""

from __future__ import annotations

import itertools
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from circlecal.pictures.limits import DEFAULT_LIMITS
from circlecal.pictures.video import Sampling, Video
from circlecal.pictures.video_writer import write_video
from circlecal.tracking import stretches
from circlecal.tracking.frame_times import FrameTimes
from circlecal.tracking.run import run_track

from . import scripted
from .test_run import clip_run, lines

PERIODS_MS = (40, 40, 33, 120, 20, 40, 67)
"""Of frames that follow each other, milliseconds: their mean rate is no rate of any of them."""


@pytest.fixture(autouse=True)
def engine(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    monkeypatch.setattr(stretches, "survey_clip", scripted.survey_clip)
    monkeypatch.setattr(stretches, "track_frames", scripted.track_frames)
    return monkeypatch


def write_varying(path: Path, count: int) -> tuple[Video, list[float]]:
    """A clip whose rate varies, and the times of its frames, seconds."""
    periods = itertools.chain([0], itertools.cycle(PERIODS_MS))
    times = [ms / 1000.0 for ms in itertools.accumulate(itertools.islice(periods, count))]
    with write_video(path, 20.0) as writer:
        for k, time_s in enumerate(times):
            writer.write(np.full((180, 320, 3), 40 + 3 * (k % 40), np.uint8), time_s)
    return Video.open(path, path.stem, DEFAULT_LIMITS), times


@pytest.mark.parametrize("every", [1, 2, 3, 7])
def test_each_nth_frame_of_a_clip_of_varying_rate_has_a_record_and_its_number(tmp_path: Path, every: int) -> None:
    video, times = write_varying(tmp_path / "clip.mp4", 60)
    run_track([video], clip_run(str(every)), tmp_path / "out")
    found = lines(tmp_path / "out")
    assert [line["track"]["frame"] for line in found] == list(range(0, 60, every))
    assert [line["source"]["time_s"] for line in found] == pytest.approx(times[::every], abs=1e-4)


@pytest.mark.parametrize("every", ["1", "3", "200ms"])
@pytest.mark.parametrize("start", [None, "0.5"])
@pytest.mark.parametrize("is_followed", [True, False])
def test_neither_stretches_nor_a_stop_change_a_number(
    tmp_path: Path, engine: pytest.MonkeyPatch, every: str, start: str | None, is_followed: bool
) -> None:
    if not is_followed:
        engine.setattr(stretches, "FOLLOWED_STEP_S", 1.0)
    video, times = write_varying(tmp_path / "clip.mp4", 60)
    run = clip_run(every, start=start)
    run_track([video], run, tmp_path / "whole")
    engine.setattr(stretches, "STRETCH_S", 0.7)
    engine.setattr(stretches, "MARGIN_S", 0.2)
    run_track([video], run, tmp_path / "many")
    whole = lines(tmp_path / "whole")
    assert lines(tmp_path / "many") == whole
    numbers = [line["track"]["frame"] for line in whole]
    assert numbers[0] == np.searchsorted(times, float(start or 0.0))
    assert [times[number] for number in numbers] == pytest.approx(
        [line["source"]["time_s"] for line in whole], abs=1e-4
    )
    for stop_after in (1, len(whole) // 2, len(whole) - 1):
        out = tmp_path / f"stopped-{stop_after}"

        def stop(progress: object, count: int = stop_after) -> None:
            if progress.finished == count:  # type: ignore[attr-defined]
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            run_track([video], run, out, on_progress=stop)
        run_track([video], run, out)
        assert lines(out) == whole


def test_no_frame_is_lost_where_the_header_tells_a_lower_rate(tmp_path: Path) -> None:
    """As that of a clip does whose last frame is shown for long: the mean rate then is that of no two frames."""
    path = scripted.write_clip(tmp_path / "clip.mp4", 60)
    video = replace(Video.open(path, "clip", DEFAULT_LIMITS), rate=0.95 * scripted.RATE)
    run_track([video], clip_run(), tmp_path / "out")
    assert [line["track"]["frame"] for line in lines(tmp_path / "out")] == list(range(60))


def test_a_file_whose_packets_tell_no_times_is_counted_by_its_rate(tmp_path: Path) -> None:
    if "libx264" not in av.codecs_available:
        pytest.skip("this FFmpeg writes no H.264")
    with av.open(str(tmp_path / "clip.h264"), "w", format="h264") as container:
        stream = container.add_stream("libx264", rate=Fraction(25))
        stream.width, stream.height = 320, 180
        for k in range(20):
            picture = np.full((180, 320, 3), 40 + 3 * k, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode(None))
    video = Video.open(tmp_path / "clip.h264", "clip", DEFAULT_LIMITS)
    assert video.list_times() == ()
    run_track([video], clip_run(), tmp_path / "out")
    assert [line["track"]["frame"] for line in lines(tmp_path / "out")] == list(range(20))
    run_track([video], clip_run("5"), tmp_path / "fifth")
    assert [line["track"]["frame"] for line in lines(tmp_path / "fifth")] == [0, 5, 10, 15]


def test_numbers_of_times_and_times_of_numbers() -> None:
    whole = FrameTimes(25.0, (0.0, 0.04, 0.1, 0.5, 0.52))
    for frames in (whole, whole.cut(1, 4), whole.cut(-3, 9)):
        assert [frames.number_at(time_s) for time_s in (0.04, 0.0996, 0.3, 0.52, 9.0)] == [1, 2, 2, 4, 4]
        assert [frames.number_from(time_s) for time_s in (0.04, 0.05, 0.3, 0.5204, 9.0)] == [1, 2, 3, 4, 5]
        assert [frames.time_of(number) for number in (1, 3, 7)] == [0.04, 0.5, 0.52]


def test_times_that_packets_tell_are_those_of_the_frames(tmp_path: Path) -> None:
    video, times = write_varying(tmp_path / "clip.mp4", 60)
    assert video.list_times() == pytest.approx(times, abs=1e-4)
    decoded = [frame.time_s for frame in video.frames(Sampling.parse("1"))]
    assert video.list_times() == pytest.approx(decoded, abs=1e-6)
    assert len(video.list_times(0.5)) >= np.searchsorted(times, 0.5)
