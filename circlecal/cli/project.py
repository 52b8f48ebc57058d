"""``circlecal project``."""

from __future__ import annotations

import io
import json
import math
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from circlecal.cli import options

if TYPE_CHECKING:
    from circlecal.api.tables import PointTable, ProjectedPoint
    from circlecal.records.record import ResultRecord


class Target(StrEnum):
    """Where points are taken to."""

    FIELD = "field"
    IMAGE = "image"

    @property
    def units(self) -> tuple[str, str]:
        """Unit of what is given, and of what is found."""
        return ("px", "m") if self is Target.FIELD else ("m", "px")


def _parse_coordinate(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is no number; separate X and Y by a blank") from None


def project(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Result file of circlecal calibrate; with --points a run too.")
    ],
    *,
    coordinates: Annotated[
        list[float] | None,
        typer.Argument(metavar="X Y", parser=_parse_coordinate, help="Pixels for --to field, metres for --to image."),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option(
            "--points",
            metavar="CSV",
            help="Table with the columns frame (id, or number in a tracked clip), x, y; of several clips also video; "
            "- reads standard input.",
        ),
    ] = None,
    to: Annotated[Target, typer.Option("--to", help="field: pixels to metres; image: metres to pixels.")],
    point_sigma: Annotated[
        float,
        typer.Option(
            "--point-sigma",
            metavar="PX",
            min=0.0,
            help="How well the pixels themselves are known: one standard deviation along x and along y, which sigma "
            "then holds too. Without it sigma is that of the camera alone.",
            show_default=False,
        ),
    ] = 0.0,
    as_json: options.Json = False,
    quiet: options.QuietNotes = False,
    verbose: options.Verbose = False,
) -> None:
    """Take points from the picture to the field or back, with the camera's lens where the result has a camera."""
    from circlecal.api.tables import TablePoint, explain_no_view, project_points
    from circlecal.cli import console
    from circlecal.errors import InputError
    from circlecal.files import is_folder
    from circlecal.records.json_text import read_result
    from circlecal.records.log import is_log

    console.configure_logging(quiet=quiet, verbose=verbose)
    if math.isinf(point_sigma):
        raise InputError("--point-sigma takes a finite number of pixels")
    if point_sigma and to is Target.IMAGE:
        raise InputError("--point-sigma is how well pixels are known, for --to field; --to image is given metres")
    if points is not None:
        if coordinates:
            raise InputError("project takes X Y [X Y ...] or --points, not both")
        _project_table(result, points, to, point_sigma, as_json=as_json)
        return
    if not coordinates or len(coordinates) % 2 or not all(map(math.isfinite, coordinates)):
        raise InputError("project takes finite numbers in pairs: X Y [X Y ...]")
    if is_folder(result) or is_log(result):
        raise InputError(
            f"{result}: holds the results of a run; give a result file of circlecal calibrate, or --points with a run"
        )
    stored = read_result(result)
    if stored.status == "calibrated" and stored.view is None:
        why = explain_no_view(stored)
        raise InputError(f"{result}: {stored.id} is calibrated, but {why}; calibrate the frame again")
    if stored.status != "calibrated":
        console.print_error(f"{result}: {stored.id} was refused, so nothing can be projected: {stored.reason}")
        raise typer.Exit(1)
    given = [TablePoint(stored.id, x, y) for x, y in zip(coordinates[::2], coordinates[1::2], strict=True)]
    found = project_points(stored, given, to.value, point_sigma)
    if not quiet:
        _note_open_size(stored)
    if as_json:
        for point in found:
            console.print_json(json.dumps(_json_line(point, to)))
        return
    given_unit, unit = to.units
    columns = (f"x {given_unit}", f"y {given_unit}", f"x {unit}", f"y {unit}", f"sigma {unit}", "")
    console.print_table(None, columns, [_cells(point, to) for point in found])


