"""Options of estimating what many frames of one camera share."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class RigConfig(BaseModel):
    """Options of ``circlecal rig``; the priors of what is shared are those of the section ``camera``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    least_frames: int = Field(2, ge=1, description="Fewer frames that agree on where the camera stands are no camera.")
    maximum_frames: int = Field(
        40, ge=1, le=2000, description="Frames of one camera that are estimated together: the best determined ones."
    )
    position_deviation_m: float = Field(
        0.05, ge=0, description="By how much the optical centre of one frame deviates from the camera's, metres."
    )
    roll_deviation_deg: float = Field(0.05, ge=0, description="How far the roll of a frame may deviate, degrees.")
    principal_point_deviation_px: float = Field(
        1.0, ge=0, description="How far the principal point of a frame may deviate, pixels at 1920 px width."
    )
    k1_deviation: float = Field(
        0.001, ge=0, description="How far the radial distortion of a frame may deviate, half-widths."
    )
    principal_point_by_zoom_px: float = Field(
        10.0,
        ge=0,
        description="Prior of how far the principal point moves while the focal length grows e-fold, pixels at 1920 px "
        "width; 0 for not at all.",
    )
    k1_by_zoom: float = Field(
        0.01,
        ge=0,
        description="Prior of how much the radial distortion changes while the focal length grows "
        "e-fold, about what broadcast zooms do where camera.k1_mean is null, else about 0.",
    )
    lever_m: float = Field(
        0.6,
        ge=-2.0,
        le=5.0,
        description="How far the optical centre usually lies before the axes about which the camera turns, metres: 0.1 "
        "to 1.3 m on real cameras.",
    )
    lever_sd_m: float = Field(0.4, ge=0, description="Its standard deviation, metres; 0 where the lever arm is known.")
    lean_sd_deg: float = Field(
        0.6,
        ge=0,
        description="How far the pan axis usually leans, degrees: the roll of standing broadcast cameras changes by "
        "-0.8 to 0.7 degrees by the sine of pan; 0 for an upright one.",
    )
    whole_share: float = Field(
        0.15,
        ge=0.05,
        le=1.0,
        description="Smallest share of the circle from which the detector measures a frame whose camera is known; "
        "alone a frame needs more, since an arc might be another one.",
    )
    share_of_lone_arc: float = Field(
        0.8, ge=0.0, le=1.0, description="Smallest share of what the picture holds of it that must be drawn."
    )
    maximum_chi_square_increase: float = Field(
        30.0,
        gt=0,
        description="A frame that fits the others this much worse than alone (difference of the sums of squared "
        "residuals in sigmas) is left out of the camera.",
    )
