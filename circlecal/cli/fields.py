"""``circlecal fields``."""

from __future__ import annotations


def fields() -> None:
    """List the field templates that come with circlecal, and their circles."""
    from circlecal.cli import console
    from circlecal.field import field_names, load_field

    rows = []
    for template in map(load_field, field_names()):
        for circle in template.circles:
            usual = "default" if circle.name == template.default_circle else ""
            radius = f"{circle.radius_m:g} m ({circle.edge} edge)"
            size = f"{template.length_m:g} x {template.width_m:g} m"
            rows.append((template.name, size, f"{template.marking_width_m:g} m", circle.name, radius, usual))
    console.print_table("Field templates", ("field", "size", "marking", "circle", "radius", ""), rows)
