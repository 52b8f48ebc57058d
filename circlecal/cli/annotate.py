"""``circlecal annotate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import typer

from circlecal.cli import options


def annotate(
    inputs: Annotated[
        list[str],
        typer.Argument(metavar="INPUT", help="A folder of circlecal batch, pictures, folders of them, videos."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="Folder of the annotations. (default: RUN/annotations, else circlecal-annotations)"
        ),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0 takes a free one.")] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
    frame: Annotated[
        str | None, typer.Option("--frame", metavar="ID", help="Frame to begin with. (default: the first to do)")
    ] = None,
    part: Annotated[
        str | None,
        typer.Option("--part", metavar="K/N", help="Only the K-th of N equal parts, for one of several people."),
    ] = None,
    every: Annotated[
        str | None,
        typer.Option("--every", metavar="TIME|N", help="Of videos: a frame a TIME, or each N-th. (default: 1s)"),
    ] = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    camera_prior: options.CameraPrior = None,
    venue: options.VenueFile = None,
    field: options.FieldName = None,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Look at frames, name their markings and see them calibrated, in the browser; everything stays on this machine."""
    from circlecal.cli import console
    from circlecal.errors import InputError, MissingExtraError
    from circlecal.pictures.video import DEFAULT_EVERY, Sampling

    console.configure_logging(quiet=quiet, verbose=verbose)
    try:
        from circlecal.workbench.server import serve
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "starlette", "annotate") from error
    from circlecal.formats.annotation import ANNOTATION_FOLDER
    from circlecal.report.pages import tell_workbench
    from circlecal.workbench.frames import is_run, list_frames, take_part
    from circlecal.workbench.session import Session
    from circlecal.workbench.store import AnnotationStore

    chosen = options.choose_config(config, settings, field, camera_prior=camera_prior, venue=venue)
    frames = take_part(list_frames(inputs, Sampling.parse(every or DEFAULT_EVERY)), part)
    runs = [path for path in map(Path, inputs) if is_run(path)]
    folder = out or (runs[0] / ANNOTATION_FOLDER if runs else Path("circlecal-annotations"))
    session = Session(frames, AnnotationStore(folder), chosen)

    if frame is not None and all(frame != listed.file.id for listed in frames):
        raise InputError(f"--frame {frame}: no such frame among the {len(frames)} that were given")

    def tell(address: str) -> None:
        for run in runs:
            tell_workbench(run, address)
        address += "" if frame is None else f"#{quote(frame)}"
        console.print_line(address)
        if not quiet:
            console.print_note(
                f"{len(frames)} {'frame' if len(frames) == 1 else 'frames'}; annotations go to {folder}; Ctrl-C ends"
            )
        if not no_browser:
            typer.launch(address)

    try:
        serve(session, port, tell)
    finally:
        for run in runs:
            tell_workbench(run, None)
