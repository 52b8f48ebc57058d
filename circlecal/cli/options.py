"""Options that several commands share, and the configuration that they add up to."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from circlecal.config import Config
    from circlecal.formats.images import Frame

Inputs = Annotated[list[Path], typer.Argument(metavar="INPUT...", help="Pictures and folders of pictures.")]
Out = Annotated[Path, typer.Option("--out", "-o", help="Folder for everything that is written.")]
Mask = Annotated[
    Path | None,
    typer.Option(
        "--mask",
        metavar="FILE|FOLDER",
        help="Segmentation mask, or folder of masks named like the frames. [default: x.mask.png or masks/x.png "
        "beside x.jpg]",
    ),
]
ConfigFile = Annotated[
    str | None, typer.Option("--config", "-c", metavar="FILE|NAME", help="YAML file, or a name such as broadcast.")
]
Settings = Annotated[
    list[str] | None, typer.Option("--set", "-s", metavar="KEY=VALUE", help="Set section.key=value; repeatable.")
]
FieldName = Annotated[
    str | None, typer.Option("--field", metavar="NAME|FILE", help="Field template; see circlecal fields.")
]
Seed = Annotated[int | None, typer.Option("--seed", help="Seed of the random draws.")]
Radar = Annotated[bool, typer.Option("--radar", help="Also write the frame warped to the field plane.")]
NoOverlay = Annotated[bool, typer.Option("--no-overlay", help="Do not write overlay pictures.")]
Json = Annotated[bool, typer.Option("--json", help="Print results as JSON, one line each.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Log what is done.")]


def chosen_config(
    file: str | None,
    settings: Sequence[str] | None,
    field: str | None = None,
    seed: int | None = None,
    *,
    radar: bool = False,
    no_overlay: bool = False,
) -> Config:
    """The configuration of a command, its field template checked.

    Raises
    ------
    ConfigError
        As :func:`circlecal.config.load_config`.
    """
    from circlecal.api import field_template
    from circlecal.config import load_config

    overrides = list(settings or ())
    overrides += [] if field is None else [f"field.template={json.dumps(field)}"]
    overrides += [] if seed is None else [f"seed={seed}"]
    overrides += ["output.radar=true"] if radar else []
    overrides += ["output.overlay=false"] if no_overlay else []
    config = load_config(file, overrides)
    field_template(config)
    return config


def chosen_frames(inputs: Sequence[Path], out: Path, mask: Path | None) -> list[Frame]:
    """The frames among the inputs.

    Raises
    ------
    InputError
        As :func:`circlecal.formats.images.find_frames`, or the mask option does not fit.
    """
    from circlecal.errors import InputError
    from circlecal.formats.images import find_frames

    if mask is not None and not mask.exists():
        raise InputError(f"{mask}: no such mask file or folder")
    around_inputs = {folder for path in inputs for folder in (path.resolve(), *path.resolve().parents)}
    apart = [path for path in (out, mask) if path is not None and path.resolve() not in around_inputs]
    frames = find_frames(inputs, exclude=apart)
    if mask is not None and mask.is_file() and len(frames) > 1:
        raise InputError(f"{mask}: is one mask for {len(frames)} frames; give a folder of masks named like the frames")
    return frames
