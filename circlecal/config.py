"""The configuration: every option of every stage, from YAML files and ``--set`` overrides, checked and described.

A file gives only what differs from the defaults. Keys that are unknown, values of the wrong type, keys given twice and
values that are not finite are errors that name the file and the key.
"""

from __future__ import annotations

import contextlib
import difflib
import hashlib
import json
import math
import os
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, get_args

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from circlecal.camera.options import CameraConfig
from circlecal.camera.rig_options import RigConfig
from circlecal.detection.keypoints import KeypointsConfig
from circlecal.errors import ConfigError, InputError, explain_problem
from circlecal.field import FieldTemplate, load_field
from circlecal.files import is_file, open_regular, read_text
from circlecal.formats.meaning import SourcesConfig
from circlecal.paint.along_curve import RaysConfig
from circlecal.pictures.limits import DEFAULT_LIMITS, LimitsConfig
from circlecal.stages.correspondences import CorrespondencesConfig
from circlecal.stages.cues import CuesConfig
from circlecal.stages.edges import EdgesConfig
from circlecal.stages.ellipse import EllipseConfig
from circlecal.stages.homography import HomographyConfig
from circlecal.stages.mask import MaskConfig
from circlecal.stages.verdict import VerdictConfig
from circlecal.yaml_text import MAX_BYTES, YamlError, parse_yaml

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
_COMMENT_WIDTH = 118


AUTO = "auto"
"""Stands for a field template that the picture tells."""
TOLD_APART = (
    "soccer",
    "robocup",
    "robocup-adult",
    "robocup-msl",
    "ice-hockey-nhl",
    "ice-hockey",
    "basketball",
    "basketball-nba",
    "basketball-ncaa",
    "futsal",
    "handball",
)
"""Templates of which real pictures were seen, and those that differ from them in their sizes."""


class FieldConfig(BaseModel):
    """Which field is seen, and which of its circles."""

    model_config = _STRICT

    template: str = Field(
        "soccer",
        description="Name of a field template (`circlecal fields` lists them), a YAML file of your own, or auto: the"
        " one that a picture shows.",
    )
    among: tuple[str, ...] = Field(
        TOLD_APART,
        min_length=1,
        description="Templates that auto chooses from, by name or as YAML files of your own; the first one is taken"
        " where its answer is beyond doubt.",
    )
    circle: str | None = Field(
        None, description="Circle of the template that is seen; null: the template's default circle."
    )
    any_circle: bool = Field(
        False,
        description="Whether every circle of the template may be the one that is seen, told by all other markings,"
        " where none is named above and the default circle with its line does not calibrate.",
    )
    all_markings: bool = Field(
        False,
        description="Whether every marking of the template is measured where a camera from circle and halfway line puts"
        " it, and those that agree are taken in.",
    )
    sizes: dict[str, float] = Field(
        {}, description="Sizes in metres over those of the template, e.g. {length: 100, marking: 0.1}."
    )
    length_sd_m: float | None = Field(
        None,
        ge=0,
        description="How far the field's length may be from the template's or the given one, metres; null: mostly very "
        "near, or anywhere that the rules allow.",
    )
    width_sd_m: float | None = Field(
        None, ge=0, description="How far its width may be, metres; null as for the length."
    )


class LearningConfig(BaseModel):
    """What the frames of a run that were calibrated alone tell those that were refused."""

    model_config = _STRICT

    enabled: bool = Field(
        True,
        description="Whether frames of a batch that are refused are calibrated again, told what the others of their"
        " folder or video agree on: the colour of the paint, and with the field `auto` the field; and whether a clip is"
        " tracked along the colour of the paint on which its first frames agree.",
    )
    least_frames: int = Field(3, ge=2, le=1000, description="Fewer frames that agree tell nothing.")


