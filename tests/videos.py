"""Videos whose frames carry their number as a pattern of bars, in containers that are seeked in different ways."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

BITS = 12
WIDTH, HEIGHT = 160, 96
RATE = 25.0


def numbered_picture(number: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """Picture (height, width, 3) that shows a number."""
    picture = np.full((height, width, 3), 60, np.uint8)
    for bit in range(BITS):
        if number >> bit & 1:
            picture[8 : height - 8, 8 + 12 * bit : 18 + 12 * bit] = 220
    return picture


def number_of(picture: np.ndarray) -> int:
    """The number that a picture shows."""
    inner = picture[20 : HEIGHT - 20]
    return sum(1 << bit for bit in range(BITS) if inner[:, 11 + 12 * bit : 15 + 12 * bit].mean() > 140)


def write_video(path: Path, code: str, count: int, rate: float = RATE, width: int = WIDTH) -> Path:
    """A video of numbered frames; the test is skipped where this OpenCV cannot write it."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), rate, (width, HEIGHT))
    if not writer.isOpened():
        pytest.skip(f"this OpenCV writes no {code} into {path.suffix}")
    for number in range(count):
        writer.write(numbered_picture(number, width))
    writer.release()
    return path


def write_variable_rate(path: Path, count: int) -> list[float]:
    """A video with 25, then 8 1/3, then 12.5 frames per second; the times of its frames."""
    if not hasattr(cv2, "VIDEOWRITER_PROP_PTS"):
        pytest.skip("this OpenCV sets no times of frames")
    raw = [cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"MJPG"), RATE, (WIDTH, HEIGHT), raw)
    times, ticks = [], 0
    for number in range(count):
        writer.set(cv2.VIDEOWRITER_PROP_KEY_FLAG, 1)
        writer.set(cv2.VIDEOWRITER_PROP_PTS, ticks)
        writer.write(cv2.imencode(".jpg", numbered_picture(number))[1].reshape(1, -1))
        times.append(ticks / RATE)
        ticks += 1 if number < count // 3 else 3 if number < 2 * count // 3 else 2
    writer.release()
    return times


def write_h264(
    path: Path,
    pictures: Iterable[np.ndarray],
    rate: float = RATE,
    *,
    aspect: Fraction = Fraction(1),
    turned_deg: int = 0,
    key_every: int = 50,
) -> Path:
    """H.264 with reordered frames; the test is skipped where this FFmpeg has no encoder for it."""
    if "libx264" not in av.codecs_available:
        pytest.skip("this FFmpeg writes no H.264")
    with av.open(str(path), "w") as container:
        stream = container.add_stream(
            "libx264", rate=Fraction(rate), options={"crf": "12", "g": str(key_every), "sc_threshold": "0"}
        )
        for number, picture in enumerate(pictures):
            if number == 0:
                stream.height, stream.width = picture.shape[:2]
                stream.codec_context.sample_aspect_ratio = aspect
                if turned_deg:
                    stream.set_display_rotation(turned_deg)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode(None))
    return path


def copy_stream(source: Path, path: Path, start_s: float, end_s: float, options: dict[str, str] | None = None) -> Path:
    """What ``ffmpeg -ss START -to END -c copy`` writes: all packets from the key frame before the start on."""
    with av.open(str(source)) as opened, av.open(str(path), "w", options=options or {}) as written:
        stream = opened.streams.video[0]
        target = written.add_stream_from_template(stream)
        shift = round(start_s / stream.time_base)
        opened.seek(shift, stream=stream)
        for packet in opened.demux(stream):
            if packet.dts is None or packet.pts * stream.time_base >= end_s:
                continue
            packet.pts, packet.dts, packet.stream = packet.pts - shift, packet.dts - shift, target
            written.mux(packet)
    return path
