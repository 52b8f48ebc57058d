"""Clips of a standing camera with the truth of every frame.

One tripod, one pitch, one look: textures, stands, boards and the score stay what they are over the whole clip; the
camera and the players move. A cut shows something else for a while and comes back to the same tripod.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from circlecal.field import FieldTemplate
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface, SurfaceShape
from circlecal.synthetic.renderer import Randomness, render
from circlecal.synthetic.scene import Delivery, Player, RenderConfig, Scene
from circlecal.synthetic.tripod import Tripod
from circlecal.synthetic.truth import Truth

ClipKind = Literal["still", "attack", "sweep", "zooms", "cuts"]
CLIP_KINDS: tuple[ClipKind, ...] = get_args(ClipKind)
ShotKind = Literal["main", "cut", "replay"]

_SHUTTER = 0.5
"""Share of the frame's period during which light falls on the sensor: the usual 180 degrees."""
_LEAST_BLUR_PX = 0.3
_REPLAY_PAN_RAD_S, _CUT_PAN_RAD_S = 0.05, 0.01
_SHARED_KEYS = frozenset(
    {"width", "height", "field", "crown_m", "crown_shape", "crown_reference_m", "marking_width_m", "pixel_aspect"}
)


@dataclass(frozen=True, slots=True)
class ClipSpec:
    """What a clip is to show; all else is drawn at random.

    Attributes
    ----------
    kind : str
        ``"still"``: the circle, hardly moving. ``"attack"``: from the circle to a penalty area. ``"sweep"``: fast pans
        over both penalty areas and the circle. ``"zooms"``: in and out over the circle and a penalty area. ``"cuts"``:
        an attack with a close-up or a view of the crowd, and a replay from behind the goal; after each the main camera
        is back in a penalty area.
    width, height : int
        Pixels.
    seconds, rate : float, float
        Length, and frames per second.
    interlaced : bool
        Whether every frame holds two fields, half a period apart, of a moving camera.
    look : str
        Scene profile that light, ground and paint are drawn from; of another sport (``"rink"``, ``"ice"``,
        ``"court"``, ``"wood"``) the field, its decals and the camera's place too. There an attack and a sweep go to the
        sides of what that camera shows, and there are no cuts.
    pitch_m : (float, float) or None
        Length and width; None for what the Laws allow, 90-120 by 45-90 m.
    surface : SurfaceShape or None
        Shape of the pitch; None for any.
    """

    kind: ClipKind = "attack"
    width: int = 1280
    height: int = 720
    seconds: float = 12.0
    rate: float = 25.0
    interlaced: bool = False
    look: str = "broadcast"
    pitch_m: tuple[float, float] | None = None
    surface: SurfaceShape | None = None


@dataclass(frozen=True, slots=True)
class FrameTruth:
    """Truth of one frame of a clip.

    Attributes
    ----------
    time_s : float
        From the first frame.
    shot : str
        ``"main"``: the camera on the tripod. ``"replay"``: another camera, whose truth is given too. ``"cut"``: no
        view of the pitch that could be calibrated.
    pan_rad, tilt_rad : float or None
        On the head of the tripod, in the shots of the main camera.
    truth : Truth or None
        None in a cut.
    """

    time_s: float
    shot: ShotKind
    pan_rad: float | None
    tilt_rad: float | None
    truth: Truth | None

    def to_json(self) -> dict[str, Any]:
        """JSON-ready mapping; the keys of a frame's truth without those that hold for the whole clip."""
        record: dict[str, Any] = {"time_s": round(self.time_s, 6), "shot": self.shot}
        if self.pan_rad is not None and self.tilt_rad is not None:
            record |= {
                "head_pan_deg": float(np.degrees(self.pan_rad)),
                "head_tilt_deg": float(np.degrees(self.tilt_rad)),
            }
        if self.truth is not None:
            record |= {key: value for key, value in self.truth.to_json().items() if key not in _SHARED_KEYS}
        return record


