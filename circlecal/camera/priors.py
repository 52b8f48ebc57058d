"""What is known of a camera before a frame: Gaussians on its parameters, its usual place, and what other frames say.

Position, roll, lens, principal point, surface and the field's sizes belong to the camera and the stadium, not to a
frame: frames of one standing camera share them. Principal point and distortion may change with the zoom: linearly with
the logarithm of the focal length, and the radial distortion by the bend of a zoom lens beside that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from circlecal.camera.viewing_coordinates import columns_of
from circlecal.geometry.camera_parameters import INDEX, KAPPA_1, LOG_FOCAL, PARAMETERS, active_parameters
from circlecal.geometry.projective import Array, Indices

SHARED = (
    "roll", "x", "y", "z", "pp_x", "pp_y", "kappa_1", "kappa_2", "log_aspect", "crown", "width", "length", "breadth",
)  # fmt: skip
"""Parameters that frames of one camera share."""
ZOOMED = ("pp_x", "pp_y", "kappa_1")
"""Of these, the ones that may change with the zoom."""
_IN_PIXELS = ("pp_x", "pp_y")
_BY_ZOOM = " by zoom"
INDEFINITE = 1e-9
"""Least eigenvalue, as a correlation below 0, that rounding gives a covariance in a file."""
RIDGE = 2.0 * INDEFINITE
"""Added to the unit diagonal of correlations, so that those of parameters that follow each other exactly have a
Cholesky factor.
"""
MOST_WIDTHS = 1.33
"""Picture widths over the focal length up to which :class:`ZoomLens` was measured: wider lenses are others."""
KNOWN_POSITION_SD_M = 1.0
"""A position known to this along each axis, metres, is where the search starts. Separates cameras of a rig, whose
position five frames determine to 0.1 m (Cramer-Rao bound), from a vague prior of the venue.
"""
_GROWTH = [INDEX["length"], INDEX["breadth"]]
_POSITION = slice(INDEX["x"], INDEX["z"] + 1)
_X_Y_Z = range(_POSITION.start, _POSITION.stop)


@dataclass(frozen=True, slots=True)
class ZoomLens:
    """How the radial distortion of a zoom lens follows the focal length f: ``k1 = k1_far - by_focal (w / f)^2``, pixels
    for pictures w pixels wide.

    Attributes
    ----------
    far, by_focal : float
        Half-widths: at the long end, and what it has less where the focal length is one width.
    width : float
        Of the pictures, pixels.
    """

    far: float
    by_focal: float
    width: float

    def kappa(self, log_focal: Array) -> Array:
        """Usual radial distortion (...), half-widths, at logarithms of focal lengths in pixels (...)."""
        return np.asarray(self.far - self.by_focal * np.minimum(self._square_of_widths(log_focal), MOST_WIDTHS**2))

    def slope(self, log_focal: Array) -> Array:
        """Its derivative (...) by them."""
        squared = self._square_of_widths(log_focal)
        return np.asarray(np.where(squared < MOST_WIDTHS**2, 2.0 * self.by_focal * squared, 0.0))

    def bend(self, log_focal: Array, about: float) -> tuple[Array, Array]:
        """By how much the radial distortion (...) differs at logarithms of focal lengths (...) from what its value and
        its slope ``about`` one of them make of it, and the derivative (...) of that. :attr:`far` does not count.
        """
        at = np.array(about)
        away = np.asarray(log_focal) - at
        slope = self.slope(at)
        return self.kappa(log_focal) - self.kappa(at) - slope * away, self.slope(log_focal) - slope

    def _square_of_widths(self, log_focal: Array) -> Array:
        return np.asarray(np.exp(2.0 * (np.log(self.width) - log_focal)))


LINEAR = ZoomLens(far=0.0, by_focal=0.0, width=1)
"""A lens without a bend: its radial distortion is linear in the logarithm of the focal length."""


@dataclass(frozen=True, slots=True)
class SharedPrior:
    """Gaussian on K shared parameters at one focal length and on how Z of them change with the zoom.

    Attributes
    ----------
    parameters, zoomed : tuples of str
        Names (K) and (Z).
    log_focal : float
        Logarithm of the focal length in pixels at which the parameters are quoted.
    mean, covariance : (K + Z,), (K + Z, K + Z) arrays
        First the parameters, then their changes per unit of the logarithm of the focal length.
    deviation_sd : (K,) array
        How far a single frame may deviate: no camera turns about exactly one point.
    lens : ZoomLens
        By how much the radial distortion, where it changes with the zoom, bends away from the linear change.
    """

    parameters: tuple[str, ...]
    zoomed: tuple[str, ...]
    log_focal: float
    mean: Array
    covariance: Array
    deviation_sd: Array
    lens: ZoomLens = LINEAR

    @property
    def indices(self) -> Indices:
        """Where the parameters stand in the parameter vector (K,)."""
        return np.array([INDEX[name] for name in self.parameters], dtype=np.int_)

    def at(self, log_focal: Array) -> tuple[Array, Array, Array]:
        """Means (B, K), covariances (B, K, K) and changes with the zoom (B, K) at logarithms of focal lengths (B,)."""
        K = len(self.parameters)
        spread = np.zeros((K, len(self.zoomed)))
        spread[[self.parameters.index(name) for name in self.zoomed], np.arange(len(self.zoomed))] = 1.0
        mapping = np.concatenate(
            [
                np.broadcast_to(np.eye(K), (len(log_focal), K, K)),
                (log_focal - self.log_focal)[:, None, None] * spread,
            ],
            axis=2,
        )
        covariance = mapping @ self.covariance @ np.swapaxes(mapping, 1, 2) + np.diag(self.deviation_sd**2)
        mean = mapping @ self.mean
        slope = np.tile(spread @ self.mean[K:], (len(log_focal), 1))
        if "kappa_1" in self.zoomed:
            bend, steeper = self.lens.bend(log_focal, self.log_focal)
            mean[:, self.parameters.index("kappa_1")] += bend
            slope[:, self.parameters.index("kappa_1")] += steeper
        return mean, covariance, slope

    @property
    def frame_sd(self) -> Array:
        """Standard deviations (K,) of the parameters of a single frame, which may deviate from the shared ones."""
        shared_sd = np.sqrt(np.diag(self.covariance)[: len(self.parameters)])
        return np.asarray(np.hypot(shared_sd, self.deviation_sd))

    def residuals(self, theta: Array) -> tuple[Array, Array]:
        """Normalised residuals (B, K) of parameter vectors (B, P) and their Jacobian (B, K, P).

        How the covariance grows with the zoom is left out of the Jacobian, and its determinant out of the sum of
        squares: on the average the derivatives of the two balance.
        """
        mean, covariance, slope = self.at(theta[:, 0])
        size = np.sqrt(np.einsum("bkk->bk", covariance))
        correlation = covariance / (size[:, :, None] * size[:, None, :])
        # by Cholesky's factor, which changes with the zoom as smoothly as the covariance does
        correlation = correlation + RIDGE * np.eye(len(self.parameters))
        root = np.linalg.inv(np.linalg.cholesky(correlation)) / size[:, None, :]
        jacobian = np.zeros((*root.shape[:2], len(PARAMETERS)))
        jacobian[..., self.indices] = root
        jacobian[..., 0] = -(root @ slope[..., None])[..., 0]
        return (root @ (theta[:, self.indices] - mean)[..., None])[..., 0], jacobian

    def only(self, names: Sequence[str]) -> SharedPrior:
        """The marginal of some of the parameters."""
        kept = [k for k, name in enumerate(self.parameters) if name in names]
        also = [k for k, name in enumerate(self.zoomed) if name in names]
        index = np.array(kept + [len(self.parameters) + k for k in also], dtype=int)
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in kept),
            zoomed=tuple(self.zoomed[k] for k in also),
            mean=self.mean[index],
            covariance=self.covariance[np.ix_(index, index)],
            deviation_sd=self.deviation_sd[kept],
        )

    def resize(self, factor: float) -> SharedPrior:
        """The prior for pictures that are ``factor`` times as wide."""
        size = np.array([factor if name in _IN_PIXELS else 1.0 for name in (*self.parameters, *self.zoomed)])
        return replace(
            self,
            log_focal=self.log_focal + float(np.log(factor)),
            mean=self.mean * size,
            covariance=self.covariance * np.outer(size, size),
            deviation_sd=self.deviation_sd * size[: len(self.parameters)],
            lens=replace(self.lens, width=self.lens.width * factor),
        )


class SharedPriorConfig(BaseModel):
    """A :class:`SharedPrior` as it is written in configurations and prior files."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    width: int = Field(gt=0, description="Width of the pictures that pixels refer to.")
    log_focal: float = Field(description="Logarithm of the focal length in pixels at which the parameters are quoted.")
    parameters: tuple[str, ...] = Field(
        min_length=1, description="Names; `pp_x by zoom` is the change of pp_x per unit of log_focal."
    )
    mean: tuple[float, ...] = Field(description="Means of the parameters.")
    covariance: tuple[tuple[float, ...], ...] = Field(description="Their covariance.")
    deviation_sd: tuple[float, ...] = Field(description="How far a single frame may deviate from each of them.")
    k1_by_focal: float = Field(
        0.0,
        ge=0,
        description="The b of the law -b (width / f)^2 along which kappa_1 bends away from its linear change by zoom; "
        "0 for a linear change alone, as in files without this key.",
    )

    def model_post_init(self, context: object) -> None:
        """Check names, sizes and that the covariance is one.

        Raises
        ------
        ValueError
            Where they do not fit.
        """
        names = [name for name in self.parameters if not name.endswith(_BY_ZOOM)]
        zoomed = [name.removesuffix(_BY_ZOOM) for name in self.parameters[len(names) :]]
        if set(names) - set(SHARED) or len(set(names)) != len(names) or set(zoomed) - (set(names) & set(ZOOMED)):
            raise ValueError(f"parameters must be different ones of {', '.join(SHARED)}, then changes by zoom")
        K = len(self.parameters)
        if len(self.mean) != K or {len(self.covariance), *map(len, self.covariance)} != {K}:
            raise ValueError(f"mean and covariance must have the size of parameters, {K}")
        if len(self.deviation_sd) != len(names) or min(self.deviation_sd) < 0:
            raise ValueError(f"deviation_sd needs {len(names)} standard deviations")
        matrix = np.array(self.covariance)
        if not np.allclose(matrix, matrix.T, rtol=1e-6) or (np.diag(matrix) <= 0).any():
            raise ValueError("covariance must be symmetric with a positive diagonal")
        size = np.sqrt(np.diag(matrix))
        if np.linalg.eigvalsh(matrix / np.outer(size, size))[0] < -INDEFINITE:
            raise ValueError("covariance must be positive definite")
        if any(name.endswith(_BY_ZOOM) for name in self.parameters[: len(names)]):
            raise ValueError("parameters must have their changes by zoom last")

    def prior(self, width: int) -> SharedPrior:
        """The prior for pictures of some width."""
        names = tuple(name for name in self.parameters if not name.endswith(_BY_ZOOM))
        zoomed = tuple(name.removesuffix(_BY_ZOOM) for name in self.parameters[len(names) :])
        prior = SharedPrior(
            names,
            zoomed,
            self.log_focal,
            np.array(self.mean),
            np.array(self.covariance),
            np.array(self.deviation_sd),
            ZoomLens(0.0, self.k1_by_focal, self.width),
        )
        return prior if width == self.width else prior.resize(width / self.width)

    @staticmethod
    def of(prior: SharedPrior, width: int) -> SharedPriorConfig:
        """A prior for pictures of some width as configuration."""
        return SharedPriorConfig(
            width=width,
            log_focal=float(prior.log_focal),
            parameters=(*prior.parameters, *(f"{name}{_BY_ZOOM}" for name in prior.zoomed)),
            mean=tuple(prior.mean.tolist()),
            covariance=tuple(tuple(row) for row in prior.covariance.tolist()),
            deviation_sd=tuple(prior.deviation_sd.tolist()),
            k1_by_focal=prior.lens.by_focal if "kappa_1" in prior.zoomed else 0.0,
        )


