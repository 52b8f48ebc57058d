"""The cameras of a run and its pitch: from the venue that was found, or from what the frames of each camera say."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from circlecal.errors import CirclecalError
from circlecal.field import FieldTemplate, load_field
from circlecal.geometry.projective import Array
from circlecal.pictures.files import natural_order
from circlecal.report.reading import FrameRow
from circlecal.results.numbers import show_with_sigma
from circlecal.rig.venue import VENUE_NAME, KnownValue, TripodPart, read_venue_file

MARGIN_M = 6.0
FURTHEST_M = 200.0
"""Cameras further from the centre mark than this are not drawn: the field would shrink to a spot."""
MOST_DOTS = 800
LARGEST_SHARE = 2.0
"""A field that is more times as large as its template's, or as small, is drawn as the template has it."""


@dataclass(frozen=True, slots=True)
class Tripod:
    """One camera: where it stands, and how the table tells it.

    Attributes
    ----------
    name : str
        As the run calls it.
    x_m, y_m : float
        On the field, metres from the centre mark.
    cells : tuple of str
        Place, height, focal lengths, pan, pitch, and from how many frames they are known.
    pitch_m : (2,) tuple of float or None
        Length and width of its field, where they were estimated.
    """

    name: str
    x_m: float
    y_m: float
    cells: tuple[str, ...]
    pitch_m: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """The field from above, metres.

    Attributes
    ----------
    box : (4,) tuple of float
        Left, top, width and height.
    markings : tuple of str
        SVG paths of the field's markings.
    dots : tuple of (2,) tuple of float
        Where the cameras of single frames stand.
    tripods : tuple of Tripod
        The cameras.
    """

    box: tuple[float, float, float, float]
    markings: tuple[str, ...]
    dots: tuple[tuple[float, float], ...]
    tripods: tuple[Tripod, ...]


HEADS = ("position, m", "height, m", "focal length, px", "pan", "pitch, m", "found from")


def plan_of(folder: Path, rows: Sequence[FrameRow], field: str) -> Plan | None:
    """What is known of the cameras of a run; None where no frame has one, or the field is not known here.

    Parameters
    ----------
    folder : Path
        The run's; a venue file in it is read.
    rows : sequence of FrameRow
        Its frames.
    field : str
        Name of the field template.
    """
    try:
        template = load_field(field)
    except CirclecalError:
        return None
    tripods = tuple(_of_venue(folder)) or tuple(_of_frames(rows))
    pitch_m = next((tripod.pitch_m for tripod in tripods if tripod.pitch_m is not None), None)
    if pitch_m is not None and _is_its_size(pitch_m, template):
        template = load_field(field, {"length": pitch_m[0], "width": pitch_m[1]})
    places = [row.position_m[:2] for row in rows if row.position_m is not None]
    shown = [place for place in places if np.hypot(*place) < FURTHEST_M]
    if not shown and not tripods:
        return None
    half = np.array([template.length_m, template.width_m]) / 2
    near = [(t.x_m, t.y_m) for t in tripods if np.hypot(t.x_m, t.y_m) < FURTHEST_M]
    corners = np.concatenate([np.array([*shown, *near]).reshape(-1, 2), [-half, half]])
    low, high = corners.min(axis=0) - MARGIN_M, corners.max(axis=0) + MARGIN_M
    return Plan(
        (float(low[0]), float(low[1]), float(high[0] - low[0]), float(high[1] - low[1])),
        tuple(_path(points) for points in _markings(template)),
        tuple(shown[:: max(1, len(shown) // MOST_DOTS)]),
        tripods,
    )


def _is_its_size(pitch_m: tuple[float, float], template: FieldTemplate) -> bool:
    """Whether a venue's field is of the order of its template's: its file may hold any number."""
    shares = np.array(pitch_m) / (template.length_m, template.width_m)
    return bool((shares > 1.0 / LARGEST_SHARE).all() and (shares < LARGEST_SHARE).all())


def _markings(template: FieldTemplate) -> Iterator[Array]:
    yield from template.polylines(1.0).values()


def _path(points: Array) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points.tolist())


def _of_venue(folder: Path) -> Iterator[Tripod]:
    for path in sorted(folder.glob(f"*{VENUE_NAME}"), key=lambda p: natural_order(p.name)):
        try:
            content = read_venue_file(path)
        except CirclecalError:
            continue
        clip = path.name.removesuffix(VENUE_NAME).rstrip(".")
        for tripod in content.tripods:
            yield _tripod(f"{clip}: {tripod.name}" if clip else tripod.name, tripod)


def _tripod(name: str, tripod: TripodPart) -> Tripod:
    values = tripod.parameters
    length, width = values["pitch_length_m"], values["pitch_width_m"]
    x, y, z = (values[f"axis_{axis}_m"] for axis in "xyz")
    low, high = tripod.range.focal_px
    pan = tripod.range.pan_deg
    return Tripod(
        name,
        x.mean,
        y.mean,
        (
            f"{_with_sigma(x)}, {_with_sigma(y)}",
            _with_sigma(KnownValue(mean=-z.mean, sd=z.sd)),
            f"{low:.0f} to {high:.0f}",
            f"{pan[0]:z.1f}° to {pan[1]:z.1f}°",
            f"{_with_sigma(length)} x {_with_sigma(width)}",
            f"{len(tripod.frames)} frames",
        ),
        (length.mean, width.mean),
    )


def _with_sigma(value: KnownValue) -> str:
    return show_with_sigma(value.mean, value.sd, "±")


def _of_frames(rows: Sequence[FrameRow]) -> Iterator[Tripod]:
    """Medians of the frames of each camera."""
    names = sorted({row.camera for row in rows if row.camera is not None}, key=natural_order)
    for name in names:
        own = [row for row in rows if row.camera == name and row.position_m is not None]
        if not own:
            continue
        x, y, height = np.median([row.position_m for row in own if row.position_m is not None], axis=0).tolist()
        focal = [row.focal_px for row in own if row.focal_px is not None]
        pan = [row.pan_deg for row in own if row.pan_deg is not None]
        yield Tripod(
            name,
            x,
            y,
            (
                f"{x:z.2f}, {y:z.2f}",
                f"{height:.2f}",
                f"{min(focal):.0f} to {max(focal):.0f}" if focal else "-",
                f"{min(pan):z.1f}° to {max(pan):z.1f}°" if pan else "-",
                "-",
                f"{len(own)} frames",
            ),
        )
