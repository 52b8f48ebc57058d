"""Decoding the wanted frames of a video, and no others."""

import tracemalloc
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from videos import (
    HEIGHT,
    RATE,
    WIDTH,
    copy_stream,
    number_of,
    numbered_picture,
    write_h264,
    write_variable_rate,
    write_video,
)

from circlecal.errors import InputError
from circlecal.pictures.limits import DEFAULT_LIMITS
from circlecal.pictures.video import Sampling, Video, _Decoder, frame_id, pictures_at

COUNT = 700
KINDS = [("mp4", "mp4v"), ("avi", "MJPG"), ("mkv", "VP90"), ("ts", "MPG2"), ("mpg", "MPG2"), ("mov", "XVID")]


@pytest.fixture(scope="module", params=KINDS, ids=lambda kind: kind[0])
def video(request, tmp_path_factory) -> Path:
    suffix, code = request.param
    return write_video(tmp_path_factory.mktemp("videos") / f"match.{suffix}", code, COUNT)


def fail(missing: str) -> None:
    raise AssertionError(missing)


def taken(path: Path, every: str, start: str | None = None, end: str | None = None) -> list[tuple[int, float]]:
    """Number shown by, and time of each frame."""
    frames = Video.open(path, "match", DEFAULT_LIMITS).frames(Sampling.parse(every, start, end), fail)
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
    for wrong in ("1:75", "1:60:00"):
        with pytest.raises(InputError, match="60 or more minutes or seconds behind a colon"):
            Sampling.parse("1s", wrong)
    assert Sampling.parse("1s", "93:20").start_s == 93 * 60 + 20, "minutes of a match are counted past the hour"


def test_times_as_numbers():
    assert Sampling.parse("1s", 0.1 + 0.2, 3.4000000000000004) == Sampling.parse("1s", "0.3", "3.4")
    assert Sampling.parse(5, 1e-5, np.float32(2)) == Sampling.parse("5", "0.00001", "2")
    for wrong in (-1.0, float("nan"), 1e12, Path("x")):
        with pytest.raises(InputError, match=rf"^start {wrong}: must be seconds"):
            Sampling.parse("1s", wrong)


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
    opened = av.open

    class Lying:
        def __init__(self, *arguments: object, **options: object) -> None:
            self._container = opened(*arguments, **options)

        def __getattr__(self, name: str) -> object:
            return getattr(self._container, name)

        def seek(self, ticks: int, stream: av.VideoStream) -> None:
            self._container.seek(ticks + round(20 / stream.time_base), stream=stream, backward=False)

    monkeypatch.setattr("av.open", Lying)
    assert taken(path, "10s") == expected


def test_a_title_that_is_no_utf8(tmp_path):
    path = write_video(tmp_path / "match.mp4", "mp4v", 3)
    titled = tmp_path / "titled.mkv"
    with av.open(str(path)) as opened, av.open(str(titled), "w") as written:
        written.metadata["title"] = "a title"
        target = written.add_stream_from_template(opened.streams.video[0])
        for packet in opened.demux(opened.streams.video[0]):
            if packet.dts is not None:
                packet.stream = target
                written.mux(packet)
    content = titled.read_bytes()
    assert b"a title" in content
    titled.write_bytes(content.replace(b"a title", b"\xff\xfe\xfd\xfc\xfb\xfa\xf9"))
    assert len(taken(titled, "1")) == 3


def test_long_stretches_are_skipped(tmp_path, monkeypatch):
    path = write_video(tmp_path / "match.avi", "MJPG", COUNT)
    grabbed = []
    grab = _Decoder.grab
    monkeypatch.setattr(_Decoder, "grab", lambda self: grabbed.append(1) or grab(self))
    assert [number for number, _ in taken(path, "20s")] == [0, 500]
    assert len(grabbed) < COUNT / 2


def test_memory_does_not_grow_with_the_length(tmp_path):
    path = write_video(tmp_path / "match.avi", "MJPG", COUNT)
    video = Video.open(path, "match", DEFAULT_LIMITS)
    tracemalloc.start()
    for frame in video.frames(Sampling.parse("1"), fail):
        assert frame.picture.shape == (HEIGHT, WIDTH, 3)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * 3 * WIDTH * HEIGHT


