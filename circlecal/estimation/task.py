"""What a camera is estimated from, and how far the estimate has come."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from circlecal.camera.multistart import COARSE_POINTS
from circlecal.camera.observed import NoiseModel, curves_from_observations, points_from_observations
from circlecal.camera.options import CameraConfig, noise_model, priors_of, relief_of
from circlecal.camera.problem import Problem, State
from circlecal.camera.residuals import CurvePoints
from circlecal.camera.spike_and_slab import Posterior
from circlecal.camera.starts_circle import SeenEllipse
from circlecal.camera.starts_landmarks import Landmarks
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera_parameters import ProjectionModel
from circlecal.geometry.least_squares import StoppingRule
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface
from circlecal.observations import CirclePoints, LinePoints, MarkingKey, Observations
from circlecal.results import CameraFit, RoughCamera

DENSE_POINTS = 60
"""Of a marking: so many tell their noise, and which of them lie on something else; clicked ones are fewer."""

ARC_SIGMA_PX = 0.5
"""Of the points of curves that were seen without a name, at 1920 px width."""


@dataclass(frozen=True, slots=True)
class Task:
    """What a camera is estimated from, and with; the names of lines, by index, were given to them here."""

    observations: Observations
    template: FieldTemplate
    circle: Circle
    config: CameraConfig
    side: str
    earlier: CameraFit | RoughCamera | None
    names: dict[int, str] = field(default_factory=dict)

    @property
    def noise(self) -> NoiseModel:
        """How far points are trusted."""
        return noise_model(self.config, self.observations.width)

    @property
    def coarse_noise(self) -> NoiseModel:
        """How far, and how many, while hypotheses are only compared."""
        return replace(self.noise, maximum_points=COARSE_POINTS)

    def curves(self) -> CurvePoints:
        """All named circles, arcs and lines."""
        return curves_from_observations(self.observations, self.template, self.noise)

    def problem(self) -> Problem:
        """All that is seen, and the priors."""
        reference_m = max(self.circle.radius_m, 1e-3)
        surface = Surface(self.config.usual_crown, reference_m)
        model = ProjectionModel(self.observations.width, self.observations.height, surface)
        priors = priors_of(self.config, self.template, self.circle, model)
        points = points_from_observations(self.observations, self.template, relief_of(self.config, self.template))
        return Problem(self.curves(), points, priors, model, self.config.loss_scale)

    def rule(self, rule: StoppingRule, bar: float = np.inf) -> StoppingRule:
        """A stopping rule with the limit of iterations that the options set."""
        return replace(rule, iterations=self.config.iterations, bar=bar)

    def with_names(self, lines: dict[int, str], arcs: dict[int, str] | None = None) -> Task:
        """The task with names of seen lines and curves, by their index; one that has a name or no points gets none."""
        given = self.observations
        lines = {k: lines[k] for k, line in enumerate(given.lines) if k in lines and _can_be_named(line)}
        named = tuple(replace(line, line=lines.get(k, line.line)) for k, line in enumerate(given.lines))
        sigma_px = ARC_SIGMA_PX * given.width / 1920.0
        found = ((name, given.curves[k]) for k, name in (arcs or {}).items())
        circles = (CirclePoints(name, "center", points, np.full(len(points), sigma_px)) for name, points in found)
        observations = replace(given, lines=named, circles=(*given.circles, *circles))
        return replace(self, observations=observations, names=lines)

    def without(self, keys: Collection[MarkingKey]) -> Task:
        """The task without some of its markings, and their names; lines keep their numbers."""
        given = self.observations
        lines = tuple(line.clear() if line.key in keys else line for line in given.lines)
        names = {k: name for k, name in self.names.items() if MarkingKey(name) not in keys}
        return replace(self, observations=replace(given.without(keys), lines=lines), names=names)

    def without_marking(self, name: str, names: dict[int, str], by_end: bool) -> Task:
        """The task without a marking: what was taken for it is nothing, nor, ``by_end``, where other lines end.

        ``names`` are those that were given to lines, by their index, which stays what it is.
        """
        given = self.observations
        circles = tuple(circle for circle in given.circles if circle.circle != name)
        lines = tuple(
            line.clear() if names.get(k, line.line) == name else replace(line, ends=() if by_end else line.ends)
            for k, line in enumerate(given.lines)
        )
        return replace(self, observations=replace(given, circles=circles, lines=lines))


@dataclass(frozen=True, slots=True)
class Sight:
    """A task as a problem, with what starts can come from: the circle's ellipse, or where it shows none, landmarks."""

    problem: Problem
    ellipse: SeenEllipse | None
    landmarks: Landmarks | None


@dataclass(frozen=True, slots=True)
class Fit:
    """Where the estimate stands.

    Attributes
    ----------
    problem, state : Problem, State
        With the standard deviations of the moment.
    scale : float
        By how much these have grown.
    least : CurvePoints or None
        Points with the least standard deviations that they can have, where the residuals have told the noise.
    posterior : Posterior or None
        What is assumed of the field, and what else it may be like; None where there is no choice.
    given_px : (N,) array or None
        Standard deviations of the points before their residuals told more; None where they did not.
    growth : float
        How many times the variance along the valley of zoom and distance is what the linear model says.
    """

    problem: Problem
    state: State
    scale: float = 1.0
    least: CurvePoints | None = None
    posterior: Posterior | None = None
    given_px: Array | None = None
    growth: float = 1.0


def _can_be_named(line: LinePoints) -> bool:
    return line.line is None and len(line.points_px) > 0


def is_dense(curves: CurvePoints) -> bool:
    """Whether a marking has so many points that they tell their noise."""
    return bool(np.bincount(curves.group, minlength=1).max() >= DENSE_POINTS)
