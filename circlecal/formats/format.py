"""What an outside format is: how its files are recognised, read and written.

Each format has one file in this folder, which ends with ``FORMAT``, and one word in
:data:`circlecal.formats.registry.MODULES`. Whatever is wrong with a file is one line that names the file and the field.
"""

from __future__ import annotations

import json
from codecs import BOM_UTF8
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from circlecal.errors import InputError, explain_problem
from circlecal.field import FieldTemplate
from circlecal.files import read_file
from circlecal.formats.cameras import CalibratedFrame, CameraFrame, CameraModel, Size
from circlecal.formats.picture_paths import path_parts, picture_path
from circlecal.formats.shapes import AnnotatedFrame
from circlecal.pictures.files import distinct_names
from circlecal.records.json_text import RepeatedKeyError, load_json, validate_json

Kind = Literal["annotation", "camera", "result"]
MAX_BYTES = 64 << 20
"""Of a file; its values take some ten times the memory, and annotations of 100,000 frames have less."""
MAX_POINTS = 10_000
"""More points in one shape than anybody clicks or detects; the limit keeps a broken file from filling the memory."""
MAX_SHAPES = 2_000
"""More shapes in one frame than anybody draws, for the same reason."""
MAX_SIDE = 65_535
OWN_KEY = "circlecal"
"""Under which a file of another program says what only circlecal reads."""
_PAINT = "paint"
_NOT_IN_NAMES = frozenset('<>:"|?*')
_LONGEST_NAME = 150

Model = TypeVar("Model", bound=BaseModel)
Bounded = Annotated[float, Field(ge=-1e6, le=1e6)]
"""An angle in degrees, a position in metres, a pixel, a coefficient: more is damage."""
Focal = Annotated[float, Field(gt=0, le=1e7)]
Side = Annotated[int, Field(gt=1, le=MAX_SIDE)]


class FileModel(BaseModel):
    """Base of the models that describe outside files: further keys are ignored, text is never a number."""

    model_config = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False, frozen=True)


@dataclass(frozen=True)
class Content:
    """Path and bytes of a file, and what they look like before its format is known."""

    path: Path
    raw: bytes

    @classmethod
    def of(cls, path: Path) -> Content:
        """Read a file.

        Raises
        ------
        InputError
            Missing, unreadable, empty, or far larger than any annotation.
        """
        raw = read_file(path, MAX_BYTES, "split it")
        if not raw.strip():
            raise InputError(f"{path}: is empty; export it again")
        return cls(path, raw)

    @cached_property
    def head(self) -> bytes:
        """The first byte that is neither a blank nor a byte order mark."""
        return self.raw.lstrip(BOM_UTF8 + b" \t\r\n")[:1]

    @cached_property
    def json(self) -> Any:
        """The JSON value, or the error of one that is broken; None where the content does not start as one."""
        if self.head not in (b"{", b"["):
            return None
        try:
            return load_json(self.raw)
        except RepeatedKeyError as error:
            return InputError(f"{self.path}: {error}")
        except RecursionError:
            return InputError(f"{self.path}: is nested too deeply to be an annotation")
        except ValueError as error:
            return InputError(f"{self.path}: is not JSON: {' '.join(str(error).split())}")

    @property
    def mapping(self) -> Mapping[str, Any]:
        """The JSON object; an empty one where the content is something else."""
        return self.json if isinstance(self.json, dict) else {}


@dataclass(frozen=True, kw_only=True)
class Format:
    """What every format has.

    Attributes
    ----------
    name : str
        As the user names it; an annotation and a camera of one program share it.
    recognises : callable
        Whether a file is of the format, by its content.
    """

    name: str
    recognises: Callable[[Content], bool]
    kind: ClassVar[Kind] = "result"


@dataclass(frozen=True, kw_only=True)
class OutsideFormat(Format):
    """What the formats of other programs have.

    Attributes
    ----------
    file_name : str
        Name of a written file; with ``{id}`` there is one per frame, else one file holds all frames.
    """

    file_name: str

    @property
    def per_frame(self) -> bool:
        """Whether each frame is a file of its own."""
        return "{id}" in self.file_name


@dataclass(frozen=True, kw_only=True)
class AnnotationFormat(OutsideFormat):
    """Labelled shapes in pictures.

    Attributes
    ----------
    read : callable
        Frames of a file (path, content, size of the picture where the file has none).
    write : callable or None
        Content of a file; None where the format is only read.
    derive : callable or None
        A calibrated frame as the format's shapes, given the content that was read where the reader keeps it; None where
        no calibration is written so.
    sigma_px : float
        Standard deviation of a point, pixels at 1920 px width, where the configuration has no other.
    marks_line_ends : bool
        Whether people mark where straight lines end.
    holds_confidence : bool
        Whether points are as sure as a network said.
    draws_measured : bool
        Whether a refused frame is written with what was measured in it, for people to go on from.
    writes_observations : bool
        Whether a file holds what a frame was understood to show: ``write`` takes frames with their observations
        (:func:`circlecal.formats.meaning.understand`), not their shapes.
    requires : callable or None
        Raises InputError of a field that the format has no names for; None where it takes every field.
    holds_convention : bool
        Whether a file can say that its points lie on the middle of the paint.
    """

    read: Callable[[Path, bytes, Size | None], list[AnnotatedFrame]]
    write: Callable[[Sequence[AnnotatedFrame]], bytes] | None = None
    derive: Callable[[CalibratedFrame, Mapping[str, Any] | None], AnnotatedFrame] | None = None
    sigma_px: float = 1.5
    marks_line_ends: bool = False
    holds_confidence: bool = False
    draws_measured: bool = False
    writes_observations: bool = False
    requires: Callable[[FieldTemplate], object] | None = None
    holds_convention: bool = True
    kind: ClassVar[Kind] = "annotation"