def test_ids_sort_as_times_do(tmp_path):
    path = write_video(tmp_path / "match.avi", "MJPG", 60)
    frames = list(Video.open(path, "match", DEFAULT_LIMITS).frames(Sampling.parse("1s"), fail))
    assert [frame.id for frame in frames] == ["match_00-00-00.000", "match_00-00-01.000", "match_00-00-02.000"]
    times = [0.0, 0.04, 59.999, 60.0, 3599.96, 3600.0, 36000.0]
    assert sorted(frame_id("x", time) for time in times) == [frame_id("x", time) for time in times]
    assert frame_id("match", 723.48) == "match_00-12-03.480"


def test_what_the_header_says(tmp_path):
    video = Video.open(write_video(tmp_path / "match.avi", "MJPG", 100), "match", DEFAULT_LIMITS)
    assert (video.width, video.height, video.rate, video.duration_s, video.aspect) == (WIDTH, HEIGHT, RATE, 4.0, None)
    for every, count in (("1s", 4), ("1", 100), ("30", 4), ("10ms", 100)):
        sampling = Sampling.parse(every)
        assert video.estimate_count(sampling) == len(list(video.frames(sampling, fail))) == count


def test_pixels_that_are_not_square(tmp_path):
    path = write_h264(tmp_path / "match.mp4", [numbered_picture(k) for k in range(3)], aspect=Fraction(16, 15))
    video = Video.open(path, "match", DEFAULT_LIMITS)
    assert video.aspect == pytest.approx(16 / 15)
    assert [frame.aspect for frame in video.frames(Sampling.parse("2"), fail)] == [video.aspect] * 2


