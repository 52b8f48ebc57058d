"""The markings of a picture, found by colour and shape alone, or by users' networks.

:mod:`detector` takes the field (:mod:`field_region`) and searches it in passes (:mod:`one_pass`): ridge points
(:mod:`ridges`), straight runs (:mod:`lines`), ellipses through the others (:mod:`ellipse_search` on
:mod:`ellipse_batch`). The best are measured in the full picture (:mod:`circle`, :mod:`halfway`, :mod:`arcs`), and
:mod:`candidates` chooses the circle. Where its camera leaves much open, :mod:`short_lines` looks once more.
:mod:`marking_mask` draws what was found. :mod:`networks` and :mod:`keypoints` run models in ONNX format instead, and
:mod:`given_mask` sorts the markings of a user's mask.
"""

from circlecal.detection.circle import CircleHypothesis
from circlecal.detection.detector import Detection, detect
from circlecal.detection.options import DetectorConfig

__all__ = ["CircleHypothesis", "Detection", "DetectorConfig", "detect"]
