"""YAML that is safe to read: no code, no key twice, and no more values than a configuration can have; and where the
files are that come with the package.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from circlecal.files import is_file, read_text

MAX_BYTES = 1 << 20
"""The largest YAML file: the configuration with all its comments has 20 KB, a venue of several cameras some hundred."""
_DEEPEST = 60
"""Levels of nesting: a venue has six, and the parser in C overflows the stack at some ten thousand."""
_MOST_VALUES = 300_000
"""Values after aliases (``*name``) are replaced by what they stand for: nine lines of aliases of aliases make 10^9."""


def config_folder() -> Path:
    """Folder of the configurations that come with the package."""
    inside = Path(__file__).parent / "configs"
    return inside if inside.is_dir() else Path(__file__).parents[1] / "configs"


def config_names() -> list[str]:
    """Names of the configurations that come with the package."""
    folder = config_folder()
    networks = (f"networks/{path.stem}" for path in folder.glob("networks/*.yaml"))
    return [*sorted(path.stem for path in folder.glob("*.yaml")), *sorted(networks)]


def find_config(name_or_file: str | Path) -> Path | None:
    """A configuration's file: the one that is there, or the one of that name that comes with the package; None where
    neither is.
    """
    path, shipped = Path(name_or_file), config_folder() / f"{name_or_file}.yaml"
    return path if is_file(path) else shipped if is_file(shipped) else None


class YamlError(ValueError):
    """A text is not YAML that is read; its text is one line without the file.

    Parameters
    ----------
    reason : str
        What is wrong.
    line : int or None
        Where, counted from 1.
    """

    def __init__(self, reason: str, line: int | None = None) -> None:
        super().__init__(" ".join(reason.split()))
        self.line = line


_NUMBERS = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"


def _without_colons(pattern: re.Pattern[str]) -> re.Pattern[str]:
    """What a pattern takes, but for texts with a colon."""
    return re.compile(f"(?![^:]*:)(?:{pattern.pattern})", pattern.flags)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Safe YAML in which a key given twice is an error, 1e-3 is a number, and 1:30 a text, not 90 as in YAML 1.1."""

    def get_single_node(self) -> yaml.Node | None:
        node = super().get_single_node()
        if node is not None and _count(node, {}, set()) > _MOST_VALUES:
            raise yaml.constructor.ConstructorError(
                None, None, f"its aliases stand for more than {_MOST_VALUES} values", node.start_mark
            )
        return node


def _count(node: yaml.Node, known: dict[int, int], within: set[int]) -> int:
    """Values of a node with its aliases replaced; each node is looked at once."""
    if isinstance(node, yaml.ScalarNode):
        return 1
    if id(node) in within:
        raise yaml.constructor.ConstructorError(None, None, "a value that holds itself", node.start_mark)
    if id(node) not in known:
        within.add(id(node))
        pairs = isinstance(node, yaml.MappingNode)
        children = [child for pair in node.value for child in pair] if pairs else node.value
        known[id(node)] = 1 + sum(_count(child, known, within) for child in children)
        within.remove(id(node))
    return known[id(node)]


def _mapping_without_doubles(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    seen: set[Any] = set()
    for key_node, _ in node.value:
        key = loader.construct_object(key_node, deep=True)
        if not isinstance(key, str | int | float):
            raise yaml.constructor.ConstructorError(None, None, "a key must be a name", key_node.start_mark)
        if key in seen:
            raise yaml.constructor.ConstructorError(None, None, f"key {key!r} is given twice", key_node.start_mark)
        seen.add(key)
    return loader.construct_mapping(node, deep=True)


_FLOAT = (
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)
"""What is a number beside those of YAML 1.1: 1e-3, without a point."""
_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping_without_doubles)
_Loader.yaml_implicit_resolvers = {
    first: [(tag, _without_colons(pattern) if tag in _NUMBERS else pattern) for tag, pattern in known]
    for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(*_FLOAT)


class _Dumper(yaml.SafeDumper):
    """Quotes text that the loader would read as a number, such as the digest 12e345678901."""


_Dumper.add_implicit_resolver(*_FLOAT)


def dump_yaml(content: Any) -> str:
    """YAML of a mapping, which :func:`parse_yaml` reads back equal; keys stay in their order."""
    text: str = yaml.dump(content, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=120)
    return text


def _require_shallow(text: str) -> None:
    """Go through a text without building anything of it, which needs no stack however deep it is.

    Raises
    ------
    yaml.YAMLError
        No YAML, or nested more deeply than any file of ours.
    """
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > _DEEPEST:
                raise yaml.composer.ComposerError(None, None, "nested too deeply", None)
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1


def _is_indented_by_tab(text: str, number: int) -> bool:
    lines = text.splitlines()[number : number + 1]
    return any("\t" in line[: len(line) - len(line.lstrip())] for line in lines)


def parse_yaml(text: str) -> Any:
    """The value of a YAML text.

    Raises
    ------
    YamlError
        No YAML, a key twice, a value that holds itself, or more values than a configuration can have.
    """
    try:
        _require_shallow(text)
        return yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        reason = error.problem or error.context or "is not YAML"
        if mark and _is_indented_by_tab(text, mark.line):
            reason = "a tab begins the line; indent with blanks"
        elif error.context_mark and (error.context or "").startswith("while parsing a flow"):
            reason += f"; a bracket opened on line {error.context_mark.line + 1} is not closed"
        raise YamlError(reason, mark.line + 1 if mark else None) from error
    except RecursionError as error:
        raise YamlError("is not YAML that is read: nested too deeply") from error
    except (yaml.YAMLError, ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError) as error:
        raise YamlError(f"is not YAML: {error}") from error


def read_yaml(path: Path) -> Any:
    """The value of a YAML file.

    Raises
    ------
    InputError
        The file cannot be read, is too large or no UTF-8.
    YamlError
        As :func:`parse_yaml`.
    """
    return parse_yaml(read_text(path, MAX_BYTES))
