"""Clips of a standing camera with the truth of every frame.

One tripod, one pitch, one look: textures, stands, boards and the score stay what they are over the whole clip; the
camera and the players move. A cut shows something else for a while and comes back to the same tripod.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from circlecal.errors import InputError
from circlecal.field import FieldTemplate, load_field
from circlecal.files import prepare_folder, write_atomic
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface, SurfaceShape
from circlecal.pictures.video_writer import write_video
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.dataset import LARGEST_SIZE, SMALLEST_SIZE, TRUTH_FOLDER
from circlecal.synthetic.looks import sample_config
from circlecal.synthetic.negatives import NegativeKind, negative_scene
from circlecal.synthetic.renderer import Randomness, render
from circlecal.synthetic.scene import Delivery, Player, RenderConfig, Scene, sample_player
from circlecal.synthetic.tripod import Tripod, sample_tripod
from circlecal.synthetic.truth import Truth

ClipKind = Literal["still", "attack", "sweep", "zooms", "cuts"]
CLIP_KINDS: tuple[ClipKind, ...] = get_args(ClipKind)
ShotKind = Literal["main", "cut", "replay"]

SURFACE_SHARES: dict[SurfaceShape, float] = {"roof": 0.5, "parabola": 0.35, "flat": 0.15}
"""Of pitches, how many have which shape, assumed. Hipped roofs are rendered where they are asked for, as cameras are
fitted before them.
"""
_SHUTTER = 0.5
"""Share of the frame's period during which light falls on the sensor: the usual 180 degrees."""
_LEAST_BLUR_PX = 0.3
_KNOTS_A_SECOND = 50
_OPERATOR_S = 0.12
"""Standard deviation in time of the inertia of head and operator: no jerk is faster."""
_TREMOR_S, _TREMOR_RAD = 0.5, np.radians(0.03)
"""Time and size of an operator's small corrections."""
_TEAM_SIZE = 11
_LONGEST_S, _RATES = 600.0, (1.0, 120.0)
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
        Scene profile that light, ground and paint are drawn from.
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
class _Path:
    """Pan, tilt and logarithm of the focal length of a shot, twice continuously differentiable in time."""

    curve: CubicSpline

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Pan and tilt on the head, and focal length in widths of the picture."""
        pan, tilt, log_focal = self.curve(time_s)
        return float(pan), float(tilt), float(np.exp(log_focal))


@dataclass(frozen=True, slots=True)
class _Shot:
    """A stretch without a cut; ``path`` belongs to the main camera, ``scene`` to what else is shown."""

    kind: ShotKind
    start_s: float
    end_s: float
    path: _Path | None = None
    scene: Scene | None = None


@dataclass(frozen=True, slots=True)
class _Run:
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
    """

    spec: ClipSpec
    tripod: Tripod
    template: FieldTemplate
    surface: Surface
    config: RenderConfig
    shots: tuple[_Shot, ...]
    runs: tuple[_Run, ...]
    seeds: tuple[int, int, int]

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

    def camera_at(self, time_s: float, shot: _Shot) -> Camera:
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

    def _scene(self, shot: _Shot, camera: Camera, time_s: float) -> Scene:
        if shot.kind == "cut" and shot.scene is not None:
            return replace(shot.scene, camera=camera)
        half = np.array([self.template.length_m, self.template.width_m]) / 2 + 2.0
        main = shot.path or next(other.path for other in self.shots if other.path is not None)
        looked_at = self.tripod.camera(*main.at(time_s), self.spec.width, self.spec.height)
        middle = looked_at.back_project(looked_at.principal_point_px)
        middle = np.clip(np.where(np.isfinite(middle), middle, 0.0), -half, half)
        players = tuple(run.at(time_s, 0.55 * middle * (1.0, 0.3), half) for run in self.runs)
        return Scene(camera, self.template, self.surface, self.config, players, ball_m=middle + np.array([0.4, 0.8]))

    def _blur_motion(self, scene: Scene, shot: _Shot, time_s: float) -> Scene:
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

    def _image_speed(self, shot: _Shot, time_s: float) -> Array:
        """Speed (2,) of the still world in the middle of the picture, pixels per second."""
        step = 0.1 / self.spec.rate
        before, after = (self.camera_at(t, shot) for t in (time_s - step, time_s + step))
        middle = before.principal_point_px
        ahead = before.position_m + 60.0 * before.R[2]
        return np.asarray((after.project(ahead) - middle) / (2 * step))


