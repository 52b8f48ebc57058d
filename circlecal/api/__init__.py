"""What one calls from Python: calibrating pictures, points and videos, and reading results back."""

from circlecal.api.calibration import Calibration, SurePoints
from circlecal.api.calls import calibrate, calibrate_points, calibrate_video
from circlecal.api.exports import export
from circlecal.api.run import Run, load
from circlecal.api.transformer import ViewTransformer

__all__ = [
    "Calibration",
    "Run",
    "SurePoints",
    "ViewTransformer",
    "calibrate",
    "calibrate_points",
    "calibrate_video",
    "export",
    "load",
]
