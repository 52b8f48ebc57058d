"""Reading: YAML files and overrides, laid over each other and checked.

A file gives only what differs from the defaults. Keys that are unknown, values of the wrong type, keys given twice and
values that are not finite are errors that name the file and the key.
"""

from __future__ import annotations

import contextlib
import difflib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from circlecal.config.sections import Config, FieldConfig, change_files, find_nested_model
from circlecal.errors import ConfigError, InputError, explain_problem
from circlecal.field import load_field
from circlecal.files import read_text
from circlecal.yaml_text import MAX_BYTES, YamlError, config_names, find_config, parse_yaml


@dataclass(frozen=True, slots=True)
class NamedOption:
    """One option of the configuration, which errors call as the user gave it: ``told``, as ``--max-pixels 10``."""

    key: str
    value: Any
    told: str


def load_config(
    file: str | Path | Config | None = None, overrides: Sequence[str | NamedOption] | Mapping[str, Any] = ()
) -> Config:
    """Configuration from a file and overrides: over the defaults the options of the field's sport, over them the file,
    and over it the overrides.

    Parameters
    ----------
    file : path, str or Config, optional
        YAML file, or the name of a configuration that comes with the package; the defaults when None. Or one that is
        loaded already, which is complete unless an override names another field.
    overrides : sequence of str or NamedOption, or mapping
        ``section.key=value`` each, the value in YAML; or values by ``section.key``. Later ones win.

    Raises
    ------
    ConfigError
        One line with the file or the override, the full key and the mend.
    """
    content, source = _read_content(file)
    chosen, origins = _apply_overrides(content, overrides)
    suited = _name_suited_config(chosen.get("field"))
    if isinstance(file, Config) and (suited is None or _is_of_field(file, chosen)):
        chosen, origins = _apply_overrides(file.model_dump(mode="json"), overrides)
    elif suited not in (None, file):
        path = _find_config(suited)
        source = str(path) if file is None else source
        chosen, origins = _apply_overrides(_lay_over(_read_mapping(path), content, Config), overrides)
    return _validate(chosen, source, origins)


def _read_content(file: str | Path | Config | None) -> tuple[dict[str, Any], str]:
    """What a configuration sets, and what errors call it."""
    if file is None:
        return {}, "configuration"
    if isinstance(file, Config):
        return file.model_dump(mode="json", exclude_unset=True), "configuration"
    path = _find_config(file)
    content = _read_mapping(path)
    change_files(content, lambda named: str(path.parent / named))
    return content, str(path)


def _is_of_field(config: Config, content: Mapping[str, Any]) -> bool:
    """Whether a loaded configuration is for the field that is chosen, so that its sport's options are in it."""
    section = content.get("field")
    default = config.field.template
    return not isinstance(section, dict) or section.get("template", default) == default


def _apply_overrides(
    content: Mapping[str, Any], overrides: Sequence[str | NamedOption] | Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, str]]:
    """The content with the overrides, the given one left alone; and by key what errors call each."""
    chosen: dict[str, Any] = _copy_sections(content)
    origins: dict[str, str] = {}
    for override in overrides.items() if isinstance(overrides, Mapping) else overrides:
        key, told = _apply_override(chosen, override)
        origins[key] = told
    return chosen, origins


def _apply_override(content: dict[str, Any], override: str | NamedOption | tuple[str, Any]) -> tuple[str, str]:
    """Set one option; return its key and what errors call it."""
    if isinstance(override, str):
        key, equals, text = override.partition("=")
        told, value = f"--set {override}", _parse_yaml(text, f"--set {override}") if equals else None
    elif isinstance(override, NamedOption):
        key, equals, value, told = override.key, "=", override.value, override.told
    else:
        key, value = override
        if isinstance(value, np.ndarray | np.generic):
            value = value.tolist()
        value = _copy_sections(value)
        equals, told = "=", f"set {key}={_kind(value) if isinstance(value, list | dict) else value}"
        if not isinstance(key, str):
            raise ConfigError(f"{told}: {key!r} is no name of an option, such as 'camera.roll_sd_deg'")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise ConfigError(f"{told}: must look like section.key=value")
    section = content
    for depth, part in enumerate(parts[:-1], start=1):
        section = section.setdefault(part, {})
        if not isinstance(section, dict):
            raise ConfigError(f"{told}: {'.'.join(parts[:depth])} has no keys of its own")
    section[parts[-1]] = value
    return ".".join(parts), told


def _copy_sections(value: Any) -> Any:
    """The value with mappings of its own, since later keys are set in them and they may be the caller's."""
    return {key: _copy_sections(inner) for key, inner in value.items()} if isinstance(value, dict) else value


