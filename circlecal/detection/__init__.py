"""Picture -> field hull, ridge points, straight lines, circle hypotheses, marking mask; and users' networks."""

from circlecal.detection.circle import CircleHypothesis
from circlecal.detection.detector import Detection, detect
from circlecal.detection.options import DetectorConfig

__all__ = ["CircleHypothesis", "Detection", "DetectorConfig", "detect"]