def plan_clip(spec: ClipSpec, rng: np.random.Generator) -> Clip:
    """A random clip: pitch, crown, look, tripod, lens, the path of the camera and the players."""
    length, width = spec.pitch_m or (float(rng.uniform(90.0, 120.0)), float(rng.uniform(45.0, 90.0)))
    template = load_field("soccer", {"length": length, "width": width})
    drawn = list(SURFACE_SHARES)[rng.choice(len(SURFACE_SHARES), p=list(SURFACE_SHARES.values()))]
    roof_m, parabola_m = float(rng.uniform(0.02, 0.08)), float(rng.uniform(0.0, 0.025))
    shape = spec.surface or drawn
    crown_m = {"roof": roof_m, "hip": roof_m, "parabola": parabola_m, "flat": 0.0}[shape]
    surface = Surface(shape, template.circle_by_name[template.default_circle].radius_m, crown_m)
    config = sample_config(spec.look, rng, spec.width).model_copy(
        update={"scorebug": True, "motion_px": 0.0, "precipitation": 0.0, "near_crowd": False}
    )
    tripod = sample_tripod(width, rng)
    shots = _plan_shots(spec, tripod, template, surface, config, rng)
    runs = _plan_runs(template, rng)
    world, graphics, sensor = (int(seed) for seed in rng.integers(0, 2**31, 3))
    return Clip(spec, tripod, template, surface, config, shots, runs, (world, graphics, sensor))


