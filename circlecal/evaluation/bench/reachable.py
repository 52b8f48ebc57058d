"""What the markings that a rendered frame shows allow at best: the Cramer-Rao bound from the truth alone."""

from __future__ import annotations

import numpy as np

from circlecal.camera.options import CameraConfig
from circlecal.camera.world import FLAT_SD_M
from circlecal.evaluation.bench.bounds import bound_covariance
from circlecal.field import Circle, FieldTemplate, Line
from circlecal.geometry.camera_parameters import ProjectionModel, project, theta_of
from circlecal.geometry.projective import Array, Mask
from circlecal.geometry.surface import Surface
from circlecal.observations import CirclePoints, LinePoints, MarkPoint, Observations
from circlecal.synthetic.paint import class_id
from circlecal.synthetic.truth import Truth

CIRCLE_SIGMA_PX, LINE_SIGMA_PX, CORRELATION_PX = 0.05, 0.08, 60.0
"""What the middle of a circle and of a straight marking are measured to over a stretch of the last length, pixels at
1920 px width: medians of the frames of ``partial``, ``hidden_mark`` and ``hard`` against their truth, with what
neighbouring points repeat of each other's error.
"""
MARK_SIGMA_PX = 0.4
"""Of a spot, pixels at 1920 px width."""
_SPACING_PX = 4.0
"""Between points along a marking, pixels at 1920 px width: what they repeat of each other's error is in their noise."""
_STEP_M, _SOCCER_RADIUS_M = 0.02, 9.15
"""Between places along a marking of a soccer field, metres; as much smaller on others as their circle is."""
_DRAWS = 400
"""Over which the expected error is averaged."""


def bound_px(truth: Truth, grid_m: Array, template: FieldTemplate, config: CameraConfig) -> float:
    """Expected mean reprojection error of a frame, px at 1920 px width, of an estimator that reaches the bound.

    The observations are what the truth knows to be seen of the template's markings: their unoccluded places inside
    the picture, every line rightly named, at the noise that the measurement of edges has. Lens, principal point,
    crown and the camera's place have the priors of ``config``. Painters' errors, where they were drawn, are as
    large as the template says and known to nobody. The profile of the field is known, its crown has the prior that
    it has among fields of its kind: a flat one is flat to half a centimetre, as nobody knows a field better. No
    detection, no result and no wear of the paint enters.

    Parameters
    ----------
    truth : Truth
    grid_m : (N, 2) array
        Field points over which the error is averaged.
    template : FieldTemplate
        The field.
    config : CameraConfig
        Priors.

    Returns
    -------
    float
        Infinite where nothing fixes the rotation about the circle, or no circle is seen.
    """
    circle = template.circle_by_name[template.default_circle]
    seen = visible_observations(truth, template)
    if len(grid_m) == 0 or seen.circle(circle.name, "center") is None or not (seen.lines or len(seen.circles) > 1):
        return float("inf")
    camera, surface = truth.camera, truth.surface
    shaped = config.model_copy(update=_describe_crown(surface))
    placed = template if truth.painted == truth.template else truth.painted
    covariance = bound_covariance(camera, surface.crown_m, seen, placed, circle, shaped, with_painters=True)
    model = ProjectionModel.of(camera, surface)
    theta = theta_of(camera, model, surface.crown_m)
    jacobian = project(theta[None], grid_m[None], model).jacobians()[0][0]
    values, vectors = np.linalg.eigh(covariance)
    root = jacobian @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    rng = np.random.default_rng(0)
    draws = rng.standard_normal((len(values), _DRAWS))
    return float(np.linalg.norm(root @ draws, axis=1).mean()) * 1920.0 / truth.camera.width


def _describe_crown(surface: Surface) -> dict[str, object]:
    """Options for a field whose profile is known, and how far it falls is not."""
    if surface.shape == "flat":
        return {"crown_shape": "roof", "crown_m": 0.0, "crown_sd_m": FLAT_SD_M}
    return {"crown_shape": surface.shape}


def visible_observations(truth: Truth, template: FieldTemplate) -> Observations:
    """Noiseless points along the middle of everything that is painted, in view and not covered."""
    camera = truth.camera
    surface = truth.surface
    unit = camera.width / 1920.0
    spread = unit * np.sqrt(CORRELATION_PX / _SPACING_PX)
    painted = truth.painted
    elements: tuple[Circle | Line, ...] = (*painted.round_ones, *painted.lines)
    middles = painted.polylines(_STEP_M * painted.circle_by_name[painted.default_circle].radius_m / _SOCCER_RADIUS_M)
    circles, lines = [], []
    for element in elements:
        pixels = camera.project(surface.lift(middles[element.name]))
        pixels = pixels[_is_uncovered(truth, pixels, class_id(template, element))]
        pixels = _thin(pixels, _SPACING_PX * unit)
        if len(pixels) < 2:
            continue
        if isinstance(element, Line):
            lines.append(LinePoints(element.name, pixels, np.full(len(pixels), LINE_SIGMA_PX * spread)))
        else:
            sigma = np.full(len(pixels), CIRCLE_SIGMA_PX * spread)
            circles.append(CirclePoints(element.name, "center", pixels, sigma))
    seen_mark = truth.center_mark == "visible"
    marks = (MarkPoint("centre_mark", truth.imaged_center_px, MARK_SIGMA_PX * unit),) if seen_mark else ()
    return Observations(camera.width, camera.height, tuple(circles), tuple(lines), marks)


def _is_uncovered(truth: Truth, pixels: Array, painted: int) -> Mask:
    """Which places (N, 2) lie in the picture and show the paint of a class."""
    x0, y0, x1, y1 = truth.picture_box_px
    with np.errstate(invalid="ignore"):
        inside = np.asarray(((pixels >= (x0, y0)) & (pixels <= (x1, y1))).all(axis=1), np.bool_)
    column, row = np.rint(np.where(inside[:, None], pixels, 0.0)).astype(np.intp).T
    return np.asarray(inside & (truth.classes[row, column] == painted), np.bool_)


def _thin(pixels: Array, spacing_px: float) -> Array:
    """About one of the places (N, 2) along a curve for every so many pixels of it."""
    if len(pixels) < 2:
        return pixels
    step = np.hypot(*np.diff(pixels, axis=0).T)
    # a gap is no length
    travelled = np.concatenate([[0.0], np.cumsum(np.where(step < spacing_px, step, 0.0))])
    return pixels[np.diff(np.floor(travelled / spacing_px), prepend=-1.0) > 0]
