"""Options that several commands share, and the configuration that they add up to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, overload

import typer

from circlecal.cli.plain_flags import CAMERA_AND_FIELD, INPUT, OUTPUT, RUNNING

if TYPE_CHECKING:
    from circlecal.config import Config
    from circlecal.formats.exports import Exports


def complete_config(incomplete: str) -> list[str]:
    """Names of shipped configurations that begin so, for the shell."""
    from circlecal.config import config_names

    return [name for name in config_names() if name.startswith(incomplete)]


def complete_field(incomplete: str) -> list[str]:
    """Names of shipped field templates that begin so, for the shell."""
    from circlecal.field import field_names

    return [name for name in field_names() if name.startswith(incomplete)]


def complete_field_or_auto(incomplete: str) -> list[str]:
    """Names of shipped field templates that begin so, and ``auto``, for the shell."""
    return [name for name in ("auto",) if name.startswith(incomplete)] + complete_field(incomplete)


def _require_annotations(given: Path | None) -> Path | None:
    """A folder of annotations that was named, or a ZIP of it, if it is there."""
    from circlecal.formats.annotation import require_annotations
    from circlecal.formats.unpacking import is_archive

    if given is not None and not is_archive(given):
        require_annotations(given)
    return given


class Convention(StrEnum):
    """Where annotated points of a marking lie."""

    OFFICIAL = "official"
    PAINT = "paint"


def convention_of(given: Convention | None) -> Literal["official", "paint"]:
    """Where annotated points lie, by the rules where nothing was given."""
    return (given or Convention.OFFICIAL).value


_MOST_DIGITS = 18
"""Of a number that is read at all."""
_ANNOTATIONS = "coco, cvat, extremities, gamestate, labelme, labelstudio, pnlcalib, soccernet, workbench"
TARGETS = "broadtrack, coco, cvat, gamestate, labelme, labelstudio, pnlcalib, soccernet, tvcalib, worldcup"
CONVERSIONS = (
    "coco, cvat, extremities, labelme, labelstudio, pnlcalib, soccernet, workbench for annotations, broadtrack, "
    "gamestate, soccernet, tvcalib, worldcup for cameras, or parquet"
)
"""Names of formats, written down here so that ``--help`` imports nothing; a test compares them with the registry."""
FrameInputs = Annotated[
    list[str],
    typer.Argument(
        metavar="INPUT",
        help="Pictures, annotation files, folders or ZIPs of them, patterns, sequences (x_%04d.png), lists (x.txt).",
    ),
]
Keypoints = Annotated[
    Path | None,
    typer.Option(
        "--keypoints",
        metavar="FILE|FOLDER",
        help="Keypoints and lines used together with the pictures.",
        rich_help_panel=INPUT,
    ),
]
Annotations = Annotated[
    Path | None,
    typer.Option(
        "--annotations",
        metavar="FOLDER|ZIP",
        callback=_require_annotations,
        help="What was named in circlecal annotate. (default: OUT/annotations, and x.json beside x.jpg)",
        rich_help_panel=INPUT,
    ),
]
ClipAnnotations = Annotated[
    Path | None,
    typer.Option(
        "--annotations",
        metavar="FOLDER|ZIP",
        callback=_require_annotations,
        help="What was named in circlecal annotate. (default: OUT/annotations)",
        rich_help_panel=INPUT,
    ),
]
PointConvention = Annotated[
    Convention | None,
    typer.Option(
        "--convention",
        help="Points of annotation files lie at the sizes of the rules, or on the middle of the paint. "
        "(default: official)",
        rich_help_panel=INPUT,
    ),
]
To = Annotated[
    list[str] | None,
    typer.Option(
        "--to",
        metavar="FORMAT",
        help=f"Also write the calibration in this format; repeatable: {TARGETS}.",
        rich_help_panel=OUTPUT,
    ),
]
ToAll = Annotated[
    list[str] | None,
    typer.Option(
        "--to",
        metavar="FORMAT",
        help=f"Also write all frames in this format; repeatable: {TARGETS}, parquet.",
        rich_help_panel=OUTPUT,
    ),
]
EvalSize = Annotated[
    str | None,
    typer.Option(
        "--eval-size", metavar="WIDTHxHEIGHT", help="Picture size of cameras written by --to.", rich_help_panel=OUTPUT
    ),
]
FromFormat = Annotated[
    str | None,
    typer.Option(
        "--from",
        metavar="FORMAT",
        help=f"Format of annotation files: {_ANNOTATIONS}. (default: recognised by content)",
        rich_help_panel=INPUT,
    ),
]
Size = Annotated[
    str | None,
    typer.Option(
        "--size",
        metavar="WIDTHxHEIGHT",
        help="Size of the pictures, where an annotation file has none.",
        rich_help_panel=INPUT,
    ),
]
Out = Annotated[
    Path, typer.Option("--out", "-o", help="Folder for everything that is written.", rich_help_panel=OUTPUT)
]
Every = Annotated[
    str | None,
    typer.Option(
        "--every",
        metavar="TIME|N",
        help="Take one frame per TIME (1s, 500ms), or every N-th frame, of a video. (default: 1s)",
        rich_help_panel=INPUT,
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        "--start", metavar="TIME", help="Take a video from here on: seconds, MM:SS or H:MM:SS.", rich_help_panel=INPUT
    ),
]
End = Annotated[
    str | None,
    typer.Option(
        "--end", metavar="TIME", help="Take a video up to here: seconds, MM:SS or H:MM:SS.", rich_help_panel=INPUT
    ),
]
Mask = Annotated[
    Path | None,
    typer.Option(
        "--mask",
        metavar="FILE|FOLDER",
        help="Segmentation mask, or folder of masks named like the frames. (default: x.mask.png or masks/x.png "
        "beside x.jpg)",
        rich_help_panel=INPUT,
    ),
]
ConfigFile = Annotated[
    str | None,
    typer.Option(
        "--config",
        "-c",
        metavar="FILE|NAME",
        help="YAML file, or a name such as broadcast; over the options of the field's sport.",
        autocompletion=complete_config,
        rich_help_panel=CAMERA_AND_FIELD,
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set", "-s", metavar="KEY=VALUE", help="Set section.key=value; repeatable.", rich_help_panel=CAMERA_AND_FIELD
    ),
]
Workers = Annotated[
    int | None,
    typer.Option("--workers", "-w", min=1, help="Worker processes. (default: one per CPU)", rich_help_panel=RUNNING),
]
FieldName = Annotated[
    str | None,
    typer.Option(
        "--field",
        metavar="NAME|FILE",
        help="Field template; see circlecal fields. auto: the one that the picture shows. (default: soccer)",
        autocompletion=complete_field_or_auto,
        rich_help_panel=CAMERA_AND_FIELD,
    ),
]
OneFieldName = Annotated[
    str | None,
    typer.Option(
        "--field",
        metavar="NAME|FILE",
        help="Field template; see circlecal fields. (default: soccer)",
        autocompletion=complete_field,
        rich_help_panel=CAMERA_AND_FIELD,
    ),
]
"""For commands that must know the field before they see a picture."""
CameraPrior = Annotated[
    Path | None,
    typer.Option(
        "--camera-prior",
        metavar="FILE",
        help="Known camera: a prior file, or the result of another frame.",
        rich_help_panel=CAMERA_AND_FIELD,
    ),
]
VenueFile = Annotated[
    Path | None,
    typer.Option(
        "--venue",
        metavar="FILE",
        help="Known cameras, field and pitch: the venue.yaml of an earlier run.",
        rich_help_panel=CAMERA_AND_FIELD,
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="tcp://HOST:PORT|local:N",
        help="Run on this Dask cluster instead.",
        rich_help_panel=RUNNING,
    ),
]
Solver = Annotated[
    str | None,
    typer.Option(
        "--solver",
        metavar="NAME",
        help="A published method instead of circlecal's camera: great_axis, footyvision, magera_case1, magera_case2, "
        "magera_case3, alvarez_caselles, gupta, chum_matas, chen_wu, huang_self_polar, tvcalib_like, pnl_like; or "
        "circlecal's own as a peer of these: circlecal, circlecal_default.",
        rich_help_panel=CAMERA_AND_FIELD,
    ),
]


def _parse_pixels(text: str) -> int:
    return _whole_number(text, "pixels, such as 50000000")


def _parse_bytes(text: str) -> int:
    return _whole_number(text, "bytes, such as 268435456 for 256 MB")


def _whole_number(text: str, unit: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= _MOST_DIGITS):
        raise typer.BadParameter(f"{text!r} is no whole number of {unit}")
    return int(text)


MaxPixels = Annotated[
    int | None,
    typer.Option(
        "--max-pixels",
        metavar="PIXELS",
        parser=_parse_pixels,
        help="Largest picture that is read, width times height. (default: 50 million)",
        rich_help_panel=INPUT,
    ),
]
MaxBytes = Annotated[
    int | None,
    typer.Option(
        "--max-bytes",
        metavar="BYTES",
        parser=_parse_bytes,
        help="Largest picture file that is read, in bytes. (default: 256 MB)",
        rich_help_panel=INPUT,
    ),
]
Restart = Annotated[bool, typer.Option("--restart", help="Start over instead of going on.", rich_help_panel=RUNNING)]
Seed = Annotated[
    int | None, typer.Option("--seed", min=0, help="Seed of the random draws. (default: 0)", rich_help_panel=RUNNING)
]
Radar = Annotated[
    bool, typer.Option("--radar", help="Also write the frame warped to the field plane.", rich_help_panel=OUTPUT)
]
NoOverlay = Annotated[bool, typer.Option("--no-overlay", help="Do not write overlay pictures.", rich_help_panel=OUTPUT)]
Json = Annotated[bool, typer.Option("--json", help="Print results as JSON, one line each.", rich_help_panel=OUTPUT)]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.", rich_help_panel=RUNNING)]
QuietNotes = Annotated[
    bool, typer.Option("--quiet", "-q", help="Leave out notes and warnings.", rich_help_panel=RUNNING)
]
"""For commands whose output is all that they are for."""
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Log what is done.", rich_help_panel=RUNNING)]


def choose_config(
    file: str | None,
    settings: Sequence[str] | None,
    field: str | None = None,
    seed: int | None = None,
    *,
    radar: bool = False,
    no_overlay: bool = False,
    camera_prior: Path | None = None,
    venue: Path | None = None,
    solver: str | None = None,
    max_pixels: int | None = None,
    max_bytes: int | None = None,
    tells_field: bool = False,
) -> Config:
    """The configuration of a command, its field template and networks checked.

    Raises
    ------
    ConfigError
        As :func:`circlecal.config.load_config`, and where pictures are to tell the field to a command that needs to
        know it before (all but those with ``tells_field``).
    """
    from circlecal.batch.frames import require_networks
    from circlecal.config import AUTO, NamedOption, load_config
    from circlecal.errors import ConfigError
    from circlecal.pipeline import field_of

    if camera_prior is not None and venue is not None:
        raise ConfigError("--camera-prior and --venue both say where the camera stands; give one of them")
    overrides: list[str | NamedOption] = []
    if camera_prior is not None:
        from circlecal.records.camera_prior import prior_settings

        overrides += prior_settings(camera_prior)
    if venue is not None:
        from circlecal.rig.venue import choose_field, venue_settings

        field = choose_field(venue, load_config(file, settings or ()).field, field)
    named_field = [] if field is None else [NamedOption("field.template", field, f"--field {field}")]
    if venue is not None:
        overrides += venue_settings(venue, field_of(load_config(file, [*(settings or ()), *named_field]))[0])
    overrides += [*(settings or ()), *named_field]
    named = (
        ("seed", seed, "--seed"),
        ("solver", solver, "--solver"),
        ("limits.max_pixels", max_pixels, "--max-pixels"),
        ("limits.max_bytes", max_bytes, "--max-bytes"),
    )
    overrides += [NamedOption(key, value, f"{name} {value}") for key, value, name in named if value is not None]
    overrides += ["output.radar=true"] if radar else []
    overrides += ["output.overlay=false"] if no_overlay else []
    config = load_config(file, overrides)
    try:
        field_of(config)
    except ConfigError as error:
        if settings and str(error).startswith(tuple(settings)):
            raise ConfigError(f"--set {error}") from error
        if file is None or load_config(file).field != config.field:
            raise
        raise ConfigError(f"{file}: {error}") from error
    if config.field.template == AUTO and not tells_field:
        raise ConfigError("--field auto is for calibrate, batch, debug and track, without --rig; name the field")
    require_networks(config)
    return config


def folder_of_run(out: Path, digest: str, *, ask: bool, restart: bool, find_hint: Callable[[], str] = str) -> Path:
    """The folder that was named, or a new one beside it where that holds another run and the user agrees.

    ``find_hint`` is asked where there is another run: what may have made it another one, added to what is said.

    Raises
    ------
    OtherRunError
        It holds another run, which is not dropped by ``restart``, and nobody can be asked.
    """
    from circlecal.records.log import OtherRunError, ResultLog

    if restart:
        return out
    try:
        with ResultLog(out) as log:
            log.take_up(digest)
    except OtherRunError as error:
        told = f"{error}{find_hint()}"
        if not ask:
            raise OtherRunError(told) from error
        count = 2
        while (new := out.with_name(f"{out.name}-{count}")).exists():
            count += 1
        typer.echo(f"circlecal: {told}", err=True)
        if not typer.confirm(f"Start a new run in {new}?", err=True):
            raise typer.Exit(2) from None
        return new
    return out


@overload
def parse_size(text: str, option: str = "--size") -> tuple[int, int]: ...


@overload
def parse_size(text: str | None, option: str = "--size") -> tuple[int, int] | None: ...


def parse_size(text: str | None, option: str = "--size") -> tuple[int, int] | None:
    """Width and height from an option such as 1920x1080; None where it was not given.

    Raises
    ------
    InputError
        Anything else.
    """
    from circlecal.errors import InputError

    if text is None:
        return None
    width, _, height = text.lower().partition("x")
    if not all(side.isascii() and side.isdigit() for side in (width, height)):
        raise InputError(f"{option} {text!r} is not WIDTHxHEIGHT, such as 1920x1080")
    if not all(len(side) <= 5 and 1 < int(side) <= 65535 for side in (width, height)):
        raise InputError(f"{option} {text!r}: each side must be from 2 to 65535 pixels")
    return int(width), int(height)


@dataclass(frozen=True, slots=True)
class ExportChoice:
    """What ``--to`` and ``--eval-size`` ask for: names of formats, size of the pictures in which cameras count, and
    whether a Parquet table is wanted too.
    """

    targets: tuple[str, ...]
    size: tuple[int, int] | None
    parquet: bool

    def into(self, folder: Path) -> Exports:
        """The formats, to be written into a folder."""
        from circlecal.formats.exports import Exports

        return Exports(self.targets, folder, self.size)


def choose_exports(targets: Sequence[str] | None, eval_size: str | None) -> ExportChoice:
    """The outside formats of a run; what cannot be written is told before the first frame.

    Raises
    ------
    InputError, MissingExtraError
        An unknown format or no size; Parquet without its library.
    """
    from circlecal.formats.registry import calibration_formats, require_format
    from circlecal.records.parquet import PARQUET_FORMAT, require_parquet

    named = tuple(targets or ())
    for name in named:
        require_format(name, {**calibration_formats(), PARQUET_FORMAT: None}, "--to", "format that can be written")
    if PARQUET_FORMAT in named:
        require_parquet()
    others = tuple(name for name in named if name != PARQUET_FORMAT)
    choice = ExportChoice(others, parse_size(eval_size, "--eval-size"), PARQUET_FORMAT in named)
    choice.into(Path())
    return choice


def require_export_field(targets: Sequence[str] | None, config: Config) -> None:
    """Tell before the first frame that a format of ``--to`` has no names for the field in use.

    Raises
    ------
    InputError
        It has none.
    """
    from circlecal.config import AUTO
    from circlecal.formats.exports import require_field
    from circlecal.pipeline import field_of

    if targets and config.field.template != AUTO:
        require_field(targets, field_of(config)[0])


def choose_format(name: str | None) -> str | None:
    """Name of an annotation format, checked.

    Raises
    ------
    InputError
        Unknown.
    """
    from circlecal.formats.registry import annotation_formats, require_format

    if name is not None:
        require_format(name, annotation_formats(), "--from", "annotation format")
    return name
