"""Clips drawn up at random: the pitch and its look, the tripod, the path of the camera, and the players."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from circlecal.errors import InputError
from circlecal.field import FieldTemplate, load_field
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface, SurfaceShape
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.looks import sample_config
from circlecal.synthetic.negatives import NegativeKind, negative_scene
from circlecal.synthetic.sampling import SceneProfile, profile_field, sample_scene
from circlecal.synthetic.scene import Player, RenderConfig, Scene, sample_player
from circlecal.synthetic.tripod import Tripod, sample_tripod
from circlecal.synthetic.video import CLIP_KINDS, AimPath, Clip, ClipKind, ClipSpec, Run, Shot

SURFACE_SHARES: dict[SurfaceShape, float] = {"roof": 0.5, "parabola": 0.35, "flat": 0.15}
"""Of pitches, how many have which shape, assumed. Hipped roofs are rendered where they are asked for, as cameras are
fitted before them.
"""
_KNOTS_A_SECOND = 50
_OPERATOR_S = 0.12
"""Standard deviation in time of the inertia of head and operator: no jerk is faster."""
_TREMOR_S, _TREMOR_RAD = 0.5, np.radians(0.03)
"""Time and size of an operator's small corrections."""
_TEAM_SIZE = 11
_ASIDE = 0.35
"""How far to a side an attack or a sweep of another sport goes, in what is seen from side to side."""
_LENS_SHARE = 0.5
"""How much the lenses of other sports change with the zoom where that of a soccer broadcast changes by 1, assumed."""
_LOOK_OF_CLIPS = {"scorebug": True, "motion_px": 0.0, "precipitation": 0.0, "near_crowd": False}


def kinds_of(look: str) -> tuple[ClipKind, ...]:
    """Kinds of clips that there are with a look: cuts of soccer only."""
    return tuple(kind for kind in CLIP_KINDS if kind != "cuts" or profile_field(look) == "soccer")


def plan_clip(spec: ClipSpec, rng: np.random.Generator) -> Clip:
    """A random clip: pitch, crown, look, tripod, lens, the path of the camera and the players.

    Raises
    ------
    InputError
        Cuts in another sport than soccer.
    """
    if profile_field(spec.look) != "soccer":
        return _plan_other_sport(spec, rng)
    length, width = spec.pitch_m or (float(rng.uniform(90.0, 120.0)), float(rng.uniform(45.0, 90.0)))
    template = load_field("soccer", {"length": length, "width": width})
    drawn = list(SURFACE_SHARES)[rng.choice(len(SURFACE_SHARES), p=list(SURFACE_SHARES.values()))]
    roof_m, parabola_m = float(rng.uniform(0.02, 0.08)), float(rng.uniform(0.0, 0.025))
    shape = spec.surface or drawn
    crown_m = {"roof": roof_m, "hip": roof_m, "parabola": parabola_m, "flat": 0.0}[shape]
    surface = Surface(shape, template.circle_by_name[template.default_circle].radius_m, crown_m)
    config = sample_config(spec.look, rng, spec.width).model_copy(update=_LOOK_OF_CLIPS)
    tripod = sample_tripod(width, rng)
    shots = _plan_shots(spec, tripod, template, surface, config, rng)
    runs = _plan_runs(template, rng)
    return Clip(spec, tripod, template, surface, config, shots, runs, _draw_seeds(rng))


def _draw_seeds(rng: np.random.Generator) -> tuple[int, int, int]:
    world, graphics, sensor = (int(seed) for seed in rng.integers(0, 2**31, 3))
    return world, graphics, sensor


