"""``circlecal bench sports``: real frames of several sports whose field nobody names.

Truth is a folder with a JSON file ``<frame id>.json`` for each frame, of which these keys are read: ``sport``, or else
``field`` where that is text, the sport or a template of it (soccer where there is neither); ``expect``, which is
``refuse`` where nobody can calibrate the frame; and, where there are both, ``reference`` with ``camera``
(SoccerNet's keys) or ``H_image_field`` (field metres to pixels), and ``grid``, the field points (N, 2) at which it is
compared.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from circlecal.api.calls import calibrate_picture
from circlecal.config import AUTO, Config, load_config
from circlecal.errors import InputError
from circlecal.field import field_names, load_field
from circlecal.field.view import FieldView
from circlecal.files import read_text
from circlecal.geometry.camera import camera_from_soccernet
from circlecal.geometry.projective import Array, apply_homography
from circlecal.pictures.files import PICTURE_SUFFIXES, read_image
from circlecal.results import FrameCalibration

GOOD_PX, WRONG_PX = 8.0, 30.0
"""Mean error over the grid, pixels at 1920 px width, up to which a frame is good and from which on it is wrong."""
LARGEST_PX = 2000.0
"""No point counts more."""


@dataclass(frozen=True, slots=True)
class SportFrame:
    """One frame: its sport and what was answered; ``told`` is the sport that the answer or the refusal names.

    ``error_px`` is the mean distance from the reference at 1920 px width, None without one. ``kept`` says of a frame
    of the first template whether it was answered as if that had been named; None for others.
    """

    id: str
    sport: str
    expect: str
    status: str
    code: str | None
    template: str
    told: str | None
    error_px: float | None
    kept: bool | None
    seconds: float
    tried: tuple[str, ...]

    @property
    def is_answered(self) -> bool:
        """Whether it was calibrated."""
        return self.status == "calibrated"

    @property
    def is_told(self) -> bool:
        """Whether the right sport is named; of a frame that nobody can calibrate none need be, since it may show no
        field at all.
        """
        return self.told == self.sport or (self.told is None and self.expect == "refuse")

    @property
    def is_wrong(self) -> bool:
        """Whether an answer was given that should not be: of a frame to refuse, or far from the reference."""
        far = self.error_px is not None and self.error_px > WRONG_PX
        return self.is_answered and (self.expect == "refuse" or far)


def run_frames(
    pictures: Path, truth: Path, advance: Callable[[str], None] = lambda _: None, config: Config | None = None
) -> list[SportFrame]:
    """Calibrate each picture of a folder that has a truth file, without telling its field.

    Raises
    ------
    InputError
        No picture has a truth file, or one cannot be read.
    """
    named = {path.stem: path for path in sorted(pictures.iterdir()) if path.suffix.lower() in PICTURE_SUFFIXES}
    told = {path.stem: path for path in sorted(truth.glob("*.json"))}
    both = [name for name in named if name in told]
    if not both:
        raise InputError(f"{truth}: has no truth file <picture>.json for a picture of {pictures}")
    chosen = load_config(config, {"field.template": AUTO})
    rows = []
    for name in both:
        rows.append(_run_frame(name, named[name], told[name], chosen))
        advance(name)
    return rows


def _run_frame(name: str, picture: Path, told_by: Path, config: Config) -> SportFrame:
    truth = _read_truth(told_by)
    sport = sport_of(told_by, truth)
    image = read_image(picture)
    start = time.perf_counter()
    found = calibrate_picture(image, config, frame_id=name)
    seconds = time.perf_counter() - start
    usual = load_field(config.field.among[0])
    kept = None
    if sport == usual.sport:
        alone = calibrate_picture(image, load_config(None, {"field.template": usual.name}), frame_id=name)
        kept = alone.status == found.status and (found.status == "refused" or found.field_name == usual.name)
    template = found.template or usual
    likely = None if found.sport is None else found.sport.name
    told = template.sport_name if found.status == "calibrated" else likely
    return SportFrame(
        name,
        sport,
        str(truth.get("expect", "calibrate")),
        found.status,
        found.verdict.code,
        found.field_name,
        told,
        _error_px(found, truth),
        kept,
        seconds,
        tuple(
            f"{c.template} {c.status if c.code is None else c.code}"
            + ("" if c.evidence is None else f" {c.evidence:.2f} {c.found_share:.2f} {c.explained_share:.2f}")
            for c in found.fields
        ),
    )


def _read_truth(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(read_text(path, 1 << 24))
    except ValueError as error:
        raise InputError(f"{path}: is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: must be a mapping")
    return content


def sport_of(path: Path, truth: dict[str, Any]) -> str:
    """The sport that a truth file names, as the templates call it.

    Raises
    ------
    InputError
        No template is of that sport.
    """
    field = truth.get("field")
    name = truth.get("sport") or (field if isinstance(field, str) else "soccer")
    if name in field_names():
        return load_field(name).sport or str(name)
    known = sorted({str(load_field(field_name).sport) for field_name in field_names()})
    if name in known:
        return str(name)
    raise InputError(f"{path}: sport: {name!r} is unknown; known: {', '.join(known)}, and the fields of them")


def _error_px(found: FrameCalibration, truth: dict[str, Any]) -> float | None:
    """Mean distance (px at 1920 px width) from the reference; the field turned by 180 degrees is the same."""
    reference, grid, view = truth.get("reference"), truth.get("grid"), found.view
    if not isinstance(reference, dict) or not grid or view is None or found.status != "calibrated":
        return None
    points = np.array(grid, dtype=np.float64)
    keys = reference.get("camera")
    if keys is None:
        there = apply_homography(np.array(reference["H_image_field"], dtype=np.float64), points)
    else:
        there = FieldView(camera_from_soccernet(keys, found.width, found.height)).project(points)
    unit = 1920.0 / found.width
    return min(_mean_distance(view.project(sign * points), there) * unit for sign in (1.0, -1.0))


def _mean_distance(here: Array, there: Array) -> float:
    off = np.linalg.norm(np.nan_to_num(here, nan=1e9) - there, axis=1)
    return float(np.minimum(off, LARGEST_PX).mean())


@dataclass(frozen=True, slots=True)
class SportRow:
    """Counts over the frames of one sport, or of all: how many were answered, with the right sport; how many name the
    right sport, refused ones too; how many were answered rightly (within :data:`GOOD_PX` of the reference, of those
    with one), wrongly; how many were answered as if the first template had been named (those that are not of it count
    as kept); and the median and largest seconds.
    """

    sport: str
    frames: int
    answered: int
    right_sport: int
    sport_told: int
    with_reference: int
    good: int
    wrong: int
    kept: int
    median_s: float
    worst_s: float


def summarise_sports(frames: Sequence[SportFrame]) -> list[SportRow]:
    """One row for each sport and one for all."""
    sports = sorted({frame.sport for frame in frames})
    parts = [(sport, [f for f in frames if f.sport == sport]) for sport in sports]
    return [_summary(name, part) for name, part in (*parts, ("all", list(frames)))]


def _summary(name: str, frames: Sequence[SportFrame]) -> SportRow:
    answered = [frame for frame in frames if frame.is_answered]
    errors = [frame.error_px for frame in answered if frame.error_px is not None]
    seconds = [frame.seconds for frame in frames]
    return SportRow(
        name,
        len(frames),
        len(answered),
        sum(frame.told == frame.sport for frame in answered),
        sum(frame.is_told for frame in frames),
        len(errors),
        sum(error <= GOOD_PX for error in errors),
        sum(frame.is_wrong for frame in frames),
        sum(frame.kept is not False for frame in frames),
        float(np.median(seconds)),
        max(seconds),
    )
