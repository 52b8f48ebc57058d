"""``venue.yaml``: the cameras around a pitch, and the pitch, as a run found them and the next one starts with them.

Every value has its standard deviation beside it, and the file may be written or changed by hand: a person who has
measured the pitch writes its length with a small ``sd``. Lengths are absolute; the template that they are compared with
is that of the reader's configuration.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from circlecal.camera.options import KnownCamera
from circlecal.camera.priors import SHARED, ZOOMED, SharedPrior, SharedPriorConfig, ZoomLens
from circlecal.config import AUTO, FieldConfig
from circlecal.errors import InputError, explain_problem
from circlecal.field import FieldTemplate, field_names
from circlecal.files import write_atomic
from circlecal.geometry.camera_parameters import INDEX
from circlecal.geometry.homography import side_of_place
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface, SurfaceShape
from circlecal.results.numbers import show_with_sigma
from circlecal.rig.tripod import COMMON, PLACE, PaintersShare, TripodEstimate, Venue, unwrap_pan
from circlecal.yaml_text import YamlError, dump_yaml, read_yaml

VENUE_NAME = "venue.yaml"
VENUE_VERSION = 1
_UNITS = {
    **dict.fromkeys(("lean_x", "lean_y", "head_roll"), "rad"),
    **dict.fromkeys(("pp_x", "pp_y", "pp_x_by_zoom", "pp_y_by_zoom"), "px"),
    **dict.fromkeys(("kappa_1", "kappa_1_by_zoom", "kappa_1_by_focal", "kappa_2", "log_aspect"), ""),
}
"""Of the tripod's parameters; all others are in metres."""
_NAMES = {"width": "marking_width_m", "length": "pitch_length_m", "breadth": "pitch_width_m"}
FILE_NAMES = tuple(
    _NAMES.get(name, "_".join(part for part in (name, _UNITS.get(name, "m")) if part)) for name in COMMON
)
"""Names of the tripod's parameters in the file, with their units."""
_SIZES = ("width", "length", "breadth")
_HEAD_STEPS = 9
"""Positions of the head, along pan and tilt each, over which a prior for single frames is averaged: enough that the
mean of the sine over 90 degrees is met to a thousandth.
"""
_LEAST_SD = 1e-6
"""Added to what is known exactly, metres, radians and pixels, so that the covariance can be inverted: far below what a
picture shows.
"""
_FAR_SD = 3.0
"""Standard deviations that hardly anything lies beside what is known of it."""
DEGREES = 180.0 / np.pi
_MOST = 1e9
"""Metres, pixels or radians: far more than anything around a pitch has, and its powers are finite still."""

_WIDEST_SD, _SIZE_SLACK = 5.0, 0.2
"""A pitch is within so many standard deviations of its template's size, or within what the rules allow, give or take
this share of it: more than grounds differ and surveys err.
"""

Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class KnownValue(_Part):
    """A value with its standard deviation; 0 fixes it."""

    mean: float = Field(ge=-_MOST, le=_MOST)
    sd: float = Field(ge=0, le=_MOST)


class SurfacePart(_Part):
    """Profile of the pitch, and the radius at which its crown is quoted, metres."""

    shape: SurfaceShape
    crown_radius_m: float = Field(gt=0)


class Range(_Part):
    """From where to where the head has been seen to move; focal lengths in pixels of the stated picture size."""

    pan_deg: tuple[Finite, Finite]
    tilt_deg: tuple[Finite, Finite]
    focal_px: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]]


def _mirror_rows(rows: Sequence[Sequence[float]], matrix: Array) -> Array:
    """A symmetric matrix (K, K) with the last of its rows as far as they are written, each from its first number."""
    for k, row in enumerate(rows, start=len(matrix) - len(rows)):
        matrix[k, : len(row)] = matrix[: len(row), k] = row
    return matrix


def _require_distribution(name: str, matrix: Array) -> None:
    """Refuse a matrix (K, K) that is no covariance of anything.

    Raises
    ------
    ValueError
        It has a negative eigenvalue.
    """
    if np.linalg.eigvalsh(matrix).min() < -1e-6:
        raise ValueError(f"{name} is that of no distribution: it has a negative eigenvalue")