class OutputConfig(BaseModel):
    """What is written beside the result; nothing here changes an answer."""

    model_config = _STRICT

    overlay: bool = Field(True, description="Write the frame with the projected field template, `<id>.overlay.jpg`.")
    radar: bool = Field(False, description="Write the frame warped to the field plane, `<id>.radar.jpg`.")
    radar_px_per_m: float = Field(10.0, ge=1.0, le=100.0, description="Scale of the radar picture, pixels per metre.")
    debug: bool = Field(
        False, description="Write one picture per stage and a contact sheet, in the folder `<id>.debug`."
    )
    jpeg_quality: int = Field(90, ge=1, le=100, description="JPEG quality of the written pictures.")


class Config(BaseModel):
    """Everything that can be set."""

    model_config = _STRICT

    seed: int = Field(0, ge=0, le=2**32 - 1, description="Seed of all random draws; every frame begins with it anew.")
    solver: str | None = Field(
        None,
        description="One of the published solvers instead of the closed forms and the camera stage; null for none.",
    )
    field: FieldConfig = Field(FieldConfig(), description="Field: the template and the circle that is seen.")
    mask: MaskConfig = Field(MaskConfig(), description="Mask: where the markings are, read or detected.")
    keypoints: KeypointsConfig = Field(
        KeypointsConfig(), description="Keypoints: a network that finds points of the field, for pictures."
    )
    edges: EdgesConfig = Field(EdgesConfig(), description="Edges: sub-pixel Canny points on the markings.")
    rays: RaysConfig = Field(RaysConfig(), description="Rays: outer edge, inner edge and centreline of the circle.")
    ellipse: EllipseConfig = Field(EllipseConfig(), description="Ellipse: the conic of each edge.")
    cues: CuesConfig = Field(CuesConfig(), description="Cues: halfway line, centre mark, further straight markings.")
    correspondences: CorrespondencesConfig = Field(
        CorrespondencesConfig(), description="Correspondences: points and tangents with their field coordinates."
    )
    homography: HomographyConfig = Field(HomographyConfig(), description="Homography: DLT on points and lines.")
    camera: CameraConfig = Field(CameraConfig(), description="Camera: everything that was seen, with priors.")
    verdict: VerdictConfig = Field(VerdictConfig(), description="Verdict: when a calibration is refused.")
    sources: SourcesConfig = Field(
        default_factory=SourcesConfig,
        description="Sources: how far annotations and detections from files are trusted.",
    )
    learning: LearningConfig = Field(
        LearningConfig(),
        description="Learning: what frames of one run (`circlecal batch`, `track`) tell each other.",
    )
    rig: RigConfig = Field(RigConfig(), description="Rig: what many frames of one camera share (`circlecal rig`).")
    output: OutputConfig = Field(OutputConfig(), description="Output: what is written beside the result.")
    limits: LimitsConfig = Field(
        DEFAULT_LIMITS, description="Limits: how much of a file, a picture, time and memory a frame may take."
    )


def config_folder() -> Path:
    """Folder of the configurations that come with the package."""
    inside = Path(__file__).parent / "configs"
    return inside if inside.is_dir() else Path(__file__).parent.parent / "configs"


def config_names() -> list[str]:
    """Names of the configurations that come with the package."""
    folder = config_folder()
    networks = (f"networks/{path.stem}" for path in folder.glob("networks/*.yaml"))
    return [*sorted(path.stem for path in folder.glob("*.yaml")), *sorted(networks)]


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
    _change_files(content, lambda named: str(path.parent / named))
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


def _copy_sections(value: Any) -> Any:
    """The value with mappings of its own, since later keys are set in them and they may be the caller's."""
    return {key: _copy_sections(inner) for key, inner in value.items()} if isinstance(value, dict) else value


