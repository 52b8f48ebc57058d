"""Options that several commands share, and the configuration that they add up to."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, overload

import typer

if TYPE_CHECKING:
    from circlecal.batch.frames import FrameRun
    from circlecal.config import Config
    from circlecal.formats.exports import Exports
    from circlecal.formats.inputs import FrameOfFile
    from circlecal.pictures.files import PictureFile
    from circlecal.pictures.inputs import Inputs
    from circlecal.pictures.video import Sampling, Video


def complete_config(incomplete: str) -> list[str]:
    """Names of shipped configurations that begin so, for the shell."""
    from circlecal.config import config_names

    return [name for name in config_names() if name.startswith(incomplete)]


def complete_field(incomplete: str) -> list[str]:
    """Names of shipped field templates that begin so, for the shell."""
    from circlecal.field import field_names

    return [name for name in ("auto", *field_names()) if name.startswith(incomplete)]


def _require_folder(folder: Path | None) -> Path | None:
    """A folder that was named, if it is there: what is read from it is optional, and would be missed in silence."""
    from circlecal.errors import InputError
    from circlecal.files import is_folder

    if folder is not None and not is_folder(folder):
        raise InputError(f"{folder}: no such folder of annotations; circlecal annotate writes one")
    return folder


class Convention(StrEnum):
    """Where annotated points of a marking lie."""

    OFFICIAL = "official"
    PAINT = "paint"


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
        metavar="INPUT", help="Pictures, annotation files, folders, patterns, sequences (x_%04d.png), lists (x.txt)."
    ),
]
Keypoints = Annotated[
    Path | None,
    typer.Option("--keypoints", metavar="FILE|FOLDER", help="Keypoints and lines used together with the pictures."),
]
Annotations = Annotated[
    Path | None,
    typer.Option(
        "--annotations",
        metavar="FOLDER",
        callback=_require_folder,
        help="What was named in circlecal annotate. (default: OUT/annotations, and x.json beside x.jpg)",
    ),
]
PointConvention = Annotated[
    Convention,
    typer.Option("--convention", help="Annotated points lie at the official size, or on the middle of the paint."),
]
To = Annotated[
    list[str] | None,
    typer.Option("--to", metavar="FORMAT", help=f"Also write the calibration in this format; repeatable: {TARGETS}."),
]
EvalSize = Annotated[
    str | None,
    typer.Option("--eval-size", metavar="WIDTHxHEIGHT", help="Picture size of cameras written by --to."),
]
FromFormat = Annotated[
    str | None,
    typer.Option(
        "--from",
        metavar="FORMAT",
        help=f"Format of annotation files: {_ANNOTATIONS}. (default: recognised by content)",
    ),
]
Size = Annotated[
    str | None,
    typer.Option("--size", metavar="WIDTHxHEIGHT", help="Size of the pictures, where an annotation file has none."),
]
Out = Annotated[Path, typer.Option("--out", "-o", help="Folder for everything that is written.")]
Mask = Annotated[
    Path | None,
    typer.Option(
        "--mask",
        metavar="FILE|FOLDER",
        help="Segmentation mask, or folder of masks named like the frames. (default: x.mask.png or masks/x.png "
        "beside x.jpg)",
    ),
]
ConfigFile = Annotated[
    str | None,
    typer.Option(
        "--config",
        "-c",
        metavar="FILE|NAME",
        help="YAML file, or a name such as broadcast. (default: default)",
        autocompletion=complete_config,
    ),
]
Settings = Annotated[
    list[str] | None, typer.Option("--set", "-s", metavar="KEY=VALUE", help="Set section.key=value; repeatable.")
]
Workers = Annotated[int | None, typer.Option("--workers", "-w", min=1, help="Worker processes. (default: one per CPU)")]
FieldName = Annotated[
    str | None,
    typer.Option(
        "--field",
        metavar="NAME|FILE",
        help="Field template; see circlecal fields. auto: the one that the picture shows. (default: soccer)",
        autocompletion=complete_field,
    ),
]
CameraPrior = Annotated[
    Path | None,
    typer.Option("--camera-prior", metavar="FILE", help="Known camera: a prior file, or the result of another frame."),
]
VenueFile = Annotated[
    Path | None,
    typer.Option("--venue", metavar="FILE", help="Cameras and pitch that are known: the venue.yaml of an earlier run."),
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="tcp://HOST:PORT|local:N", help="Run on this Dask cluster instead."),
]
Solver = Annotated[
    str | None,
    typer.Option(
        "--solver",
        metavar="NAME",
        help="A published method instead of circlecal's camera: great_axis, footyvision, magera_case1, magera_case2, "
        "magera_case3, alvarez_caselles, gupta, chum_matas, chen_wu, huang_self_polar, tvcalib_like, pnl_like.",
    ),
]
MaxPixels = Annotated[
    int | None,
    typer.Option("--max-pixels", metavar="N", help="Largest picture that is read, in pixels. (default: 50 million)"),
]
MaxBytes = Annotated[
    int | None, typer.Option("--max-bytes", metavar="N", help="Largest picture file that is read. (default: 256 MB)")
]
Seed = Annotated[int | None, typer.Option("--seed", min=0, help="Seed of the random draws. (default: 0)")]
Radar = Annotated[bool, typer.Option("--radar", help="Also write the frame warped to the field plane.")]
NoOverlay = Annotated[bool, typer.Option("--no-overlay", help="Do not write overlay pictures.")]
Json = Annotated[bool, typer.Option("--json", help="Print results as JSON, one line each.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Log what is done.")]


def cpu_count() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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
    from circlecal.config import AUTO, load_config
    from circlecal.errors import ConfigError
    from circlecal.pipeline import field_of

    overrides: list[str] = []
    if camera_prior is not None:
        from circlecal.records.camera_prior import prior_settings

        overrides += prior_settings(camera_prior)
    named_field = [] if field is None else [f"field.template={json.dumps(field)}"]
    if venue is not None:
        from circlecal.rig.venue import venue_settings

        overrides += venue_settings(venue, field_of(load_config(file, [*(settings or ()), *named_field]))[0])
    overrides += [*(settings or ()), *named_field]
    overrides += [] if seed is None else [f"seed={seed}"]
    overrides += [] if solver is None else [f"solver={json.dumps(solver)}"]
    overrides += [] if max_pixels is None else [f"limits.max_pixels={max_pixels}"]
    overrides += [] if max_bytes is None else [f"limits.max_bytes={max_bytes}"]
    overrides += ["output.radar=true"] if radar else []
    overrides += ["output.overlay=false"] if no_overlay else []
    config = load_config(file, overrides)
    field_of(config)
    if config.field.template == AUTO and (venue is not None or not tells_field):
        raise ConfigError(
            "--field auto is for calibrate, batch, debug and track, without --venue and --rig; name the field"
        )
    require_networks(config)
    return config


def folder_of_run(out: Path, digest: str, *, ask: bool, restart: bool) -> Path:
    """The folder that was named, or a new one beside it where that holds another run and the user agrees.

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
        if not ask:
            raise
        count = 2
        while (new := out.with_name(f"{out.name}-{count}")).exists():
            count += 1
        typer.echo(f"circlecal: {error}", err=True)
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
    from circlecal.records.parquet import PARQUET_FORMAT, require_parquet

    named = tuple(targets or ())
    if PARQUET_FORMAT in named:
        require_parquet()
    others = tuple(name for name in named if name != PARQUET_FORMAT)
    choice = ExportChoice(others, parse_size(eval_size, "--eval-size"), PARQUET_FORMAT in named)
    choice.into(Path())
    return choice


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


