"""``circlecal fields``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

NO_CIRCLE = "no circle: pictures cannot be calibrated"


def fields(
    draw: Annotated[
        Path | None, typer.Option("--draw", metavar="FOLDER", help="Draw each template there, <name>.png.")
    ] = None,
) -> None:
    """List the field templates that come with circlecal, and their circles."""
    from circlecal.cli import console
    from circlecal.field import field_names, load_field

    templates = [load_field(name) for name in field_names()]
    if draw is not None:
        from circlecal.files import prepare_folder
        from circlecal.overlay.template_picture import write_template_pictures

        prepare_folder(draw, "--draw")
        for path in write_template_pictures(templates, draw):
            console.print_line(str(path))
        return
    rows = []
    for template in templates:
        size = f"{template.length_m:g} x {template.width_m:g} m"
        width = f"{template.marking_width_m:g} m"
        shown = [
            c for c in (*template.circles, *template.arcs) if c in template.circles or c.name == template.default_circle
        ]
        for circle in shown:
            usual = "default" if circle.name == template.default_circle else ""
            radius = f"{circle.radius_m:g} m ({circle.edge} edge)"
            rows.append((template.name, size, width, circle.name, radius, usual))
        if not shown:
            rows.append((template.name, size, width, NO_CIRCLE, "", ""))
    console.print_table("Field templates", ("field", "size", "marking", "circle", "radius", ""), rows)
