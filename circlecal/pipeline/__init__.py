"""The order of the stages, and what is tried again after a refusal: a frame goes in, every intermediate comes out.

One attempt measures the picture and estimates a calibration from what was measured (``attempts``). ``refinements`` look
at the picture once more where an attempt's own camera says what to look for; ``other_circles``, ``placed_field`` and
``field_lines`` take something else in the picture for what is looked for, ``discs`` the rim of a filled circle,
``field_choice`` another field (``leagues`` tells which sizes of a sport are worth it), ``paints`` the lines of one
colour alone. ``placed_view`` takes in all markings that a camera puts into view, and ``doubtful_circle`` refuses what
too few of them carry. ``clicks`` calibrates from points without a picture, and ``known_cameras`` tries a frame as one
known camera's after the other. Each attempt is a value of its own, so what is not taken leaves nothing behind.
"""

from circlecal.pipeline.clicks import run_observations
from circlecal.pipeline.field_choice import calibrate_unknown_field
from circlecal.pipeline.fields import Convention, apply_convention, field_of
from circlecal.pipeline.paints import calibrate_image
from circlecal.pipeline.run import run

__all__ = [
    "Convention",
    "apply_convention",
    "calibrate_image",
    "calibrate_unknown_field",
    "field_of",
    "run",
    "run_observations",
]