def choose_frames(inputs: Sequence[Path], out: Path, mask: Path | None) -> list[PictureFile]:
    """The frames among the inputs.

    Raises
    ------
    InputError
        As :func:`circlecal.pictures.files.find_frames`, or the mask option does not fit.
    """
    from circlecal.errors import InputError
    from circlecal.files import exists, is_folder, real_path
    from circlecal.pictures.files import find_frames

    if mask is not None and not exists(mask):
        raise InputError(f"{mask}: no such mask file or folder")
    around_inputs = {folder for path in inputs for folder in (real_path(path), *real_path(path).parents)}
    apart = [path for path in (out, mask) if path is not None and real_path(path) not in around_inputs]
    frames = find_frames(inputs, exclude=apart)
    if mask is not None and not is_folder(mask) and len(frames) > 1:
        raise InputError(f"{mask}: is one mask for {len(frames)} frames; give a folder of masks named like the frames")
    return frames


def require_frames(inputs: Sequence[object], frames: Sequence[object]) -> None:
    """There is something to calibrate: pictures, or frames in the annotation files that were named.

    Raises
    ------
    InputError
        There is not.
    """
    from circlecal.errors import InputError

    if not frames:
        named = ", ".join(map(str, inputs))
        raise InputError(f"{named}: no annotations found; give pictures, annotation files or folders of them")


def choose_inputs(
    inputs: Sequence[str], run: FrameRun, out: Path, report: Callable[[Exception], None]
) -> list[PictureFile | FrameOfFile]:
    """Pictures and frames of annotation files among the inputs; videos, URLs and files that cannot be read are
    reported.

    Raises
    ------
    InputError
        Nothing to calibrate, an option that does not fit, or a result that would be written over its source.
    """
    from circlecal.formats.registry import annotation_suffixes
    from circlecal.pictures.inputs import expand_inputs

    named = expand_inputs(inputs, annotation_suffixes())
    _report_moving_and_remote(named, report)
    return _frames_of(named.paths, run, out, report)


def _report_moving_and_remote(named: Inputs, report: Callable[[Exception], None]) -> None:
    """Say which videos and URLs are left to ``circlecal batch``.

    Raises
    ------
    InputError
        Nothing else is named.
    """
    from circlecal.errors import InputError

    for left, mend in (
        (named.videos, "is a video; use circlecal batch, with --every 1s or the like"),
        (named.urls, "is a URL; use circlecal batch"),
    ):
        if left:
            more = f" (and {len(left) - 1} more like it)" if len(left) > 1 else ""
            error = InputError(f"{left[0]}: {mend}{more}")
            if not named.paths:
                raise error
            report(error)


