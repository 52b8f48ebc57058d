"""Picture -> field hull, ridge points, straight lines, circle hypotheses, marking mask. No network."""

from circlecal.detection.circle import CircleHypothesis
from circlecal.detection.detector import Detection, detect
from circlecal.detection.options import DetectorConfig

__all__ = ["CircleHypothesis", "Detection", "DetectorConfig", "detect"]
