"""Settings of the built-in marking detector.

Lengths are given at a picture width of 1280 px where a name ends in ``_px1280`` and scale with the width; they are
plain pixels of the detection picture where a name ends in ``_px``.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from circlecal.paint.bands import RefinementConfig

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
_HalfAxis = Annotated[float, Field(gt=0.0, le=10.0)]
_Ratio = Annotated[float, Field(gt=0.0, le=1.0)]


class FieldRegionConfig(BaseModel):
    """Where the playing surface is, by its own dominant colour."""

    model_config = _STRICT

    width_px: int = Field(
        default=240, ge=80, le=1280, description="Width of the reduced picture for the colour search."
    )
    upper_share_skipped: float = Field(
        default=0.25, ge=0.0, le=0.9, description="Upper share of the picture that does not vote."
    )
    dark_level: int = Field(
        default=22, ge=0, le=255, description="Pixels darker than this (8-bit L of Lab) never vote."
    )
    histogram_sigma: float = Field(default=2.0, ge=0.3, le=10.0, description="Smoothing of the a-b histogram, in bins.")
    peak_share: float = Field(
        default=0.04,
        gt=0.0,
        lt=1.0,
        description="A colour belongs to the field above this share of the histogram's peak.",
    )
    colour_reach: int = Field(
        default=22, ge=2, le=90, description="Largest distance from the peak colour, in a-b bins."
    )
    component_share: float = Field(
        default=0.10,
        gt=0.0,
        le=1.0,
        description="Further patches join the field above this share of the largest patch.",
    )
    local_share: float = Field(
        default=0.30,
        ge=0.0,
        lt=1.0,
        description="Places whose neighbourhood holds less field colour than this are left out.",
    )
    area_share: float = Field(
        default=0.08,
        gt=0.0,
        lt=1.0,
        description="A field smaller than this share of the picture is no field (`no_field`).",
    )


class RidgeConfig(BaseModel):
    """Thin bright (or dark) structures: ridge points with their normals."""

    model_config = _STRICT

    sigma_px: float = Field(default=1.2, ge=0.6, le=4.0, description="Smoothing at every pyramid level, in its pixels.")
    levels: int = Field(default=3, ge=1, le=5, description="Pyramid levels; each doubles the ridge width.")
    level_weight: float = Field(
        default=0.71, gt=0.0, le=2.0, description="Weight of a level's response relative to the next finer one."
    )
    threshold: float = Field(
        default=4.0,
        ge=1.0,
        le=50.0,
        description="Ridge threshold in medians of the positive response inside the field.",
    )
    minimum_contrast: float = Field(
        default=0.4, ge=0.0, le=50.0, description="Least second derivative across a ridge, grey levels."
    )
    chain_px1280: float = Field(
        default=9.0, ge=1.0, le=200.0, description="Shorter chains of ridge points are dropped."
    )


class LineConfig(BaseModel):
    """Straight markings among the ridge points."""

    model_config = _STRICT

    angle_bins: int = Field(default=180, ge=36, le=720, description="Directions over half a turn in the vote.")
    tolerance_px: float = Field(
        default=1.2, gt=0.1, le=10.0, description="Distance of a supporting point from its line."
    )
    angle_tolerance_deg: float = Field(default=12.0, gt=1.0, le=45.0, description="Largest difference of direction.")
    minimum_length: float = Field(
        default=0.16,
        gt=0.02,
        le=1.0,
        description="Shortest line that is taken out of the circle search, in picture widths.",
    )
    support: float = Field(
        default=0.5, gt=0.0, le=1.0, description="Smallest share of a line's length with ridge points."
    )
    gap: float = Field(
        default=0.03, gt=0.0, le=1.0, description="A gap longer than this ends a segment, in picture widths."
    )
    count: int = Field(default=16, ge=1, le=64, description="Largest number of lines.")


class HypothesisConfig(BaseModel):
    """Random conics through two points with their tangents and a third point."""

    model_config = _STRICT

    draws: int = Field(default=12000, ge=100, le=1_000_000, description="Random triples of ridge points.")
    tangent_tolerance_deg: float = Field(
        default=12.0, gt=1.0, le=45.0, description="Agreement of the third point's tangent."
    )
    chain_weight_px1280: float = Field(
        default=60.0,
        ge=1.0,
        le=1000.0,
        description="A point's weight grows with the length of its chain up to this length.",
    )
    half_axis: tuple[_HalfAxis, _HalfAxis] = Field(
        default=(0.05, 1.2), description="Smallest and largest great half axis, in picture widths."
    )
    axis_ratio: tuple[_Ratio, _Ratio] = Field(
        default=(0.06, 1.0), description="Smallest and largest ratio of the axes."
    )
    tilt_deg: float = Field(
        default=35.0, ge=0.0, le=90.0, description="Largest tilt of the great axis, unless nearly round."
    )
    round_ratio: float = Field(default=0.6, gt=0.0, le=1.0, description="Axis ratio from which any tilt is allowed.")
    centre_margin: float = Field(
        default=0.15, ge=0.0, le=2.0, description="How far outside the picture the centre may lie, in picture widths."
    )
    scored: int = Field(default=1500, ge=10, le=100_000, description="Most hypotheses that are scored.")
    kept: int = Field(default=6, ge=1, le=50, description="Distinct best hypotheses that are fitted again.")


class AcceptanceConfig(BaseModel):
    """What a circle must show to be accepted; every gate must hold.

    The shares are those of the part inside the picture (by length and by angle) that shows a marking, and of the part
    inside the field that lies on ridge points.
    """

    model_config = _STRICT

    share: float = Field(
        default=0.74, ge=0.0, le=1.0, description="Smallest share of the visible circle that is drawn."
    )
    share_with_line: float = Field(
        default=0.68,
        ge=0.0,
        le=1.0,
        description="The same for a nearly whole circle with a halfway line through its middle.",
    )
    share_of_lone_arc: float = Field(
        default=0.85, ge=0.0, le=1.0, description="The same for a part of a circle without a halfway line."
    )
    complete_share: float = Field(
        default=0.60, ge=0.0, le=1.0, description="Least share of the whole that is nearly whole."
    )
    whole_share: float = Field(
        default=0.40, ge=0.0, le=1.0, description="Smallest share of the whole ellipse; a penalty arc has at most 0.35."
    )
    whole_share_with_line: float = Field(
        default=0.37, ge=0.0, le=1.0, description="The same when a halfway line passes through the circle's middle."
    )
    band_width: float = Field(
        default=0.005,
        ge=0.0,
        le=0.1,
        description="Smallest width of the band on the field, in radii; a ring drawn into the picture shows none.",
    )
    rms_px1920: float = Field(default=1.8, gt=0.0, le=20.0, description="Largest residual, in px at 1920 px width.")
    rms_px: float = Field(
        default=0.5,
        ge=0.0,
        le=20.0,
        description="Residual in px of the picture that a nearly whole circle with a halfway line may always have.",
    )
    rms_share: float = Field(
        default=0.004, ge=0.0, le=0.1, description="The same as a share of the great half axis: surfaces are not flat."
    )


class LikelyConfig(BaseModel):
    """What a circle must show to be likely: worn, mostly hidden, or a short arc, but with its halfway line.

    A likely circle counts only if something else confirms it later: another marking at its place, or the centre mark.
    """

    model_config = _STRICT

    share: float = Field(default=0.5, ge=0.0, le=1.0, description="Smallest share of the visible circle that is drawn.")
    painted_share: float = Field(
        default=0.55,
        ge=0.0,
        le=1.0,
        description="The same of the sectors in which paint stands out on average: for faint paint, which single places"
        " do not show; ellipses stitched from streaks have less than half.",
    )
    whole_share: float = Field(
        default=0.14, ge=0.0, le=1.0, description="Smallest share of the whole ellipse that is drawn."
    )
    gapless_share: float = Field(
        default=0.65,
        ge=0.0,
        le=1.0,
        description="As `share`, for an arc without a line through its middle, which other lines must confirm.",
    )
    arc_share: float = Field(
        default=0.12,
        ge=0.0,
        le=1.0,
        description="Smallest share of a circle that is drawn without a gap where it is taken for an arc of the field.",
    )
    side_share: float = Field(
        default=0.02,
        ge=0.0,
        le=0.5,
        description="Smallest share of the whole on either side of the line, where the picture shows more than twice as"
        " much of it; a penalty arc has one side only.",
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
    support: float = Field(
        default=0.4, gt=0.0, le=1.0, description="Smallest supported share of the chord inside the circle."
    )
    support_with_rest: float = Field(
        default=0.18,
        gt=0.0,
        le=1.0,
        description="The same where the line is drawn outside the circle too, by `support` of its visible length.",
    )
    extent: float = Field(default=2.0, ge=1.0, le=10.0, description="How far the line is followed, in half chords.")


class FirstPassConfig(BaseModel):
    """The first, quick pass over a picture, in which most circles are found."""

    model_config = _STRICT

    width_px: int = Field(
        default=960,
        ge=160,
        le=3840,
        description="Width of its picture, where `detection_width_px` is not smaller; 720 finds the same circles"
        " sooner, but fewer other lines.",
    )
    effort: float = Field(
        default=0.25, gt=0.0, le=1.0, description="Share of the hypotheses that are drawn and scored."
    )


class SecondPassConfig(BaseModel):
    """The second, slower pass over a picture in which the first found no certain circle."""

    model_config = _STRICT

    threshold: float = Field(default=2.8, ge=1.0, le=50.0, description="Ridge threshold, as `ridges.threshold`.")
    flat_width_px: int = Field(
        default=1440,
        ge=160,
        le=3840,
        description="Width of the picture that is searched for very flat circles where no circle is found otherwise.",
    )
    flattest: float = Field(default=0.03, gt=0.0, le=1.0, description="Smallest ratio of the axes there.")
    effort: int = Field(
        default=3, ge=1, le=20, description="How many times as many hypotheses are drawn, scored, kept and measured."
    )


class DetectorConfig(BaseModel):
    """The built-in detector of field markings: no network, colour and shape alone."""

    model_config = _STRICT

    marking: Literal["light", "dark", "any"] = Field(
        default="light",
        description="Whether markings are lighter or darker than the surface; any tries both, light first.",
    )
    one_paint: bool = Field(
        default=True,
        description="Whether the markings are all in one paint, so that what is painted in another is none of them.",
    )
    detection_width_px: int = Field(
        default=960,
        ge=160,
        le=3840,
        description="Width to which larger pictures are reduced for the second pass; smaller ones keep their size.",
    )
    enlarged_width_px: int = Field(
        default=640, ge=80, le=1920, description="Width to which smaller pictures are enlarged for the search."
    )
    field_region: FieldRegionConfig = Field(default=FieldRegionConfig(), description="Search for the playing surface.")
    ridges: RidgeConfig = Field(default=RidgeConfig(), description="Ridge points.")
    lines: LineConfig = Field(default=LineConfig(), description="Straight markings.")
    hypotheses: HypothesisConfig = Field(default=HypothesisConfig(), description="Circle hypotheses.")
    refinement: RefinementConfig = Field(default=RefinementConfig(), description="Measurement at full resolution.")
    acceptance: AcceptanceConfig = Field(default=AcceptanceConfig(), description="Gates of the circle.")
    likely: LikelyConfig = Field(default=LikelyConfig(), description="Gates of a circle that needs a confirmation.")
    halfway: HalfwayConfig = Field(default=HalfwayConfig(), description="Halfway line.")
    thorough: bool = Field(
        default=True, description="Whether a picture without a certain circle is searched a second time, more slowly."
    )
    first_pass: FirstPassConfig = Field(default=FirstPassConfig(), description="The first search.")
    second_pass: SecondPassConfig = Field(default=SecondPassConfig(), description="The second search.")
    candidates: int = Field(default=3, ge=1, le=20, description="Most candidates that are measured and reported.")
    near_points: bool = Field(
        default=False,
        description="Whether hypotheses of points near each other are drawn too where no circle is found: the second"
        " pass does.",
    )

    @property
    def sign(self) -> float:
        """1 where a pass looks for markings lighter than the surface, -1 for darker ones."""
        return -1.0 if self.marking == "dark" else 1.0