def _lay_over(lower: Mapping[str, Any], upper: Mapping[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """One content with everything that another sets over it, section by section; a whole value replaces another."""
    merged = dict(lower)
    for key, value in upper.items():
        nested, below = find_nested_model(model, key), merged.get(key)
        if nested is not None and isinstance(below, dict) and isinstance(value, dict):
            value = _lay_over(below, value, nested)
        merged[key] = value
    return merged


def _name_suited_config(section: Any) -> str | None:
    """Name of the configuration that the template of a field section asks for; None also where the section or the
    template cannot be read, which is said where it is used.
    """
    with contextlib.suppress(ConfigError, ValidationError):
        field = FieldConfig.model_validate_json(json.dumps(section or {}, default=str), strict=True)
        if field.template != FieldConfig().template:
            return load_field(field.template, field.sizes).config
    return None


def _find_config(name_or_file: str | Path) -> Path:
    found = find_config(name_or_file)
    if found is not None:
        return found
    if Path(name_or_file).suffix in (".yaml", ".yml"):
        return Path(name_or_file)  # reading it tells what is wrong
    raise ConfigError(f"config {str(name_or_file)!r} is no file and no known name; known: {', '.join(config_names())}")


def _read_mapping(path: Path) -> dict[str, Any]:
    try:
        text = read_text(path, MAX_BYTES)
    except InputError as error:
        raise ConfigError(f"{error}; give a YAML file or one of: {', '.join(config_names())}") from error
    content = _parse_yaml(text, str(path))
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: must be a mapping of sections, not {_kind(content)}")
    return {key: {} if value is None and find_nested_model(Config, key) else value for key, value in content.items()}


def _parse_yaml(text: str, source: str) -> Any:
    try:
        return parse_yaml(text)
    except YamlError as error:
        where = f", line {error.line}" if error.line else ""
        raise ConfigError(f"{source}{where}: {error}") from error


def _validate(content: dict[str, Any], source: str, origins: Mapping[str, str]) -> Config:
    try:
        # JSON in strict mode: lists become tuples and integers floats, but text never a number, nor true a 1
        return Config.model_validate_json(json.dumps(content, default=str), strict=True)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        key = _key(problems[0])
        same = [problem for problem in problems if _key(problem) == key]
        origin = next((text for name, text in origins.items() if _is_related(key, name)), source)
        more = f" (and {len(problems) - len(same)} more)" if len(problems) > len(same) else ""
        raise ConfigError(f"{origin}: {_explanation(key, same)}{more}") from error


def _is_related(key: str, other: str) -> bool:
    """Whether one key is the other or lies inside it."""
    return f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}.")


def _key(problem: ErrorDetails) -> str:
    """The key as the user writes it: pydantic adds the branch of a union, e.g. ``function-after[...]`` or ``int``."""
    parts: list[str] = []
    model: Any = Config
    for part in problem["loc"]:
        if isinstance(model, type) and issubclass(model, BaseModel) and part in model.model_fields:
            model = model.model_fields[str(part)].annotation
        elif parts and not isinstance(part, int) and problem["type"] != "extra_forbidden" and not _is_mapping(model):
            continue
        parts.append(str(part))
    return ".".join(parts)


def _is_mapping(annotation: Any) -> bool:
    return getattr(annotation, "__origin__", None) is dict


def _explanation(key: str, problems: Sequence[ErrorDetails]) -> str:
    if problems[0]["type"] == "extra_forbidden":
        return _unknown_key(key)
    wanted = dict.fromkeys(explain_problem(problem["type"], problem["msg"]) for problem in problems)
    given = problems[0]["input"]
    tells_all = problems[0]["type"] in ("value_error", "missing", "too_short", "too_long")
    shown = "" if tells_all else f", not {_kind(given)}"
    return f"{key}: {' or '.join(wanted)}{shown}"


def _kind(value: Any) -> str:
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "a mapping"
    return json.dumps(value, default=str)


def _unknown_key(key: str) -> str:
    section, _, name = key.rpartition(".")
    known = sorted(_fields_of(section))
    matches = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    close = [f"{section}.{match}" if section else match for match in matches]
    close = close or [full for full in _all_keys(Config) if full.rpartition(".")[2] == name]
    if close:
        return f"unknown key {key}; did you mean {' or '.join(close)}?"
    return f"unknown key {key}; known{f' in {section}' if section else ''}: {', '.join(known)}"


def _fields_of(section: str) -> list[str]:
    model: type[BaseModel] = Config
    for part in section.split(".") if section else []:
        nested = find_nested_model(model, part)
        if nested is None:
            return []
        model = nested
    return list(model.model_fields)


def _all_keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name in model.model_fields:
        nested = find_nested_model(model, name)
        if nested is None:
            yield f"{prefix}{name}"
        else:
            yield from _all_keys(nested, f"{prefix}{name}.")