@dataclass(frozen=True, kw_only=True)
class CameraFormat(OutsideFormat):
    """Cameras, or homographies alone.

    Attributes
    ----------
    read : callable
        Frames of a file (path, content, size of the pictures where the file has none).
    write : callable
        Content of a file.
    holds : {"camera", "centred camera", "homography"}
        The most that the format can say.
    lists_refused : bool
        Whether a file of several frames names those without a camera too.
    requires : callable or None
        Raises an InputError for a field on which the format's numbers mean nothing; None where it takes all.
    """

    read: Callable[[Path, bytes, Size | None], list[CameraFrame]]
    write: Callable[[Sequence[CameraFrame]], bytes]
    holds: CameraModel = "camera"
    lists_refused: bool = False
    requires: Callable[[FieldTemplate], object] | None = None
    kind: ClassVar[Kind] = "camera"


def parse_content(model: type[Model], path: Path, content: bytes | str, line: int | None = None) -> Model:
    """The content of a JSON file, or of one line of it, as a model; a byte order mark before it is passed over.

    Raises
    ------
    InputError
        One line with the file, the line, the field and what is wrong with it.
    """
    try:
        return validate_json(model, content)
    except ValidationError as error:
        raise _first_problem(error, path, line) from error


def parse_value(model: type[Model], path: Path, value: Any, prefix: str = "") -> Model:
    """A part of a JSON file that is parsed already as a model; ``prefix`` names where it stands.

    Raises
    ------
    InputError
        One line with the file, the field and what is wrong with it.
    """
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
    message = explain_problem(first["type"], first["msg"])
    given = first["input"]
    is_told = isinstance(given, str | int | float) and first["loc"] and first["type"] != "extra_forbidden"
    shown = f", not {json.dumps(given)[:60]}" if is_told else ""
    return InputError(f"{path}{where}: {message}{shown}")


def tell_convention(frame: AnnotatedFrame) -> dict[str, dict[str, str]]:
    """What the record of a frame says, under a key of circlecal's own, where points lie on the middle of the paint."""
    return {OWN_KEY: {"convention": _PAINT}} if frame.on_paint else {}


def says_paint(told: object) -> bool:
    """Whether what a file has under circlecal's key says that points lie on the middle of the paint."""
    return isinstance(told, Mapping) and told.get("convention") == _PAINT


def require_size(path: Path, *known: Size | tuple[int | None, int | None] | None) -> Size:
    """The first size of the picture that is known.

    Raises
    ------
    InputError
        None is.
    """
    for size in known:
        if size is not None and size[0] and size[1]:
            return size[0], size[1]
    raise InputError(f"{path}: does not say how large the picture is; give --size WIDTHxHEIGHT")


def require_distinct(path: Path, field: str, keys: Sequence[object]) -> None:
    """See that no two entries of a list have one key; ``field`` names both, with ``{}`` for the place in the list.

    Raises
    ------
    InputError
        Two have.
    """
    seen: set[object] = set()
    for number, key in enumerate(keys):
        if key in seen:
            raise InputError(f"{path}: {field.format(number)}: {key} is given twice; give each its own")
        seen.add(key)


def stem_of(name: str) -> str:
    """Name of a picture without folders and suffix, whichever system wrote it, fit to be that of a file."""
    base = picture_path(name).rstrip("/").rpartition("/")[2]
    stem, dot, _ = base.rpartition(".")
    chosen = stem if dot and stem else base
    return "".join(c if c.isprintable() and c not in _NOT_IN_NAMES else "_" for c in chosen)[:_LONGEST_NAME].strip(". ")


def ids_of_pictures(names: Iterable[str]) -> list[str]:
    """Ids of the frames of a file, by the names of their pictures: different ones.

    Pictures of one name in several folders are told apart by these, as ``cam1__a`` and ``cam2__a``; what no folder
    tells apart is numbered.
    """
    paths = list(names)
    ids = [stem_of(name) for name in paths]
    folders = [path_parts(picture_path(name))[:-1] for name in paths]
    alike: dict[str, list[int]] = defaultdict(list)
    for k, own in enumerate(ids):
        alike[own.casefold()].append(k)
    for group in (group for group in alike.values() if len(group) > 1):
        depths = range(1, 1 + max(len(folders[k]) for k in group))
        depth = next((d for d in depths if len({folders[k][-d:] for k in group}) == len(group)), 0)
        for k in group if depth else ():
            ids[k] = "__".join((*folders[k][-depth:], ids[k]))
    return distinct_names(ids)


def json_bytes(record: Mapping[str, Any] | list[Any]) -> bytes:
    """JSON text of a file; numbers keep all their digits, and bytes of names that are no text become escapes."""
    return (json.dumps(record, allow_nan=False, ensure_ascii=False) + "\n").encode("utf-8", "backslashreplace")