class PaintersPart(_Part):
    """Covariance of the parameters if painters made no errors, its rows up to the diagonal, and how the parameters
    follow each painters' error of one standard deviation, all in standard deviations of the parameters: where a person
    changes one of these, what painters leave open of it changes with it.
    """

    covariance: list[list[Finite]]
    by_errors: dict[str, list[Finite]]

    @model_validator(mode="after")
    def _complete(self) -> Self:
        count = len(FILE_NAMES)
        if [len(row) for row in self.covariance] != list(range(1, count + 1)):
            raise ValueError(f"covariance needs {count} rows with 1 to {count} numbers")
        for name, values in self.by_errors.items():
            if len(values) != count:
                raise ValueError(f"by_errors.{name} needs {count} numbers")
        _require_distribution("covariance", self._whole())
        return self

    @classmethod
    def of(cls, share: PaintersShare, sd: Array) -> Self:
        """What the file has of a share, for parameters with standard deviations (K,)."""
        share = share.resize(np.divide(1.0, sd, out=np.zeros_like(sd), where=sd > 0.0))
        rows = [row[: k + 1] for k, row in enumerate(share.covariance.tolist())]
        return cls(covariance=rows, by_errors={name: values.tolist() for name, values in share.by_errors.items()})

    def share(self, sd: Array) -> PaintersShare:
        """The share of parameters with standard deviations (K,)."""
        return PaintersShare(self._whole(), {name: np.array(v) for name, v in self.by_errors.items()}).resize(sd)

    def _whole(self) -> Array:
        return _mirror_rows(self.covariance, np.zeros((len(FILE_NAMES), len(FILE_NAMES))))


class TripodPart(_Part):
    """One camera."""

    name: str = Field(pattern=r"^[\w.-]+$")
    picture_px: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    reference_focal_px: float = Field(gt=0)
    surface: SurfacePart
    parameters: dict[str, KnownValue]
    correlation: list[list[Annotated[float, Field(ge=-1.0, le=1.0)]]] = []
    painters: PaintersPart | None = None
    range: Range
    frames: list[str] = []
    left_out: list[str] = []

    @model_validator(mode="after")
    def _complete(self) -> Self:
        unknown = sorted(set(self.parameters) - set(FILE_NAMES))
        if unknown:
            raise ValueError(f"parameters.{unknown[0]} is unknown; known: {', '.join(FILE_NAMES)}")
        missing = [name for name in FILE_NAMES if name not in self.parameters]
        if missing:
            raise ValueError(f"parameters.{missing[0]} is missing")
        if self.parameters["axis_z_m"].mean > 0.0:
            raise ValueError("parameters.axis_z_m is below the ground: above it, z is negative")
        if self.correlation and [len(row) for row in self.correlation] != list(range(1, len(FILE_NAMES))):
            raise ValueError(f"correlation needs {len(FILE_NAMES) - 1} rows with 1 to {len(FILE_NAMES) - 1} numbers")
        _require_distribution("correlation", self.correlations())
        return self

    def correlations(self) -> Array:
        """Correlation matrix (K, K); what is not written is 0."""
        return _mirror_rows(self.correlation, np.eye(len(FILE_NAMES)))

    def sds(self) -> Array:
        """Standard deviations (K,) of the parameters, without what painters' errors add."""
        return np.array([self.parameters[name].sd for name in FILE_NAMES])

    def whole_sds(self) -> Array:
        """Standard deviations (K,) of the parameters with painters' errors."""
        sd = self.sds()
        return sd if self.painters is None else np.sqrt(np.diag(self.painters.share(sd).whole))

    def estimate(self, template: FieldTemplate) -> TripodEstimate:
        """The camera, its sizes as offsets from a template's."""
        mean, sd = np.array([self.parameters[name].mean for name in FILE_NAMES]) - _offsets(template), self.sds()
        low, high = (
            np.array([np.log(self.range.focal_px[k]), *np.radians([self.range.pan_deg[k], self.range.tilt_deg[k]])])
            for k in (0, 1)
        )
        pan = (low[1] + high[1]) / 2.0
        turn = np.array([0.0, unwrap_pan(pan, mean[:2]) - pan, 0.0])
        return TripodEstimate(
            name=self.name,
            size=self.picture_px,
            log_focal=float(np.log(self.reference_focal_px)),
            surface=Surface(self.surface.shape, self.surface.crown_radius_m, float(mean[PLACE["crown"]])),
            mean=mean,
            covariance=self.correlations() * np.outer(sd, sd),
            head_low=low + turn,
            head_high=high + turn,
            used=tuple(self.frames),
            left_out=tuple(self.left_out),
            painters=None if self.painters is None else self.painters.share(sd),
        )

    @classmethod
    def of(cls, tripod: TripodEstimate, template: FieldTemplate) -> Self:
        """A camera as the file has it."""
        mean = (tripod.mean + _offsets(template)).tolist()
        sd = np.sqrt(np.diag(tripod.covariance))
        size = np.where(sd > 0, sd, 1.0)
        correlation = np.clip(tripod.covariance / np.outer(size, size), -1.0, 1.0)
        low, high = tripod.head_low, tripod.head_high
        pan, tilt = ((float(np.degrees(low[k])), float(np.degrees(high[k]))) for k in (1, 2))
        return cls(
            name=tripod.name,
            picture_px=tripod.size,
            reference_focal_px=float(np.exp(tripod.log_focal)),
            surface=SurfacePart(shape=tripod.surface.shape, crown_radius_m=tripod.surface.reference_m),
            parameters={
                name: KnownValue(mean=m, sd=s) for name, m, s in zip(FILE_NAMES, mean, sd.tolist(), strict=True)
            },
            correlation=[correlation[row, :row].tolist() for row in range(1, len(FILE_NAMES))],
            painters=None if tripod.painters is None else PaintersPart.of(tripod.painters, sd),
            range=Range(pan_deg=pan, tilt_deg=tilt, focal_px=(float(np.exp(low[0])), float(np.exp(high[0])))),
            frames=list(tripod.used),
            left_out=list(tripod.left_out),
        )


