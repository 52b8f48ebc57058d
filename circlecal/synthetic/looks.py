"""Random looks of a picture by scene profile: light, ground, paint, camera, graphics, and the way to the file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from circlecal.synthetic.scene import Color, Delivery, RenderConfig

Changes = dict[str, Any]

_COMPRESSED_SHARE = 0.7
"""Of the frames of other sports: single pictures of them are mostly taken from videos."""
_DEFOCUS_PX = {"easy": (0.4, 0.8), "hard": (0.8, 1.8)}
_TEAMS: tuple[Color, ...] = (
    (235, 235, 235),
    (45, 40, 190),
    (170, 70, 30),
    (225, 175, 110),
    (40, 40, 40),
    (40, 200, 235),
    (60, 150, 60),
    (120, 40, 100),
    (60, 110, 240),
)
_TURFS: tuple[Color, ...] = (
    (38, 112, 70),
    (22, 128, 92),
    (50, 120, 48),
    (44, 92, 58),
    (30, 100, 84),
    (62, 118, 92),
    (28, 84, 42),
    (20, 140, 104),
)
_ODD_TURFS: tuple[Color, ...] = (
    (58, 98, 122),  # brown, dried out
    (70, 118, 138),
    (62, 142, 152),  # yellow
    (52, 128, 134),
    (112, 122, 112),  # grey artificial
    (96, 104, 100),
    (24, 46, 30),  # dark
    (30, 58, 26),
    (140, 96, 44),  # blue artificial
    (56, 74, 128),  # red clay
    (66, 150, 66),  # bright artificial
)
_FLOORS: tuple[Color, ...] = (
    (128, 178, 214),
    (104, 156, 200),
    (84, 128, 172),
    (150, 190, 216),
    (70, 104, 146),
    (150, 128, 84),  # blue plastic
    (96, 120, 84),  # green plastic
    (146, 148, 150),  # grey plastic
)


def sample_config(profile: str, rng: np.random.Generator, width: int = 1920) -> RenderConfig:
    """A random look: day or night, turf, wear, blur, noise; blur scales with the picture's width."""
    unit = width / 1920.0
    hard = profile == "hard"
    night = bool(rng.random() < 0.5)
    first, second = rng.choice(len(_TEAMS), 2, replace=False)
    turf = np.asarray(_TURFS[rng.integers(len(_TURFS))]) * rng.uniform(0.95, 1.2)
    white = rng.uniform(195, 235)
    usual = RenderConfig(
        marking_width_m=float(rng.uniform(0.1, 0.12) if profile == "easy" else rng.uniform(0.08, 0.12)),
        paint_bgr=(white - 4.0, white, white - 2.0),
        paint_opacity=float(rng.uniform(0.5, 0.85) if hard else rng.uniform(0.65, 0.95)),
        wear=float(rng.uniform(0.3, 0.8) if hard else rng.uniform(0.0, 0.35)),
        turf_bgr=(float(turf[0]), float(turf[1]), float(turf[2])),
        stripe_width_m=float(rng.uniform(4.5, 7.5)),
        stripe_contrast=float(rng.uniform(0.0, 0.1)),
        cross_stripes=bool(rng.random() < 0.2),
        texture=float(rng.uniform(0.01, 0.035)),
        patchiness=float(rng.uniform(0.01, 0.07)),
        shade=float(rng.uniform(0.25, 0.5)) if not night and rng.random() < 0.35 and profile != "easy" else 0.0,
        shade_edge_m=float(rng.uniform(-25, 20)),
        shade_tilt=float(rng.uniform(-0.4, 0.4)),
        vignette=float(rng.uniform(0.0, 0.2)),
        haze=float(rng.uniform(0.0, 0.2)),
        board_distance_m=float(rng.uniform(3.0, 6.0)),
        crowd_density=float(rng.uniform(0.3, 0.97)),
        stand_light=float(rng.uniform(0.3, 0.6) if night else rng.uniform(0.5, 0.95)),
        team_bgr=(_TEAMS[first], _TEAMS[second]),
        shadow_count=4 if night else 1,
        shadow_strength=float(rng.uniform(0.08, 0.18) if night else rng.uniform(0.2, 0.45)),
        shadow_length=float(rng.uniform(0.9, 1.6) if night else rng.uniform(0.5, 2.0)),
        shadow_rad=float(rng.uniform(0, 2 * np.pi)),
        defocus_px=float(unit * rng.uniform(*_DEFOCUS_PX.get(profile, (0.5, 1.1)))),
        motion_px=float(unit * rng.uniform(2.0, 7.0)) if hard and rng.random() < 0.5 else 0.0,
        motion_rad=float(rng.normal(0.0, 0.15)),
        sharpening=float(rng.uniform(0.0, 0.8)),
        noise=float(rng.uniform(1.5, 4.0) if hard else rng.uniform(0.6, 1.8)),
        jpeg_quality=int(rng.integers(60, 85) if hard else rng.integers(80, 95)),
        scorebug=bool(rng.random() < 0.4),
    )
    change = _CHANGES.get(profile)
    return usual if change is None else RenderConfig.model_validate({**usual.model_dump(), **change(rng, unit)})


