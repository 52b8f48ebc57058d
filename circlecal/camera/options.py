"""Options of the camera's fit, and the priors that they state."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat

from circlecal.camera.observed import NoiseModel
from circlecal.camera.picture_shape import square_of_width_left, usual_log_aspect, usual_point_sd
from circlecal.camera.priors import Priors, SharedPriorConfig, ZoomLens
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, KAPPA_1, LOG_ASPECT, LOG_FOCAL, PARAMETERS, ProjectionModel
from circlecal.geometry.homography import Side
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import SurfaceShape
from circlecal.geometry.window import Window

Spreads = tuple[NonNegativeFloat, NonNegativeFloat, NonNegativeFloat]
AboveGround = tuple[float, float, Annotated[float, Field(le=0)]]

BROADCAST_ZOOM = ZoomLens(far=0.035, by_focal=0.04, width=1)
"""Lens of broadcast zooms, in pictures one pixel wide. Fitted to 34 real frames of a dozen grounds that many
lines calibrate (0.0358 and 0.0412; -0.034 at 0.8 widths, -0.004 at 0.95, 0.013 at 1.5, 0.03 from 1.8 on), from which
single frames differ by 0.0074; of 11 real clips, which were not used, the two ends of the zoom differ by 0.007.
"""
BEND_SD = 0.02
"""How far the bend of a lens (``by_focal``) may be from that: half as far as one without a bend. The two ends of the
zoom differ by 0.007 between real lenses, for which 0.009 of it is enough; the rest leaves it to the frames of a clip to
tell of other lenses. Beside rendered lenses without a bend a fixed one of 0.04 took the error of a clip of zooms from
0.3 to 0.9 px.
"""
USUAL_FOCAL_WIDTHS = 2.0
"""Focal length, picture widths, whose lens is taken where one must be had before the focal length is known."""


class KnownCamera(BaseModel):
    """What is known of one of several cameras; keys of the same names in the sections ``camera`` and
    ``correspondences`` say what they are.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str = Field(description="Its name, as the results have it.")
    position_m: AboveGround = Field(description="Where it stands, metres.")
    position_sd_m: Spreads = Field(description="Prior standard deviation of that, metres.")
    shared: SharedPriorConfig = Field(description="What its other frames say of it.")
    crown_shape: SurfaceShape = Field(description="Profile of the pitch, as it was found with this camera.")
    camera_side: Side = Field(description="Side of the field on which it stands.")