@pytest.mark.parametrize("turned_deg", [90, 180, -90])
def test_a_picture_is_turned_as_players_show_it(tmp_path, turned_deg):
    if not hasattr(av.VideoStream, "set_display_rotation"):
        pytest.skip("this PyAV writes no rotation")
    picture = cv2.resize(numbered_picture(1234), None, fx=2, fy=2)
    path = write_h264(tmp_path / "phone.mp4", [picture] * 3, turned_deg=turned_deg, aspect=Fraction(4, 3))
    video = Video.open(path, "phone", DEFAULT_LIMITS)
    frame = next(video.frames(Sampling.parse("1"), fail))
    np.testing.assert_allclose(frame.picture, np.rot90(picture, turned_deg // 90), atol=40)
    assert frame.picture.shape[:2] == (video.height, video.width)
    assert video.aspect == pytest.approx(4 / 3 if turned_deg == 180 else 3 / 4)
    shown = cv2.VideoCapture(str(path)).read()[1]
    np.testing.assert_allclose(frame.picture, shown, atol=6)


@pytest.fixture(scope="module")
def whole_match(tmp_path_factory) -> Path:
    """Key frames at 0, 5, 10 and 15 s."""
    folder = tmp_path_factory.mktemp("whole")
    return write_h264(folder / "match.mp4", [numbered_picture(k) for k in range(500)], key_every=125)


def test_a_clip_cut_by_stream_copy_shows_what_its_edit_list_says(tmp_path, whole_match):
    path = copy_stream(whole_match, tmp_path / "clip.mp4", 8.0, 14.0, {"avoid_negative_ts": "disabled"})
    with av.open(str(path)) as container:
        assert container.streams.video[0].frames > 150  # those before 8 s are in the file, and are not shown
    video = Video.open(path, "clip", DEFAULT_LIMITS)
    found = taken(path, "1")
    assert [number for number, _ in found] == list(range(200, 200 + len(found)))
    assert [time for _, time in found] == pytest.approx([k / RATE for k in range(len(found))], abs=1e-3)
    assert video.estimate_count(Sampling.parse("1")) == len(found) == pytest.approx(150, abs=3)
    assert video.duration_s == pytest.approx(6.0, abs=0.15)
    assert [number for number, _ in taken(path, "9s", "5.6")] == [340]


@pytest.mark.parametrize("name", ["clip.mkv", "clip.ts", "clip.mp4"])
def test_a_clip_that_begins_between_key_frames_begins_with_the_first_frame_that_is_shown(tmp_path, whole_match, name):
    from_key = copy_stream(whole_match, tmp_path / f"key-{name}", 8.0, 16.0, {"avoid_negative_ts": "make_zero"})
    path = tmp_path / name
    with av.open(str(from_key)) as opened, av.open(str(path), "w") as written:
        stream = opened.streams.video[0]
        target = written.add_stream_from_template(stream)
        for number, packet in enumerate(opened.demux(stream)):
            if packet.dts is not None and number >= 40:  # the key frame at 5 s is gone, that at 10 s stays
                packet.stream = target
                written.mux(packet)
    missing: list[str] = []
    video = Video.open(path, "clip", DEFAULT_LIMITS)
    frames = list(video.frames(Sampling.parse("1"), missing.append))
    assert [number_of(frame.picture) for frame in frames] == list(range(250, 250 + len(frames)))
    assert [frame.time_s for frame in frames] == pytest.approx([k / RATE for k in range(len(frames))], abs=1.1e-3)
    assert video.estimate_count(Sampling.parse("1")) == pytest.approx(len(frames), abs=3)
    assert missing == [f"{path}: its first 3.4 s lack the key frame that they build upon; all else was read"]
    every_second = video.frames(Sampling.parse("1s"), missing.append)
    assert [number_of(frame.picture) for frame in every_second][:4] == [250, 275, 300, 325]


def test_pictures_at_times_in_any_order(tmp_path):
    path = write_h264(tmp_path / "match.mp4", (numbered_picture(k) for k in range(700)), key_every=125)
    times = [20.0, 3.0, 3.0, 27.96, 0.0, 15.0, 28.5, 15.04, 14.0]
    found = [None if p is None else number_of(p) for p in pictures_at(path, times)]
    assert found == [500, 75, 75, 699, 0, 375, None, 376, 350]


def test_a_truncated_video_gives_what_it_has_and_one_line(tmp_path):
    path = write_video(tmp_path / "match.avi", "MJPG", 200)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    missing: list[str] = []
    frames = list(Video.open(path, "match", DEFAULT_LIMITS).frames(Sampling.parse("25"), missing.append))
    assert [number_of(frame.picture) for frame in frames][:4] == [0, 25, 50, 75]
    assert len(missing) == 1
    assert f"{path}: ends at 00:00:0" in missing[0]
    assert "not at 00:00:08.000" in missing[0]


def test_what_cannot_be_decoded_is_left_out_and_told_once(tmp_path):
    path = write_h264(tmp_path / "match.ts", [numbered_picture(k) for k in range(200)], key_every=25)
    content = bytearray(path.read_bytes())
    start = len(content) // 2
    content[start : start + 1000] = np.random.default_rng(0).bytes(1000)
    path.write_bytes(content)
    missing: list[str] = []
    frames = list(Video.open(path, "match", DEFAULT_LIMITS).frames(Sampling.parse("1"), missing.append))
    assert 150 < len(frames) <= 200
    assert number_of(frames[0].picture) == 0
    assert number_of(frames[-1].picture) == 199
    assert frames[-1].time_s == pytest.approx(7.96, abs=1e-3)
    assert len(missing) <= 1


@pytest.mark.parametrize("content", [b"", b"no video", b"\0\0\0\x18ftypmp42" + bytes(500)])
def test_no_video(tmp_path, content):
    path = tmp_path / "match.mp4"
    path.write_bytes(content)
    with pytest.raises(InputError, match="is no video that can be read"):
        Video.open(path, "match", DEFAULT_LIMITS)


def test_a_missing_video(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        Video.open(tmp_path / "match.mp4", "match", DEFAULT_LIMITS)


@pytest.mark.parametrize("every", ["0", "0s", "-1", "1.5", "often", "", "s", "1e3"])
def test_a_wrong_step(every):
    with pytest.raises(InputError, match=r"^--every"):
        Sampling.parse(every, dashes="--")


def test_times():
    assert Sampling.parse("1s", "90", "0:02:00.5") == Sampling(1.0, None, 90.0, 120.5)
    assert Sampling.parse("25", "1:30") == Sampling(None, 25, 90.0)
    for wrong in (("1:2:3:4", None), ("x", None), ("5", "4")):
        with pytest.raises(InputError, match=r"^--start|^--end"):
            Sampling.parse("1s", *wrong, dashes="--")
