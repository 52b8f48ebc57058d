"""What the large view tells about one frame, as short texts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from circlecal.report.figures import clock, short
from circlecal.report.reading import FrameRow

_CASES = {1: "1 (line)", 2: "2 (point)", 3: "3 (two edges)"}


def frame_details(record: Mapping[str, Any], row: FrameRow) -> dict[str, Any]:
    """Facts, checks and times of a frame, ready for JSON.

    Returns
    -------
    dict
        ``facts``: pairs of label and text; ``checks``: name, value, limit, passed, the failed ones first; ``times``:
        stage, milliseconds.
    """
    return {
        "facts": [[label, text] for label, text in _facts(record, row) if text],
        "checks": sorted(
            (_check(check) for check in _list(record.get("checks")) if isinstance(check, dict)), key=lambda c: c[3]
        ),
        "times": [
            [str(stage), short(_number(ms))] for stage, ms in _mapping(record.get("timings_ms")).items() if _number(ms)
        ],
    }


def _facts(record: Mapping[str, Any], row: FrameRow) -> Iterator[tuple[str, str]]:
    rejected = _mapping(record.get("rejected_estimate"))
    camera = _mapping(record.get("camera")) or _mapping(rejected.get("camera"))
    ellipses = _mapping(record.get("ellipses"))
    fit = _mapping(ellipses.get(str(ellipses.get("primary"))))
    if row.case is not None:
        yield "case", _CASES.get(row.case, str(row.case))
    if row.sigma_px is not None:
        metres = "" if row.sigma_m is None else f", {short(row.sigma_m)} m"
        yield "predicted sigma", f"{short(row.sigma_px)} px{metres} (largest)"
    if row.rms_px is not None:
        arc = _number(fit.get("arc_degrees"))
        yield "ellipse", f"{short(row.rms_px)} px rms" + (f" over {arc:.0f}°" if arc is not None else "")
    yield from _camera(camera)
    yield "lines", _join(camera.get("named_lines"))
    yield "left out", _join(camera.get("rejected_observations"))
    if row.camera is not None:
        before = _mapping(_mapping(record.get("rig")).get("alone")).get("code")
        yield "rig", row.camera + (f", refused alone ({before})" if row.gained else "")
    if row.time_ms is not None:
        yield "time", f"{short(row.time_ms)} ms"
    image = _mapping(record.get("image"))
    if image:
        yield "picture", f"{image.get('width')} x {image.get('height')} px"
    if row.path:
        yield "file", row.path + ("" if row.time_s is None else f" at {clock(row.time_s)}")


def _camera(camera: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    position = [_number(value) for value in _list(camera.get("position_meters"))]
    if len(position) == 3 and None not in position:
        x, y, z = (value or 0.0 for value in position)
        yield "camera", f"x {x:.1f}, y {y:.1f}, {-z:.1f} m high"
    angles = [_number(camera.get(f"{name}_degrees")) for name in ("pan", "tilt", "roll")]
    if None not in angles:
        pan, tilt, roll = (value or 0.0 for value in angles)
        yield "pan, tilt, roll", f"{pan:.2f}°, {tilt:.2f}°, {roll:.2f}°"
    focal = _number(camera.get("x_focal_length"))
    if focal is not None:
        yield "focal length", f"{focal:.0f} px"


def _join(value: Any) -> str:
    names = value if isinstance(value, list | dict) else []
    return ", ".join(str(name).replace("_", " ") for name in names)


def _check(check: Mapping[str, Any]) -> list[Any]:
    value, limit = short(_number(check.get("value"))), short(_number(check.get("limit")))
    return [str(check.get("name")).replace("_", " "), value, limit, bool(check.get("passed"))]


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list) else []
