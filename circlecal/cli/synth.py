"""``circlecal synth``."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


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


def synth(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder for the frames, masks and truth.")],
    count: Annotated[int, typer.Option("--count", "-n", help="Number of frames.")] = 12,
    seed: Annotated[int, typer.Option("--seed", help="Seed; a frame depends on it and on its number only.")] = 0,
    profile: Annotated[
        list[Profile] | None, typer.Option("--profile", "-p", help="What the frames show; repeatable. [default: all]")
    ] = None,
    size: Annotated[str, typer.Option("--size", metavar="WIDTHxHEIGHT", help="Size of the frames.")] = "1920x1080",
    no_masks: Annotated[bool, typer.Option("--no-masks", help="Do not write masks.")] = False,
) -> None:
    """Render frames of a synthetic match with exact truth, for tests and training."""
    from circlecal.cli import console
    from circlecal.synthetic.dataset import write_dataset

    chosen = [p.value for p in profile or list(Profile)]
    with _progress(count) as report:
        ids = write_dataset(out, count, seed, chosen, _parsed_size(size), masks=not no_masks, report=report)
    console.print_line(f"{len(ids)} frames written to {out}")


def _parsed_size(text: str) -> tuple[int, int]:
    from circlecal.errors import InputError

    width, _, height = text.lower().partition("x")
    if not (width.isascii() and width.isdigit() and height.isascii() and height.isdigit()):
        raise InputError(f"--size {text!r} is not WIDTHxHEIGHT, such as 1920x1080")
    return int(width), int(height)


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