def write_clip(out: Path, clip_id: str, clip: Clip, *, report: Callable[[int], None] | None = None) -> Path:
    """Write ``<id>.mp4`` with the exact time of every frame, and ``truth/<id>.json``.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    path = out / f"{clip_id}.mp4"
    frames = []
    with write_video(path, clip.spec.rate) as writer:
        for picture, truth in clip.frames():
            writer.write(picture, truth.time_s)
            frames.append(truth.to_json())
            if report is not None:
                report(len(frames))
    text = json.dumps({"id": clip_id, **clip.to_json(), "frames": frames}, indent=1, allow_nan=False) + "\n"
    write_atomic(out / TRUTH_FOLDER / f"{clip_id}.json", text.encode())
    return path


def write_clips(
    out: Path,
    count: int,
    seed: int,
    spec: ClipSpec,
    kinds: Sequence[ClipKind] = CLIP_KINDS,
    *,
    report: Callable[[int], None] | None = None,
) -> list[str]:
    """Render clips into a folder; the ids come back.

    Clip ``i`` has the kind ``kinds[i % len(kinds)]`` and is drawn from ``default_rng([seed, i])``.

    Parameters
    ----------
    out : Path
        Folder; made if it is not there, files of the same name are replaced.
    count, seed : int
        Number of clips, at least 1; seed, at least 0.
    spec : ClipSpec
        Size, length, rate and look.
    kinds : sequence of str
        Kinds of clips.
    report : callable, optional
        Called with the number of finished frames after each.

    Raises
    ------
    InputError
        Count, seed, size, length or rate out of range, or the folder cannot be written.
    """
    require_clips(count, seed, spec)
    prepare_folder(out, "OUT")
    ids = []
    for index in range(count):
        kind = kinds[index % len(kinds)]
        clip = plan_clip(replace(spec, kind=kind), np.random.default_rng([seed, index]))
        ids.append(f"{kind}_{index:05d}")
        done = index * clip.count

        def tell(finished: int, done: int = done) -> None:
            if report is not None:
                report(done + finished)

        write_clip(out, ids[-1], clip, report=tell)
    return ids


def require_clips(count: int, seed: int, spec: ClipSpec) -> None:
    """Clips that can be rendered.

    Raises
    ------
    InputError
        A number is out of range.
    """
    if count < 1:
        raise InputError(f"count must be at least 1, not {count}")
    if seed < 0:
        raise InputError(f"seed must be at least 0, not {seed}")
    size = spec.width, spec.height
    in_range = all(low <= side <= high for low, side, high in zip(SMALLEST_SIZE, size, LARGEST_SIZE, strict=True))
    if not in_range or any(side % 2 for side in size):
        smallest, largest = ("x".join(map(str, limit)) for limit in (SMALLEST_SIZE, LARGEST_SIZE))
        raise InputError(
            f"size {size[0]}x{size[1]} is out of range; even sides from {smallest} to {largest} can be rendered"
        )
    if not (0.0 < spec.seconds <= _LONGEST_S and _RATES[0] <= spec.rate <= _RATES[1]):
        raise InputError(
            f"{spec.seconds:g} s at {spec.rate:g} frames per second is out of range; up to {_LONGEST_S:g} s at "
            f"{_RATES[0]:g} to {_RATES[1]:g} can be rendered"
        )


def _plan_shots(
    spec: ClipSpec,
    tripod: Tripod,
    template: FieldTemplate,
    surface: Surface,
    config: RenderConfig,
    rng: np.random.Generator,
) -> tuple[_Shot, ...]:
    side = float(rng.choice((-1.0, 1.0)))

    def circle() -> Array:
        return np.array([rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(34, 50)])

    def area(side: float, closest: float = 30.0) -> Array:
        x = side * (template.length_m / 2 - rng.uniform(11, 16))
        return np.array([x, rng.uniform(-4, 4), rng.uniform(closest, closest + 12)])

    def main(start: float, end: float, *stations: tuple[float, Array]) -> _Shot:
        start_s, end_s = start * spec.seconds, end * spec.seconds
        times = np.array([start_s + share * (end_s - start_s) for share, _ in stations])
        path = _plan_path(tripod, times, np.array([aim for _, aim in stations]), (start_s, end_s), rng)
        return _Shot("main", start_s, end_s, path=path)

    if spec.kind == "cuts":
        first, second, third = (float(share) for share in rng.uniform((0.26, 0.46, 0.7), (0.32, 0.52, 0.76)))
        cut: NegativeKind = ("close_up", "crowd")[rng.integers(2)]
        elsewhere = negative_scene(rng, (spec.width, spec.height), template, cut)
        closer = config.model_copy(update={"defocus_px": 1.5 * config.defocus_px})
        return (
            main(0.0, first, (0.0, circle()), (0.4, circle()), (1.0, area(side))),
            _Shot("cut", first * spec.seconds, second * spec.seconds, scene=replace(elsewhere, config=closer)),
            main(second, third, (0.0, area(side)), (1.0, area(side))),
            _replay(spec, (third, third + 0.1), side, template, surface, config, rng),
            main(third + 0.1, 1.0, (0.0, area(side)), (0.4, area(side)), (1.0, circle())),
        )
    here, there = circle(), area(side)
    stations: dict[ClipKind, tuple[tuple[float, Array], ...]] = {
        "still": ((0.0, here), (1.0, here + np.array([0.5, 0.3, 0.0]))),
        "attack": ((0.0, here), (0.2, circle()), (0.55, there), (0.75, area(side, 26.0)), (1.0, area(side))),
        "sweep": (
            (0.0, here),
            (0.1, here),
            (0.3, there),
            (0.4, there),
            (0.7, area(-side)),
            (0.8, area(-side)),
            (1.0, circle()),
        ),
        "zooms": (
            *((0.0, here), (0.2, here * (1, 1, 0.55)), (0.4, here * (1, 1, 1.3)), (0.6, there)),
            *((0.75, there * (1, 1, 0.6)), (0.9, there * (1, 1, 1.2)), (1.0, there)),
        ),
    }
    return (main(0.0, 1.0, *stations[spec.kind]),)


def _plan_path(
    tripod: Tripod, times_s: Array, aims: Array, span_s: tuple[float, float], rng: np.random.Generator
) -> _Path:
    """Path through aims (N, 3) at times (N,): field x and y that are looked at, and metres seen across there."""
    margin = 5 * _OPERATOR_S
    dense = np.arange(span_s[0] - margin, span_s[1] + margin, 1.0 / _KNOTS_A_SECOND)
    between = PchipInterpolator(times_s, np.column_stack([aims[:, :2], np.log(aims[:, 2])]), axis=0)
    smooth = gaussian_filter1d(
        between(np.clip(dense, times_s[0], times_s[-1])), _OPERATOR_S * _KNOTS_A_SECOND, axis=0, mode="nearest"
    )
    targets = np.column_stack([smooth[:, :2], np.zeros(len(dense))])
    angles = np.array([tripod.aim(target) for target in targets])
    tremor = gaussian_filter1d(rng.standard_normal((len(dense), 2)), _TREMOR_S * _KNOTS_A_SECOND, axis=0)
    angles += _TREMOR_RAD * tremor / max(float(tremor.std()), 1e-9)
    distance = np.linalg.norm(targets - tripod.position_m, axis=1)
    return _Path(CubicSpline(dense, np.column_stack([angles, np.log(distance) - smooth[:, 2]])))


def _replay(
    spec: ClipSpec,
    span: tuple[float, float],
    side: float,
    template: FieldTemplate,
    surface: Surface,
    config: RenderConfig,
    rng: np.random.Generator,
) -> _Shot:
    """The penalty area again from behind its goal."""
    half = template.length_m / 2
    position = np.array([side * (half + rng.uniform(9, 22)), rng.uniform(-8, 8), -rng.uniform(4.0, 9.0)])
    target = np.array([side * (half - rng.uniform(10, 20)), rng.uniform(-4, 4), 0.0])
    kappa = float(rng.uniform(0.0, 0.04))
    camera = aim_camera(position, target, rng.uniform(0.7, 1.1) * spec.width, 0.0, spec.width, spec.height, kappa)
    scene = Scene(camera, template, surface, config)
    return _Shot("replay", span[0] * spec.seconds, span[1] * spec.seconds, scene=scene)


def _plan_runs(template: FieldTemplate, rng: np.random.Generator) -> tuple[_Run, ...]:
    """Two teams and a referee, spread over the middle of the pitch."""
    half = np.array([template.length_m, template.width_m]) / 2
    runs = []
    for number in range(2 * _TEAM_SIZE + 1):
        team = 2 if number == 2 * _TEAM_SIZE else number % 2
        player = sample_player(rng.uniform(-0.75, 0.75, 2) * half, team, rng)
        player = replace(player, look_seed=int(rng.integers(2**31)))
        runs.append(
            _Run(
                player, rng.uniform(0.5, 2.5, (2, 2)), rng.uniform(3.0, 9.0, (2, 2)), rng.uniform(0, 2 * np.pi, (2, 2))
            )
        )
    return tuple(runs)
