"""Folders of synthetic frames with masks and truth."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.errors import InputError
from circlecal.field import FieldTemplate
from circlecal.files import prepare_folder, write_atomic
from circlecal.synthetic.renderer import Rendering, render
from circlecal.synthetic.sampling import PROFILE_BY_NAME, SCENE_PROFILES, sample_scene

TRUTH_FOLDER = "truth"
SMALLEST_SIZE, LARGEST_SIZE = (320, 180), (7680, 4320)


def write_dataset(
    out: Path,
    count: int,
    seed: int,
    profiles: Sequence[str] = SCENE_PROFILES,
    size: tuple[int, int] = (1920, 1080),
    *,
    template: FieldTemplate | None = None,
    masks: bool = True,
    report: Callable[[int], None] | None = None,
) -> list[str]:
    """Render ``count`` frames into a folder: ``<id>.jpg``, ``<id>.mask.png`` and ``truth/<id>.json``.

    Frame ``i`` has the profile ``profiles[i % len(profiles)]`` and is drawn from ``default_rng([seed, i])``: it is the
    same whatever the count. A frame without any marking in view gets no mask.

    Parameters
    ----------
    out : Path
        Folder; made if it is not there, files of the same name are replaced.
    count, seed : int
        Number of frames, at least 1; seed, at least 0.
    profiles : sequence of str
        Scene profiles.
    size : (int, int)
        Width and height, pixels.
    template : FieldTemplate, optional
        Field; soccer if not given.
    masks : bool
        Whether to write masks.
    report : callable, optional
        Called with the number of finished frames after each.

    Returns
    -------
    list of str
        The ids.

    Raises
    ------
    InputError
        Count, seed, profile or size out of range, or the folder cannot be written.
    """
    _require_sound(count, seed, profiles, size)
    prepare_folder(out, "OUT")
    ids = []
    for index in range(count):
        profile = PROFILE_BY_NAME[profiles[index % len(profiles)]]
        rng = np.random.default_rng([seed, index])
        scene = sample_scene(profile, rng, *size, template)
        rendering = render(scene, rng)
        ids.append(f"{profile}_{index:05d}")
        origin = {"profile": profile, "seed": seed, "index": index}
        write_frame(out, ids[-1], rendering, scene.config.jpeg_quality, origin, mask=masks)
        if report is not None:
            report(index + 1)
    return ids


def write_frame(
    out: Path, frame_id: str, rendering: Rendering, jpeg_quality: int, origin: dict[str, Any], *, mask: bool = True
) -> None:
    """Write one frame, its mask if it has any marking, and its truth with ``origin`` added to it.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    options = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
    write_atomic(out / f"{frame_id}.jpg", _encode(".jpg", rendering.image, options))
    if mask and rendering.truth.classes.any():
        strongest = [cv2.IMWRITE_PNG_COMPRESSION, 9]
        write_atomic(out / f"{frame_id}.mask.png", _encode(".png", rendering.truth.classes, strongest))
    record = {"id": frame_id, **origin, **rendering.truth.to_json()}
    text = json.dumps(record, indent=1, allow_nan=False) + "\n"
    write_atomic(out / TRUTH_FOLDER / f"{frame_id}.json", text.encode())


def _encode(suffix: str, picture: NDArray[np.uint8], options: list[int]) -> bytes:
    _, content = cv2.imencode(suffix, picture, options)
    return bytes(content.tobytes())


def _require_sound(count: int, seed: int, profiles: Sequence[str], size: tuple[int, int]) -> None:
    if count < 1:
        raise InputError(f"count must be at least 1, not {count}")
    if seed < 0:
        raise InputError(f"seed must be at least 0, not {seed}")
    unknown = [profile for profile in profiles if profile not in SCENE_PROFILES]
    if unknown or not profiles:
        named = ", ".join(map(repr, unknown)) or "none"
        raise InputError(f"profile {named} is unknown; known: {', '.join(SCENE_PROFILES)}")
    smallest, largest = ("x".join(map(str, limit)) for limit in (SMALLEST_SIZE, LARGEST_SIZE))
    if not all(low <= side <= high for low, side, high in zip(SMALLEST_SIZE, size, LARGEST_SIZE, strict=True)):
        raise InputError(f"size {size[0]}x{size[1]} is out of range; {smallest} to {largest} can be rendered")
