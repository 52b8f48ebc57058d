"""The field that a configuration names, as the estimation takes it."""

from __future__ import annotations

from typing import Literal

from circlecal.config import AUTO, Config, check_among
from circlecal.errors import ConfigError
from circlecal.field import Circle, FieldTemplate, load_field

Convention = Literal["official", "paint"]
NO_PAINT_M = 1e-9
"""Width of paint that has none, metres: both of its edges lie where the rules put the marking."""


def field_of(config: Config) -> tuple[FieldTemplate, Circle]:
    """Field template and circle that the configuration names.

    Raises
    ------
    ConfigError
        Where the template or its circle does not exist, or one of ``field.among``. Of a field that pictures are to tell
        it is the first template.
    """
    name = config.field.template
    if name == AUTO:
        if config.field.circle is not None or config.field.sizes:
            raise ConfigError("field.template: auto goes with neither field.circle nor field.sizes; name the field")
        check_among(config.field.among)
        name = config.field.among[0]
    template = load_field(name, config.field.sizes)
    known_sizes = _known_sizes(config)
    if known_sizes:  # else what was derived from the template holds for all pictures
        template = template.model_copy(update=known_sizes)
    name = config.field.circle or template.default_circle
    circle = template.circle_by_name.get(name)
    if not name:
        raise ConfigError(f"field.template: {template.name} has no circle, from which circlecal could calibrate")
    if circle is None:
        known = ", ".join(template.circle_by_name)
        raise ConfigError(f"field.circle: {name!r} is not a circle of {template.name}; known: {known}")
    return template, circle


def _known_sizes(config: Config) -> dict[str, float | None]:
    """What a configuration says of how much length and width of its template vary."""
    changes: dict[str, float | None] = {}
    for side, sd_m in (("length", config.field.length_sd_m), ("width", config.field.width_sd_m)):
        if sd_m is not None or side in config.field.sizes:
            changes[f"{side}_range_m"] = None
        if sd_m is not None:
            changes[f"{side}_sd_m"] = sd_m
    return changes


def apply_convention(template: FieldTemplate, convention: Convention) -> FieldTemplate:
    """The template as :func:`run_observations` takes it: with ``official`` no width of markings, and exact sizes.

    A result tells the convention by the width of the paint among the sizes of its field.
    """
    if convention == "paint":
        return template
    known = {"marking_width_sd_m": 0.0, "length_sd_m": 0.0, "width_sd_m": 0.0}
    sizes = template.sizes | ({"marking": NO_PAINT_M} if "marking" in template.sizes else {})
    return template.model_copy(update={"marking_width_m": NO_PAINT_M, "sizes": sizes, **known})
