"""How well a detector's keypoints of the centre circle agree with each other.

Opposed points of a circle lie on a line through its centre, and a homography keeps that. So the distances from the
imaged centre to the lines through opposed keypoints are an error that needs no annotation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from circlecal.config import Config
from circlecal.errors import InputError
from circlecal.files import find_files, is_folder
from circlecal.formats.cameras import Size
from circlecal.formats.format import Content
from circlecal.formats.meaning import observe
from circlecal.formats.pnlcalib import CENTRE_MARK, keypoint_number
from circlecal.formats.pnlcalib import FORMAT as KEYPOINTS
from circlecal.formats.registry import parse_annotations
from circlecal.formats.shapes import AnnotatedFrame
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.pipeline import field_of, run_observations

OPPOSED = ((32, 35), (50, 52), (48, 54), (49, 53), (38, 43), (39, 42))
"""Keypoints of PnLCalib on either side of the centre; 52 stands at 9.00 m, but on the same line."""
Center = Literal["kp", "ours"]


@dataclass(frozen=True, slots=True)
class AuditedFrame:
    """One frame.

    Attributes
    ----------
    id : str
        Name of the frame.
    distances_px : mapping of (int, int) to float
        From the centre to the line through each opposed pair that was detected.
    reason : str or None
        Why there are none.
    """

    id: str
    distances_px: Mapping[tuple[int, int], float]
    reason: str | None = None


@dataclass(frozen=True, slots=True)
class PairRow:
    """Distances of one opposed pair, or of all, over the frames that have it, and how many distances these are."""

    pair: str
    count: int
    mean_px: float
    median_px: float
    p90_px: float
    largest_px: float


def read_keypoints(path: Path, size: Size) -> list[AnnotatedFrame]:
    """Keypoint predictions of a file, or of every ``.json`` file of a folder.

    Raises
    ------
    InputError
        Nothing there, or a file that is no prediction.
    """
    files = find_files(path, (".json",)) if is_folder(path) else [path]
    if not files:
        raise InputError(f"{path}: holds no keypoint file (<id>.json)")
    return [frame for file in files for frame in _read_file(file, size)]


def _read_file(file: Path, size: Size) -> list[AnnotatedFrame]:
    content = Content.of(file)
    if not KEYPOINTS.recognises(content):
        raise InputError(f"{file}: is no keypoint file of PnLCalib, which has the keys kp and lines; give such files")
    return parse_annotations(KEYPOINTS, content, size)


def audit_frames(frames: Sequence[AnnotatedFrame], center: Center, config: Config) -> list[AuditedFrame]:
    """Audit every frame.

    Parameters
    ----------
    frames : sequence of AnnotatedFrame
        With keypoints labelled ``kp_1`` ... ``kp_57``.
    center : {"kp", "ours"}
        The detected centre mark (51), or the centre that circlecal derives from all keypoints and lines of the frame;
        then everything is measured in undistorted pixels of its camera.
    config : Config
        Of circlecal's calibration.
    """
    return [_audit(frame, center, config) for frame in frames]


def _audit(frame: AnnotatedFrame, center: Center, config: Config) -> AuditedFrame:
    points = {
        number: shape.points_px[0] for shape in frame.shapes if (number := keypoint_number(shape.label)) is not None
    }
    if not any(a in points and b in points for a, b in OPPOSED):
        return AuditedFrame(frame.id, {}, "no two opposed keypoints of the circle")
    if center == "kp":
        if CENTRE_MARK not in points:
            return AuditedFrame(frame.id, {}, f"no keypoint {CENTRE_MARK}")
        return AuditedFrame(frame.id, opposite_pair_distances(points, points[CENTRE_MARK]))
    camera, middle, reason = _own_center(frame, config)
    if camera is None or middle is None:
        return AuditedFrame(frame.id, {}, reason)
    undistorted = {number: camera.undistort(point) for number, point in points.items()}
    return AuditedFrame(frame.id, opposite_pair_distances(undistorted, middle))


def opposite_pair_distances(points: Mapping[int, Array], center: Array) -> dict[tuple[int, int], float]:
    """Distance from the centre (2,) to the line through each opposed pair of keypoints (2,) that is there."""
    found = {}
    for first, second in OPPOSED:
        if first not in points or second not in points:
            continue
        along = points[second] - points[first]
        length = float(np.hypot(*along))
        offset = center - points[first]
        if length > 0:
            found[first, second] = abs(float(along[0] * offset[1] - along[1] * offset[0])) / length
    return found


def _own_center(frame: AnnotatedFrame, config: Config) -> tuple[Camera | None, Array | None, str | None]:
    template, _ = field_of(config)
    seen = observe(frame, template, config.sources, "pnlcalib", frame.id).observations
    result = run_observations(seen, config, frame_id=frame.id)
    if result.status != "calibrated" or result.attempt.camera is None:
        return None, None, result.verdict.reason
    return result.attempt.camera.camera, result.attempt.camera.imaged_center_px, None


def distances_by_pair(frames: Sequence[AuditedFrame]) -> dict[tuple[int, int], Array]:
    """Distances (N,) of all frames by opposed pair; pairs that were never seen are left out."""
    by_pair = {pair: [f.distances_px[pair] for f in frames if pair in f.distances_px] for pair in OPPOSED}
    return {pair: np.array(values) for pair, values in by_pair.items() if values}


def pair_rows(by_pair: Mapping[tuple[int, int], Array]) -> list[PairRow]:
    """Figures of every pair, and of all together."""
    named = {f"{a}-{b}": values for (a, b), values in by_pair.items()}
    if named:
        named["all"] = np.concatenate(list(named.values()))
    return [
        PairRow(
            name,
            len(values),
            float(values.mean()),
            float(np.median(values)),
            float(np.percentile(values, 90)),
            float(values.max()),
        )
        for name, values in named.items()
    ]
