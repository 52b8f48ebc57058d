"""How long the chain takes, stage by stage, against decoding the same JPEG: one thread, the best of several runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config
from circlecal.errors import InputError
from circlecal.pipeline import calibrate_image
from circlecal.results import FrameCalibration

DECODINGS = 15
RUNS = 15


@dataclass(frozen=True, slots=True)
class ChainTime:
    """Milliseconds of decoding, of the chain from the decoded picture to the verdict, and of each of its stages; each
    the best of its runs.

    ``decoding_ms`` is that of a program that does nothing else: every picture lies in memory that is fresh from the
    system. Between two runs of the chain memory is at hand, and decoding takes ``decoding_in_turn_ms``.
    """

    frame: str
    width: int
    height: int
    status: str
    decoding_ms: float
    decoding_in_turn_ms: float
    chain_ms: float
    stage_ms: dict[str, float]

    @property
    def times_decoding(self) -> float:
        """The chain in multiples of decoding."""
        return self.chain_ms / self.decoding_ms


def decoding_ms(encoded: NDArray[np.uint8], decodings: int = DECODINGS) -> float:
    """Best time of decoding a JPEG."""
    return min(_ms(lambda: cv2.imdecode(encoded, cv2.IMREAD_COLOR)) for _ in range(decodings))


def time_run(
    image: NDArray[np.uint8], config: Config, frame_id: str, runs: int = RUNS
) -> tuple[FrameCalibration, float, dict[str, float]]:
    """The calibration of a picture, and the best time of several runs: of the whole and of each stage, milliseconds."""
    found, whole = [], []
    for _ in range(runs):
        start = time.perf_counter()
        found.append(calibrate_image(image, config, frame_id=frame_id))
        whole.append((time.perf_counter() - start) * 1e3)
    return found[0], min(whole), least(calibration.timings_ms for calibration in found)


def time_chain(name: str, encoded: NDArray[np.uint8], config: Config, runs: int = RUNS) -> ChainTime:
    """Time the chain on one JPEG (row 16 of the figures to reach).

    Parameters
    ----------
    name : str
        Name of the frame.
    encoded : (N,) uint8
        Contents of the file.
    config : Config
        Options of every stage.
    runs : int
        How often the chain is run.

    Raises
    ------
    InputError
        Where it is no picture.
    """
    cv2.setNumThreads(1)
    if not encoded.size or cv2.imdecode(encoded, cv2.IMREAD_COLOR) is None:
        raise InputError(f"{name}: not a picture that OpenCV can decode")
    alone, turns, in_turn = decoding_ms(encoded), [], []
    for _ in range(runs):
        start = time.perf_counter()
        image = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), np.uint8)
        in_turn.append((time.perf_counter() - start) * 1e3)
        turns.append(time_run(image, config, name, 1))
    found = turns[0][0]
    height, width = image.shape[:2]
    return ChainTime(
        frame=name,
        width=width,
        height=height,
        status=found.status,
        decoding_ms=alone,
        decoding_in_turn_ms=min(in_turn),
        chain_ms=min(chain_ms for _, chain_ms, _ in turns),
        stage_ms=least(stages for _, _, stages in turns),
    )


def time_file(path: Path, config: Config) -> ChainTime:
    """:func:`time_chain` of a file."""
    try:
        return time_chain(path.name, np.frombuffer(path.read_bytes(), np.uint8), config)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error


def least(timings: Iterable[dict[str, float]]) -> dict[str, float]:
    """Smallest time of each step, in the order of the steps."""
    best: dict[str, float] = {}
    for row in timings:
        for name, ms in row.items():
            best[name] = min(ms, best.get(name, ms))
    return best


def _ms(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return (time.perf_counter() - start) * 1e3
