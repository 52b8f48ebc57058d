"""The field: templates and their files here, and where a camera shows it in :mod:`circlecal.field.view`."""

from circlecal.field.loading import field_folder, field_names, load_field, template_from_mapping
from circlecal.field.template import (
    COMPASS,
    MEET,
    Arc,
    Circle,
    FieldTemplate,
    Ground,
    Line,
    Mark,
    evaluate_size,
    unit_circle,
)

__all__ = [
    "COMPASS",
    "MEET",
    "Arc",
    "Circle",
    "FieldTemplate",
    "Ground",
    "Line",
    "Mark",
    "evaluate_size",
    "field_folder",
    "field_names",
    "load_field",
    "template_from_mapping",
    "unit_circle",
]
