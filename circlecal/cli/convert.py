"""``circlecal convert``."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from circlecal.cli import options


def convert(
    inputs: Annotated[
        list[Path],
        typer.Argument(metavar="INPUT", help="Annotation or camera files, results, results.jsonl, and folders."),
    ],
    to: Annotated[
        str,
        typer.Option("--to", metavar="FORMAT", help=f"Format to write, of the same kind: {options.CONVERSIONS}."),
    ],
    out: options.Out = Path("circlecal-out"),
    from_format: options.FromFormat = None,
    size: options.Size = None,
    field: options.FieldName = None,
    settings: options.Settings = None,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Rewrite annotations as annotations and cameras as cameras of another program, without calibrating."""
    from circlecal.cli import console
    from circlecal.formats.exports import convert as convert_files
    from circlecal.formats.inputs import find_convertible
    from circlecal.pipeline import field_of
    from circlecal.records.log import read_records
    from circlecal.records.parquet import PARQUET_FORMAT, PARQUET_NAME, write_parquet

    console.configure_logging(quiet=quiet, verbose=verbose)
    if to == PARQUET_FORMAT:
        written = write_parquet(chain.from_iterable(map(read_records, inputs)), out / PARQUET_NAME)
        if not quiet:
            console.print_line(str(written))
        return
    template, _ = field_of(options.choose_config(None, settings, field))
    files = find_convertible(inputs, from_format, out)
    for path in convert_files(files, from_format, to, out, template, options.parse_size(size)):
        if not quiet:
            console.print_line(str(path))
