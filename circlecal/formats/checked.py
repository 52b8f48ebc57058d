"""Files of other programs, checked: whatever is wrong with one is one line that names the file and the field."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from circlecal.errors import InputError

MAX_BYTES = 256 * 1024 * 1024
MAX_POINTS = 10_000
"""More points in one shape than anybody clicks or detects; the limit keeps a broken file from filling the memory."""
MAX_SHAPES = 2_000
"""The same for the shapes of one frame."""
MAX_SIDE = 65_535
_NOT_IN_NAMES = frozenset('<>:"|?*')
_LONGEST_NAME = 150

Model = TypeVar("Model", bound=BaseModel)
Size = tuple[int, int]
Bounded = Annotated[float, Field(ge=-1e6, le=1e6)]
"""An angle in degrees, a position in metres, a pixel, a coefficient: more is damage."""
Focal = Annotated[float, Field(gt=0, le=1e7)]
Side = Annotated[int, Field(gt=1, le=MAX_SIDE)]


class Checked(BaseModel):
    """Base of the models that describe outside files: further keys are ignored, text is never a number."""

    model_config = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False, frozen=True)


def read_content(path: Path) -> bytes:
    """Content of a file.

    Raises
    ------
    InputError
        Missing, unreadable, empty, or far larger than any annotation.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: is larger than {MAX_BYTES >> 20} MB; split it")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    if not content.strip():
        raise InputError(f"{path}: is empty; export it again")
    return content


def checked(model: type[Model], path: Path, content: bytes | str, line: int | None = None) -> Model:
    """The content of a JSON file, or of one line of it, as a model.

    Raises
    ------
    InputError
        One line with the file, the line, the field and what is wrong with it.
    """
    try:
        return model.model_validate_json(content)
    except ValidationError as error:
        raise _first_problem(error, path, line) from error


def checked_value(model: type[Model], path: Path, value: Any, prefix: str = "") -> Model:
    """The same for a part that is parsed already; ``prefix`` names where it stands."""
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise _first_problem(error, path, None, prefix) from error


def _first_problem(error: ValidationError, path: Path, line: int | None, prefix: str = "") -> InputError:
    first = error.errors(include_url=False, include_context=False)[0]
    field = ".".join(str(part) for part in (prefix, *first["loc"]) if part not in ("", "root"))
    where = "".join(
        f"{separator}{part}" for separator, part in ((", line ", line), (": ", field)) if part not in (None, "")
    )
    message = first["msg"].removeprefix("Value error, ")
    given = first["input"]
    shown = f", not {json.dumps(given)[:60]}" if isinstance(given, str | int | float) and first["loc"] else ""
    return InputError(f"{path}{where}: {message}{shown}")


def parsed_json(path: Path, content: bytes) -> Any:
    """Any JSON value, for telling what a file is.

    Raises
    ------
    InputError
        Not JSON, or nested too deeply.
    """
    try:
        return json.loads(content)
    except RecursionError as error:
        raise InputError(f"{path}: is nested too deeply to be an annotation") from error
    except ValueError as error:
        raise InputError(f"{path}: is not JSON: {' '.join(str(error).split())}") from error


def require_size(path: Path, size: Size | None, found: Size | None = None) -> Size:
    """Size of the picture: the user's, else the one that was found.

    Raises
    ------
    InputError
        Neither is known.
    """
    chosen = size or found
    if chosen is None:
        raise InputError(f"{path}: does not say how large the picture is; give --size WIDTHxHEIGHT")
    return chosen


def stem_of(name: str) -> str:
    """Name of a picture without folders and suffix, whichever system wrote it, fit to be that of a file."""
    base = name.replace("\\", "/").rstrip("/").rpartition("/")[2]
    stem, dot, _ = base.rpartition(".")
    chosen = stem if dot and stem else base
    return "".join(c if c.isprintable() and c not in _NOT_IN_NAMES else "_" for c in chosen)[:_LONGEST_NAME].strip(". ")
