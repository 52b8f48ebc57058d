"""What suits a frame: the configuration for the field and the pixels that it turns out to have, and the field templates
that the configuration names.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel

from circlecal.config.loading import load_config
from circlecal.config.sections import Config, FieldConfig, is_own_template
from circlecal.errors import ConfigError
from circlecal.field import FieldTemplate, load_field


def suit_config(config: Config, template: str) -> Config:
    """The configuration for a field template: what the template asks for, under everything that was set to something
    else than its default.

    Parameters
    ----------
    config : Config
        Of a field that is not known.
    template : str
        Name of a template or its file; of a file among ``field.among`` the name in it is enough.

    Raises
    ------
    ConfigError
        The template does not exist, or what was set contradicts it.
    """
    named = find_template(config, template)
    changes = _differences(config, Config()) | {"field.template": named, "field.among": FieldConfig().among}
    return load_config(load_field(named).config, changes)


def _differences(given: BaseModel, usual: BaseModel, prefix: str = "") -> dict[str, Any]:
    """Values by ``section.key`` in which one model differs from another of its kind."""
    found: dict[str, Any] = {}
    for name in type(given).model_fields:
        value, other = getattr(given, name), getattr(usual, name)
        if isinstance(value, BaseModel) and type(value) is type(other):
            found |= _differences(value, other, f"{prefix}{name}.")
        elif value != other:
            found[f"{prefix}{name}"] = given.model_dump(mode="json", include={name})[name]
    return found


def suit_pixels(config: Config, aspect: float | None) -> Config:
    """The configuration for pictures whose pixels are ``aspect`` times as wide as tall, as their file tells; the one
    given where no file tells it (None, or 1 in what circlecal has written), or where it says itself what they are like.
    """
    if aspect in (None, 1.0) or config.camera.aspect is not None:
        return config
    return config.model_copy(update={"camera": config.camera.model_copy(update={"aspect": aspect})})


def aspect_of(config: Config) -> float:
    """Width of a pixel over its height as far as the options or a video's file tell; 1 where they tell nothing."""
    return 1.0 if config.camera.aspect is None else config.camera.aspect


def find_template(config: Config, name: str) -> str:
    """How an option names the template that results call ``name``: the file where it is one among ``field.among``.

    Raises
    ------
    ConfigError
        A file cannot be read as a template.
    """
    among = config.field.among
    files = (entry for entry in among if name not in among and is_own_template(entry))
    return next((file for file in files if load_field(file).name == name), name)


def load_told_field(config: Config, name: str) -> FieldTemplate:
    """The template that results call ``name``, which may be a file among ``field.among``.

    Raises
    ------
    ConfigError
        It does not exist, or a file cannot be read as a template.
    """
    return load_field(find_template(config, name))


def check_among(among: Sequence[str]) -> None:
    """See that the templates of ``field.among`` can be read, and that results tell them by their names.

    Raises
    ------
    ConfigError
        One line with the option, the template and the mend.
    """
    entry_of: dict[str, str] = {}
    for entry in among:
        try:
            name = load_field(entry).name
        except ConfigError as error:
            raise ConfigError(f"field.among: {error}") from error
        if name in entry_of and entry_of[name] != entry:
            raise ConfigError(
                f"field.among: {entry_of[name]} and {entry} are both named {name!r}; rename one in its file"
            )
        entry_of[name] = entry
