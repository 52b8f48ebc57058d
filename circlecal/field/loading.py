"""Field templates from their files: those that come with the package, by name, and those of users."""

from __future__ import annotations

import difflib
import logging
import os
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from circlecal.errors import ConfigError, InputError, explain_problem
from circlecal.field.template import FieldTemplate, evaluate_size
from circlecal.files import is_file, open_regular
from circlecal.yaml_text import YamlError, config_folder, config_names, find_config, read_yaml

FACTS_OF_SPORT = ("sport", "ground", "config", "polarity", "has_leagues")
"""Keys that all templates of one sport share. A template of a user's that leaves some of them out has those of its
relative.
"""
LEAST_SHARED_NAMES = 0.5
"""Share of the names of markings of two templates, of one or the other or both, that they have in common at least where
they are of one sport. Templates of one sport that come with the package share 0.82 or more, those of two sports 0.44 or
less, but robot soccer, which has soccer's names on a field a tenth as long: there the nearest length tells.
"""
LEAST_LIKENESS = 0.85
"""Of two names of sports, from 0 to 1, from which on one is taken for a misspelling of the other; one wrong letter in
seven is less, ``American football`` beside ``Australian football`` is not.
"""
_log = logging.getLogger(__name__)


def template_from_mapping(content: Any, source: str, sizes: dict[str, float] | None = None) -> FieldTemplate:
    """Template from the content of its YAML file.

    Parameters
    ----------
    content : mapping
        What the file holds.
    source : str
        Named in error messages.
    sizes : dict, optional
        Sizes set by the user, over those of the file.

    Raises
    ------
    ConfigError
        With the file or the sizes that were set, the key and the mend.
    """
    if not isinstance(content, dict) or not isinstance(content.get("sizes"), dict):
        raise ConfigError(f"{source}: a field template is a mapping with a 'sizes' mapping in it")
    merged = dict(content["sizes"])
    for key, value in (sizes or {}).items():
        if key not in merged:
            raise ConfigError(f"field.sizes.{key} is unknown; known in {source}: {', '.join(sorted(merged))}")
        merged[key] = value
    try:
        evaluated: dict[str, float] = {}
        for key, value in merged.items():
            try:
                evaluated[key] = evaluate_size(value, evaluated)
            except ValueError as error:
                raise ConfigError(f"{source}: sizes.{key}: {error}") from error
        return FieldTemplate.model_validate({**content, "sizes": evaluated}, context={"sizes": evaluated})
    except ValidationError as error:
        first = error.errors()[0]
        missing = [_name_missing(problem["loc"]) for problem in error.errors() if problem["type"] == "missing"]
        if len(missing) > 1 or first["type"] == "missing":
            told = "is missing" if len(missing) == 1 else "are missing"
            raise ConfigError(f"{source}: {', '.join(missing)} {told}") from error
        where = ".".join(str(part) for part in first["loc"]) or "template"
        given = ", ".join(f"field.sizes.{key}={value:g}" for key, value in (sizes or {}).items())
        raise ConfigError(f"{given or source}: {where}: {explain_problem(first['type'], first['msg'])}") from error


def _name_missing(location: tuple[int | str, ...]) -> str:
    """A key that is missing, with what may stand there where that is not plain."""
    hint = " (a line's name, or null)" if location == ("halfway_line",) else ""
    return ".".join(map(str, location)) + hint


def field_folder() -> Path:
    """Folder of the templates that come with the package."""
    return config_folder() / "fields"


def field_names() -> list[str]:
    """Names of the templates that come with the package."""
    return sorted(path.stem for path in field_folder().glob("*.yaml"))


def load_field(name_or_file: str | Path, sizes: dict[str, float] | None = None) -> FieldTemplate:
    """Template by name or from a file of the user's.

    Raises
    ------
    ConfigError
        Unknown name, unreadable file, or a wrong template.
    """
    path = Path(name_or_file)
    if path.suffix not in (".yaml", ".yml"):
        path = field_folder() / f"{name_or_file}.yaml"
        if not is_file(path):
            known = ", ".join(field_names())
            if is_file(Path(name_or_file)):
                raise ConfigError(f"{name_or_file}: is no field template by its name; rename it to end in .yaml")
            raise ConfigError(f"field {str(name_or_file)!r} is unknown; known: {known}, or give a .yaml file")
    try:
        with open_regular(path) as descriptor:
            changed = os.fstat(descriptor).st_mtime_ns
        return _read_field(path, changed, tuple(sorted((sizes or {}).items())))
    except InputError as error:
        raise ConfigError(str(error)) from error


@lru_cache(maxsize=32)
def _read_field(path: Path, changed_ns: int, sizes: tuple[tuple[str, float], ...]) -> FieldTemplate:
    """One file read once, as long as it does not change."""
    try:
        content = read_yaml(path)
    except YamlError as error:
        where = f", line {error.line}" if error.line else ""
        raise ConfigError(f"{path}{where}: cannot be read: {error}") from error
    template = template_from_mapping(content, str(path), dict(sizes))
    if path.parent == field_folder():
        return template
    _require_sport(template.sport, path)
    _require_config(template.config, path)
    return complete_facts(template)


def _require_sport(sport: str | None, path: Path) -> None:
    """See that a sport is none of the package's that is misspelt, or named by a word of its name alone.

    Raises
    ------
    ConfigError
        It is.
    """
    known = sorted({named for name in field_names() if (named := load_field(name).sport) is not None}, key=str.lower)
    if sport is None or sport in known:
        return
    names = {word for name in known for word in (name.lower(), *name.lower().split())}
    if difflib.get_close_matches(sport.lower(), names, n=1, cutoff=LEAST_LIKENESS):
        raise ConfigError(f"{path}: sport: {sport!r} is unknown; known: {', '.join(known)}")


def _require_config(config: str | None, path: Path) -> None:
    """See that the configuration that a template brings is one of the package's, or a file.

    Raises
    ------
    ConfigError
        It is neither.
    """
    if config is not None and find_config(config) is None:
        known = ", ".join(config_names())
        raise ConfigError(f"{path}: config: {config!r} is no file and no known name; known: {known}")


def complete_facts(template: FieldTemplate) -> FieldTemplate:
    """A template of a user's with :data:`FACTS_OF_SPORT` of its relative wherever its file does not say them itself."""
    missing = [key for key in FACTS_OF_SPORT if key not in template.model_fields_set]
    relative = find_relative(template) if missing else None
    if relative is None:
        return template
    _log.info("field %s: %s as of %s", template.name, ", ".join(missing), relative.name)
    return template.model_copy(update={key: getattr(relative, key) for key in missing})


def find_relative(template: FieldTemplate) -> FieldTemplate | None:
    """The template of the package that has the sport of a given one, or, where that names none, most of its names of
    markings; the one nearest in length where there are several, and None where there is none.
    """
    shipped = [load_field(name) for name in field_names()]
    if template.sport is not None:
        related = [other for other in shipped if other.sport == template.sport]
    else:
        related = [other for other in shipped if _share_of_names(template, other) >= LEAST_SHARED_NAMES]
    return min(related, key=lambda other: abs(np.log(other.length_m / template.length_m)), default=None)


def _share_of_names(one: FieldTemplate, other: FieldTemplate) -> float:
    return len(one.names & other.names) / len(one.names | other.names)
