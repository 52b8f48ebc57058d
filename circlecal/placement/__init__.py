"""Where a whole field lies about a circle that was seen: which of its circles that is, told by everything else that is
painted.

A circle that is seen and a focal length leave two planes (the circular sections of the cone over its image), and on
each the field may be turned about the circle. So every circle in the picture is taken for every circle and arc of the
field, with many focal lengths and turns; under each such camera the template is laid over the ridges of the picture,
and the one whose markings lie on ridges of their direction wins. Neither a halfway line nor a centre circle is needed.

``paint_maps`` (what is painted, and where) -> ``evidence`` (how far a view goes together with it) -> ``camera_batch``
(cameras before a circle) -> ``fit`` (cameras moved onto the paint) -> ``search``.
"""

from circlecal.placement.evidence import Outlines, ViewEvidence, mean_distance_px, share_on_surface, weigh_view
from circlecal.placement.paint_maps import (
    SeenPaint,
    SurfaceRidges,
    add_rims,
    distinct_circles,
    see_paint,
    see_surface,
)
from circlecal.placement.search import (
    LaidField,
    PlacedField,
    RoughPlacements,
    lay_over_view,
    refine_placements,
    search_placements,
)

__all__ = [
    "LaidField",
    "Outlines",
    "PlacedField",
    "RoughPlacements",
    "SeenPaint",
    "SurfaceRidges",
    "ViewEvidence",
    "add_rims",
    "distinct_circles",
    "lay_over_view",
    "mean_distance_px",
    "refine_placements",
    "search_placements",
    "see_paint",
    "see_surface",
    "share_on_surface",
    "weigh_view",
]
