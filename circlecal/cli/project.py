"""``circlecal project``."""

from __future__ import annotations

import csv
import io
import json
import math
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli import options
from circlecal.names import as_cell

if TYPE_CHECKING:
    from circlecal.records.record import ResultRecord


class Target(StrEnum):
    """Where points are taken to."""

    FIELD = "field"
    IMAGE = "image"


def project(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Result file of circlecal calibrate; with --points a run too.")
    ],
    *,
    coordinates: Annotated[
        list[float] | None, typer.Argument(metavar="X Y", help="Pixels for --to field, metres for --to image.")
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option("--points", metavar="CSV", help="Table with the columns frame, x, y; - reads standard input."),
    ] = None,
    to: Annotated[Target, typer.Option("--to", help="field: pixels to metres; image: metres to pixels.")],
    as_json: options.Json = False,
) -> None:
    """Take points from the picture to the field or back, with the camera's lens where the result has a camera."""
    from circlecal.api.tables import OUTSIDE, are_outside
    from circlecal.cli import console
    from circlecal.errors import InputError
    from circlecal.records.json_text import read_result

    if points is not None:
        if coordinates:
            raise InputError("project takes X Y [X Y ...] or --points, not both")
        _project_table(result, points, to, as_json=as_json)
        return
    if not coordinates or len(coordinates) % 2 or not all(map(math.isfinite, coordinates)):
        raise InputError("project takes finite numbers in pairs: X Y [X Y ...]")
    stored = read_result(result)
    view = stored.view
    if stored.status != "calibrated" or view is None:
        console.print_error(f"{result}: {stored.id} was refused, so nothing can be projected: {stored.reason}")
        raise typer.Exit(1)
    given = list(zip(coordinates[::2], coordinates[1::2], strict=True))
    mapped = (view.to_field if to is Target.FIELD else view.project)(given, sigma=True)
    _note_open_size(stored)
    sigma = [None] * len(given) if mapped.sigma is None else mapped.sigma.tolist()
    unit, given_unit = ("m", "px") if to is Target.FIELD else ("px", "m")
    missing = "on or above the horizon" if to is Target.FIELD else "behind the camera"
    outside = are_outside(stored, mapped.points if to is Target.FIELD else given).tolist()
    notes = [OUTSIDE if out else "" for out in outside]
    answers = list(zip(given, mapped.points.tolist(), sigma, notes, strict=True))
    if as_json:
        for source, target, spread, note in answers:
            seen = math.isfinite(target[0])
            line = {given_unit: source, unit: target if seen else None, "sigma": _finite(spread)}
            line |= {} if seen else {"reason": missing}
            console.print_json(json.dumps(line | ({"note": note} if seen and note else {})))
        return
    decimals = 3 if to is Target.FIELD else 2
    rows = [
        (*(f"{value:g}" for value in source), *_cells(target, spread, decimals, missing, note))
        for source, target, spread, note in answers
    ]
    columns = (f"x {given_unit}", f"y {given_unit}", f"x {unit}", f"y {unit}", f"sigma {unit}", "")
    console.print_table(None, columns, rows)


def _note_open_size(stored: ResultRecord) -> None:
    """Say of a frame without the circle that its points lie as far from the centre mark as the field is long."""
    from circlecal.cli import console
    from circlecal.results.numbers import show_with_sigma

    camera = stored.camera
    size = None if camera is None else camera.field_size
    if camera is None or size is None or not any(camera.reference_by_growth or ()):
        return
    length, width = (
        show_with_sigma(m, sd) for m, sd in ((size.length_m, size.length_sd_m), (size.width_m, size.width_sd_m))
    )
    console.print_note(
        f"{stored.id}: the circle is not in view; sigma counts from the centre mark, which is known as well as the "
        f"field is long and wide: {length} x {width} m"
    )


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _project_table(results: Path, points: Path, to: Target, *, as_json: bool) -> None:
    """A table of points of many frames as a table, or as JSON, one line each."""
    from circlecal.api.tables import project_table, read_points
    from circlecal.cli import console
    from circlecal.files import read_file

    lines = (
        sys.stdin if str(points) == "-" else io.StringIO(read_file(points).decode("utf-8-sig", "replace"), newline="")
    )
    unit, given_unit = ("m", "px") if to is Target.FIELD else ("px", "m")
    names = ("frame", f"x_{given_unit}", f"y_{given_unit}", f"x_{unit}", f"y_{unit}", f"sigma_{unit}", "note")
    if not as_json:
        console.print_line(",".join(names))
    for found in project_table(results, read_points(lines, str(points)), to.value):
        numbers = (found.given.x, found.given.y, found.x, found.y, found.sigma)
        if as_json:
            row = (found.given.frame, *map(_finite, numbers), found.note or None)
            console.print_json(json.dumps(dict(zip(names, row, strict=True))))
            continue
        text = io.StringIO()
        cells = ["" if _finite(value) is None else f"{value:z.6g}" for value in numbers]
        csv.writer(text, lineterminator="\n").writerow([as_cell(found.given.frame), *cells, found.note])
        console.print_line(text.getvalue().rstrip("\n"))


def _cells(
    target: list[float], sigma: float | None, decimals: int, missing: str, note: str
) -> tuple[str, str, str, str]:
    from circlecal.cli import console

    if not math.isfinite(target[0]):
        return "-", "-", "-", missing
    return f"{target[0]:z.{decimals}f}", f"{target[1]:z.{decimals}f}", console.number(_finite(sigma), decimals), note
