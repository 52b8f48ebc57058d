"""Decoding the wanted frames of a video, and no others."""

import tracemalloc
from pathlib import Path

import cv2
import pytest
from videos import HEIGHT, RATE, WIDTH, number_of, write_variable_rate, write_video

from circlecal.errors import InputError
from circlecal.pictures.video import Sampling, Video, _Decoder, frame_id

COUNT = 700
KINDS = [("mp4", "mp4v"), ("avi", "MJPG"), ("mkv", "VP90"), ("ts", "MPG2"), ("mpg", "MPG2"), ("mov", "XVID")]


@pytest.fixture(scope="module", params=KINDS, ids=lambda kind: kind[0])
def video(request, tmp_path_factory) -> Path:
    suffix, code = request.param
    return write_video(tmp_path_factory.mktemp("videos") / f"match.{suffix}", code, COUNT)


def fail(error: InputError) -> None:
    raise error


def taken(path: Path, every: str, start: str | None = None, end: str | None = None) -> list[tuple[int, float]]:
    """Number shown by, and time of each frame."""
    frames = Video.open(path, "match").frames(Sampling.parse(every, start, end), fail)
    return [(number_of(frame.picture), frame.time_s) for frame in frames]


@pytest.mark.parametrize("step", [1, 7, 250])
def test_every_so_many_frames(video, step):
    assert [number for number, _ in taken(video, str(step))] == list(range(0, COUNT, step))


@pytest.mark.parametrize(("every", "step"), [("40ms", 1), ("1s", 25), ("600ms", 15), ("10s", 250), ("0.2min", 300)])
def test_every_so_many_seconds(video, every, step):
    found = taken(video, every)
    assert [number for number, _ in found] == list(range(0, COUNT, step))
    assert [time for _, time in found] == pytest.approx([n / RATE for n in range(0, COUNT, step)], abs=1e-3)


def test_times_between_two_frames_take_the_later_one(video):
    assert [number for number, _ in taken(video, "1.01s")][:4] == [0, 26, 51, 76]


