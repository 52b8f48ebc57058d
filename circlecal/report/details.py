"""What the large view tells about one frame, as short texts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from circlecal.records.record import CameraRecord, ResultRecord
from circlecal.report.figures import clock, short
from circlecal.report.reading import FrameRow

_CASES = {1: "1 (line)", 2: "2 (point)", 3: "3 (two edges)"}


def frame_details(record: ResultRecord, row: FrameRow) -> dict[str, Any]:
    """Facts, checks and times of a frame, ready for JSON.

    Returns
    -------
    dict
        ``facts``: pairs of label and text; ``checks``: name, value, limit, passed, the failed ones first; ``times``:
        stage, milliseconds.
    """
    checks = [[_words(c.name), short(c.value), short(c.limit), c.passed] for c in record.checks]
    return {
        "facts": [[label, text] for label, text in _facts(record, row) if text],
        "checks": sorted(checks, key=lambda check: bool(check[3])),
        "times": [[stage, short(ms)] for stage, ms in (record.timings_ms or {}).items() if ms],
    }


def _facts(record: ResultRecord, row: FrameRow) -> Iterator[tuple[str, str]]:
    camera = record.camera or (record.rejected_estimate.camera if record.rejected_estimate else None)
    fit = None if record.ellipses is None else record.ellipses.found
    if row.case is not None:
        yield "case", _CASES.get(row.case, str(row.case))
    if row.sigma_px is not None:
        metres = "" if row.sigma_m is None else f", {short(row.sigma_m)} m"
        yield "predicted sigma", f"{short(row.sigma_px)} px{metres} (largest)"
    if row.rms_px is not None:
        arc = None if fit is None else fit.arc_degrees
        yield "ellipse", f"{short(row.rms_px)} px rms" + (f" over {arc:.0f}°" if arc is not None else "")
    if camera is not None:
        yield from _camera(camera)
        yield "lines", _list(camera.named_lines)
        yield "left out", _list(camera.rejected_observations)
    if row.camera is not None:
        before = None if record.rig is None or record.rig.alone is None else record.rig.alone.code
        yield "rig", row.camera + (f", refused alone ({before})" if row.gained else "")
    if row.time_ms is not None:
        yield "time", f"{short(row.time_ms)} ms"
    if record.image is not None:
        yield "picture", f"{record.image.width} x {record.image.height} px"
    if row.path:
        yield "file", row.path + ("" if row.time_s is None else f" at {clock(row.time_s)}")


def _camera(camera: CameraRecord) -> Iterator[tuple[str, str]]:
    x, y, z = camera.position_meters
    if x is not None and y is not None and z is not None:
        yield "camera", f"x {x:.1f}, y {y:.1f}, {-z:.1f} m high"
    angles = [angle for angle in (camera.pan_degrees, camera.tilt_degrees, camera.roll_degrees) if angle is not None]
    if len(angles) == 3:
        yield "pan, tilt, roll", ", ".join(f"{angle:.2f}°" for angle in angles)
    if camera.x_focal_length is not None:
        yield "focal length", f"{camera.x_focal_length:.0f} px"


def _list(names: Sequence[str]) -> str:
    return ", ".join(map(_words, names))


def _words(name: str) -> str:
    return name.replace("_", " ")
