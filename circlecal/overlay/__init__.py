"""Result to pictures: draws what a calibration holds, for refused frames too, and never estimates anything."""

from circlecal.overlay.frame_overlay import draw_overlay, draw_readable_overlay
from circlecal.overlay.radar import draw_radar
from circlecal.overlay.stage_pictures import contact_sheet, stage_pictures

__all__ = ["contact_sheet", "draw_overlay", "draw_radar", "draw_readable_overlay", "stage_pictures"]