class CameraConfig(BaseModel):
    """Options of the stage ``camera``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    enabled: bool = Field(
        True, description="Whether a camera is estimated; without it the homography of the closed forms is the result."
    )
    focal_px: float | None = Field(
        None,
        gt=0,
        description="Focal length where it is known, as of a lens without zoom that was calibrated, pixels of the "
        "picture as stored; null where it is not.",
    )
    focal_sd: float = Field(
        0.005, gt=0, le=1, description="Its standard deviation, as a share of it; used where focal_px is given."
    )
    principal_point_sd_px: float | None = Field(
        None,
        ge=0,
        description="Prior of the principal point about the image centre, pixels at 1920 px width; 0 fixes it. null: "
        "15, and up to 250 for pictures of a shape that no camera has (16:9, 4:3, 3:2, 2:3, ... within 1 %), since "
        "these were cut out of larger ones.",
    )
    window_px: Window | None = Field(
        None,
        description="The part of the picture that the camera took, at whose middle the lens points: columns before it, "
        "rows before it, its width and its height, pixels. null: all of the picture, without plain bars or a plain "
        "wall around it.",
    )
    distortion: Literal["none", "radial"] = Field(
        "radial",
        description="Lens model: none for pictures whose distortion was taken out, or radial with the priors below.",
    )
    k1_mean: float | None = Field(
        None,
        description="Prior mean of the radial distortion, half-widths: positive for pincushion, negative for barrel; "
        "null for that of broadcast zooms, which follows the focal length f as 0.035 - 0.04 (width / f)^2; in pictures "
        "that were cut out of larger ones, as principal_point_sd_px tells them, with 0.035 times the square of the "
        "share of the width that is left, 0.62 on the average.",
    )
    k1_sd: float = Field(
        0.015,
        ge=0,
        description="Prior standard deviation of it; larger where nothing is known of the lens, 0 fixes it.",
    )
    other_lens_share: float = Field(
        0.05,
        ge=0,
        lt=1,
        description="Share of frames whose lens has any distortion, four times as far from the usual one: it is "
        "thought of where what is seen pulls the distortion away from k1_mean by more than k1_sd.",
    )
    k2_mean: float = Field(0.0, description="Prior mean of the second radial coefficient, half-widths.")
    k2_sd: float = Field(0.0, ge=0, description="Prior standard deviation of it; 0 fixes it.")
    aspect: float | None = Field(
        None,
        gt=0.2,
        lt=5,
        description="Pixel aspect fy / fx, the width of a pixel over its height, over what a video's file says. null: "
        "what the file says, else 1, and of pictures of 720 x 576, 720 x 480 and other sizes of standard television, "
        "whose pixels are never square, that of 16:9 or of 4:3, which the picture must tell: 1.422 or 1.067 for "
        "720 x 576, 1.185 or 0.889 for 720 x 480.",
    )
    aspect_sd: float = Field(
        0.0, ge=0, description="Prior standard deviation of its logarithm, beside that of an unknown one; 0 fixes it."
    )
    crown_m: float = Field(
        0.05, ge=-0.5, le=1, description="Prior mean of the drop of the pitch at |y| = 9.15 m, metres."
    )
    crown_sd_m: float = Field(0.03, ge=0, description="Prior standard deviation of it; 0 fixes it.")
    crown_shape: Literal["auto", SurfaceShape] = Field(
        "auto",
        description="Profile of the pitch across its length; auto: a roof, unless the frame clearly shows a parabola. "
        "hip: a roof whose ends fall as its sides do; `circlecal track` says so where it fits a clip better.",
    )
    relief_m: float = Field(
        0.015,
        ge=0,
        description="How far grass at a mark lies above or below the profile of the field, one standard deviation, "
        "metres. In five real clips the centre mark is seen 0.1 to 1.2 px, 1.3 cm rms, off where all frames together "
        "put it, always the same way.",
    )
    usual_size_share: float = Field(
        0.94,
        ge=0,
        le=1,
        description="Share of fields that are of the template's size; the others are of any size that its rules allow. "
        "A smaller share refuses more fields whose size little of what is seen tells.",
    )
    other_length_share: float = Field(
        0.5,
        ge=0,
        le=1,
        description="Of these others, the share that has the template's width and only another length.",
    )
    flat_share: float = Field(
        0.25, ge=0, lt=1, description="Share of fields that are flat; the others have the crown of crown_m."
    )
    roll_sd_deg: float = Field(
        3.0,
        ge=0,
        description="Prior standard deviation of the camera's roll about 0, degrees: 1 on a "
        "levelled tripod, more where the camera is held by hand or flies.",
    )
    position_m: AboveGround | None = Field(
        None,
        description="Where the camera stands, where that is known: metres from the centre mark, y positive towards "
        "the main camera, z negative above the ground; null where it is not.",
    )
    position_sd_m: Spreads = Field(
        (0.5, 0.5, 0.5), description="Prior standard deviation of the position, metres, where one is given."
    )
    shared: SharedPriorConfig | None = Field(
        None, description="What other frames of the same camera say of it, as `circlecal rig` writes it, or null."
    )
    name: str | None = Field(None, description="Name of that camera, as the results are to have it, or null.")
    others: tuple[KnownCamera, ...] = Field(
        (),
        description="Further cameras that are known: one after the other is tried on a frame that is refused as one of "
        "the camera of position_m and shared. `--venue` with a file of several cameras fills this in.",
    )
    distance_radii: float = Field(
        7.0, gt=0, description="Usual distance of a camera from the circle's centre, in its radii."
    )
    distance_log_sd: float | None = Field(
        0.6, gt=0, description="Standard deviation of its logarithm; null for no prior."
    )
    elevation_deg: float = Field(
        15.0, ge=0, le=90, description="Usual angle under which a camera looks down on the circle's centre."
    )
    elevation_sd_deg: float | None = Field(10.0, gt=0, description="Its standard deviation; null for no prior.")
    bloom_sd_px: float = Field(
        0.3, ge=0, description="Prior of how far blur moves each edge outwards, pixels; 0 fixes it at 0."
    )
    width_sd_m: float | None = Field(
        None, ge=0, description="Prior of the marking width about the template's; null takes the template's."
    )
    loss_scale: float = Field(6.0, gt=0, description="Scale of the Geman-McClure loss, standard deviations.")
    model_sigma_px: float = Field(
        0.3,
        ge=0,
        description="What lens, crown and paint leave of an ideal marking, pixels at 1920 px width.",
    )
    close_sigma_px: float = Field(
        0.1,
        ge=0,
        description="The same where nothing but the circle, its line and its mark are seen, all in a small part of the"
        " field; more where the residuals show more.",
    )
    correlation_px: float = Field(
        60.0,
        ge=0,
        description="Over which length neighbouring points repeat each other's error, pixels at 1920 px width.",
    )
    maximum_points: int = Field(
        240, ge=10, le=100000, description="Points per marking; more are averaged along the marking."
    )
    starts: int = Field(8, ge=1, le=200, description="How many starts of the grid are followed where the arc is short.")
    name_lines: bool = Field(
        True,
        description="Whether straight markings that were seen without a name are matched with the template and used.",
    )
    iterations: int = Field(60, ge=1, le=1000, description="Upper limit of the optimiser's steps.")
    noise_from_residuals: bool = Field(
        True, description="Whether standard deviations grow to what the residuals and their correlation show."
    )

    def principal_point_sd(self, width: int, height: int) -> tuple[float, float]:
        """Standard deviations of the principal point about the middle of a picture's window, along its width and its
        height, in its own pixels.
        """
        width, height = self.size_of_window(width, height)
        if self.principal_point_sd_px is None:
            return usual_point_sd(width, height)
        told = self.principal_point_sd_px * width / 1920.0
        return told, told

    def size_of_window(self, width: int, height: int) -> tuple[int, int]:
        """Width and height of what a camera took of a picture of this size, in its own pixels."""
        if self.window_px is None:
            return width, height
        return round(self.window_px.width), round(self.window_px.height)

    def principal_point_shift(self, width: int, height: int) -> Array:
        """How far the middle of a picture's window lies from the picture's own (2,), pixels."""
        return np.zeros(2) if self.window_px is None else self.window_px.shift_of_middle(width, height)

    def growth_of_distortion(self, width: int) -> float:
        """How many times as large the usual radial distortion is in half-widths of a picture so wide as in those of its
        window; 1 where it is told for the whole picture.
        """
        if self.window_px is None or self.k1_mean is not None:
            return 1.0
        return (width / self.window_px.width) ** 2

    def log_aspect(self, width: int, height: int) -> tuple[float, float]:
        """Mean and standard deviation of the logarithm of fy / fx for pictures of this size."""
        mean, sd = usual_log_aspect(width, height) if self.aspect is None else (float(np.log(self.aspect)), 0.0)
        return mean, float(np.hypot(sd, self.aspect_sd))

    @property
    def usual_crown(self) -> SurfaceShape:
        """The profile that is tried first."""
        return "roof" if self.crown_shape == "auto" else self.crown_shape


def relief_of(config: CameraConfig, template: FieldTemplate) -> float:
    """How far a mark lies above or below the profile of the field, metres: floors, ice and flat fields have none."""
    return config.relief_m if template.ground == "grass" and config.crown_shape != "flat" else 0.0


def noise_model(config: CameraConfig, width: int) -> NoiseModel:
    """How many points of a marking are used, and what their standard deviations leave out, for a frame this wide."""
    unit = width / 1920.0
    return NoiseModel(config.maximum_points, config.model_sigma_px * unit, config.correlation_px * unit)


def priors_of(config: CameraConfig, template: FieldTemplate, circle: Circle, model: ProjectionModel) -> Priors:
    """Priors as means and standard deviations of the parameter vector."""
    mean, sd = np.zeros(len(PARAMETERS)), np.full(len(PARAMETERS), np.inf)
    if config.focal_px is not None:
        mean[LOG_FOCAL], sd[LOG_FOCAL] = np.log(config.focal_px), config.focal_sd
    sd[INDEX["roll"]] = np.radians(config.roll_sd_deg)
    if config.position_m is not None:
        mean[4:7], sd[4:7] = config.position_m, config.position_sd_m
    mean[7:9] = config.principal_point_shift(model.width, model.height)
    sd[7:9] = config.principal_point_sd(model.width, model.height)
    radial = config.distortion == "radial"
    grown = config.growth_of_distortion(model.width)
    usual = grown * usual_kappa(config, USUAL_FOCAL_WIDTHS, (model.width, model.height)), grown * config.k1_sd
    mean[KAPPA_1], sd[KAPPA_1] = usual if radial else (0.0, 0.0)
    mean[10], sd[10] = (config.k2_mean, config.k2_sd) if radial else (0.0, 0.0)
    mean[LOG_ASPECT], sd[LOG_ASPECT] = config.log_aspect(model.width, model.height)
    flat = config.crown_shape == "flat"
    mean[INDEX["crown"]], sd[INDEX["crown"]] = (0.0, 0.0) if flat else (config.crown_m, config.crown_sd_m)
    sd[INDEX["width"]] = template.marking_width_sd_m if config.width_sd_m is None else config.width_sd_m
    sd[INDEX["bloom"]] = config.bloom_sd_px
    sd[INDEX["length"]], sd[INDEX["breadth"]] = template.length_sd_m, template.width_sd_m
    shared = None
    if config.shared is not None:
        shared = config.shared.prior(model.width).only([name for name in PARAMETERS if sd[INDEX[name]] > 0])
        sd[shared.indices], mean[shared.indices] = np.inf, shared.mean[: len(shared.parameters)]
    free = has_position(config)
    return Priors(
        mean=mean,
        sd=sd,
        distance_m=config.distance_radii * circle.radius_m,
        distance_log_sd=np.inf if config.distance_log_sd is None or free else config.distance_log_sd,
        elevation_rad=np.radians(config.elevation_deg),
        elevation_sd_rad=np.inf if config.elevation_sd_deg is None or free else np.radians(config.elevation_sd_deg),
        center_m=np.asarray(circle.center, dtype=np.float64),
        shared=shared,
        lens=zoom_lens(config, (model.width, model.height)) if radial and np.isfinite(sd[KAPPA_1]) else None,
    )


def zoom_lens(config: CameraConfig, size: tuple[int, int]) -> ZoomLens | None:
    """How the radial distortion follows the focal length in pictures of a width and height; None where its mean is
    told.

    Of a picture that has the share s of a larger one's width W, ``s^2 (k1_far - by_focal (W / f)^2)`` counts in its own
    half-widths. With its own width sW that is ``s^2 k1_far - by_focal (s W / f)^2``: only the long end is another one.
    """
    if config.k1_mean is not None:
        return None
    grown, told = config.growth_of_distortion(size[0]), BROADCAST_ZOOM
    far = told.far - _shortfall_at_long_end(config, size)
    return replace(told, far=grown * far, by_focal=grown * told.by_focal, width=config.size_of_window(*size)[0])


def _shortfall_at_long_end(config: CameraConfig, size: tuple[int, int]) -> float:
    """By how much less lenses distort pictures of a size, half-widths, which were cut out of larger ones; 0 for whole
    ones, as all are where the user tells that the principal point is near their middle.
    """
    is_whole = config.principal_point_sd_px is not None
    left = 1.0 if is_whole else square_of_width_left(*config.size_of_window(*size))
    return (1.0 - left) * BROADCAST_ZOOM.far


def usual_kappa(config: CameraConfig, focal_widths: float, size: tuple[int, int] = (1920, 1080)) -> float:
    """The radial distortion that is expected in pictures of a width and height of a lens whose focal length is so many
    picture widths, half-widths.
    """
    if config.k1_mean is not None:
        return config.k1_mean
    return float(BROADCAST_ZOOM.kappa(np.log(focal_widths))) - _shortfall_at_long_end(config, size)


def usual_kappa_by_zoom(config: CameraConfig, focal_widths: float) -> float:
    """By how much the radial distortion is expected to grow, half-widths, while the focal length of a lens, so many
    picture widths, grows e-fold.
    """
    return float(BROADCAST_ZOOM.slope(np.log(focal_widths))) if config.k1_mean is None else 0.0


def usual_k1_by_focal(config: CameraConfig) -> float:
    """How the radial distortion of a lens is expected to bend with the focal length (``by_focal`` of
    :class:`circlecal.camera.priors.ZoomLens`); 0 where its mean is told, or there is none.
    """
    return BROADCAST_ZOOM.by_focal if config.k1_mean is None and config.distortion == "radial" else 0.0


def has_position(config: CameraConfig) -> bool:
    """Whether the camera's position has a prior."""
    shared = config.shared is not None and {"x", "y", "z"} <= set(config.shared.parameters)
    return shared or config.position_m is not None
