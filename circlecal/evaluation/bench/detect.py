"""``circlecal bench detect``: the whole chain on rendered frames, from the picture alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from circlecal.config import Config, load_config
from circlecal.evaluation.bench.chain_time import decoding_ms, time_run
from circlecal.evaluation.bench.reachable import bound_px
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import project
from circlecal.geometry.projective import Array
from circlecal.results import CameraFit
from circlecal.synthetic.sampling import SCENE_PROFILES, SceneProfile, profile_field, render_frame
from circlecal.synthetic.truth import Truth

RUNS, TIMED_FRAMES = 3, 20
"""Times are the best of this many runs on the same frame, and the median over so many frames of a profile: those that
come after them are for the errors alone, and calibrated once.
"""
GOOD_PX, WRONG_PX = 5.0, 20.0
"""Mean errors up to which a frame is good, and beyond which it is wrong, pixels at 1920 px width."""
REACH_RADII = 22.0 / 9.15
"""Errors are averaged over the visible field this near to the circle's centre: 22 m in soccer; over all of the visible
field where the circle is not seen."""
ANY_SIZE_SD = {"length_sd_m": (120.0 - 90.0) / 12**0.5, "width_sd_m": (90.0 - 45.0) / 12**0.5}
"""Standard deviations of the sizes that Law 1 allows, metres: 90-120 by 45-90 m, all alike."""
FIELD_KINDS = ("penalty_area", "corner", "goal_mouth", "behind_net", "crowd", "close_up", "grass", "wipe", "board")
"""Kinds of frames without the circle that show a soccer field, and perhaps enough of its lines."""
BEHIND_PX = 1e5
"""How far off a point counts that a camera has behind itself, where two cameras are compared."""
CHI2_90 = 4.605
"""90 % point of chi-square with two degrees of freedom."""


@dataclass(frozen=True, slots=True)
class ProfileRow:
    """One profile; errors in pixels at 1920 px width, shares of all its frames.

    ``coverage`` is the share of the visible field's points, over all frames, whose true place lies in the reported
    90 % region. ``right`` is the share of frames that are good, or refused where the truth says that too little is in
    view. ``wrong_kinds`` counts what the wrong frames showed. A soccer field seen without its circle may be calibrated
    from its lines, and is then judged by the error over all of the field in view; what shows no soccer field is wrong
    where it is calibrated at all.
    ``bound_good`` is the share of all frames in which an estimator that reaches the Cramer-Rao bound of what they show
    (:func:`circlecal.evaluation.bench.reachable.bound_px`: from the truth, every line rightly named, at our noise and
    with our priors) expects a mean reprojection error of at most 5 px; ``bound_median_px`` is the median of these
    expectations.
    """

    profile: str
    frames: int
    calibrated: float
    good: float
    wrong: float
    right: float
    median_px: float
    p90_px: float
    predicted_median_px: float
    coverage: float
    bound_good: float
    bound_median_px: float
    decoding_ms: float
    times_decoding: float
    stage_ms: dict[str, float]
    wrong_kinds: dict[str, int]


@dataclass(frozen=True, slots=True)
class _FrameRow:
    """One frame: what :func:`compare` says of its calibration, None where it was refused; the error to expect at best;
    times of the decoding, of the whole chain and of its stages, ms; what a calibrated one shows; and whether the truth
    says that a refused one shows too little.
    """

    compared: tuple[float, float, float] | None
    bound_px: float
    decoding_ms: float
    chain_ms: float
    stages: dict[str, float]
    kind: str = ""
    refusable: bool = False

    @property
    def is_wrong(self) -> bool:
        """Whether the frame is calibrated far from the truth."""
        return self.compared is not None and self.compared[0] > WRONG_PX


def run_profiles(
    profiles: Sequence[SceneProfile],
    count: int,
    seed: int,
    advance: Callable[[str], None] = lambda _: None,
    width: int = 1920,
) -> list[ProfileRow]:
    """Render, calibrate and compare ``count`` frames of each profile, 16:9 and so many pixels wide."""
    cv2.setNumThreads(1)
    rows = []
    for profile in profiles:
        frames = []
        for index in range(count):
            frames.append(_run_frame(profile, seed, index, width))
            advance(profile)
        rows.append(_summarise(profile, frames))
    return rows


def _run_frame(profile: SceneProfile, seed: int, index: int, width: int) -> _FrameRow:
    rng = np.random.default_rng([seed, index, SCENE_PROFILES.index(profile)])
    rendering = render_frame(profile, rng, width, round(width * 9 / 16))
    encoded = cv2.imencode(".jpg", rendering.image, [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
    image = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), dtype=np.uint8)
    config = profile_config(profile, rendering.truth)
    found, chain, stages = time_run(image, config, f"{profile}-{index}", RUNS if index < TIMED_FRAMES else 1)
    bound = predict_error_px(rendering.truth, config)
    times = decoding_ms(np.asarray(encoded), 5), chain, stages
    if found.status != "calibrated" or found.attempt.camera is None:
        return _FrameRow(None, bound, *times, refusable=rendering.truth.expect == "refuse")
    return _FrameRow(compare(rendering.truth, found.attempt.camera), bound, *times, rendering.truth.kind or profile)


def profile_config(profile: str, truth: Truth) -> Config:
    """What a user knows before the picture: the sport, and the pixel aspect that a video file states."""
    name = profile_field(profile)
    aspect = float(truth.camera.focal_px[1] / truth.camera.focal_px[0])
    oblong = abs(aspect - 1.0) > 1e-6
    if name == "soccer" and not oblong:
        return Config()
    return load_config(None, [f"field.template={name}", *([f"camera.aspect={aspect}"] if oblong else [])])


def compare(truth: Truth, fit: CameraFit) -> tuple[float, float, float]:
    """Mean and mean predicted error over the visible field near the circle, and the share inside the 90 % region."""
    camera = truth.camera
    surface, grid = truth.surface, _visible(truth)
    if len(grid) == 0 or (truth.visible_circle_deg == 0.0 and truth.kind not in FIELD_KINDS):
        return float("inf"), 0.0, 0.0
    true = camera.project(surface.lift(grid))
    # a field turned by 180 degrees looks alike: errors, and what is said of them, are those of the nearer one
    near = min((grid, -grid), key=lambda places: _mean_distance_px(fit.view.project(places), true))
    seen = project(fit.theta[None], near[None], fit.model)
    difference, by_theta = seen.pixels[0] - true, seen.jacobians()[0][0]
    spread = np.einsum("nip,pq,njq->nij", by_theta, fit.covariance, by_theta)
    distance = np.einsum("ni,nij,nj->n", difference, np.linalg.inv(spread), difference)
    sigma, _ = seen.sigma(fit.covariance)
    unit = 1920.0 / camera.width
    error = float(np.linalg.norm(difference, axis=-1).mean()) * unit
    return error, float(sigma.mean()) * unit, float(np.mean(distance < CHI2_90))


def _mean_distance_px(here: Array, there: Array) -> float:
    """Mean distance of pixels (N, 2), of which those behind the camera are far off."""
    return float(np.nan_to_num(np.linalg.norm(here - there, axis=-1), nan=BEHIND_PX).mean())


def predict_error_px(truth: Truth, config: Config) -> float:
    """Mean reprojection error, px at 1920 px width, that the markings in view let one expect at best.

    Of a field of another size than its template's nothing is known before but what the Laws allow.
    """
    field = truth.template
    if field.sizes != load_field(field.name).sizes:
        field = field.model_copy(update=ANY_SIZE_SD)
    return bound_px(truth, _visible(truth), field, config.camera)


def _visible(truth: Truth) -> Array:
    """Points (N, 2) of the field at which errors are measured: a grid over what the picture shows of it, metres."""
    field = truth.template
    circle = field.circle_by_name[field.default_circle]
    step = circle.radius_m / 9.15
    reach = REACH_RADII * circle.radius_m if truth.visible_circle_deg > 0.0 else max(field.length_m, field.width_m) / 2
    axis = np.arange(-reach, reach + 0.5 * step, step)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    grid += np.asarray(circle.center) if truth.visible_circle_deg > 0.0 else 0.0
    grid = grid[(np.abs(grid) <= (field.length_m / 2, field.width_m / 2)).all(axis=1)]
    pixels = truth.camera.project(truth.surface.lift(grid))
    x0, y0, x1, y1 = truth.picture_box_px
    with np.errstate(invalid="ignore"):
        inside = (pixels >= (x0, y0)).all(axis=1) & (pixels <= (x1, y1)).all(axis=1)
    return grid[inside]


def _summarise(profile: str, frames: list[_FrameRow]) -> ProfileRow:
    compared = np.array([f.compared for f in frames if f.compared is not None]).reshape(-1, 3)
    errors, predicted, inside = compared.T
    good, refusable = int(np.sum(errors <= GOOD_PX)), sum(f.refusable for f in frames)
    bounds = np.array([f.bound_px for f in frames])
    bound_median_px = float(np.median(bounds))
    timed = frames[:TIMED_FRAMES]
    return ProfileRow(
        profile=profile,
        frames=len(frames),
        calibrated=len(errors) / len(frames),
        good=good / len(frames),
        wrong=sum(f.is_wrong for f in frames) / len(frames),
        right=(good + refusable) / len(frames),
        median_px=_or_nan(np.median, errors),
        p90_px=_or_nan(lambda found: np.percentile(found, 90), errors),
        predicted_median_px=_or_nan(np.median, predicted),
        coverage=_or_nan(np.mean, inside),
        bound_good=float(np.mean(bounds <= GOOD_PX)),
        bound_median_px=bound_median_px if np.isfinite(bound_median_px) else float("nan"),
        decoding_ms=float(np.median([f.decoding_ms for f in timed])),
        times_decoding=float(np.median([f.chain_ms / f.decoding_ms for f in timed])),
        stage_ms=_stage_times(timed),
        wrong_kinds=dict(Counter(f.kind for f in frames if f.is_wrong)),
    )


def _or_nan(statistic: Callable[[Array], float], values: Array) -> float:
    """A statistic of the values (N,); nan where there are none."""
    with np.errstate(invalid="ignore"):  # a negative that is calibrated has an infinite error
        return float(statistic(values)) if len(values) else float("nan")


def _stage_times(frames: Sequence[_FrameRow]) -> dict[str, float]:
    """Median time of each stage over the frames that reach it, ms, in the order of the frame with the most stages."""
    stages = max((f.stages for f in frames), key=len)
    return {name: float(np.median([f.stages[name] for f in frames if name in f.stages])) for name in stages}
