"""Frames of a video in the report."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from circlecal.pictures.files import REPORT_FOLDER
from circlecal.pictures.limits import DEFAULT_LIMITS
from circlecal.pictures.video import Sampling, Video, pictures_at
from circlecal.report.pictures import Media
from tests.report.conftest import refused
from tests.report.test_pages import details, listing, media, written


@pytest.fixture
def video(tmp_path, frame_image) -> Path:
    """Twenty pictures at 5 per second; a patch gets brighter with each."""
    path = tmp_path / "match.avi"
    height, width = frame_image.shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 5.0, (width, height))
    if not writer.isOpened():
        pytest.skip("OpenCV writes no video here")
    for k in range(20):
        picture = frame_image.copy()
        picture[:40, :40] = 12 * k
        writer.write(picture)
    writer.release()
    return path


def patch(picture: np.ndarray) -> float:
    return float(picture[5:35, 5:35].mean())


def test_pictures_at_the_times_that_were_told(video):
    frames = list(Video.open(video, "match", DEFAULT_LIMITS).frames(Sampling.parse("600ms"), lambda error: None))
    again = list(pictures_at(video, [frame.time_s for frame in frames]))
    assert len(frames) == 7
    for frame, picture in zip(frames, again, strict=True):
        np.testing.assert_array_equal(frame.picture, picture)
    assert [picture is None for picture in pictures_at(video, [0.2, 0.3, 3.8, 99.0, 0.4])] == [
        False,
        True,
        False,
        True,
        False,
    ]


@pytest.mark.parametrize("moved", [False, True])
def test_a_match_in_the_report(tmp_path, video, named, moved):
    times = [0.4, 1.0, 3.0]
    records = [named(f"m{time}", source={"path": str(video), "time_s": time}) for time in times]
    options = {}
    if moved:
        (tmp_path / "archive").mkdir()
        video.rename(tmp_path / "archive" / video.name)
        options["frames"] = tmp_path / "archive"
    report = written(tmp_path / "run", [refused("a"), *reversed(records)], **options)
    assert listing(report)["videos"] == ["match.avi"]
    assert [Media.FRAME in has for has in media(report)] == [False, True, True, True]
    seen = [patch(cv2.imread(str(report / "frames" / "000" / f"{k:06d}.jpg"))) for k in (1, 2, 3)]
    np.testing.assert_allclose(seen, [12 * 5 * time for time in times], atol=4)
    assert dict(details(report)[2]["facts"])["file"] == f"{video} at 0:01"


def test_a_video_that_was_replaced_is_told_once_and_not_shown(tmp_path, video, named, caplog):
    size = video.stat().st_size
    records = [named(f"m{time}", source={"path": str(video), "time_s": time, "bytes": size}) for time in (0.4, 1.0)]
    assert all(Media.FRAME in has for has in media(written(tmp_path / "run", records)))
    with video.open("ab") as file:
        file.write(bytes(100))
    report = written(tmp_path / "run", records)
    assert not any(Media.FRAME in has for has in media(report))
    told = f"{video}: has changed since its frames were calibrated; their pictures are left out"
    assert [message for message in caplog.messages if "changed" in message] == [told]


def test_a_video_that_is_gone_or_none(tmp_path, named):
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(b"no video" * 100)
    records = [
        named(f"{path}{t}", source={"path": path, "time_s": t})
        for path in ("gone.mp4", str(broken))
        for t in (0.0, 1.0)
    ]
    report = written(tmp_path / "run", records)
    assert [Media.FRAME in has for has in media(report)] == [False] * 4
    assert all(Media.TEMPLATE in has for has in media(report))


def test_from_the_video_to_the_report(tmp_path, video, run_circlecal, in_this_process):
    assert run_circlecal("batch", video, "--every", "2s", "--out", tmp_path / "run", "--workers", 1).code == 0
    assert run_circlecal("report", tmp_path / "run").out.endswith("index.html: 2 frames\n")
    assert listing(tmp_path / "run" / REPORT_FOLDER)["columns"]["time_s"] == [0.0, 2.0]
    second = cv2.imread(str(tmp_path / "run" / REPORT_FOLDER / "frames" / "000" / "000001.jpg"))
    assert patch(second) == pytest.approx(120, abs=4)
