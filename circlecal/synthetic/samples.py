"""The frames of the ``samples`` folder; ``python -m circlecal.synthetic.samples FOLDER`` makes them again.

Masks go into a folder of their own: beside the pictures they would be taken instead of the detector.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from circlecal.geometry.surface import Surface
from circlecal.pictures.files import MASK_SUFFIX
from circlecal.synthetic.cameras import aim_camera, soccer
from circlecal.synthetic.dataset import write_frame
from circlecal.synthetic.looks import sample_config
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import SceneProfile, players_in_view
from circlecal.synthetic.scene import Scene, sample_player

_HD, _FULL_HD = (1280, 720), (1920, 1080)
_SEED = 9150
SEGMENTATION_FOLDER = "segmentation"


def write_samples(out: Path) -> list[str]:
    """Render the samples into a folder, their masks and truth into folders in it; the ids come back.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    for number, (name, compose) in enumerate(_SAMPLES.items()):
        rng = np.random.default_rng([_SEED, number])
        scene = compose(rng)
        write_frame(out, name, render(scene, rng), scene.config.jpeg_quality, {"profile": "sample"})
        (out / SEGMENTATION_FOLDER).mkdir(exist_ok=True)
        mask = f"{name}{MASK_SUFFIX}"
        (out / mask).replace(out / SEGMENTATION_FOLDER / mask)
    return list(_SAMPLES)


def _look_from(
    rng: np.random.Generator,
    position_m: tuple[float, float, float],
    target_m: tuple[float, float, float],
    focal_px: float,
    *,
    profile: SceneProfile = "broadcast",
    size: tuple[int, int] = _HD,
    roll_deg: float = 0.4,
    kappa: float = 0.03,
    crown_m: float = 0.05,
    look: dict[str, object] | None = None,
) -> Scene:
    surface = Surface("roof", crown_m=crown_m)
    focal = focal_px * size[0] / 1920.0
    camera = aim_camera(np.array(position_m), np.array(target_m), focal, np.radians(roll_deg), *size, kappa)
    calm = {"scorebug": False, "shade": 0.0, "jpeg_quality": 88, "wear": 0.15}
    config = sample_config(profile, rng, size[0]).model_copy(update={**calm, **(look or {})})
    players = players_in_view(profile, camera, soccer(), surface, rng)
    return Scene(camera, soccer(), surface, config, players)


def _full_circle(rng: np.random.Generator) -> Scene:
    scene = _look_from(
        rng, (4.0, 66.0, -17.0), (0.5, -1.0, 0.0), 4300.0, profile="easy", size=_FULL_HD,
        look={"turf_bgr": (40.0, 128.0, 84.0), "stripe_contrast": 0.05, "noise": 1.0, "jpeg_quality": 88},
    )  # fmt: skip
    spots = ((-6.0, -3.5), (5.0, -6.0), (10.5, 4.0), (-9.15, 0.9), (3.5, 5.5), (-13.0, 6.0))
    players = tuple(sample_player(np.array(spot), index % 2, rng) for index, spot in enumerate(spots))
    return replace(scene, players=players)


def _partial(rng: np.random.Generator) -> Scene:
    return _look_from(rng, (-5.0, 62.0, -16.0), (11.0, 0.0, 0.0), 4400.0, look={"turf_bgr": (32.0, 126.0, 100.0)})


def _hidden_mark(rng: np.random.Generator) -> Scene:
    scene = _look_from(rng, (6.0, 64.0, -18.0), (-2.0, -4.0, 0.0), 3000.0, look={"turf_bgr": (44.0, 118.0, 66.0)})
    toward = np.array([6.0, 64.0]) / np.hypot(6.0, 64.0)
    player = replace(sample_player(3.6 * toward, 0, rng), width=1.0)
    return replace(scene, players=(*scene.players, player))


def _low_night(rng: np.random.Generator) -> Scene:
    night = {
        "turf_bgr": (30.0, 78.0, 44.0), "stand_light": 0.35, "shadow_count": 4, "shadow_strength": 0.15, "noise": 2.2,
        "vignette": 0.2,
    }  # fmt: skip
    return _look_from(rng, (-8.0, 52.0, -8.5), (-1.5, 0.0, 0.0), 2900.0, roll_deg=-1.2, look=night)


def _broadcast(rng: np.random.Generator) -> Scene:
    look = {"turf_bgr": (36.0, 132.0, 88.0), "stripe_contrast": 0.07, "scorebug": True, "stand_light": 0.75}
    return _look_from(rng, (1.5, 74.0, -20.0), (5.0, -10.0, 0.0), 2300.0, look=look)


def _no_halfway(rng: np.random.Generator) -> Scene:
    return _look_from(rng, (3.0, 62.0, -15.0), (20.5, -4.0, 0.0), 3300.0, look={"turf_bgr": (28.0, 130.0, 82.0)})


def _negative(rng: np.random.Generator) -> Scene:
    return _look_from(rng, (0.0, 68.0, -19.0), (41.0, -4.0, 0.0), 3000.0, look={"turf_bgr": (42.0, 120.0, 74.0)})


def _touchline_only(rng: np.random.Generator) -> Scene:
    return _look_from(rng, (3.0, 62.0, -15.0), (18.5, -12.0, 0.0), 5600.0, look={"turf_bgr": (30.0, 124.0, 74.0)})


_SAMPLES: dict[str, Callable[[np.random.Generator], Scene]] = {
    "full_circle": _full_circle,
    "partial_circle": _partial,
    "hidden_mark": _hidden_mark,
    "low_camera_night": _low_night,
    "broadcast_view": _broadcast,
    "no_halfway_line": _no_halfway,
    "penalty_area": _negative,
    "touchline_only": _touchline_only,
}

if __name__ == "__main__":
    write_samples(Path(sys.argv[1]))