@dataclass(frozen=True)
class Priors:
    """Gaussian priors of the parameters, and of a camera's usual place.

    Attributes
    ----------
    mean, sd : (P,) arrays
        Per parameter; sd 0 fixes it at its mean, inf leaves it free. Of B hypotheses at once (B, P),
        :func:`stack_priors`: then as many starts are asked for, each by its own.
    distance_m, distance_log_sd : float
        Log-normal prior of the distance from ``center_m``; sd inf for none.
    elevation_rad, elevation_sd_rad : float
        Gaussian prior of the angle under which the camera looks down on it; sd inf for none.
    center_m : (2,) array
        What the camera looks at: the circle's centre, or the middle of what was seen instead of the circle.
    center_by_growth : (2,) array
        By how much that moves along x per metre that the field is longer, and along y per metre that it is broader.
    shared : SharedPrior or None
        What other frames of the same camera say; the parameters that it covers have no other prior.
    lens : ZoomLens or None
        How the mean of the radial distortion follows the focal length; None where it does not.
    """

    mean: Array
    sd: Array
    distance_m: float
    distance_log_sd: float
    elevation_rad: float
    elevation_sd_rad: float
    center_m: Array
    center_by_growth: Array = field(default_factory=lambda: np.zeros(2))
    shared: SharedPrior | None = None
    lens: ZoomLens | None = None

    @property
    def standing_m(self) -> Array | None:
        """Where the camera stands (3,), metres, if that is known well."""
        known = self.sd <= KNOWN_POSITION_SD_M
        if self.shared is not None:
            known[self.shared.indices] = True
        return self.mean[_POSITION] if known[_POSITION].all() else None

    @cached_property
    def active(self) -> Indices:
        """Indices of the parameters that are estimated."""
        return active_parameters(np.atleast_2d(self.sd)[0])

    @cached_property
    def is_camera_free(self) -> bool:
        """Whether focal length, angles and place are all estimated."""
        return bool((self.sd[..., : _POSITION.stop] > 0).all())

    def center_of(self, theta: Array) -> Array:
        """What the cameras look at, metres, on the field of the size that theta (B, P) has: (B, 2), or (1, 2) where it
        is one place for all.
        """
        return self.center_m + self.center_by_growth * theta[:, _GROWTH] if self._has_moving_center else self._center

    @cached_property
    def _has_moving_center(self) -> bool:
        return bool(self.center_by_growth.any())

    @cached_property
    def _center(self) -> Array:
        return np.asarray(self.center_m, dtype=np.float64)[None]

    def residuals(self, theta: Array) -> tuple[Array, Array]:
        """Normalised residuals (B, K) and their Jacobian (B, K, P)."""
        values, jacobian = self._of_parameters_and_place(theta)
        if self.shared is None:
            return values, jacobian
        shared, by_theta = self.shared.residuals(theta)
        return np.concatenate([values, shared], axis=1), np.concatenate([jacobian, by_theta], axis=1)

    @cached_property
    def _linear(self) -> tuple[Indices, Array, Array, Array]:
        """Which parameters have a prior of their own (K,), their means and standard deviations (..., K), and the
        Jacobian (..., K or more, P) without the place's.
        """
        first = np.atleast_2d(self.sd)[0]
        used = np.flatnonzero((first > 0) & np.isfinite(first))
        place = np.isfinite([self.distance_log_sd, self.elevation_sd_rad])
        mean, sd = self.mean[..., used], self.sd[..., used]
        jacobian = np.zeros((*sd.shape[:-1], len(used) + int(place.sum()), len(PARAMETERS)))
        jacobian[..., np.arange(len(used)), used] = 1.0 / sd
        return used, mean, sd, jacobian

    @cached_property
    def _lens_row(self) -> int | None:
        """Which of the parameters with a prior of their own is the radial distortion; None where it is none of them."""
        row = np.flatnonzero(self._linear[0] == KAPPA_1)
        return int(row[0]) if len(row) else None

    def usual_kappa(self, log_focal: float) -> float:
        """The radial distortion that is expected at a logarithm of the focal length, half-widths."""
        return float(self.mean[KAPPA_1] if self.lens is None else self.lens.kappa(np.array(log_focal)))

    def distortion_off(self, theta: Array) -> float:
        """By how much the radial distortion of a camera (P,) is more than what is expected of its focal length."""
        return float(theta[KAPPA_1]) - self.usual_kappa(theta[LOG_FOCAL])

    def at_focal(self, log_focal: float) -> Priors:
        """The priors for one focal length, at which the radial distortion has a mean."""
        mean = self.mean.copy()
        mean[KAPPA_1] = self.usual_kappa(log_focal)
        return replace(self, mean=mean, lens=None)

    def _of_parameters_and_place(self, theta: Array) -> tuple[Array, Array]:
        used, mean, sd, linear = self._linear
        jacobian = np.empty((len(theta), *linear.shape[-2:]))
        jacobian[:] = linear
        values, row = np.empty(jacobian.shape[:2]), len(used)
        values[:, :row] = (theta[:, used] - mean) / sd
        if self.lens is not None and self._lens_row is not None:
            k, log_focal = self._lens_row, theta[:, LOG_FOCAL]
            values[:, k] = (theta[:, KAPPA_1] - self.lens.kappa(log_focal)) / sd[..., k]
            jacobian[:, k, LOG_FOCAL] = -self.lens.slope(log_focal) / sd[..., k]
        if row == linear.shape[-2]:
            return values, jacobian
        x, y, z = columns_of(theta[:, _POSITION])
        x, y = x - self.center_m[0], y - self.center_m[1]
        level2 = np.maximum(x * x + y * y, 1e-12)
        distance2 = np.maximum(level2 + z * z, 1e-6)
        if np.isfinite(self.distance_log_sd):
            values[:, row] = (0.5 * np.log(distance2) - np.log(self.distance_m)) / self.distance_log_sd
            scale = distance2 * self.distance_log_sd
            for column, offset in zip(_X_Y_Z, (x, y, z), strict=True):
                jacobian[:, row, column] = offset / scale
            row += 1
        if np.isfinite(self.elevation_sd_rad):
            level = np.sqrt(level2)
            rise = z / level
            values[:, row] = (np.arctan2(-z, level) - self.elevation_rad) / self.elevation_sd_rad
            scale = distance2 * self.elevation_sd_rad
            for column, by_offset in zip(_X_Y_Z, (x * rise, y * rise, -level), strict=True):
                jacobian[:, row, column] = by_offset / scale
        return values, jacobian


def stack_priors(priors: Sequence[Priors]) -> Priors:
    """Priors of several hypotheses about a camera as one, which differ in means and in standard deviations alone, and
    estimate the same parameters.
    """
    mean, sd = (np.array([getattr(own, name) for own in priors]) for name in ("mean", "sd"))
    return replace(priors[0], mean=mean, sd=sd)
