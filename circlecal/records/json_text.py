"""A result record as JSON text and as a file, and what is wrong with one."""

from __future__ import annotations

import json
from codecs import BOM_UTF8
from collections import Counter
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticSerializationError

from circlecal.errors import InputError, OutputError, explain_problem
from circlecal.files import exists, is_folder, read_file, write_atomic
from circlecal.records.record import SCHEMA_VERSION, ResultRecord, ResultRow

GIVE_A_RESULT = "give a result file of circlecal calibrate"
Record = TypeVar("Record", bound=ResultRow)
Model = TypeVar("Model", bound=BaseModel)


class RepeatedKeyError(ValueError):
    """A JSON object has two values of one name, of which a reader would take the last in silence."""

    def __init__(self, name: str) -> None:
        super().__init__(f"the key {json.dumps(name)} is given twice; keep one of the two")


def load_json(content: bytes) -> Any:
    """The value of a JSON text that a person may have written or changed.

    Raises
    ------
    RepeatedKeyError
        With the key.
    ValueError
        It is no JSON.
    """
    return json.loads(content, object_pairs_hook=_keep_each_key_once)


def _keep_each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        ((name, _),) = Counter(name for name, _ in pairs).most_common(1)
        raise RepeatedKeyError(name)
    return content


def write_result(path: Path, record: ResultRecord) -> None:
    """Write a result file, whole or not at all; nothing but an earlier result is replaced.

    Raises
    ------
    OutputError
        The file cannot be written, or it exists and is no result of circlecal.
    """
    if exists(path) and not is_folder(path) and not _is_result_file(path):
        raise OutputError(f"{path}: exists and is no result of circlecal; choose another name or folder for the result")
    write_atomic(path, (result_line(record) + "\n").encode())


def _is_result_file(path: Path) -> bool:
    """Whether a file holds one result, sound or not."""
    try:
        return is_record(read_file(path)) is True
    except InputError:
        return False


def result_line(record: ResultRecord) -> str:
    """The record on one line, with the keys that were given."""
    return model_text(record, exclude_unset=True)


def read_result(path: Path) -> ResultRecord:
    """Read a result file.

    Raises
    ------
    InputError
        Missing, no result of circlecal, of another version, damaged, or with a key that is given twice.
    """
    try:
        content = read_file(path)
    except InputError as error:
        raise InputError(f"{error}; {GIVE_A_RESULT}") from error
    return parse_record(content, ResultRecord, str(path), GIVE_A_RESULT)


def parse_record(content: bytes, model: type[Record], name: str, mend: str) -> Record:
    """A record from its JSON text.

    Parameters
    ----------
    content : bytes
        The text.
    model : type
        :class:`ResultRecord`, or :class:`ResultRow` for no more than tables need.
    name, mend : str
        Where the text stands, and what to do about damage, for messages.

    Raises
    ------
    InputError
        No result of circlecal, of another version, or damaged; a whole record also where a key is given twice, which
        takes longer to find than all that a row needs.
    """
    if issubclass(model, ResultRecord):
        require_single_keys(content, name)
    try:
        record = validate_json(model, content, strict=False)
    except ValidationError as error:
        version = _version_of(content)
        if version in (None, SCHEMA_VERSION):
            raise InputError(f"{name}: is no result: {explain_damage(error)}; {mend}") from error
    else:
        version = record.schema_version
        if version == SCHEMA_VERSION:
            return record
    raise InputError(f"{name}: has schema_version {version}; this version reads {SCHEMA_VERSION}")


def require_single_keys(content: bytes, name: str) -> None:
    """See that no key is given twice, of which all readers would take the last in silence.

    Raises
    ------
    InputError
        With the key, after ``name``.
    """
    try:
        load_json(content)
    except RepeatedKeyError as error:
        raise InputError(f"{name}: {error}") from error
    except (ValueError, RecursionError):
        pass  # what is wrong with it is told by those who read it


def validate_json(model: type[Model], content: bytes | str, strict: bool | None = None) -> Model:
    """A model from its JSON text, in which names may stand that no encoding can write
    (:data:`circlecal.records.parts.Text`); a byte order mark before it is passed over.

    Raises
    ------
    ValidationError
        It is no such model.
    """
    content = content.removeprefix(BOM_UTF8) if isinstance(content, bytes) else content
    try:
        return model.model_validate_json(content)
    except ValidationError:
        text = content if isinstance(content, bytes) else content.encode(errors="surrogatepass")
        if b"\\ud" not in text:
            raise
    try:
        value = json.loads(content)  # which takes such a name, as the model's parser does not
    except (ValueError, RecursionError):
        return model.model_validate_json(content)
    return model.model_validate(value, strict=strict)


def model_text(model: BaseModel, *, exclude_unset: bool = False) -> str:
    """A model as JSON on one line; what no encoding can write becomes escapes, which :func:`validate_json` reads."""
    try:
        return model.model_dump_json(exclude_unset=exclude_unset)
    except PydanticSerializationError:
        return json.dumps(model.model_dump(exclude_unset=exclude_unset), allow_nan=False, separators=(",", ":"))


def parse_sound_parts(content: bytes) -> ResultRecord:
    """A record from its JSON text without those of its keys whose content is damaged.

    Raises
    ------
    ValueError
        Not even what every record has is sound.
    """
    try:
        return validate_json(ResultRecord, content, strict=False)
    except ValidationError as error:
        damaged = {problem["loc"][0] for problem in error.errors(include_url=False) if problem["loc"]}
        value = json.loads(content)
        return ResultRecord.model_validate({k: v for k, v in value.items() if k not in damaged}, strict=False)


def is_record(content: bytes) -> bool | None:
    """Whether a JSON text is meant to be a record, sound or not; None where it is no JSON. Lines of JSON, as other
    programs write them, are none.
    """
    try:
        return _is_record(json.loads(content))
    except (ValueError, RecursionError):
        first, _, rest = content.partition(b"\n")
    try:
        return False if rest.strip() and not _is_record(json.loads(first)) else None
    except (ValueError, RecursionError):
        return None


def _is_record(value: object) -> bool:
    return isinstance(value, dict) and value.keys() >= {"schema_version", "status"}


def _version_of(content: bytes) -> Any:
    try:
        value = json.loads(content)
    except (ValueError, RecursionError):
        return None
    return value.get("schema_version") if isinstance(value, dict) else None


def explain_damage(error: ValidationError) -> str:
    """The first thing that is wrong with a record, as field and words."""
    first = error.errors(include_url=False, include_context=False)[0]
    where = ".".join(str(part) for part in first["loc"])
    joint = " " if first["type"] == "missing" else ": "
    return f"{where}{joint * bool(where)}{explain_problem(first['type'], first['msg'])}"


def to_mapping(record: ResultRecord) -> dict[str, Any]:
    """The record as JSON's own types."""
    content: dict[str, Any] = json.loads(result_line(record))
    return content