def _json_line(point: ProjectedPoint, to: Target) -> dict[str, object]:
    """A point, its place, and a note, which is the reason where it has no place."""
    given_unit, unit = to.units
    has_place = math.isfinite(point.x)
    line = {
        given_unit: (point.given.x, point.given.y),
        unit: (point.x, point.y) if has_place else None,
        "sigma": _finite(point.sigma),
    }
    return line | ({"note" if has_place else "reason": point.note} if point.note else {})


def _cells(point: ProjectedPoint, to: Target) -> tuple[str, ...]:
    """A point, its place and a note as the cells of a table."""
    from circlecal.cli import console

    given = f"{point.given.x:g}", f"{point.given.y:g}"
    if not math.isfinite(point.x):
        return (*given, "-", "-", "-", point.note)
    decimals = 3 if to is Target.FIELD else 2
    place = (f"{value:z.{decimals}f}" for value in (point.x, point.y))
    return (*given, *place, console.number(_finite(point.sigma), decimals), point.note)


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


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _project_table(results: Path, points: Path, to: Target, point_sigma_px: float, *, as_json: bool) -> None:
    """A table of points of many frames with the places behind its own columns, or as JSON, one line each."""
    from circlecal.api.tables import NO_SUCH_FRAME, project_table, read_points
    from circlecal.cli import console
    from circlecal.errors import InputError
    from circlecal.files import decode_table, read_file

    name = "standard input" if str(points) == "-" else str(points)
    text = decode_table(_read_standard_input() if str(points) == "-" else read_file(points), name)
    given_unit, unit = to.units
    names = (f"x_{given_unit}", f"y_{given_unit}", f"x_{unit}", f"y_{unit}", f"sigma_{unit}", "note")
    table = read_points(io.StringIO(text, newline=""), name, names if as_json else names[2:])
    if to is Target.IMAGE and "z" in table.columns:
        console.print_note(
            f"{name}: the column z is not read, points are taken to lie on the field; to_image of Python takes z"
        )
    if not as_json:
        console.print_row([*table.columns, *names[2:]], table.delimiter)
    is_known = not table.points
    for found in project_table(results, table.points, to.value, point_sigma_px):
        is_known = is_known or found.note != NO_SUCH_FRAME
        place = (found.x, found.y, found.sigma)
        if as_json:
            told = (*map(_finite, (found.given.x, found.given.y, *place)), found.note or None)
            console.print_json(json.dumps(_name_cells(table, found) | dict(zip(names, told, strict=True))))
            continue
        cells = ["" if _finite(value) is None else f"{value:z.6g}" for value in place]
        console.print_row([*found.given.cells, *cells, found.note], table.delimiter)
    if not is_known:
        raise InputError(
            f"{name}: {results} has none of its frames; the column frame holds their ids, or the numbers of those of "
            "one tracked clip, which a column video names"
        )


def _read_standard_input() -> bytes:
    """Everything that comes from there.

    Raises
    ------
    InputError
        It is a folder or the like, or has more than is read of a file.
    """
    from circlecal.errors import InputError
    from circlecal.files import MAX_BYTES, size_in_words

    try:
        content = sys.stdin.buffer.read(MAX_BYTES + 1)
    except OSError as error:
        raise InputError(f"standard input: cannot be read: {error.strerror}; give the table with <") from error
    if len(content) > MAX_BYTES:
        raise InputError(f"standard input: has more than {size_in_words(MAX_BYTES)}; split it")
    return content


def _name_cells(table: PointTable, found: ProjectedPoint) -> dict[str, str]:
    """The cells of a row without its point, by the names of their columns."""
    own = {table.places["x"], table.places["y"]}
    names = {table.places["frame"]: "frame"}
    cells = enumerate(zip(table.columns, found.given.cells, strict=True))
    row = {names.get(place, column): cell for place, (column, cell) in cells if place not in own}
    return row | {"frame": found.given.frame}
