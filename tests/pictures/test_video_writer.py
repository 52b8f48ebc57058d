"""Videos that are written have the times that were given, and appear whole or not at all."""

import av
import cv2
import numpy as np
import pytest
from videos import number_of, numbered_picture

from circlecal.errors import InputError
from circlecal.pictures import video_writer
from circlecal.pictures.limits import DEFAULT_LIMITS
from circlecal.pictures.video import Sampling, Video
from circlecal.pictures.video_writer import write_video


def read(path):
    return list(Video.open(path, "x", DEFAULT_LIMITS).frames(Sampling.parse("1")))


@pytest.mark.parametrize("rate", [24, 25, 30000 / 1001, 50, 60])
def test_every_frame_has_its_time(tmp_path, rate):
    path = tmp_path / "new" / "x.mp4"
    with write_video(path, rate) as writer:
        for number in range(40):
            writer.write(numbered_picture(number), number / rate)
    frames = read(path)
    assert [number_of(frame.picture) for frame in frames] == list(range(40))
    assert [frame.time_s for frame in frames] == pytest.approx([k / rate for k in range(40)], abs=1e-5)
    assert Video.open(path, "x", DEFAULT_LIMITS).rate == pytest.approx(rate)


def test_times_need_not_be_even(tmp_path):
    times = [0.0, 0.04, 0.08, 1.0, 1.02, 5.5]
    with write_video(tmp_path / "x.mp4", 25.0) as writer:
        for number, time_s in enumerate(times):
            writer.write(numbered_picture(number), time_s)
        with pytest.raises(ValueError, match="cannot follow"):
            writer.write(numbered_picture(0), 5.5)
    assert [frame.time_s for frame in read(tmp_path / "x.mp4")] == pytest.approx(times, abs=1e-5)


def test_colours_come_back(tmp_path):
    """Both ways with the matrix that is written into the file: with another one, red is wrong by 15 grey levels."""
    picture = np.zeros((96, 160, 3), np.uint8)
    picture[:, :80], picture[:, 80:] = (42, 118, 72), (222, 40, 190)
    with write_video(tmp_path / "x.mp4", 25.0) as writer:
        writer.write(picture, 0.0)
    [frame] = read(tmp_path / "x.mp4")
    for columns in (slice(8, 70), slice(90, 150)):
        error = frame.picture[8:-8, columns].mean(axis=(0, 1)) - picture[8:-8, columns].mean(axis=(0, 1))
        assert np.abs(error).max() < 4


@pytest.mark.parametrize("codec", ["libx264", "mpeg4"])
@pytest.mark.parametrize("is_interlaced", [True, False])
def test_a_file_says_whether_its_frames_hold_two_fields(tmp_path, monkeypatch, codec, is_interlaced):
    """And holds them: rows of one field stay apart from those of the other."""
    if codec not in av.codecs_available:
        pytest.skip(f"this FFmpeg has no {codec}")
    monkeypatch.setattr(video_writer, "_CODECS", [entry for entry in video_writer._CODECS if entry[0] == codec])
    picture = np.full((96, 160, 3), 60, np.uint8)
    picture[::2, 40:80], picture[1::2, 60:100] = (222, 140, 190), (222, 140, 190)
    with write_video(tmp_path / "x.mp4", 25.0, is_interlaced=is_interlaced) as writer:
        for number in range(12):
            writer.write(np.roll(picture, 2 * number, axis=1), number / 25.0)
    with av.open(str(tmp_path / "x.mp4")) as container:
        stream = container.streams.video[0]
        assert {frame.interlaced_frame for frame in container.decode(stream)} == {is_interlaced}
    frames = read(tmp_path / "x.mp4")
    assert [frame.time_s for frame in frames] == pytest.approx([k / 25.0 for k in range(12)], abs=1e-5)
    for number, frame in enumerate(frames):
        off = cv2.cvtColor(frame.picture, cv2.COLOR_BGR2GRAY).astype(float)
        off -= cv2.cvtColor(np.roll(picture, 2 * number, axis=1), cv2.COLOR_BGR2GRAY)
        assert np.sqrt(np.square(off).mean()) < 8.0


def test_an_odd_row_and_column_are_left_out(tmp_path):
    with write_video(tmp_path / "x.mp4", 25.0) as writer:
        writer.write(np.full((97, 161, 3), 90, np.uint8), 0.0)
    assert read(tmp_path / "x.mp4")[0].picture.shape == (96, 160, 3)


def test_after_an_error_there_is_no_file(tmp_path):
    with pytest.raises(RuntimeError), write_video(tmp_path / "x.mp4", 25.0) as writer:
        writer.write(numbered_picture(0), 0.0)
        raise RuntimeError
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"), write_video(tmp_path / "file" / "x.mp4", 25.0):
        pass


def test_pixels_that_are_not_square_stay_so(tmp_path):
    for name, aspect in (("wide", 4 / 3), ("square", None)):
        with write_video(tmp_path / f"{name}.mp4", 25.0, aspect) as writer:
            writer.write(numbered_picture(0), 0.0)
        assert Video.open(tmp_path / f"{name}.mp4", name, DEFAULT_LIMITS).aspect == (
            None if aspect is None else pytest.approx(aspect)
        )
