"""A calibration as a notebook shows it: its picture with the field drawn over it, and a table of what matters."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.records.record import ResultRecord
from circlecal.refusals import explain

_SHOWN_WIDTH_PX = 720
"""Width of the picture that a notebook shows; wider ones only make the notebook's file large."""
_SHOWN_QUALITY = 80
"""JPEG quality of the picture that a notebook shows."""


def show_record(record: ResultRecord, drawn: NDArray[np.uint8] | None) -> str:
    """HTML of a frame: the picture with the field drawn over it, where it is at hand, and the table."""
    rows = "".join(
        f"<tr><th style='text-align:left'>{html.escape(name)}</th>"
        f"<td style='text-align:left'>{html.escape(fact)}</td></tr>"
        for name, fact in _facts(record)
    )
    return f"{'' if drawn is None else _embed(record.id, drawn)}<table>{rows}</table>"


def _facts(record: ResultRecord) -> Iterator[tuple[str, str]]:
    time_s = None if record.source is None else record.source.time_s
    yield "frame", record.id if time_s is None else f"{record.id} at {time_s:.3f} s"
    yield "verdict", record.status if record.status == "calibrated" else f"{record.status}: {record.reason}"
    if record.code is not None:
        yield "what helps", explain(record.code, record.stage).help
    camera = record.camera
    if camera is None:
        return
    x, y, z = camera.position_meters
    if x is not None and y is not None and z is not None:
        yield "camera", f"{x:z.1f}, {y:z.1f} m from the centre mark, {-z:.1f} m high"
    pan, tilt, roll = camera.pan_degrees, camera.tilt_degrees, camera.roll_degrees
    if pan is not None and tilt is not None and roll is not None:
        yield "pan, tilt, roll", f"{pan:z.2f}, {tilt:z.2f}, {roll:z.2f} degrees"
    if camera.x_focal_length is not None:
        yield "focal length", f"{camera.x_focal_length:.0f} px"
    if camera.max_sigma_px is not None and camera.max_sigma_m is not None:
        yield (
            "standard deviation",
            f"at most {camera.max_sigma_px:.1f} px, {camera.max_sigma_m:.2f} m near the circle",
        )


def _embed(name: str, drawn: NDArray[np.uint8]) -> str:
    scale = min(1.0, _SHOWN_WIDTH_PX / drawn.shape[1])
    small = cv2.resize(drawn, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    _, content = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _SHOWN_QUALITY])
    text = base64.b64encode(content.tobytes()).decode()
    return f"<img alt='{html.escape(name)}' src='data:image/jpeg;base64,{text}'>"
