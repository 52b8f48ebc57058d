"""Picture -> field hull, ridge points, straight lines, circle hypotheses, marking mask. No network."""

from circlecal.detection.detector import detect
from circlecal.detection.options import DetectorConfig
from circlecal.detection.result import CircleHypothesis, Detection

__all__ = ["CircleHypothesis", "Detection", "DetectorConfig", "detect"]