@dataclass(frozen=True, slots=True)
class AimPath:
    """Pan, tilt and logarithm of the focal length of a shot, twice continuously differentiable in time."""

    curve: CubicSpline

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Pan and tilt on the head, and focal length in widths of the picture."""
        pan, tilt, log_focal = self.curve(time_s)
        return float(pan), float(tilt), float(np.exp(log_focal))


@dataclass(frozen=True, slots=True)
class Shot:
    """A stretch without a cut; ``path`` belongs to the main camera, ``scene`` to what else is shown."""

    kind: ShotKind
    start_s: float
    end_s: float
    path: AimPath | None = None
    scene: Scene | None = None


@dataclass(frozen=True, slots=True)
class Run:
    """How a player moves: about a place that shifts with the play, in sums of two sines for each axis."""

    player: Player
    amplitude_m: Array
    period_s: Array
    phase_rad: Array

    def at(self, time_s: float, shift_m: Array, half_m: Array) -> Player:
        """The player at a time; ``shift_m`` (2,) moves the play, ``half_m`` (2,) bounds the pitch."""
        turn = 2 * np.pi * time_s / self.period_s + self.phase_rad
        place = self.player.position_m + shift_m + (self.amplitude_m * np.sin(turn)).sum(axis=0)
        speed = np.linalg.norm((self.amplitude_m * np.cos(turn) * 2 * np.pi / self.period_s).sum(axis=0))
        swing = 0.13 * min(float(speed), 6.0) * np.sin(2 * np.pi * 1.4 * time_s + self.phase_rad[0, 0])
        pose = np.array([swing, -0.8 * swing, 0.8 * swing, self.player.pose[3]])
        return replace(self.player, position_m=np.clip(place, -half_m, half_m), pose=pose)


@dataclass(frozen=True, slots=True)
class Clip:
    """A clip that has been drawn up and can be rendered, more than once with the same pictures.

    Attributes
    ----------
    spec : ClipSpec
        What was asked for.
    tripod, template, surface, config : Tripod, FieldTemplate, Surface, RenderConfig
        What all frames share.
    shots : tuple
        Stretches between cuts, in order.
    runs : tuple
        How each player moves.
    seeds : (int, int, int)
        Of the world around the pitch, of the graphics and of the sensor's noise.
    ground : Scene or None
        Of another sport than soccer: a scene with all that lies on its floor beside the markings.
    """

    spec: ClipSpec
    tripod: Tripod
    template: FieldTemplate
    surface: Surface
    config: RenderConfig
    shots: tuple[Shot, ...]
    runs: tuple[Run, ...]
    seeds: tuple[int, int, int]
    ground: Scene | None = None

    @property
    def count(self) -> int:
        """Number of frames."""
        return max(1, round(self.spec.seconds * self.spec.rate))

    def frames(self) -> Iterator[tuple[NDArray[np.uint8], FrameTruth]]:
        """Pictures (H, W, 3), BGR, and their truth, one after the other."""
        for index in range(self.count):
            yield self.frame(index)

    def frame(self, index: int) -> tuple[NDArray[np.uint8], FrameTruth]:
        """One picture and its truth; it is the same whatever was rendered before."""
        time_s = index / self.spec.rate
        shot = next(shot for shot in self.shots if time_s < shot.end_s or shot is self.shots[-1])
        world, graphics, sensor = self.seeds
        chance = Randomness(
            np.random.default_rng([world, self.shots.index(shot) if shot.kind == "cut" else 0]),
            np.random.default_rng(graphics),
            np.random.default_rng([sensor, index]),
        )
        camera = self.camera_at(time_s, shot)
        moving = self._blur_motion(self._scene(shot, camera, time_s), shot, time_s)
        rendering = render(moving, chance)
        pan, tilt = shot.path.at(time_s)[:2] if shot.path is not None else (None, None)
        truth = None if shot.kind == "cut" else rendering.truth
        return rendering.image, FrameTruth(time_s, shot.kind, pan, tilt, truth)

    def camera_at(self, time_s: float, shot: Shot) -> Camera:
        """Camera of a shot at a time, which need not be that of a frame."""
        if shot.path is not None:
            return self.tripod.camera(*shot.path.at(time_s), self.spec.width, self.spec.height)
        if shot.scene is None:
            raise ValueError("a shot has a path or a scene")
        rate = _REPLAY_PAN_RAD_S if shot.kind == "replay" else _CUT_PAN_RAD_S
        turn = np.array([rate * (time_s - shot.start_s), 0.0, 0.0])
        return replace(shot.scene.camera, angles_rad=shot.scene.camera.angles_rad + turn)

    def to_json(self) -> dict[str, Any]:
        """JSON-ready mapping of what holds for the whole clip."""
        return {
            "kind": self.spec.kind,
            "width": self.spec.width,
            "height": self.spec.height,
            "rate": self.spec.rate,
            "interlaced": self.spec.interlaced,
            "field": self.template.name,
            "pitch": {
                "length_m": self.template.length_m,
                "width_m": self.template.width_m,
                "marking_width_m": self.config.marking_width_m,
                "crown_m": self.surface.crown_m,
                "crown_shape": self.surface.shape,
                "crown_reference_m": self.surface.reference_m,
            },
            "tripod": self.tripod.to_json(),
            "shots": [{"shot": s.kind, "start_s": s.start_s, "end_s": s.end_s} for s in self.shots],
        }

    def _scene(self, shot: Shot, camera: Camera, time_s: float) -> Scene:
        if shot.kind == "cut" and shot.scene is not None:
            return replace(shot.scene, camera=camera)
        half = np.array([self.template.length_m, self.template.width_m]) / 2 + 2.0
        if self.ground is not None:
            players = tuple(run.at(time_s, np.zeros(2), half) for run in self.runs)
            return replace(self.ground, camera=camera, config=self.config, players=players)
        main = shot.path or next(other.path for other in self.shots if other.path is not None)
        looked_at = self.tripod.camera(*main.at(time_s), self.spec.width, self.spec.height)
        middle = looked_at.back_project(looked_at.principal_point_px)
        middle = np.clip(np.where(np.isfinite(middle), middle, 0.0), -half, half)
        players = tuple(run.at(time_s, 0.55 * middle * (1.0, 0.3), half) for run in self.runs)
        return Scene(camera, self.template, self.surface, self.config, players, ball_m=middle + np.array([0.4, 0.8]))

    def _blur_motion(self, scene: Scene, shot: Shot, time_s: float) -> Scene:
        """The scene with the blur of its moving camera, and with two fields where it is interlaced."""
        period = 1.0 / self.spec.rate
        speed = self._image_speed(shot, time_s)
        length = float(np.linalg.norm(speed)) * _SHUTTER * period * (0.5 if self.spec.interlaced else 1.0)
        update: dict[str, float] = {}
        if length >= _LEAST_BLUR_PX:
            update = {"motion_px": length, "motion_rad": float(np.arctan2(speed[1], speed[0]))}
        config = scene.config.model_copy(update={"motion_px": 0.0, **update})
        pan_px = -float(speed[0]) * period / 2 if self.spec.interlaced else 0.0
        return replace(scene, config=config, delivery=Delivery(interlace_px=float(np.clip(pan_px, -60.0, 60.0))))

    def _image_speed(self, shot: Shot, time_s: float) -> Array:
        """Speed (2,) of the still world in the middle of the picture, pixels per second."""
        step = 0.1 / self.spec.rate
        before, after = (self.camera_at(t, shot) for t in (time_s - step, time_s + step))
        middle = before.principal_point_px
        ahead = before.position_m + 60.0 * before.R[2]
        return np.asarray((after.project(ahead) - middle) / (2 * step))