def sample_delivery(profile: str, rng: np.random.Generator, size: tuple[int, int]) -> Delivery:
    """How a picture reaches a file of a size."""
    if profile == "archive":
        return _archive_delivery(rng, size)
    if profile in ("rink", "court", "robots") and rng.random() < _COMPRESSED_SHARE:
        return Delivery(chroma_step=2, block_quality=int(rng.integers(30, 75)))
    return _bars(rng, size) if profile == "letterbox" else Delivery()


def archive_format(rng: np.random.Generator) -> tuple[tuple[int, int], tuple[int, int]]:
    """Size with square pixels and stored size of old video."""
    formats = (
        ((398, 224), (398, 224)),
        ((640, 360), (640, 360)),
        ((480, 360), (480, 360)),
        ((848, 478), (848, 478)),
        ((768, 576), (720, 576)),
        ((1024, 576), (720, 576)),
        ((640, 480), (720, 480)),
    )
    return formats[rng.choice(len(formats), p=(0.14, 0.14, 0.1, 0.14, 0.2, 0.18, 0.1))]


def _archive_delivery(rng: np.random.Generator, size: tuple[int, int]) -> Delivery:
    standard = size[1] in (480, 576)
    pan = float(rng.choice((-1.0, 1.0)) * rng.uniform(1.0, 9.0)) if standard and rng.random() < 0.7 else 0.0
    # pictures on the web are often enlarged from what the tape held
    factor = 2 if not pan and rng.random() < 0.25 else 1
    return Delivery(
        interlace_px=pan,
        size=(factor * size[0], factor * size[1]) if factor > 1 else None,
        chroma_step=int(rng.choice((4, 6))) if standard else 2,
        block_quality=int(rng.integers(22, 55)) if factor == 1 else int(rng.integers(45, 75)),
    )