def _plan_other_sport(spec: ClipSpec, rng: np.random.Generator) -> Clip:
    """A clip of a scene of another sport, whose camera stands on a tripod and turns about what it shows."""
    if spec.kind not in kinds_of(spec.look):
        raise InputError("clips with cuts are rendered of soccer only; choose another kind than cuts")
    scene = sample_scene(cast(SceneProfile, spec.look), rng, spec.width, spec.height)
    camera, template = scene.camera, scene.template
    tripod = sample_tripod(template.width_m, rng)
    focal = float(camera.focal_px[0]) / spec.width
    tripod = replace(
        tripod,
        position_m=camera.position_m - tripod.lever_m * camera.R[2],
        roll_rad=float(camera.angles_rad[2]),
        kappa=float(camera.kappa[0]),
        kappa_by_focal=_LENS_SHARE * (focal / tripod.reference_focal) ** 2 * tripod.kappa_by_focal,
        reference_focal=focal,
    )
    middle = camera.back_project(camera.principal_point_px)
    seen_m = float(np.linalg.norm(np.append(middle, 0.0) - camera.position_m)) / focal
    here = np.array([*middle, seen_m])
    aside = np.array([_ASIDE * seen_m, 0.0, 0.0]) * float(rng.choice((-1.0, 1.0)))
    stations: dict[ClipKind, tuple[tuple[float, Array], ...]] = {
        "still": ((0.0, here), (1.0, here + 0.02 * aside)),
        "attack": ((0.0, here), (0.3, here), (0.7, here + aside), (1.0, here * (1, 1, 0.8) + aside)),
        "sweep": ((0.0, here), (0.3, here + aside), (0.7, here - aside), (1.0, here)),
        "zooms": ((0.0, here), (0.3, here * (1, 1, 0.75)), (0.7, here * (1, 1, 1.2)), (1.0, here)),
    }
    shares, aims = zip(*stations[spec.kind], strict=True)
    path = _plan_path(tripod, spec.seconds * np.array(shares), np.array(aims), (0.0, spec.seconds), rng)
    config = scene.config.model_copy(update=_LOOK_OF_CLIPS)
    runs = tuple(_move(player, rng) for player in scene.players)
    shots = (Shot("main", 0.0, spec.seconds, path=path),)
    return Clip(spec, tripod, template, scene.surface, config, shots, runs, _draw_seeds(rng), scene)


def _plan_shots(
    spec: ClipSpec,
    tripod: Tripod,
    template: FieldTemplate,
    surface: Surface,
    config: RenderConfig,
    rng: np.random.Generator,
) -> tuple[Shot, ...]:
    side = float(rng.choice((-1.0, 1.0)))

    def circle() -> Array:
        return np.array([rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(34, 50)])

    def area(side: float, closest: float = 30.0) -> Array:
        x = side * (template.length_m / 2 - rng.uniform(11, 16))
        return np.array([x, rng.uniform(-4, 4), rng.uniform(closest, closest + 12)])

    def main(start: float, end: float, *stations: tuple[float, Array]) -> Shot:
        start_s, end_s = start * spec.seconds, end * spec.seconds
        times = np.array([start_s + share * (end_s - start_s) for share, _ in stations])
        path = _plan_path(tripod, times, np.array([aim for _, aim in stations]), (start_s, end_s), rng)
        return Shot("main", start_s, end_s, path=path)

    if spec.kind == "cuts":
        first, second, third = (float(share) for share in rng.uniform((0.26, 0.46, 0.7), (0.32, 0.52, 0.76)))
        cut: NegativeKind = ("close_up", "crowd")[rng.integers(2)]
        elsewhere = negative_scene(rng, (spec.width, spec.height), template, cut)
        closer = config.model_copy(update={"defocus_px": 1.5 * config.defocus_px})
        return (
            main(0.0, first, (0.0, circle()), (0.4, circle()), (1.0, area(side))),
            Shot("cut", first * spec.seconds, second * spec.seconds, scene=replace(elsewhere, config=closer)),
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
) -> AimPath:
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
    return AimPath(CubicSpline(dense, np.column_stack([angles, np.log(distance) - smooth[:, 2]])))


def _replay(
    spec: ClipSpec,
    span: tuple[float, float],
    side: float,
    template: FieldTemplate,
    surface: Surface,
    config: RenderConfig,
    rng: np.random.Generator,
) -> Shot:
    """The penalty area again from behind its goal."""
    half = template.length_m / 2
    position = np.array([side * (half + rng.uniform(9, 22)), rng.uniform(-8, 8), -rng.uniform(4.0, 9.0)])
    target = np.array([side * (half - rng.uniform(10, 20)), rng.uniform(-4, 4), 0.0])
    kappa = float(rng.uniform(0.0, 0.04))
    camera = aim_camera(position, target, rng.uniform(0.7, 1.1) * spec.width, 0.0, spec.width, spec.height, kappa)
    scene = Scene(camera, template, surface, config)
    return Shot("replay", span[0] * spec.seconds, span[1] * spec.seconds, scene=scene)


def _plan_runs(template: FieldTemplate, rng: np.random.Generator) -> tuple[Run, ...]:
    """Two teams and a referee, spread over the middle of the pitch."""
    half = np.array([template.length_m, template.width_m]) / 2
    runs = []
    for number in range(2 * _TEAM_SIZE + 1):
        team = 2 if number == 2 * _TEAM_SIZE else number % 2
        player = sample_player(rng.uniform(-0.75, 0.75, 2) * half, team, rng)
        player = replace(player, look_seed=int(rng.integers(2**31)))
        runs.append(_move(player, rng))
    return tuple(runs)


def _move(player: Player, rng: np.random.Generator) -> Run:
    return Run(player, rng.uniform(0.5, 2.5, (2, 2)), rng.uniform(3.0, 9.0, (2, 2)), rng.uniform(0, 2 * np.pi, (2, 2)))
