"""Videos whose frames carry their number as a pattern of bars, in containers that are seeked in different ways."""

from pathlib import Path

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
