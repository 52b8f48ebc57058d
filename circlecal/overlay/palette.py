"""Colours (BGR) that readers with any colour vision tell apart, on turf, ice and wood (Okabe and Ito 2008)."""

from __future__ import annotations

Color = tuple[int, int, int]

BLACK: Color = (0, 0, 0)
WHITE: Color = (255, 255, 255)
GREY: Color = (150, 150, 150)
ORANGE: Color = (0, 159, 230)
SKY: Color = (233, 180, 86)
GREEN: Color = (115, 158, 0)
YELLOW: Color = (66, 228, 240)
BLUE: Color = (255, 130, 40)
"""Lighter than Okabe and Ito's, which is too dark on a dimmed picture."""
VERMILION: Color = (20, 94, 225)
PURPLE: Color = (200, 121, 204)

TEMPLATE = SKY
CIRCLE = YELLOW
POINT = VERMILION
TANGENT = PURPLE
INLIER = ORANGE
ACCEPTED = GREEN
REFUSED = VERMILION
EDGE_COLORS: dict[str, Color] = {"outer": VERMILION, "inner": BLUE, "center": YELLOW}
CLASS_COLORS: dict[int, Color] = {7: YELLOW, 18: SKY, 17: PURPLE}
