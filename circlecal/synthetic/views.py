"""Which views the camera profiles draw from: places, zooms, aims, and what must be in the picture.

Distances and heights are those of main broadcast cameras; bounds on ``focal_px`` hold for a frame 1920 pixels wide.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

CameraProfile = Literal[
    "main",
    "wide",
    "high",
    "partial",
    "arc",
    "hard",
    "broadcast",
    "pitchside",
    "tactical",
    "side",
    "oblique",
    "short_arc",
    "no_halfway",
    "rink",
    "hall",
    "rink_zone",
    "court",
    "robot",
]
CAMERA_PROFILES: tuple[CameraProfile, ...] = get_args(CameraProfile)


@dataclass(frozen=True, slots=True)
class View:
    """What a profile draws from and what it accepts; pairs are (lowest, highest).

    ``circle_half_widths`` is about the circle's radius in half-widths of the frame; ``aim_share`` how far the centre
    mark may lie from the middle of the picture, in widths and heights (None: wherever the whole circle fits about);
    ``foreground_m`` how much ground before the near touchline may be seen at most; ``azimuth_deg`` ranges of where the
    camera stands, 0 at the near touchline, 90 behind the right goal (empty: 0); ``halfway_px``, ``halfway_most_px`` how
    much of the halfway line is seen, at a width of 1920; ``others_m`` how many metres of further markings at least.
    """

    distance_m: tuple[float, float] = (45.0, 90.0)
    height_m: tuple[float, float] = (8.0, 25.0)
    offset_m: float = 12.0
    roll_sd_deg: float = 1.0
    circle_half_widths: tuple[float, float] = (0.35, 0.99)
    aim_share: tuple[float, float] | None = None
    visible_share: tuple[float, float] = (1.0, 1.0)
    only_circle: bool = True
    halfway_px: float = 100.0
    foreground_m: float = np.inf
    azimuth_deg: tuple[tuple[float, float], ...] = ()
    halfway_most_px: float = np.inf
    others_m: float = 0.0
    focal_px: tuple[float, float] = (0.0, np.inf)


VIEWS: dict[str, View] = {
    "main": View(),
    "wide": View(offset_m=25.0),
    "partial": View(circle_half_widths=(0.4, 1.7), aim_share=(0.75, 0.6), visible_share=(0.4, 0.8)),
    "arc": View(
        circle_half_widths=(0.9, 2.4),
        aim_share=(1.3, 0.9),
        visible_share=(0.0, 1.0),
        focal_px=(5000.0, 16000.0),
        halfway_px=60.0,
    ),
    "high": View(height_m=(25.0, 40.0)),
    "low": View(
        height_m=(6.0, 10.0),
        roll_sd_deg=3.0,
        circle_half_widths=(0.25, 1.1),
        aim_share=(0.6, 0.3),
        visible_share=(0.45, 1.0),
        only_circle=False,
        foreground_m=12.0,
    ),
    "near": View(
        distance_m=(38.0, 45.0),
        height_m=(6.0, 15.0),
        roll_sd_deg=3.0,
        circle_half_widths=(0.3, 1.2),
        aim_share=(0.5, 0.3),
        visible_share=(0.45, 1.0),
        only_circle=False,
        foreground_m=12.0,
    ),
    "broadcast": View(
        distance_m=(50.0, 95.0),
        height_m=(12.0, 28.0),
        offset_m=6.0,
        circle_half_widths=(0.18, 0.6),
        aim_share=(0.4, 0.17),
        only_circle=False,
        focal_px=(1500.0, 4000.0),
        foreground_m=8.0,
    ),
    "pitchside": View(
        distance_m=(42.0, 80.0),
        height_m=(3.0, 7.0),
        offset_m=20.0,
        roll_sd_deg=2.0,
        circle_half_widths=(0.22, 0.8),
        aim_share=(0.45, 0.25),
        visible_share=(0.6, 1.0),
        only_circle=False,
    ),
    "tactical": View(
        distance_m=(45.0, 80.0),
        height_m=(9.0, 25.0),
        offset_m=15.0,
        circle_half_widths=(0.14, 0.4),
        aim_share=(0.35, 0.25),
        only_circle=False,
        focal_px=(700.0, 2200.0),
    ),
    "side": View(
        distance_m=(70.0, 105.0),
        height_m=(9.0, 26.0),
        offset_m=10.0,
        circle_half_widths=(0.14, 0.6),
        aim_share=(0.4, 0.3),
        visible_share=(0.7, 1.0),
        only_circle=False,
        azimuth_deg=((78.0, 102.0), (258.0, 282.0)),
    ),
    "oblique": View(
        distance_m=(55.0, 100.0),
        height_m=(9.0, 26.0),
        circle_half_widths=(0.16, 0.6),
        aim_share=(0.4, 0.3),
        visible_share=(0.7, 1.0),
        only_circle=False,
        azimuth_deg=((25.0, 78.0), (102.0, 258.0), (282.0, 335.0)),
    ),
    "short_arc": View(
        distance_m=(50.0, 95.0),
        height_m=(9.0, 26.0),
        circle_half_widths=(0.25, 0.9),
        aim_share=(0.75, 0.6),
        visible_share=(60.0 / 360.0, 140.0 / 360.0),
        only_circle=False,
        foreground_m=8.0,
        halfway_px=200.0,
        others_m=12.0,
    ),
    "no_halfway": View(
        distance_m=(50.0, 95.0),
        height_m=(9.0, 28.0),
        circle_half_widths=(0.2, 0.8),
        aim_share=(0.8, 0.5),
        visible_share=(0.2, 0.5),
        only_circle=False,
        foreground_m=8.0,
        halfway_px=0.0,
        halfway_most_px=0.0,
        others_m=25.0,
    ),
    "rink": View(
        distance_m=(26.0, 52.0),
        height_m=(9.0, 20.0),
        offset_m=7.0,
        circle_half_widths=(0.12, 0.36),
        aim_share=(0.4, 0.25),
        visible_share=(0.85, 1.0),
        only_circle=False,
        azimuth_deg=((0.0, 0.0), (0.0, 0.0), (60.0, 120.0), (-30.0, 30.0)),
    ),
    "hall": View(
        distance_m=(14.0, 34.0),
        height_m=(3.5, 10.0),
        offset_m=8.0,
        roll_sd_deg=1.5,
        circle_half_widths=(0.15, 0.5),
        aim_share=(0.4, 0.25),
        visible_share=(0.75, 1.0),
        only_circle=False,
        azimuth_deg=((0.0, 0.0), (-40.0, 40.0), (75.0, 105.0)),
    ),
    "rink_zone": View(
        distance_m=(30.0, 42.0),
        height_m=(9.0, 14.0),
        offset_m=3.0,
        circle_half_widths=(0.3, 0.65),
        aim_share=(0.55, 0.35),
        visible_share=(0.4, 1.0),
        only_circle=False,
        halfway_px=0.0,
        others_m=12.0,
    ),
    "court": View(
        distance_m=(20.0, 30.0),
        height_m=(5.0, 9.0),
        offset_m=3.0,
        circle_half_widths=(0.15, 0.27),
        aim_share=(0.4, 0.25),
        visible_share=(0.6, 1.0),
        only_circle=False,
        halfway_px=0.0,
        others_m=8.0,
    ),
    "robot": View(
        distance_m=(1.2, 3.6),
        height_m=(0.4, 1.1),
        offset_m=0.8,
        roll_sd_deg=3.0,
        circle_half_widths=(0.35, 0.95),
        aim_share=(0.3, 0.25),
        visible_share=(0.6, 1.0),
        only_circle=False,
        azimuth_deg=((250.0, 290.0),),
    ),
}
"""The profile ``hard`` is ``low`` or ``near``."""