@pytest.mark.parametrize("start", [0.0, 0.04, 3.1, 8.5, 11.96, 12.0, 19.99, 24.4, 27.96])
def test_a_start_anywhere(video, start):
    first = round(-(-start // 0.04)) if start % 0.04 > 1e-6 else round(start * RATE)
    assert [number for number, _ in taken(video, "1", str(start))][:3] == list(range(first, COUNT))[:3]
    assert [number for number, _ in taken(video, "9s", str(start))] == list(range(first, COUNT, 225))


def test_an_end(video):
    assert [number for number, _ in taken(video, "1s", "10", "0:13")] == [250, 275, 300]
    assert taken(video, "1s", "1:00:00") == []


def test_a_rate_that_is_no_whole_number(tmp_path):
    path = write_video(tmp_path / "match.mp4", "mp4v", 400, 30000 / 1001)
    assert [number for number, _ in taken(path, "1s")][:5] == [0, 30, 60, 90, 120]
    assert taken(path, "1", "10")[0][0] == 300


def test_a_variable_rate(tmp_path):
    times = write_variable_rate(tmp_path / "match.mkv", 600)
    for every in (1000, 100, 9000):
        expected, target = [], 0
        for number, time in enumerate(times):
            if round(1000 * time) >= target:
                expected.append(number)
                target = (round(1000 * time) // every + 1) * every
        assert [number for number, _ in taken(tmp_path / "match.mkv", f"{every}ms")] == expected
    assert [number for number, _ in taken(tmp_path / "match.mkv", "50", "20")][:2] == [300, 350]


def test_a_seek_that_leads_too_far_is_not_believed(tmp_path, monkeypatch):
    path = write_video(tmp_path / "match.mp4", "mp4v", COUNT)
    expected = taken(path, "10s")
    capture = cv2.VideoCapture

    class Lying:
        def __init__(self, name: str) -> None:
            self._capture = capture(name)

        def __getattr__(self, name: str) -> object:
            return getattr(self._capture, name)

        def set(self, key: int, value: float) -> bool:
            return self._capture.set(key, value + 6000.0)

    monkeypatch.setattr("circlecal.pictures.video.cv2.VideoCapture", Lying)
    assert taken(path, "10s") == expected


def test_long_stretches_are_skipped(tmp_path, monkeypatch):
    path = write_video(tmp_path / "match.avi", "MJPG", COUNT)
    grabbed = []
    grab = _Decoder.grab
    monkeypatch.setattr(_Decoder, "grab", lambda self: grabbed.append(1) or grab(self))
    assert [number for number, _ in taken(path, "20s")] == [0, 500]
    assert len(grabbed) < COUNT / 2


def test_memory_does_not_grow_with_the_length(tmp_path):
    path = write_video(tmp_path / "match.avi", "MJPG", COUNT)
    video = Video.open(path, "match")
    tracemalloc.start()
    for frame in video.frames(Sampling.parse("1"), fail):
        assert frame.picture.shape == (HEIGHT, WIDTH, 3)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * 3 * WIDTH * HEIGHT


def test_ids_sort_as_times_do(tmp_path):
    path = write_video(tmp_path / "match.avi", "MJPG", 60)
    frames = list(Video.open(path, "match").frames(Sampling.parse("1s"), fail))
    assert [frame.id for frame in frames] == ["match_00-00-00.000", "match_00-00-01.000", "match_00-00-02.000"]
    times = [0.0, 0.04, 59.999, 60.0, 3599.96, 3600.0, 36000.0]
    assert sorted(frame_id("x", time) for time in times) == [frame_id("x", time) for time in times]
    assert frame_id("match", 723.48) == "match_00-12-03.480"


def test_what_the_header_says(tmp_path):
    video = Video.open(write_video(tmp_path / "match.avi", "MJPG", 100), "match")
    assert (video.width, video.height, video.rate, video.duration_s, video.aspect) == (WIDTH, HEIGHT, RATE, 4.0, None)
    for every, count in (("1s", 4), ("1", 100), ("30", 4), ("10ms", 100)):
        sampling = Sampling.parse(every)
        assert video.estimate_count(sampling) == len(list(video.frames(sampling, fail))) == count


def test_pixels_that_are_not_square(tmp_path, monkeypatch):
    path = write_video(tmp_path / "match.avi", "MJPG", 3)
    value = _Decoder.value
    sar = {cv2.CAP_PROP_SAR_NUM: 16.0, cv2.CAP_PROP_SAR_DEN: 15.0}
    monkeypatch.setattr(_Decoder, "value", lambda self, key: sar.get(key) or value(self, key))
    video = Video.open(path, "match")
    assert video.aspect == pytest.approx(16 / 15)
    assert [frame.aspect for frame in video.frames(Sampling.parse("2"), fail)] == [video.aspect] * 2


def test_a_truncated_video_gives_what_it_has_and_one_line(tmp_path):
    path = write_video(tmp_path / "match.avi", "MJPG", 200)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    errors: list[InputError] = []
    frames = list(Video.open(path, "match").frames(Sampling.parse("25"), errors.append))
    assert [number_of(frame.picture) for frame in frames][:4] == [0, 25, 50, 75]
    assert len(errors) == 1
    assert f"{path}: ends at 00:00:0" in str(errors[0])
    assert "not at 00:00:08.000" in str(errors[0])


@pytest.mark.parametrize("content", [b"", b"no video", b"\0\0\0\x18ftypmp42" + bytes(500)])
def test_no_video(tmp_path, content):
    path = tmp_path / "match.mp4"
    path.write_bytes(content)
    with pytest.raises(InputError, match="is no video that can be read"):
        Video.open(path, "match")


def test_a_missing_video(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        Video.open(tmp_path / "match.mp4", "match")


@pytest.mark.parametrize("every", ["0", "0s", "-1", "1.5", "often", "", "s", "1e3"])
def test_a_wrong_step(every):
    with pytest.raises(InputError, match="--every"):
        Sampling.parse(every)


def test_times():
    assert Sampling.parse("1s", "90", "0:02:00.5") == Sampling(1.0, None, 90.0, 120.5)
    assert Sampling.parse("25", "1:30") == Sampling(None, 25, 90.0)
    for wrong in (("1:2:3:4", None), ("x", None), ("5", "4")):
        with pytest.raises(InputError, match=r"--start|--end"):
            Sampling.parse("1s", *wrong)