def _bars(rng: np.random.Generator, size: tuple[int, int]) -> Delivery:
    """Bars inside a frame: a cinema picture, an old one of 4:3, a screen recording, a picture in a phone's frame."""
    width, height = size
    kind = str(rng.choice(("wide", "old", "window", "uneven"), p=(0.35, 0.35, 0.15, 0.15)))
    tall = round(rng.uniform(0.09, 0.14) * height)
    side = round(rng.uniform(0.11, 0.14) * width)
    low = round(rng.uniform(0.05, 0.16) * height)
    left, top, right, bottom = {
        "wide": (0, tall, 0, tall),
        "old": (side, 0, side, 0),
        "window": (side // 2, tall // 2, side // 2, tall // 2),
        "uneven": (0, low // 3, 0, low),
    }[kind]
    grey = float(rng.choice((0.0, 0.0, 16.0, 30.0)))
    return Delivery(
        bars_px=(left, top, right, bottom),
        bar_bgr=(grey, grey, grey),
        blurred_bars=bool(rng.random() < 0.25),
        chroma_step=2,
        block_quality=int(rng.integers(55, 90)),
    )


def _shade(rng: np.random.Generator, unit: float) -> Changes:
    exposure = float(rng.uniform(1.05, 1.5))
    return {
        "shade": float(rng.uniform(0.45, 0.75)),
        "shade_edge_m": float(rng.uniform(-8, 9)),
        "shade_tilt": float(np.clip(rng.normal(0.0, 0.7), -2.0, 2.0))
        if rng.random() < 0.6
        else float(rng.uniform(-2.0, 2.0)),
        "shade_depth_m": float(rng.uniform(6, 22)) if rng.random() < 0.3 else 400.0,
        "shade_soft_m": float(rng.uniform(0.2, 1.5)),
        "sun_patches": float(rng.uniform(0.2, 0.7)) if rng.random() < 0.3 else 0.0,
        "exposure": exposure,
        "shadow_count": 1,
        "shadow_strength": float(rng.uniform(0.3, 0.55)),
        "shadow_length": float(rng.uniform(0.8, 3.0)),
        "stand_light": float(rng.uniform(0.3, 0.7)),
    }


def _draw_wear(rng: np.random.Generator, unit: float) -> Changes:
    return {
        "paint_opacity": float(rng.uniform(0.4, 0.75)),
        "wear": float(rng.uniform(0.5, 0.95)),
        "wear_scale_m": float(rng.uniform(0.2, 1.2)),
        "line_gaps": float(rng.uniform(0.0, 0.3)),
        "patchiness": float(rng.uniform(0.04, 0.14)),
        "texture": float(rng.uniform(0.02, 0.05)),
        "noise": float(rng.uniform(0.8, 2.5)),
    }


def _graphics(rng: np.random.Generator, unit: float) -> Changes:
    return {
        "scorebug": True,
        "round_logos": bool(rng.random() < 0.5),
        "graphics": {
            "rings": int(rng.integers(0, 5)),
            "drawn_lines": int(rng.integers(0, 4)),
            "logo": bool(rng.random() < 0.8),
            "lower_third": bool(rng.random() < 0.45),
            "ticker": bool(rng.random() < 0.25),
            "watermark": bool(rng.random() < 0.3),
        },
    }


def _banners(rng: np.random.Generator, unit: float) -> Changes:
    return {
        "scorebug": True,
        "graphics": {
            "banners": int(rng.integers(1, 3)),
            "logo": bool(rng.random() < 0.8),
            "watermark": bool(rng.random() < 0.3),
        },
    }


def _repaint(rng: np.random.Generator, unit: float) -> Changes:
    return {
        "wear": float(rng.uniform(0.2, 0.7)),
        "wear_scale_m": float(rng.uniform(0.3, 2.0)),
        "paint_opacity": float(rng.uniform(0.55, 0.9)),
    }


def _colours(rng: np.random.Generator, unit: float) -> Changes:
    turf = np.asarray(_ODD_TURFS[rng.integers(len(_ODD_TURFS))]) * rng.uniform(0.9, 1.1)
    pattern = rng.choice(("none", "stripes", "squares", "across", "oblique", "rings"))
    directions = {"across": np.pi / 2, "oblique": float(rng.uniform(0.3, 1.2))}
    white = float(rng.uniform(215, 245))
    return {
        "turf_bgr": tuple(float(v) for v in turf),
        "paint_bgr": (white - 4.0, white, white - 2.0),
        "stripe_contrast": 0.0 if pattern == "none" else float(rng.uniform(0.05, 0.2)),
        "stripe_width_m": float(rng.uniform(2.5, 8.0)),
        "stripe_rad": directions.get(str(pattern), 0.0),
        "cross_stripes": pattern == "squares",
        "mown_rings": pattern == "rings",
        "patchiness": float(rng.uniform(0.02, 0.12)),
        "marking_width_m": float(rng.uniform(0.1, 0.12)),
    }


def _night(rng: np.random.Generator, unit: float) -> Changes:
    cast = np.array([rng.uniform(0.75, 1.1), 1.0, rng.uniform(0.85, 1.15)])
    return {
        "exposure": float(rng.uniform(0.42, 0.85)),
        "cast_bgr": tuple(float(v) for v in cast),
        "light_pools": float(rng.uniform(0.1, 0.6)),
        "stand_light": float(rng.uniform(0.08, 0.35)),
        "sky_bgr": (8.0, 6.0, 6.0),
        "shadow_count": 4,
        "shadow_strength": float(rng.uniform(0.08, 0.2)),
        "shade": 0.0,
        "noise": float(rng.uniform(2.0, 6.0)),
        "vignette": float(rng.uniform(0.1, 0.35)),
        "defocus_px": float(unit * rng.uniform(0.6, 1.4)),
    }


def _haze(rng: np.random.Generator, unit: float) -> Changes:
    return {
        "haze": float(rng.uniform(0.15, 0.55)),
        "veil": float(rng.uniform(0.1, 0.45)),
        "precipitation": float(rng.uniform(0.2, 1.0)) if rng.random() < 0.5 else 0.0,
        "shade": 0.0,
        "shadow_strength": float(rng.uniform(0.0, 0.08)),
        "defocus_px": float(unit * rng.uniform(0.7, 1.5)),
    }


def _blur(rng: np.random.Generator, unit: float) -> Changes:
    return {
        "motion_px": float(unit * rng.uniform(5.0, 18.0)),
        "motion_rad": float(rng.normal(0.0, 0.12) if rng.random() < 0.8 else rng.uniform(0, np.pi)),
        "defocus_px": float(unit * rng.uniform(0.6, 2.0)),
    }


def _amateur(rng: np.random.Generator, unit: float) -> Changes:
    """A ground without stands: a fence, trees or sky."""
    if rng.random() < 0.4:
        return {"near_crowd": bool(rng.random() < 0.4)}
    sky = rng.uniform(170, 250)
    return {
        "stand_height_m": float(rng.uniform(0.0, 9.0)),
        "crowd_density": float(rng.uniform(0.0, 0.3)),
        "sky_bgr": (float(min(255.0, sky * 1.05)), float(sky), float(sky * 0.92)),
        "wear": float(rng.uniform(0.1, 0.6)),
    }


def _archive(rng: np.random.Generator, unit: float) -> Changes:
    return {
        "defocus_px": float(rng.uniform(0.3, 0.9)),
        "sharpening": float(rng.uniform(0.2, 1.4)),
        "noise": float(rng.uniform(1.0, 4.0)),
        "cast_bgr": (float(rng.uniform(0.85, 1.1)), 1.0, float(rng.uniform(0.9, 1.12))),
        "marking_width_m": float(rng.uniform(0.1, 0.12)),
    }


def _near_stand(rng: np.random.Generator, unit: float) -> Changes:
    return {"near_crowd": bool(rng.random() < 0.6)}


def _ice(rng: np.random.Generator, unit: float) -> Changes:
    white = rng.uniform(205, 240)
    return {
        "ground": "ice",
        "turf_bgr": (float(white), float(white * 0.985), float(white * 0.965)),
        "marking_width_m": 0.05,
        "paint_opacity": float(rng.uniform(0.55, 0.85)),
        "wear": float(rng.uniform(0.0, 0.35)),
        "texture": float(rng.uniform(0.01, 0.04)),
        "gloss": float(rng.uniform(0.0, 0.06)),
        "roof_m": float(rng.uniform(12, 22)),
        "shade": 0.0,
        "haze": 0.0,
        "board_distance_m": 0.05,
        "board_height_m": 1.1,
        "corner_m": 8.0,
        "crowd_density": float(rng.uniform(0.3, 0.97)),
        "stand_light": float(rng.uniform(0.15, 0.5)),
        "near_crowd": True,
        "shadow_strength": float(rng.uniform(0.03, 0.1)),
        "shadow_count": 4,
        "motion_px": float(unit * rng.uniform(2.0, 6.0)) if rng.random() < 0.2 else 0.0,
    }


def _wood(rng: np.random.Generator, unit: float) -> Changes:
    floor = np.asarray(_FLOORS[rng.integers(len(_FLOORS))]) * rng.uniform(0.85, 1.08)
    inks = ((235, 238, 238), (30, 28, 26), (40, 190, 225), (170, 80, 30), (40, 36, 180), (60, 110, 40))
    # a colour that can be told from the floor
    far = [ink for ink in inks if np.abs(np.asarray(ink) - floor).max() > 70 and abs(np.mean(ink) - floor.mean()) > 45]
    ink = np.asarray(far[rng.integers(len(far))] if far else inks[0], dtype=np.float64)
    return {
        "ground": "wood",
        "turf_bgr": tuple(float(min(v, 255.0)) for v in floor),
        "paint_bgr": tuple(float(v) for v in ink),
        "paint_opacity": float(rng.uniform(0.8, 0.97)),
        "wear": float(rng.uniform(0.0, 0.25)),
        "marking_width_m": float(rng.uniform(0.05, 0.08)),
        "texture": float(rng.uniform(0.01, 0.035)),
        "patchiness": float(rng.uniform(0.01, 0.05)),
        "gloss": float(rng.uniform(0.0, 0.3)),
        "roof_m": float(rng.uniform(7, 12)),
        "shade": 0.0,
        "haze": 0.0,
        "board_distance_m": float(rng.uniform(1.0, 3.0)),
        "board_height_m": float(rng.uniform(0.6, 2.2)),
        "stand_height_m": float(rng.uniform(3.0, 9.0)),
        "sky_bgr": tuple(float(v) for v in rng.uniform(60, 200, 1).repeat(3) + rng.normal(0, 8, 3)),
        "crowd_density": float(rng.uniform(0.0, 0.9)),
        "shadow_strength": float(rng.uniform(0.05, 0.15)),
        "shadow_count": 4,
    }


def _rink(rng: np.random.Generator, unit: float) -> Changes:
    return {
        **_ice(rng, unit),
        "paint_opacity": float(rng.uniform(0.4, 0.75)),
        "gloss": float(rng.uniform(0.02, 0.12)),
        "glass": float(rng.uniform(0.5, 0.95)),
        "round_logos": True,
        "scorebug": True,
        "defocus_px": float(unit * rng.uniform(0.8, 1.6)),
        "motion_px": float(unit * rng.uniform(2.0, 14.0)) if rng.random() < 0.35 else 0.0,
        "noise": float(rng.uniform(1.0, 3.0)),
    }


def _court(rng: np.random.Generator, unit: float) -> Changes:
    return {
        **_wood(rng, unit),
        "gloss": float(rng.uniform(0.2, 0.5)),
        "board_distance_m": float(rng.uniform(2.0, 4.0)),
        "near_crowd": bool(rng.random() < 0.7),
        "scorebug": True,
        "defocus_px": float(unit * rng.uniform(0.8, 1.8)),
        "motion_px": float(unit * rng.uniform(2.0, 6.0)) if rng.random() < 0.25 else 0.0,
    }


def _robots(rng: np.random.Generator, unit: float) -> Changes:
    green = np.array([38.0, 92.0, 52.0]) * rng.uniform(0.6, 1.2)
    return {
        "turf_bgr": tuple(float(v) for v in green),
        "paint_bgr": (float(rng.uniform(120, 235)), 228.0, 226.0),
        # chalk or thin paint on artificial turf, between the blades of which the ground shows
        "paint_opacity": float(rng.uniform(0.12, 0.8)),
        "marking_width_m": 0.05,
        "wear": float(rng.uniform(0.3, 0.8)),
        "wear_scale_m": 0.03,
        "texture": float(rng.uniform(0.05, 0.12)),
        "stripe_contrast": 0.0,
        "shade": 0.0,
        "haze": 0.0,
        "board_distance_m": float(rng.uniform(0.7, 2.0)),
        "board_height_m": float(rng.uniform(0.4, 1.2)),
        "stand_height_m": float(rng.uniform(0.0, 4.0)),
        "defocus_px": float(unit * rng.uniform(1.5, 4.0)),
        "motion_px": float(unit * rng.uniform(2.0, 8.0)) if rng.random() < 0.4 else 0.0,
        "noise": float(rng.uniform(1.5, 5.0)),
        "scorebug": False,
    }


_CHANGES: dict[str, Callable[[np.random.Generator, float], Changes]] = {
    "shade": _shade,
    "worn": _draw_wear,
    "graphics": _graphics,
    "low_camera": _amateur,
    "archive": _archive,
    "colours": _colours,
    "night": _night,
    "haze": _haze,
    "blur": _blur,
    "behind_goal": _near_stand,
    "world_banners": _banners,
    "world_paint": _repaint,
    "ice": _ice,
    "wood": _wood,
    "rink": _rink,
    "court": _court,
    "robots": _robots,
}
