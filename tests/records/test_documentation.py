"""Every key of a result file and every column of a table stands on the page of formats."""

import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from circlecal.records.cameras_table import COLUMNS
from circlecal.records.parquet import table_row
from circlecal.records.record import SCHEMA_VERSION, ResultRecord
from circlecal.records.summary import FrameSummary

PAGE = Path(__file__).parents[2] / "circlecal" / "formats" / "README.md"


def named_in(heading: str) -> set[str]:
    """Words in backticks of one section, the rows of its tables among them."""
    text = re.split(r"^## ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    section = next(part for part in text if part.startswith(f"{heading}\n"))
    return {word for quoted in re.findall(r"`([^`]+)`", section) for word in re.split(r"[.\s]+", quoted)}


def keys_of(annotation: Any) -> Iterator[str]:
    """Keys of a model and of all models in it."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        for name, field in annotation.model_fields.items():
            yield name
            yield from keys_of(field.annotation)
    for inner in get_args(annotation):
        yield from keys_of(inner)


def test_every_key_of_a_result_file_is_described():
    keys = set(keys_of(ResultRecord))
    assert {"semi_axes_px", "crossed", "field_line", "hypotheses", "shift", "log_focal_sigma"} <= keys
    assert not keys - named_in("Result file")


@pytest.mark.parametrize(
    ("file", "columns"),
    [
        ("results.parquet", table_row(ResultRecord(schema_version=SCHEMA_VERSION, id="x", status="refused"))),
        ("cameras.csv", COLUMNS),
        ("summary.csv", [column.name for column in fields(FrameSummary)]),
    ],
)
def test_every_column_of_a_table_is_described(file, columns):
    assert not set(columns) - named_in(f"`{file}`")
