"""``circlecal fields``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from circlecal.field import FieldTemplate

NO_CIRCLE = "no circle: pictures cannot be calibrated"


def fields(
    templates: Annotated[
        list[str] | None,
        typer.Argument(metavar="TEMPLATE", help="Names, or YAML files of your own; all of the package when none."),
    ] = None,
    draw: Annotated[
        Path | None, typer.Option("--draw", metavar="FOLDER", help="Draw each template there, <name>.png.")
    ] = None,
) -> None:
    """List field templates, the configuration that each brings, and its circles; check templates of your own."""
    from circlecal.field import field_names, load_field

    chosen = [load_field(name) for name in templates or field_names()]
    if draw is not None:
        _draw_templates(chosen, draw)
    else:
        _list_templates(chosen)


def _draw_templates(chosen: Sequence[FieldTemplate], folder: Path) -> None:
    from circlecal.cli import console
    from circlecal.files import prepare_folder
    from circlecal.overlay.template_picture import write_template_pictures

    prepare_folder(folder, "--draw")
    for path in write_template_pictures(chosen, folder):
        console.print_line(str(path))


def _list_templates(chosen: Sequence[FieldTemplate]) -> None:
    from circlecal.cli import console

    rows = []
    for template in chosen:
        size = f"{template.length_m:g} x {template.width_m:g} m"
        width = f"{template.marking_width_m:g} m"
        config = template.config or "default"
        shown = [c for c in template.round_ones if c in template.circles or c.name == template.default_circle]
        for circle in shown:
            usual = "yes" if circle.name == template.default_circle else ""
            radius = f"{circle.radius_m:g} m ({circle.edge} edge)"
            rows.append((template.name, size, width, config, circle.name, radius, usual))
        if not shown:
            rows.append((template.name, size, width, config, NO_CIRCLE, "", ""))
    heads = ("field", "size", "marking", "config", "circle", "radius", "default")
    console.print_table("Field templates", heads, rows)
