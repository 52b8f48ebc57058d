"""What the benchmarks share: their lists of names, their tables, their JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from math import isfinite, isnan
from typing import Annotated, TypeVar

import typer

from circlecal.errors import ConfigError

Row = TypeVar("Row")
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of all that is drawn by chance.")]


def split_names(text: str, option: str = "", known: Collection[str] | None = None) -> list[str]:
    """Names of a list that is separated by commas.

    Raises
    ------
    ConfigError
        A name that is not among the known ones; the option is named.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [] if known is None else [name for name in names if name not in known]
    if known is not None and unknown:
        raise ConfigError(f"{option}: {', '.join(unknown)} is unknown; known: {', '.join(known)}")
    return names


def print_rows(title: str, rows: Sequence[Row], columns: Mapping[str, Callable[[Row], str]]) -> None:
    """Print a table: for each column its heading and what stands there in a row."""
    from circlecal.cli.console import print_table

    print_table(title, list(columns), [[cell(row) for cell in columns.values()] for row in rows])


def print_record(record: object) -> None:
    """Print JSON, with null for numbers that are not finite."""
    typer.echo(json.dumps(_replace_nonfinite(record), indent=1, allow_nan=False))


def format_figure(value: float | None, form: str) -> str:
    """A figure, or a dash where there is none."""
    return "-" if value is None or isnan(value) else format(value, form)


def _replace_nonfinite(value: object) -> object:
    if isinstance(value, float) and not isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _replace_nonfinite(item) for key, item in value.items()}
    return [_replace_nonfinite(item) for item in value] if isinstance(value, list | tuple) else value
