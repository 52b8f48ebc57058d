"""Frozen result types: what each stage hands on, and the whole calibration of a frame.

Arrays are float64 unless said; nothing here computes. A field that is None was not reached or not determined.
"""

from circlecal.results.attempt import Attempt, FieldCandidate, Fitted, FrameCalibration, LikelySport, Rival
from circlecal.results.estimates import (
    CameraFit,
    Correspondences,
    DerivedPoint,
    FieldSize,
    HomographyFit,
    HomographyRegion,
    LineCorrespondence,
    OtherSize,
    PaintersFit,
    PointCorrespondence,
)
from circlecal.results.seen import (
    CIRCLE_ID,
    HALFWAY_ID,
    CircleCandidate,
    Cues,
    EdgePoints,
    EllipseFit,
    EllipseFits,
    Interpretation,
    LineCue,
    MarkCue,
    MarkingMask,
    RayPoints,
    SeenArc,
    Segment,
)
from circlecal.results.verdict import Agreement, Check, Evidence, Status, Surroundings, Verdict

__all__ = [
    "CIRCLE_ID",
    "HALFWAY_ID",
    "Agreement",
    "Attempt",
    "CameraFit",
    "Check",
    "CircleCandidate",
    "Correspondences",
    "Cues",
    "DerivedPoint",
    "EdgePoints",
    "EllipseFit",
    "EllipseFits",
    "Evidence",
    "FieldCandidate",
    "FieldSize",
    "Fitted",
    "FrameCalibration",
    "HomographyFit",
    "HomographyRegion",
    "Interpretation",
    "LikelySport",
    "LineCorrespondence",
    "LineCue",
    "MarkCue",
    "MarkingMask",
    "OtherSize",
    "PaintersFit",
    "PointCorrespondence",
    "RayPoints",
    "Rival",
    "SeenArc",
    "Segment",
    "Status",
    "Surroundings",
    "Verdict",
]