class VenueFile(_Part):
    """The whole file."""

    venue_version: int
    field: str
    config_digest: str | None = None
    clip: str | None = None
    clip_bytes: int | None = None
    paint_bgr: tuple[Finite, Finite, Finite] | None = None
    tripods: list[TripodPart] = []

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if self.venue_version != VENUE_VERSION:
            raise ValueError(f"venue_version is {self.venue_version}; this version reads {VENUE_VERSION}")
        names = [tripod.name for tripod in self.tripods]
        doubled = sorted({name for name in names if names.count(name) > 1})
        if doubled:
            raise ValueError(f"tripods: the name {doubled[0]} is used twice")
        return self


def read_venue(path: Path, template: FieldTemplate) -> Venue:
    """Cameras and pitch from a venue file.

    Parameters
    ----------
    path : Path
        The file.
    template : FieldTemplate
        The field; sizes of the pitch become offsets from its.

    Raises
    ------
    InputError
        Unreadable, damaged, of another field, or with a pitch of a size that the field cannot have: one line with the
        file, the key and the mend.
    """
    content = read_venue_file(path)
    if content.field != template.name:
        mend = "give its --field"
        if content.field not in field_names():
            mend = f"give its --field as a file, if it is your own; known: {', '.join(field_names())}"
        raise InputError(f"{path}: field: is {content.field}, not {template.name}; {mend}")
    for number, tripod in enumerate(content.tripods):
        _require_sizes(f"{path}: tripods.{number}.parameters", tripod, template)
    return Venue(content.field, tuple(tripod.estimate(template) for tripod in content.tripods), content.paint_bgr)


def _require_sizes(where: str, tripod: TripodPart, template: FieldTemplate) -> None:
    """See that a pitch is about as long and as broad as its field can be; fields of one size are that size.

    Raises
    ------
    InputError
        It is not, with the parameter after ``where``.
    """
    spreads = template.length_sd_m, template.width_sd_m
    for name, extent, sd in zip(("pitch_length_m", "pitch_width_m"), template.extents, spreads, strict=True):
        low, high = extent.range_m or (extent.size_m - _WIDEST_SD * sd, extent.size_m + _WIDEST_SD * sd)
        low, high, size = low * (1.0 - _SIZE_SLACK), high * (1.0 + _SIZE_SLACK), tripod.parameters[name].mean
        if not low <= size <= high:
            told = f"{where}.{name}: is {size:g}, and {template.name} has {low:.3g} to {high:.3g} m"
            raise InputError(f"{told}; correct it, or the file's field")


def choose_field(path: Path, chosen: FieldConfig, named: str | None) -> str | None:
    """The field of a run with a venue: the venue's, where the user named none or asked for ``auto``.

    Parameters
    ----------
    path : Path
        The venue file.
    chosen : FieldConfig
        What configuration and single options say of the field.
    named : str, optional
        The field that the user named beside them.

    Raises
    ------
    InputError
        Unreadable or damaged.
    """
    configured = None if chosen.template == FieldConfig().template else chosen.template
    if (configured if named is None else named) not in (None, AUTO):
        return named
    field = read_venue_file(path).field
    return field if field in field_names() else named


