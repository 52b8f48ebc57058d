"""``circlecal project``."""

from __future__ import annotations

import json
import math
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from circlecal.cli import options


class Target(StrEnum):
    """Where points are taken to."""

    FIELD = "field"
    IMAGE = "image"


def project(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Result file of circlecal calibrate.")],
    coordinates: Annotated[
        list[float], typer.Argument(metavar="X Y", help="Pixels for --to field, metres for --to image.")
    ],
    to: Annotated[Target, typer.Option("--to", help="field: pixels to metres; image: metres to pixels.")],
    as_json: options.Json = False,
) -> None:
    """Take points from the picture to the field or back, with the camera's lens where the result has a camera."""
    from circlecal.cli import console
    from circlecal.errors import InputError
    from circlecal.records.record import read_result

    if len(coordinates) % 2 or not all(map(math.isfinite, coordinates)):
        raise InputError("project takes finite numbers in pairs: X Y [X Y ...]")
    stored = read_result(result)
    view = stored.view
    if stored.status != "calibrated" or view is None:
        console.print_error(f"{result}: {stored.id} was refused, so nothing can be projected: {stored.reason}")
        raise typer.Exit(1)
    given = list(zip(coordinates[::2], coordinates[1::2], strict=True))
    mapped = (view.to_field if to is Target.FIELD else view.project)(given, sigma=True)
    sigma = [None] * len(given) if mapped.sigma is None else mapped.sigma.tolist()
    unit, given_unit = ("m", "px") if to is Target.FIELD else ("px", "m")
    missing = "on or above the horizon" if to is Target.FIELD else "behind the camera"
    answers = list(zip(given, mapped.points.tolist(), sigma, strict=True))
    if as_json:
        for source, target, spread in answers:
            seen = math.isfinite(target[0])
            line = {given_unit: source, unit: target if seen else None, "sigma": _finite(spread)}
            console.print_json(json.dumps(line if seen else {**line, "reason": missing}))
        return
    decimals = 3 if to is Target.FIELD else 2
    rows = [
        (*(f"{value:g}" for value in source), *_cells(target, spread, decimals, missing))
        for source, target, spread in answers
    ]
    columns = (f"x {given_unit}", f"y {given_unit}", f"x {unit}", f"y {unit}", f"sigma {unit}", "")
    console.print_table(None, columns, rows)


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _cells(target: list[float], sigma: float | None, decimals: int, missing: str) -> tuple[str, str, str, str]:
    from circlecal.cli import console

    if not math.isfinite(target[0]):
        return "-", "-", "-", missing
    return f"{target[0]:.{decimals}f}", f"{target[1]:.{decimals}f}", console.number(_finite(sigma), decimals), ""
