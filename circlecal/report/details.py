"""What the large view tells about one frame, as short texts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from circlecal.overlay.page_view import describe_view, sigma_grid
from circlecal.overlay.quality import USUAL_WIDTH, rate_sigma
from circlecal.overlay.radar import radar_half
from circlecal.overlay.template_lines import count_sigma_from_seen
from circlecal.records.parts import CameraRecord
from circlecal.records.record import ResultRecord
from circlecal.report.comparison import WORDS, Comparison
from circlecal.report.drawings import Scene
from circlecal.report.figures import clock, short
from circlecal.report.reading import FrameRow
from circlecal.results.numbers import show_with_sigma

_CASES = {1: "1 (line)", 2: "2 (point)", 3: "3 (two edges)"}


SIGMA_GRID = (16, 9)
"""Columns and rows of the places at which a frame's standard deviation is written: 2 kB of its details."""


def frame_details(
    record: ResultRecord, row: FrameRow, scene: Scene | None, compared: Comparison | None = None
) -> dict[str, Any]:
    """Facts, checks and times of a frame, and what tells metres and sigma under the pointer, ready for JSON.

    Parameters
    ----------
    record, row : ResultRecord, FrameRow
        The frame.
    scene : Scene or None
        What its record lets draw.
    compared : Comparison, optional
        Against another run.

    Returns
    -------
    dict
        ``facts``: pairs of label and text; ``checks``: name, value, limit, passed, the failed ones first; ``times``:
        stage, milliseconds; ``size``: width and height, pixels; ``view`` and ``sigma`` as of
        :mod:`circlecal.overlay.page_view`; ``radar``: half of the radar's extent, metres; ``other``: pairs of label
        and text on the other run.
    """
    view = None if scene is None else scene.view
    checks = [[words(c.name), short(c.value), short(c.limit), c.passed] for c in record.checks]
    return {
        "facts": [[label, text] for label, text in _facts(record, row) if text],
        "checks": sorted(checks, key=lambda check: bool(check[3])),
        "times": [[stage, short(ms)] for stage, ms in (record.timings_ms or {}).items() if ms],
        "size": None if scene is None else [scene.width, scene.height],
        "view": None if view is None else describe_view(view),
        "sigma": None if view is None else sigma_grid(count_sigma_from_seen(view, _by_growth(record)), SIGMA_GRID),
        "radar": None if scene is None or scene.template is None else radar_half(scene.template, scene.view).tolist(),
        "other": [[label, text] for label, text in _against(compared)],
    }


def _against(compared: Comparison | None) -> Iterator[tuple[str, str]]:
    if compared is None:
        return
    yield "change", WORDS[compared.change][0]
    if compared.other is None:
        return
    yield "there", "calibrated" if compared.other.calibrated else f"refused: {compared.other.code}"
    if compared.other.sigma_px is not None:
        yield "sigma there", f"{short(compared.other.sigma_px)} px at 1920 px width"
    if compared.apart_px is not None:
        yield "cameras apart", f"{short(compared.apart_px)} px at 1920 px width, rms over the markings in view"


def _camera_estimate(record: ResultRecord) -> CameraRecord | None:
    """The camera, also one that the verdict did not trust."""
    return record.camera or (record.rejected_estimate.camera if record.rejected_estimate else None)


def _by_growth(record: ResultRecord) -> list[float]:
    """How what was seen moves with the field's sizes, as the record has it."""
    camera = _camera_estimate(record)
    told = (None, None) if camera is None or camera.reference_by_growth is None else camera.reference_by_growth
    return [value or 0.0 for value in told]


def _facts(record: ResultRecord, row: FrameRow) -> Iterator[tuple[str, str]]:
    camera = _camera_estimate(record)
    fit = None if record.ellipses is None else record.ellipses.found
    if row.case is not None:
        yield "case", _CASES.get(row.case, str(row.case))
    if row.sigma_px is not None:
        metres = "" if row.sigma_m is None else f", {short(row.sigma_m)} m"
        rated = rate_sigma(row.sigma_px, int(USUAL_WIDTH))
        yield "predicted sigma", f"{short(row.sigma_px)} px at 1920 px width{metres} (largest, {rated})"
    if row.rms_px is not None:
        arc = None if fit is None else fit.arc_degrees
        yield (
            "ellipse",
            f"{short(row.rms_px)} px rms at 1920 px width" + (f" over {arc:.0f}°" if arc is not None else ""),
        )
    if camera is not None:
        yield from _camera(camera)
        yield "lines", _list(camera.named_lines)
        yield "left out", _list(camera.rejected_observations)
    if row.camera is not None:
        before = None if record.rig is None or record.rig.alone is None else record.rig.alone.code
        yield "tripod", row.camera + (f", refused alone ({before})" if row.gained else "")
    if row.time_ms is not None:
        yield "time", f"{short(row.time_ms)} ms"
    if record.image is not None:
        yield "picture", f"{record.image.width} x {record.image.height} px"
    if row.path:
        yield "file", row.path + ("" if row.time_s is None else f" at {clock(row.time_s)}")


def _camera(camera: CameraRecord) -> Iterator[tuple[str, str]]:
    x, y, z = camera.position_meters
    if x is not None and y is not None and z is not None:
        yield "camera", f"x {x:z.1f}, y {y:z.1f}, {-z:.1f} m high"
    angles = [angle for angle in (camera.pan_degrees, camera.tilt_degrees, camera.roll_degrees) if angle is not None]
    if len(angles) == 3:
        yield "pan, tilt, roll", ", ".join(f"{angle:z.2f}°" for angle in angles)
    if camera.x_focal_length is not None:
        yield "focal length", f"{camera.x_focal_length:.0f} px"
    size = camera.field_size
    if size is not None:
        length = show_with_sigma(size.length_m, size.length_sd_m, "±")
        yield "field", f"{length} x {show_with_sigma(size.width_m, size.width_sd_m, '±')} m"


def _list(names: Sequence[str]) -> str:
    return ", ".join(map(words, names))


def words(name: str) -> str:
    """A name of a check or marking as people read it."""
    return name.replace("_", " ")