def read_venue_file(path: Path) -> VenueFile:
    """Content of a venue file.

    Raises
    ------
    InputError
        Unreadable or damaged.
    """
    try:
        content = read_yaml(path)
    except YamlError as error:
        where = f", line {error.line}" if error.line else ""
        raise InputError(f"{path}{where}: cannot be read: {error}; give a {VENUE_NAME}") from error
    if not isinstance(content, dict) or "venue_version" not in content:
        if path.suffix == ".jsonl":
            raise InputError(f"{path}: holds results, not a venue; give the {VENUE_NAME} of circlecal track or rig")
        is_prior = isinstance(content, dict) and not content.keys().isdisjoint(("position_m", "camera"))
        way = "--camera-prior takes the file of one camera, " * is_prior + f"circlecal track and rig write {VENUE_NAME}"
        raise InputError(f"{path}: is no venue: venue_version is missing; {way}")
    if isinstance(content.get("tripods"), list):
        content["tripods"] = [_straighten(camera) for camera in content["tripods"]]
    try:
        return VenueFile.model_validate_json(json.dumps(content, default=str), strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise InputError(
            f"{path}: {where}{': ' * bool(where)}{explain_problem(first['type'], first['msg'])}"
        ) from error


def _straighten(camera: Any) -> Any:
    """A camera of a file, with the bend of its lens; one of an earlier version, which has the parameters before that
    alone, with a lens that does not bend. What is damaged stays as it is, to be told where it is checked.
    """
    match camera:
        case {"parameters": dict(parameters)} if set(parameters) == set(FILE_NAMES[:-1]):
            found = {**camera, "parameters": {**parameters, FILE_NAMES[-1]: {"mean": 0.0, "sd": 0.0}}}
        case _:
            return camera
    match camera:
        case {"correlation": [_, *_] as rows}:
            found["correlation"] = [*rows, [0.0] * len(parameters)]
    match camera:
        case {"painters": {"covariance": list(rows), "by_errors": dict(by_errors)} as painters}:
            more = {name: [*values, 0.0] if isinstance(values, list) else values for name, values in by_errors.items()}
            covariance = [*rows, [0.0] * len(FILE_NAMES)]
            found["painters"] = {**painters, "covariance": covariance, "by_errors": more}
    return found


def write_venue(
    path: Path,
    venue: Venue,
    template: FieldTemplate,
    config_digest: str | None = None,
    clip: str | None = None,
    clip_bytes: int | None = None,
) -> None:
    """Write a venue file, with a summary for its reader on top.

    Parameters
    ----------
    path, venue : Path, Venue
        The file, and its content.
    template : FieldTemplate
        The field from whose sizes those of the tripods are offsets.
    config_digest : str, optional
        Of the run that found the venue.
    clip : str, optional
        Name of the clip in which it was found.
    clip_bytes : int, optional
        Size of the file of that clip.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    content = VenueFile(
        venue_version=VENUE_VERSION,
        field=venue.field,
        config_digest=config_digest,
        clip=clip,
        clip_bytes=clip_bytes,
        paint_bgr=venue.paint_bgr,
        tripods=[TripodPart.of(tripod, template) for tripod in venue.tripods],
    )
    header = ["# A venue for --venue: where its cameras stand and turn, their lenses, and the pitch.", *_facts(content)]
    body = dump_yaml(content.model_dump(mode="json"))
    write_atomic(path, ("\n".join(header) + "\n" + body).encode())


def venue_settings(path: Path, template: FieldTemplate) -> list[str]:
    """Settings of the sections ``camera``, ``correspondences`` and ``mask`` for single frames of the cameras of a
    venue, as ``section.key=value``.

    Raises
    ------
    InputError
        As :func:`read_venue`, or the venue has no camera.
    """
    venue = read_venue(path, template)
    if not venue.tripods:
        raise InputError(f"{path}: tripods: is empty; a prior of single frames needs a camera")
    first, *others = [_known_camera(tripod).model_dump(mode="json") for tripod in venue.tripods]
    values: dict[str, Any] = {"correspondences.camera_side": first.pop("camera_side")}
    values |= {f"camera.{name}": value for name, value in first.items()} | {"camera.others": others}
    if venue.paint_bgr is not None:
        values["mask.paint_bgr"] = list(venue.paint_bgr)
    return [f"{key}={json.dumps(value)}" for key, value in values.items()]


def _known_camera(tripod: TripodEstimate) -> KnownCamera:
    """What single frames are told of a camera."""
    prior = prior_of_tripod(tripod)
    place = [prior.parameters.index(name) for name in ("x", "y", "z")]
    x, y, z = prior.mean[place].tolist()
    sd_x, sd_y, sd_z = prior.frame_sd[place].tolist()
    return KnownCamera(
        name=tripod.name,
        position_m=(x, y, z),
        position_sd_m=(sd_x, sd_y, sd_z),
        shared=SharedPriorConfig.of(prior, tripod.size[0]),
        crown_shape=tripod.surface.shape,
        camera_side=side_of_place((x, y)),
    )


def prior_of_tripod(tripod: TripodEstimate) -> SharedPrior:
    """What a tripod says of a frame whose pan and tilt are not known.

    Position, roll and lens follow the head. Over the range in which the head was seen they have a mean and a spread:
    the spread becomes the deviation that a single frame is allowed, and what is uncertain of the tripod itself the
    covariance. What is fixed is known as well, to next to nothing.
    """
    low, high = tripod.head_low, tripod.head_high
    pan, tilt = (np.linspace(low[k], high[k], _HEAD_STEPS) for k in (1, 2))
    heads = np.stack(np.meshgrid([tripod.log_focal], pan, tilt, indexing="ij"), axis=-1).reshape(-1, 3)
    thetas = tripod.model.thetas(heads, tripod.mean)
    mapping = tripod.model.derivatives(heads, tripod.mean)[1].mean(axis=0)
    at, slopes = [INDEX[name] for name in SHARED], [PLACE[f"{name}_by_zoom"] for name in ZOOMED]
    both = np.concatenate([mapping[at], np.eye(len(tripod.mean))[slopes]])
    covariance = both @ tripod.whole_covariance @ both.T
    covariance[np.diag_indices_from(covariance)] += _LEAST_SD**2
    return SharedPrior(
        parameters=SHARED,
        zoomed=ZOOMED,
        log_focal=tripod.log_focal,
        mean=np.concatenate([thetas.mean(axis=0)[at], tripod.mean[slopes]]),
        covariance=covariance,
        deviation_sd=thetas.std(axis=0)[at],
        lens=ZoomLens(0.0, float(tripod.mean[PLACE["kappa_1_by_focal"]]), tripod.size[0]),
    )


def describe_changes(known: TripodEstimate, found: TripodEstimate) -> str:
    """The parameters of a tripod, as the file names them, that are more than three of the standard deviations that are
    stated of them from where they were known, farthest first, with how many; empty where none is.
    """
    sd = np.sqrt(np.diag(known.covariance))
    away = np.abs(np.divide(found.mean - known.mean, sd, out=np.zeros_like(sd), where=sd > 0.0))
    order = [int(k) for k in np.argsort(-away) if away[k] > _FAR_SD]
    return ", ".join(f"{FILE_NAMES[k]} by {away[k]:.1f}" for k in order)


def _offsets(template: FieldTemplate) -> Array:
    """What is added to the tripod's parameters (K,) for the file, which has sizes where they have offsets."""
    offsets = np.zeros(len(COMMON))
    offsets[[PLACE[name] for name in _SIZES]] = template.marking_width_m, template.length_m, template.width_m
    return offsets


def _facts(content: VenueFile) -> list[str]:
    """What a person wants to know of each camera, as comments."""

    def describe(tripod: TripodPart, name: str, factor: float = 1.0) -> str:
        sd = float(tripod.whole_sds()[FILE_NAMES.index(name)])
        return show_with_sigma(factor * tripod.parameters[name].mean, factor * sd)

    lines = []
    for tripod in content.tripods:
        x, y, z = (describe(tripod, f"axis_{axis}_m") for axis in "xyz")
        lines.append(f"# {tripod.name}, {len(tripod.frames)} frames: axis at ({x}, {y}, {z}) m; lever arm")
        lines.append(
            f"#   {describe(tripod, 'lever_m')} m; lean {describe(tripod, 'lean_x_rad', DEGREES)} and "
            f"{describe(tripod, 'lean_y_rad', DEGREES)} degrees; pitch {describe(tripod, 'pitch_length_m')} x "
            f"{describe(tripod, 'pitch_width_m')} m"
        )
    return lines