def _frames_of(
    inputs: Sequence[Path], run: FrameRun, out: Path, report: Callable[[Exception], None]
) -> list[PictureFile | FrameOfFile]:
    from circlecal.errors import InputError
    from circlecal.files import exists
    from circlecal.formats.inputs import read_frames, refuse_overwriting, split_inputs
    from circlecal.pipeline import apply_convention, field_of

    if run.keypoints is not None and not exists(run.keypoints):
        raise InputError(f"{run.keypoints}: no such file or folder of keypoints")
    format_name = None if run.keypoints is not None else run.format_name
    pictures, files = split_inputs(inputs, format_name, exclude=[out])
    frames = choose_frames(pictures, out, run.mask) if pictures else []
    note_unused_annotations(frames if run.keypoints is None else ())
    if run.keypoints is not None and not frames:
        raise InputError(f"{run.keypoints}: --keypoints are used together with pictures, and no picture is given")
    annotated = read_frames(
        files,
        apply_convention(field_of(run.config)[0], run.convention),
        run.config.sources,
        size=run.size,
        format_name=format_name,
        taken=[frame.id for frame in frames],
        on_error=report,
    )
    refuse_overwriting(annotated, out)
    return [*frames, *annotated]


def note_unused_annotations(frames: Sequence[PictureFile]) -> None:
    """Say that annotations of other programs lie beside pictures and are not used.

    They are not taken unasked, as masks are: beside pictures lies what they are evaluated with.
    """
    from circlecal.cli import console
    from circlecal.formats.inputs import find_unused_annotations

    ignored = find_unused_annotations(frames)
    if ignored:
        more = f" and {len(ignored) - 1} more" if len(ignored) > 1 else ""
        console.print_note(
            f"{ignored[0]}{more}: an annotation beside its picture is not used; --keypoints FOLDER takes it together "
            "with the picture, and the file itself as an input takes it alone"
        )


def choose_frames_and_videos(
    inputs: Sequence[str], run: FrameRun, out: Path, report: Callable[[Exception], None]
) -> tuple[list[PictureFile | FrameOfFile], list[Video]]:
    """Pictures, frames of annotation files, and videos among the inputs.

    Raises
    ------
    InputError
        Nothing was found that can be read, or a video cannot be read.
    """
    from circlecal.errors import InputError
    from circlecal.files import is_folder
    from circlecal.formats.registry import annotation_suffixes
    from circlecal.pictures.files import PictureFile, distinct_names
    from circlecal.pictures.inputs import expand_inputs
    from circlecal.pictures.remote import url_names
    from circlecal.pictures.video import Video

    named = expand_inputs(inputs, annotation_suffixes())
    names = distinct_names([path.stem for path in named.videos])
    videos = [Video.open(path, name, run.config.limits) for path, name in zip(named.videos, names, strict=True)]
    for path in (run.mask, run.keypoints):
        if videos and path is not None and not is_folder(path):
            raise InputError(f"{path}: is one file for all frames of a video; give a folder of files named like them")
    alone = (videos or named.urls) and not named.paths
    frames = [] if alone else _frames_of(named.paths, run, out, report)
    ids = url_names(named.urls, [frame.id for frame in frames])
    frames += [PictureFile(name, Path(name), name, url=url) for name, url in zip(ids, named.urls, strict=True)]
    return frames, videos


def note_late_start(videos: Sequence[Video], sampling: Sampling) -> None:
    """Say of which videos nothing is taken, since they end before the time that was asked for."""
    from circlecal.cli import console

    for video in videos:
        if 0.0 < video.duration_s <= sampling.start_s:
            console.print_note(
                f"{video.path}: ends {video.duration_s:.1f} s after its first frame, as its header says, and "
                f"--start asks for {sampling.start_s:g} s"
            )


def choose_videos(inputs: Sequence[str], report: Callable[[Exception], None]) -> list[Video]:
    """The videos among the inputs, with different names; those that cannot be read are reported.

    Raises
    ------
    InputError
        There is none, or something else is named.
    """
    from circlecal.errors import InputError
    from circlecal.files import require_input
    from circlecal.pictures.files import distinct_names
    from circlecal.pictures.inputs import expand_inputs
    from circlecal.pictures.video import Video

    named = expand_inputs(inputs)
    if named.urls:
        raise InputError(f"{named.urls[0]}: is a URL; save the video, and give its file")
    for path in named.paths:
        require_input(path)
    if not named.videos:
        raise InputError(f"{', '.join(inputs)}: holds no video; pictures go to circlecal calibrate and batch")
    videos = []
    names = distinct_names([path.stem for path in named.videos])
    for path, name in zip(named.videos, names, strict=True):
        try:
            videos.append(Video.open(path, name))
        except InputError as error:
            report(error)
    return videos
