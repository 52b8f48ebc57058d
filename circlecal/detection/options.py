"""Options of the built-in detector of markings. What separates right from wrong pictures everywhere alike is no option
but a constant beside the code that uses it.

Names that end in ``_px`` hold pixels at 1920 px width, which scale with the picture; those that do not scale
say so.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
_HalfAxis = Annotated[float, Field(gt=0.0, le=10.0)]
_Ratio = Annotated[float, Field(gt=0.0, le=1.0)]


class FieldRegionConfig(BaseModel):
    """Where the playing surface is, by its own dominant colour."""

    model_config = _STRICT

    area_share: float = Field(
        default=0.08,
        gt=0.0,
        lt=1.0,
        description="A field smaller than this share of the picture is no field (`no_field`).",
    )
    light: bool | None = Field(
        default=None,
        description="Whether of a colour's dark and light parts the light one is the surface, as ice is among dark"
        " stands; null as the field template's ground says.",
    )


class RidgeConfig(BaseModel):
    """Thin bright (or dark) structures: ridge points with their normals."""

    model_config = _STRICT

    sigma_px: float = Field(
        default=1.2, ge=0.6, le=4.0, description="Smoothing, in pixels of the searched picture and of its reductions."
    )
    threshold: float = Field(
        default=4.0,
        ge=1.0,
        le=50.0,
        description="Least response of a ridge, in medians of the positive response inside the field.",
    )


class HypothesisConfig(BaseModel):
    """Random ellipses through two points with their tangents and a third point, and which of them may be circles."""

    model_config = _STRICT

    draws: int = Field(default=12000, ge=100, le=1_000_000, description="Random triples of ridge points.")
    half_axis: tuple[_HalfAxis, _HalfAxis] = Field(
        default=(0.05, 1.2), description="Smallest and largest great half axis, in picture widths."
    )
    axis_ratio: tuple[_Ratio, _Ratio] = Field(
        default=(0.06, 1.0), description="Smallest and largest ratio of the axes."
    )
    tilt_deg: float = Field(
        default=35.0, ge=0.0, le=90.0, description="Largest tilt of the great axis, unless nearly round."
    )


class ProfilesConfig(BaseModel):
    """Profiles across a marking in the full picture, along which it is measured."""

    model_config = _STRICT

    reach_px: float = Field(default=9.0, gt=1.5, le=60.0, description="Half length of a circle's first profiles.")
    narrow_reach_px: float = Field(
        default=5.25, gt=1.5, le=60.0, description="Half length of the later profiles, which start from a fit."
    )
    line_reach_px: float = Field(default=15.0, gt=1.5, le=60.0, description="Half length of a line's first profiles.")
    width_share: float = Field(
        default=0.02,
        ge=0.0,
        le=0.2,
        description="A circle's profiles are longer by this share of the distance from its centre.",
    )


class AcceptanceConfig(BaseModel):
    """What a circle must show to be accepted; every gate must hold.

    The shares are those of the part inside the picture (by length and by angle) that shows a marking, and of the part
    inside the field that lies on ridge points.
    """

    model_config = _STRICT

    even_width: bool = Field(
        default=False,
        description="Whether a marking may be as wide everywhere in the picture, as rims are, and rings that were drawn"
        " into it.",
    )
    share: float = Field(
        default=0.74, ge=0.0, le=1.0, description="Smallest share of the visible circle that is drawn."
    )
    share_with_line: float = Field(
        default=0.68,
        ge=0.0,
        le=1.0,
        description="Smallest share of what is visible that is drawn, of a nearly whole circle with a halfway line.",
    )
    share_of_lone_arc: float = Field(
        default=0.85,
        ge=0.0,
        le=1.0,
        description="Smallest share of what is visible that is drawn, of an arc without a line.",
    )
    whole_share: float = Field(
        default=0.40, ge=0.0, le=1.0, description="Smallest share of the whole ellipse; a penalty arc has at most 0.35."
    )
    whole_share_with_line: float = Field(
        default=0.37,
        ge=0.0,
        le=1.0,
        description="Smallest share of the whole ellipse where a halfway line passes through its middle.",
    )
    rms_share: float = Field(
        default=0.004,
        ge=0.0,
        le=0.1,
        description="Residual that a nearly whole circle with a halfway line may always have, as a share of the great"
        " half axis: surfaces are not flat.",
    )


class HalfwayConfig(BaseModel):
    """The straight marking through the circle's middle."""

    model_config = _STRICT

    distance: float = Field(
        default=0.25,
        gt=0.0,
        le=1.0,
        description="Largest distance from the centre where the ellipse is the unit circle.",
    )


class DetectorConfig(BaseModel):
    """The built-in detector of field markings: no network, colour and shape alone."""

    model_config = _STRICT

    marking: Literal["light", "dark", "any"] | None = Field(
        default=None,
        description="Whether markings are lighter or darker than the surface; any tries both, light first; null as the"
        " field template says.",
    )
    rims: bool | None = Field(
        default=None,
        description="Whether the circle may be the rim of a painted disc or of a logo, which is an edge and no line,"
        " and is looked for where no line is found; null as the field template says.",
    )
    one_paint: bool | None = Field(
        default=None,
        description="Whether the markings are all in one paint, so that what is painted in another is none of them;"
        " null where those of the field template are.",
    )
    shared_halfway: bool | None = Field(
        default=None,
        description="Whether the halfway line may be painted over as another sport's, in a paint of its own, where none"
        " in the circle's paint is seen; null on grass, where few sports have lines through the circle's middle.",
    )
    detection_width_px: int = Field(
        default=960,
        ge=160,
        le=3840,
        description="Width to which larger pictures are reduced for the search (does not scale); smaller ones keep"
        " their size.",
    )
    enlarged_width_px: int = Field(
        default=640,
        ge=80,
        le=1920,
        description="Width to which smaller pictures are enlarged for the search (does not scale).",
    )
    thorough: bool = Field(
        default=True,
        description="Whether a picture without an accepted circle is searched a second time, more slowly.",
    )
    field_region: FieldRegionConfig = Field(default=FieldRegionConfig(), description="Search for the playing surface.")
    ridges: RidgeConfig = Field(default=RidgeConfig(), description="Ridge points.")
    hypotheses: HypothesisConfig = Field(default=HypothesisConfig(), description="Circle hypotheses.")
    refinement: ProfilesConfig = Field(default=ProfilesConfig(), description="Measurement in the full picture.")
    acceptance: AcceptanceConfig = Field(default=AcceptanceConfig(), description="Gates of the circle.")
    halfway: HalfwayConfig = Field(default=HalfwayConfig(), description="Halfway line.")
