"""How far what other people and programs saw can be trusted: one standard deviation per source."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

REFERENCE_WIDTH_PX = 1920.0
"""Width of the picture for which the standard deviations are given; they grow with the width."""


class SourcesConfig(BaseModel):
    """Standard deviations of points that come from files, in pixels at 1920 px width."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    soccernet_sigma_px: float = Field(
        1.5, gt=0, le=100, description="SoccerNet line annotations: points clicked by people, pixels at 1920 px width."
    )
    extremities_sigma_px: float = Field(
        4.0, gt=0, le=100, description="Extremities read off a segmentation, pixels at 1920 px width."
    )
    pnlcalib_sigma_px: float = Field(
        2.5,
        gt=0,
        le=100,
        description="PnLCalib or NBJW keypoints and line ends of full confidence, pixels at 1920 px width; divided by "
        "the root of the confidence.",
    )
    minimum_keypoint_confidence: float = Field(
        0.1, ge=0, le=1, description="Detected keypoints below this confidence are left out."
    )
    minimum_line_confidence: float = Field(
        0.3, ge=0, le=1, description="Detected lines with an end below this confidence are left out."
    )
    coco_sigma_px: float = Field(1.5, gt=0, le=100, description="COCO keypoints, pixels at 1920 px width.")
    cvat_sigma_px: float = Field(1.5, gt=0, le=100, description="CVAT annotations, pixels at 1920 px width.")
    labelstudio_sigma_px: float = Field(
        1.5, gt=0, le=100, description="Label Studio annotations, pixels at 1920 px width."
    )
    labelme_sigma_px: float = Field(1.5, gt=0, le=100, description="LabelMe annotations, pixels at 1920 px width.")

    gamestate_sigma_px: float = Field(
        1.5, gt=0, le=100, description="Lines of SoccerNet game states, pixels at 1920 px width."
    )

    halfway_ends: bool = Field(
        False,
        description="Whether a halfway line of a SoccerNet annotation that ends inside the picture ends there on the "
        "touchline.",
    )

    def sigma_px(self, source: str, width: int) -> float:
        """Standard deviation in pixels of one source's points in a picture of this width."""
        reference: float = getattr(self, f"{source}_sigma_px")
        return reference * width / REFERENCE_WIDTH_PX
