"""Writing: the configuration as commented YAML, its JSON schema, its digest, and itself for another working folder."""

from __future__ import annotations

import hashlib
import json
import math
import os
import textwrap
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel

from circlecal.config.sections import Config, change_files
from circlecal.files import is_file, open_regular

_COMMENT_WIDTH = 118
_LIMITS = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
_Schema = Mapping[str, Any]


def absolute_files(config: Config) -> Config:
    """The configuration as a process with another working folder must have it: its templates and networks named by
    their whole paths.
    """
    content = config.model_dump(exclude_unset=True)
    change_files(content, lambda named: str(Path(named).absolute()))
    return Config.model_validate(content)


def config_digest(config: Config) -> str:
    """Twelve hexadecimal digits over everything that can change an answer.

    That is every section but ``output``, ``rig`` and ``limits``, and the content of the user's own files: templates,
    networks.
    """
    content = config.model_dump(mode="json", exclude={"output", "rig", "limits"})
    change_files(content, _file_digest)
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()[:12]


def _file_digest(name: str) -> str:
    """Digest of a file's content, or the name where there is no such file."""
    if not is_file(Path(name)):
        return name
    status = Path(name).stat()
    return _content_digest(name, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=16)
def _content_digest(name: str, size: int, changed: int) -> str:
    with open_regular(name) as descriptor, os.fdopen(os.dup(descriptor), "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def json_schema() -> dict[str, Any]:
    """JSON schema of the configuration file."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Config.model_json_schema()}


def effective_yaml(config: Config) -> str:
    """The whole configuration as YAML, each key under its description and bounds; loads back to the same one."""
    schema = Config.model_json_schema()
    header = "# Every option of circlecal with its value. A file of yours needs only the keys that differ.\n\n"
    return header + "\n".join(_yaml_lines(config, schema, schema.get("$defs", {}), "")) + "\n"


def _yaml_lines(model: BaseModel, schema: _Schema, definitions: _Schema, indent: str) -> Iterator[str]:
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        described = schema["properties"][name]
        allowed = _describe_bounds(described)
        comment = f"{field.description or ''}{f' ({allowed})' if allowed else ''}"
        if isinstance(value, BaseModel) and not indent:
            yield ""
        yield from textwrap.wrap(comment, _COMMENT_WIDTH, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}# ")
        if isinstance(value, BaseModel):
            yield f"{indent}{name}:"
            yield from _yaml_lines(value, _definition(described, definitions), definitions, f"{indent}  ")
        else:
            yield f"{indent}{name}: {_yaml_value(model.model_dump(mode='json', include={name})[name])}"


def _yaml_value(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=math.inf, allow_unicode=True)
    return text.removesuffix("\n").removesuffix("\n...")


def _definition(schema: _Schema, definitions: _Schema) -> _Schema:
    """The schema itself, or the one that it refers to (also as ``model | null``)."""
    branches = [schema, *schema.get("allOf", ()), *schema.get("anyOf", ())]
    reference = next((branch["$ref"] for branch in branches if "$ref" in branch), None)
    if reference is None:
        return schema
    definition: _Schema = definitions[reference.rpartition("/")[2]]
    return definition


def _describe_bounds(schema: _Schema) -> str:
    """Bounds and choices of one key in words."""
    if "anyOf" in schema:
        return " or ".join(filter(None, (_describe_bounds(branch) for branch in schema["anyOf"])))
    if "enum" in schema:
        return "one of " + ", ".join(_yaml_value(choice) for choice in schema["enum"])
    return ", ".join(f"{sign} {schema[key]}" for key, sign in _LIMITS.items() if key in schema)
