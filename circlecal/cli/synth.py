"""``circlecal synth``."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from circlecal.cli import options


class Profile(StrEnum):
    """What the frames show."""

    EASY = "easy"
    BROADCAST = "broadcast"
    PARTIAL = "partial"
    HIDDEN_MARK = "hidden_mark"
    HARD = "hard"
    NEGATIVE = "negative"
    SHADE = "shade"
    WORN = "worn"
    GRAPHICS = "graphics"
    LOW_CAMERA = "low_camera"
    LENS = "lens"
    ARCHIVE = "archive"
    COLOURS = "colours"
    NIGHT = "night"
    HAZE = "haze"
    BLUR = "blur"
    LETTERBOX = "letterbox"
    UHD = "uhd"
    BEHIND_GOAL = "behind_goal"
    OBLIQUE = "oblique"
    SHORT_ARC = "short_arc"
    NO_HALFWAY = "no_halfway"
    ICE = "ice"
    WOOD = "wood"
    WORLD_WHOLE = "world_whole"
    WORLD_PART = "world_part"
    WORLD_BANNERS = "world_banners"
    WORLD_ENDS = "world_ends"
    WORLD_PAINT = "world_paint"
    ALTERED = "altered"
    RINK = "rink"
    COURT = "court"
    ROBOTS = "robots"
    CUT = "cut"
    KICK_OFF = "kick_off"


class Clips(StrEnum):
    """What the main camera does in a clip."""

    STILL = "still"
    ATTACK = "attack"
    SWEEP = "sweep"
    ZOOMS = "zooms"
    CUTS = "cuts"
    ALL = "all"


class Shape(StrEnum):
    """Shape of the pitch of a clip."""

    ROOF = "roof"
    HIP = "hip"
    PARABOLA = "parabola"
    FLAT = "flat"


def synth(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder for the frames or clips, masks and truth.")],
    count: Annotated[
        int | None,
        typer.Option("--count", "-n", help="Number of frames, or of clips. (default: 12, or one clip of each kind)"),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Seed; a frame depends on it and on its number only.")] = 0,
    profile: Annotated[
        list[Profile] | None,
        typer.Option(
            "--profile",
            "-p",
            metavar="NAME",
            help=f"What the frames show, repeatable, or the look of clips: {', '.join(Profile)}. (default: all)",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option("--size", metavar="WIDTHxHEIGHT", help="Size. (default: 1920x1080, of clips 1280x720)"),
    ] = None,
    no_masks: Annotated[bool, typer.Option("--no-masks", help="Do not write masks.")] = False,
    video: Annotated[
        Clips | None,
        typer.Option(
            "--video", metavar="KIND", help="Clips of a standing camera: still, attack, sweep, zooms, cuts, all."
        ),
    ] = None,
    seconds: Annotated[float, typer.Option("--seconds", help="Length of a clip.")] = 12.0,
    rate: Annotated[float, typer.Option("--rate", help="Frames per second of a clip.")] = 25.0,
    interlaced: Annotated[bool, typer.Option("--interlaced", help="Two fields in every frame of a clip.")] = False,
    surface: Annotated[
        Shape | None,
        typer.Option(
            "--surface",
            metavar="SHAPE",
            help="How the pitch of a clip falls to its borders: roof, hip, parabola, flat. (default: any but hip)",
        ),
    ] = None,
) -> None:
    """Render frames or clips of a synthetic match with exact truth, for tests and training."""
    from circlecal.cli import console
    from circlecal.errors import InputError
    from circlecal.synthetic.dataset import write_dataset

    if video is None and (interlaced or surface is not None):
        raise InputError("--interlaced and --surface are of clips; give --video too")
    if video is not None:
        _write_clips(
            out, count, seed, video, size or "1280x720", seconds, rate, profile, surface, interlaced=interlaced
        )
        return
    count, size = 12 if count is None else count, size or "1920x1080"
    chosen = [p.value for p in profile or list(Profile)]
    with _progress(count) as report:
        ids = write_dataset(out, count, seed, chosen, options.parse_size(size), masks=not no_masks, report=report)
    console.print_line(f"{console.count_of(len(ids), 'frame')} written to {out}")


def _write_clips(
    out: Path,
    count: int | None,
    seed: int,
    kind: Clips,
    size: str,
    seconds: float,
    rate: float,
    profile: list[Profile] | None,
    surface: Shape | None,
    *,
    interlaced: bool,
) -> None:
    from circlecal.cli import console
    from circlecal.errors import InputError
    from circlecal.synthetic.clip_files import require_clips, write_clips
    from circlecal.synthetic.clip_plans import kinds_of
    from circlecal.synthetic.video import CLIP_KINDS, ClipSpec

    if profile is not None and len(profile) > 1:
        raise InputError("--profile: clips have one look; give one")
    width, height = options.parse_size(size)
    spec = ClipSpec(width=width, height=height, seconds=seconds, rate=rate, interlaced=interlaced)
    if profile:
        spec = replace(spec, look=profile[0].value)
    if surface is not None:
        spec = replace(spec, surface=surface.value)
    kinds = kinds_of(spec.look) if kind == Clips.ALL else [name for name in CLIP_KINDS if name == kind.value]
    count = len(kinds) if count is None else count
    require_clips(count, seed, spec)
    with _progress(count * round(seconds * rate)) as report:
        ids = write_clips(out, count, seed, spec, kinds, report=report)
    console.print_line(f"{len(ids)} clip{'s' * (len(ids) != 1)} written to {out}")


@contextlib.contextmanager
def _progress(total: int) -> Iterator[Callable[[int], None] | None]:
    from circlecal.cli import console

    stderr = console.stderr_console()
    if not stderr.is_terminal:
        yield None
        return
    from rich.progress import Progress

    with Progress(console=stderr, transient=True) as bar:
        task = bar.add_task("rendering", total=max(total, 1))
        yield lambda finished: bar.update(task, completed=finished)
