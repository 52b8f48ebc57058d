"""``circlecal annotate``."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from urllib.parse import quote

import typer

from circlecal.cli import options
from circlecal.cli.plain_flags import INPUT, OUTPUT, RUNNING

if TYPE_CHECKING:
    from circlecal.config import Config
    from circlecal.workbench.frames import ArchivedAnnotations, RunFacts
    from circlecal.workbench.session import Session


def annotate(
    inputs: Annotated[
        list[str],
        typer.Argument(metavar="INPUT", help="A folder of circlecal batch, pictures, folders or ZIPs of them, videos."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Folder of the annotations. (default: RUN/annotations, else circlecal-annotations)",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    port: Annotated[
        int,
        typer.Option(min=0, max=65535, help="Port of the page; 0 takes a free one.", rich_help_panel=RUNNING),
    ] = 0,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Only print the address.", rich_help_panel=RUNNING)
    ] = False,
    frame: Annotated[
        str | None,
        typer.Option(
            "--frame",
            metavar="ID",
            help="Frame to begin with. (default: the first to do)",
            rich_help_panel=INPUT,
        ),
    ] = None,
    part: Annotated[
        str | None,
        typer.Option(
            "--part",
            metavar="K/N",
            help="Only the K-th of N parts, for one of several people.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    every: options.Every = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    camera_prior: options.CameraPrior = None,
    venue: options.VenueFile = None,
    field: options.OneFieldName = None,
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
    from circlecal.files import prepare_folder
    from circlecal.formats.annotation import ANNOTATION_FOLDER
    from circlecal.report.pages import tell_workbench
    from circlecal.workbench.frames import UNPACKED_FOLDER, find_venue, is_run, list_frames, take_part, unpack_inputs
    from circlecal.workbench.session import Session
    from circlecal.workbench.store import AnnotationStore

    runs = [path for path in map(Path, inputs) if is_run(path)]
    if len(runs) > 1 and out is None:
        raise InputError(
            f"{', '.join(map(str, runs))}: each run has a folder of annotations of its own; give one run at a time, or "
            "--out FOLDER here and --annotations FOLDER to circlecal batch"
        )

    is_alone = venue is None and camera_prior is None and len(inputs) == len(runs) == 1
    of_run = find_venue(runs[0]) if is_alone else None
    venue = venue or of_run
    if of_run is not None and not quiet:
        console.print_note(f"{of_run}: frames are calibrated by its cameras; name another one with --venue")

    def choose(template: str | None, further: Sequence[str] = (), *, is_plain: bool = False) -> Config:
        given, place = [*(settings or ()), *further], None if is_plain else venue
        return options.choose_config(
            config, given, template, camera_prior=camera_prior, venue=place, tells_field=is_plain
        )

    chosen = _suit_runs(runs, field, choose, knows_venue=of_run is not None, quiet=quiet)
    sampling = Sampling.parse(every or DEFAULT_EVERY, dashes="--")
    folder = out or (runs[0] / ANNOTATION_FOLDER if runs else Path("circlecal-annotations"))
    tell = (lambda note: None) if quiet else console.print_note
    with tempfile.TemporaryDirectory(prefix="circlecal-import-") as aside:
        given, annotated = unpack_inputs(inputs, folder / UNPACKED_FOLDER, Path(aside), tell)
        if not given:
            raise InputError(f"{annotated[0].given}: holds annotations and no pictures; give their pictures too")
        frames = take_part(list_frames(given, sampling, chosen.limits), part)
        prepare_folder(folder)
        session = Session(frames, AnnotationStore(folder), chosen)
        for archive in annotated:
            _import_annotations(session, archive, tell)

    if frame is not None and all(frame != listed.file.id for listed in frames):
        raise InputError(f"--frame {frame}: no such frame among the {len(frames)} that were given")

    served: list[str] = []

    def tell_address(address: str) -> None:
        served.append(address)
        for run in runs:
            try:
                tell_workbench(run, address)
            except InputError as error:
                console.print_note(f"{error}; the report has no link to this page")
        address += "" if frame is None else f"#{quote(frame)}"
        console.print_line(address)
        if not quiet:
            console.print_note(
                f"{len(frames)} {'frame' if len(frames) == 1 else 'frames'}; annotations go to {folder}; Ctrl-C ends"
            )
        if not no_browser:
            typer.launch(address)

    try:
        serve(session, port, tell_address, part)
    finally:
        for run, address in product(runs, served):
            with contextlib.suppress(InputError):  # it was told before that it cannot be written
                tell_workbench(run, None, address)


def _import_annotations(session: Session, archive: ArchivedAnnotations, tell: Callable[[str], None]) -> None:
    """Take the annotations in a ZIP into the frames that nobody annotated yet, and say what became of them."""
    from circlecal.errors import InputError

    try:
        told = session.take_archive(archive)
    except InputError as error:  # its pictures are shown all the same
        tell(f"{error}; nothing is imported from {archive.given}")
        return
    for warning in told.warnings:
        tell(warning)
    left = [f"{told.unknown} in it are of no frame here"] * bool(told.unknown)
    left += [f"{told.kept} here are annotated already and stay (drop the ZIP on the page to replace)"] * bool(told.kept)
    tell("; ".join([f"{archive.given}: {told.taken} annotations imported", *left]))


def _suit_runs(
    runs: Sequence[Path], field: str | None, choose: Callable[..., Config], *, knows_venue: bool, quiet: bool
) -> Config:
    """The configuration, on the field and with the sizes that the records of the runs tell.

    ``knows_venue`` says that it holds the cameras that the run itself found, with which none of its frames was made.

    Raises
    ------
    InputError, ConfigError
        As :func:`_choose_field`.
    """
    from circlecal.cli import console
    from circlecal.config import AUTO, config_digest
    from circlecal.errors import ConfigError
    from circlecal.pipeline import field_of
    from circlecal.workbench.frames import RunFacts

    made = {run: RunFacts.of(run) for run in runs}
    field = _choose_field(made, field, choose)
    chosen, of_auto = choose(field), None
    of_plain = config_digest(choose(field, is_plain=True)) if knows_venue else None
    with contextlib.suppress(ConfigError):  # sizes go with no field that pictures tell
        of_auto = config_digest(choose(AUTO, is_plain=True))
    for run, facts in made.items():
        known = field_of(chosen)[0].sizes
        other = [f"field.sizes.{name}={size}" for name, size in facts.sizes.items() if size != known.get(name, size)]
        fitting = (c for c in (chosen, choose(field, other)) if config_digest(c) in facts.digests)
        suited = next(fitting, None)
        if suited is not None:
            chosen = suited
        elif not quiet and facts.digests and facts.digests.isdisjoint((of_auto, of_plain)):
            console.print_note(
                f"{run}: was made with other options than these; give its --config, --set, --camera-prior and --venue "
                "here too, so that frames are calibrated as they were"
            )
    return chosen


def _choose_field(made: Mapping[Path, RunFacts], field: str | None, choose: Callable[..., Config]) -> str | None:
    """The field that is named, else the one that the runs' records tell; None for that of the configuration.

    Raises
    ------
    InputError
        Another field is named than a run's, the records tell several and none is named, or the field has no template
        here.
    ConfigError
        As :func:`circlecal.cli.options.choose_config`.
    """
    from circlecal.errors import ConfigError, InputError
    from circlecal.pipeline import field_of

    plain = choose(field, is_plain=True)
    own = field_of(plain)[0].name
    is_named = "field" in plain.model_fields_set and "template" in plain.field.model_fields_set
    for run, fields in ((run, facts.fields) for run, facts in made.items() if facts.fields):
        told = " and ".join(fields)
        if own not in fields and is_named:
            raise InputError(f"{run}: is of the field {told}, not of {own}; name its field with --field, or none")
        if len(fields) > 1 and not is_named:
            raise InputError(f"{run}: is of the fields {told}; name one of them with --field")
        if own not in fields:
            try:
                choose(told, is_plain=True)
            except ConfigError as error:
                raise InputError(f"{run}: {error}; give the file of its field with --field") from error
            field = own = told
        is_named = True
    return field
