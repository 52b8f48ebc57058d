"""Writing a video: H.264 in MP4 with the time of every frame, as browsers and players show it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from circlecal.errors import InputError
from circlecal.files import replacement

if TYPE_CHECKING:
    from av import VideoFrame, VideoStream
    from av.container import OutputContainer

_TIME_BASE = Fraction(1, 90000)
"""Unit of the times in the file, seconds: periods of 24, 25, 30000/1001, 30, 50 and 60 frames per second are whole
numbers of it."""
_CODECS = (
    ("libx264", {"preset": "veryfast", "crf": "20"}, _TIME_BASE),
    ("mpeg4", {"qscale": "3"}, Fraction(1, 60000)),
)
"""The first one that this FFmpeg has, since builds without x264 exist; and its unit of times, seconds: MPEG-4 takes no
finer one than 1/65535."""
_INTERLACED = {"flags": "+ildct+ilme"}
"""Makes an encoder code two fields in every frame, the upper one first, and the file say so."""
_BT709 = 1
"""Number of the matrix, the primaries and the transfer of high definition video in ITU-T H.273."""


class VideoWriter:
    """Takes the frames of a video that :func:`write_video` has opened."""

    def __init__(
        self, container: OutputContainer, rate: float, aspect: float | None = None, *, is_interlaced: bool = False
    ) -> None:
        self._container, self._aspect, self._is_interlaced = container, aspect, is_interlaced
        self._rate = Fraction(rate).limit_denominator(1001)
        self._stream: VideoStream | None = None
        self._last = -1

    def write(self, picture: NDArray[np.uint8], time_s: float) -> None:
        """Append a picture (H, W, 3), BGR, as large as the first one; an odd last row or column is left out.

        Raises
        ------
        ValueError
            The time is not after that of the frame before.
        """
        from av import VideoFrame

        height, width = (side - side % 2 for side in picture.shape[:2])
        if self._stream is None:
            self._stream = self._add_stream(width, height)
        ticks = round(time_s / _TIME_BASE)
        if ticks <= self._last:
            raise ValueError(f"a frame at {time_s} s cannot follow one at {float(self._last * _TIME_BASE)} s")
        self._last = ticks
        frame = VideoFrame.from_ndarray(np.ascontiguousarray(picture[:height, :width]), format="bgr24")
        frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709")
        frame.pts, frame.time_base = ticks, _TIME_BASE
        self._encode(frame)

    def finish(self) -> None:
        """Write the frames that the encoder still holds."""
        self._encode(None)

    def _encode(self, frame: VideoFrame | None) -> None:
        if self._stream is not None:
            self._container.mux(self._stream.encode(frame))

    def _add_stream(self, width: int, height: int) -> VideoStream:
        import av

        name, options, time_base = next(entry for entry in _CODECS if entry[0] in av.codecs_available)
        options = options | (_INTERLACED if self._is_interlaced else {})
        stream = cast("VideoStream", self._container.add_stream(name, rate=self._rate, options=options))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.codec_context.time_base = stream.time_base = time_base
        if self._aspect is not None:
            stream.codec_context.sample_aspect_ratio = Fraction(self._aspect).limit_denominator(1000)
        stream.colorspace = stream.color_primaries = stream.color_trc = _BT709
        return stream


@contextlib.contextmanager
def write_video(
    path: Path, rate: float, aspect: float | None = None, *, is_interlaced: bool = False
) -> Iterator[VideoWriter]:
    """A video file that appears whole when the block is left without an error, and else not at all.

    Parameters
    ----------
    path : Path
        File to write, ``.mp4``; one of the same name is replaced.
    rate : float
        Frames per second as the header tells it; every frame has its own time nevertheless.
    aspect : float, optional
        Width of a pixel over its height, where it is not 1.
    is_interlaced : bool
        Whether every picture holds two fields, the earlier one in its even rows, counted from 0; the file says so.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    import av

    try:
        with (
            replacement(path) as temporary,
            av.open(str(temporary), "w", format="mp4", options={"movflags": "faststart"}) as container,
        ):
            writer = VideoWriter(container, rate, aspect, is_interlaced=is_interlaced)
            yield writer
            writer.finish()
    except av.FFmpegError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
