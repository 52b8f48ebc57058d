"""``circlecal convert``."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from circlecal.cli import options


def convert(
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[INPUT]", help="Annotation or camera files, results, results.jsonl, and folders."),
    ] = None,
    to: Annotated[
        str | None,
        typer.Option("--to", metavar="FORMAT", help=f"Format to write, of the same kind: {options.CONVERSIONS}."),
    ] = None,
    labels: Annotated[
        str | None,
        typer.Option("--labels", metavar="PROGRAM", help="Write a label set: cvat, labelstudio or labelme."),
    ] = None,
    out: options.Out = Path("circlecal-out"),
    from_format: options.FromFormat = None,
    size: options.Size = None,
    field: options.OneFieldName = None,
    settings: options.Settings = None,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Rewrite annotations as annotations and cameras as cameras of another program, without calibrating."""
    from circlecal.cli import console
    from circlecal.errors import InputError
    from circlecal.formats.exports import conversion_formats
    from circlecal.formats.exports import convert as convert_files
    from circlecal.formats.inputs import find_convertible
    from circlecal.formats.registry import require_format
    from circlecal.pipeline import field_of
    from circlecal.records.log import read_records
    from circlecal.records.parquet import PARQUET_FORMAT, PARQUET_NAME, write_parquet

    console.configure_logging(quiet=quiet, verbose=verbose)
    if bool(inputs) != (to is not None) or not (inputs or labels):
        raise InputError("convert takes files and --to FORMAT, or --labels PROGRAM; see circlecal convert --help")
    if labels is not None:
        _write_label_set(labels, out, settings, field, quiet=quiet)
    if not inputs or to is None:
        return
    require_format(to, {**conversion_formats(), PARQUET_FORMAT: None}, "--to", "format that can be written")
    if to == PARQUET_FORMAT:
        records = chain.from_iterable(map(read_records, inputs))
        first = next(records, None)
        if first is None:
            raise InputError(
                f"{inputs[0]}: holds no frame; give the folder that circlecal batch, track or calibrate wrote"
            )
        written = write_parquet(chain([first], records), out / PARQUET_NAME)
        if not quiet:
            console.print_line(str(written))
        return
    chosen = options.choose_config(None, settings, field)
    template, _ = field_of(chosen)
    files = find_convertible(inputs, from_format, out)
    failures: list[InputError] = []
    written_files = convert_files(
        files,
        source=from_format,
        target=to,
        folder=out,
        template=template,
        size=options.parse_size(size),
        field=chosen.field.template,
        failures=failures,
    )
    for path in written_files:
        if not quiet:
            console.print_line(str(path))
    if failures:
        others = "" if len(failures) == 1 else f" ({len(failures)} files like this; the first is named)"
        raise InputError(f"{failures[0]}{others}; the other files are converted")


def _write_label_set(program: str, out: Path, settings: list[str] | None, field: str | None, *, quiet: bool) -> None:
    """The label set of a field for an annotation program."""
    from circlecal.cli import console
    from circlecal.files import write_atomic
    from circlecal.formats.labels import LABEL_SETS, write_labels
    from circlecal.formats.registry import require_format
    from circlecal.pipeline import field_of

    require_format(program, LABEL_SETS, "--labels", "program whose labels are known")
    name, content = write_labels(program, field_of(options.choose_config(None, settings, field))[0])
    write_atomic(out / name, content)
    if not quiet:
        console.print_line(str(out / name))