def _lay_over(lower: Mapping[str, Any], upper: Mapping[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """One content with everything that another sets over it, section by section; a whole value replaces another."""
    merged = dict(lower)
    for key, value in upper.items():
        nested, below = _find_nested_model(model, key), merged.get(key)
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


def find_template(config: Config, name: str) -> str:
    """How an option names the template that results call ``name``: the file where it is one among ``field.among``.

    Raises
    ------
    ConfigError
        A file cannot be read as a template.
    """
    among = config.field.among
    files = (entry for entry in among if name not in among and _is_own_template(entry))
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


def _is_own_template(named: str) -> bool:
    return named.endswith((".yaml", ".yml"))


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


def _find_config(name_or_file: str | Path) -> Path:
    path = Path(name_or_file)
    if path.suffix in (".yaml", ".yml") or is_file(path):
        return path
    shipped = config_folder() / f"{name_or_file}.yaml"
    if is_file(shipped):
        return shipped
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
    return {key: {} if value is None and _find_nested_model(Config, key) else value for key, value in content.items()}


def _parse_yaml(text: str, source: str) -> Any:
    try:
        return parse_yaml(text)
    except YamlError as error:
        where = f", line {error.line}" if error.line else ""
        raise ConfigError(f"{source}{where}: {error}") from error


def _kind(value: Any) -> str:
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "a mapping"
    return json.dumps(value, default=str)


TEMPLATE_KEYS = (("field", "template"), ("field", "among"))
MODEL_KEYS = (("mask", "model"), ("keypoints", "model"), ("keypoints", "lines_model"))
"""The keys that name files of the user: templates, where they are not built in, and networks."""


def absolute_files(config: Config) -> Config:
    """The configuration as a process with another working folder must have it: its templates and networks named by
    their whole paths.
    """
    content = config.model_dump(exclude_unset=True)
    _change_files(content, lambda named: str(Path(named).absolute()))
    return Config.model_validate(content)


def _change_files(content: dict[str, Any], change: Callable[[str], str]) -> None:
    """Write what ``change`` makes of its name for every file of the user that the content of a configuration names."""
    for name, key in (*TEMPLATE_KEYS, *MODEL_KEYS):
        section = content.get(name)
        if not isinstance(section, dict) or key not in section:
            continue
        is_file = _is_own_template if (name, key) in TEMPLATE_KEYS else bool
        named = section[key]
        many = list(named) if isinstance(named, list | tuple) else [named]
        many = [change(entry) if isinstance(entry, str) and is_file(entry) else entry for entry in many]
        section[key] = type(named)(many) if isinstance(named, list | tuple) else many[0]


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
        nested = _find_nested_model(model, part)
        if nested is None:
            return []
        model = nested
    return list(model.model_fields)


def _find_nested_model(model: type[BaseModel], name: str) -> type[BaseModel] | None:
    if name not in model.model_fields:
        return None
    annotation = model.model_fields[name].annotation
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None


def _all_keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name in model.model_fields:
        nested = _find_nested_model(model, name)
        if nested is None:
            yield f"{prefix}{name}"
        else:
            yield from _all_keys(nested, f"{prefix}{name}.")


def suit_pixels(config: Config, aspect: float | None) -> Config:
    """The configuration for pictures whose pixels are ``aspect`` times as wide as tall, as their file tells; the one
    given where no file tells it, or where it says itself what pixels are like.
    """
    if aspect is None or config.camera.aspect != 1.0:
        return config
    return config.model_copy(update={"camera": config.camera.model_copy(update={"aspect": aspect})})


def config_digest(config: Config) -> str:
    """Twelve hexadecimal digits over everything that can change an answer.

    That is every section but ``output``, ``rig`` and ``limits``, and the content of the user's own files: templates,
    networks.
    """
    content = config.model_dump(mode="json", exclude={"output", "rig", "limits"})
    _change_files(content, _file_digest)
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


_Schema = Mapping[str, Any]


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


_LIMITS = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}


def _describe_bounds(schema: _Schema) -> str:
    """Bounds and choices of one key in words."""
    if "anyOf" in schema:
        return " or ".join(filter(None, (_describe_bounds(branch) for branch in schema["anyOf"])))
    if "enum" in schema:
        return "one of " + ", ".join(_yaml_value(choice) for choice in schema["enum"])
    return ", ".join(f"{sign} {schema[key]}" for key, sign in _LIMITS.items() if key in schema)
