"""Clips in files: pictures with the exact time of each, and the truth beside them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from circlecal.errors import InputError
from circlecal.files import prepare_folder, write_atomic
from circlecal.pictures.video_writer import write_video
from circlecal.synthetic.clip_plans import kinds_of, plan_clip
from circlecal.synthetic.dataset import LARGEST_SIZE, SMALLEST_SIZE, TRUTH_FOLDER
from circlecal.synthetic.sampling import profile_field
from circlecal.synthetic.video import Clip, ClipKind, ClipSpec

_LONGEST_S, _RATES = 600.0, (1.0, 120.0)


def write_clip(out: Path, clip_id: str, clip: Clip, *, report: Callable[[int], None] | None = None) -> Path:
    """Write ``<id>.mp4`` with the exact time of every frame, and ``truth/<id>.json``.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    path = out / f"{clip_id}.mp4"
    frames = []
    with write_video(path, clip.spec.rate, is_interlaced=clip.spec.interlaced) as writer:
        for picture, truth in clip.frames():
            writer.write(picture, truth.time_s)
            frames.append(truth.to_json())
            if report is not None:
                report(len(frames))
    text = json.dumps({"id": clip_id, **clip.to_json(), "frames": frames}, indent=1, allow_nan=False) + "\n"
    write_atomic(out / TRUTH_FOLDER / f"{clip_id}.json", text.encode())
    return path


def write_clips(
    out: Path,
    count: int,
    seed: int,
    spec: ClipSpec,
    kinds: Sequence[ClipKind] = (),
    *,
    report: Callable[[int], None] | None = None,
) -> list[str]:
    """Render clips into a folder; the ids come back.

    Clip ``i`` has the kind ``kinds[i % len(kinds)]`` and is drawn from ``default_rng([seed, i])``; where no kinds are
    given, these are all that there are with its look.

    Parameters
    ----------
    out : Path
        Folder; made if it is not there, files of the same name are replaced.
    count, seed : int
        Number of clips, at least 1; seed, at least 0.
    spec : ClipSpec
        Size, length, rate and look.
    kinds : sequence of str
        Kinds of clips.
    report : callable, optional
        Called with the number of finished frames after each.

    Raises
    ------
    InputError
        Count, seed, size, length or rate out of range, cuts in another sport than soccer, or the folder cannot be
        written.
    """
    require_clips(count, seed, spec)
    prepare_folder(out, "OUT")
    kinds = kinds or kinds_of(spec.look)
    ids = []
    for index in range(count):
        kind = kinds[index % len(kinds)]
        clip = plan_clip(replace(spec, kind=kind), np.random.default_rng([seed, index]))
        ids.append(f"{kind}_{index:05d}")
        done = index * clip.count

        def tell(finished: int, done: int = done) -> None:
            if report is not None:
                report(done + finished)

        write_clip(out, ids[-1], clip, report=tell)
    return ids


def require_clips(count: int, seed: int, spec: ClipSpec) -> None:
    """Clips that can be rendered.

    Raises
    ------
    InputError
        A number is out of range, or a surface is chosen for a sport whose fields have one shape.
    """
    if count < 1:
        raise InputError(f"count must be at least 1, not {count}")
    if seed < 0:
        raise InputError(f"seed must be at least 0, not {seed}")
    size = spec.width, spec.height
    in_range = all(low <= side <= high for low, side, high in zip(SMALLEST_SIZE, size, LARGEST_SIZE, strict=True))
    if not in_range or any(side % 2 for side in size):
        smallest, largest = ("x".join(map(str, limit)) for limit in (SMALLEST_SIZE, LARGEST_SIZE))
        raise InputError(
            f"size {size[0]}x{size[1]} is out of range; even sides from {smallest} to {largest} can be rendered"
        )
    if spec.surface is not None and profile_field(spec.look) != "soccer":
        raise InputError("--surface: pitches of soccer alone have a shape to choose; leave it out for other sports")
    if not (0.0 < spec.seconds <= _LONGEST_S and _RATES[0] <= spec.rate <= _RATES[1]):
        raise InputError(
            f"{spec.seconds:g} s at {spec.rate:g} frames per second is out of range; up to {_LONGEST_S:g} s at "
            f"{_RATES[0]:g} to {_RATES[1]:g} can be rendered"
        )
