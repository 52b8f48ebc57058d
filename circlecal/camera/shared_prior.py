"""What other frames of one standing camera say of a frame: a Gaussian on what they share.

Position, roll, lens, principal point, surface and the field's sizes belong to the camera and the stadium, not to a
frame. Principal point and distortion may change with the zoom: linearly with the logarithm of the focal length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from circlecal.geometry.camera_parameters import INDEX, PARAMETERS
from circlecal.geometry.projective import Array, Indices

SHARED = (
    "roll", "x", "y", "z", "pp_x", "pp_y", "kappa_1", "kappa_2", "log_aspect", "crown", "width", "length", "breadth",
)  # fmt: skip
"""Parameters that frames of one camera share."""
ZOOMED = ("pp_x", "pp_y", "kappa_1")
"""Of these, the ones that may change with the zoom."""
_IN_PIXELS = ("pp_x", "pp_y")
_BY_ZOOM = " by zoom"


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
    """

    parameters: tuple[str, ...]
    zoomed: tuple[str, ...]
    log_focal: float
    mean: Array
    covariance: Array
    deviation_sd: Array

    @property
    def indices(self) -> Indices:
        """Where the parameters stand in the parameter vector (K,)."""
        return np.array([INDEX[name] for name in self.parameters], dtype=np.int_)

    def at(self, log_focal: Array) -> tuple[Array, Array, Array]:
        """Means (B, K), covariances (B, K, K) and changes with the zoom (K,) at logarithms of focal lengths (B,)."""
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
        return mapping @ self.mean, covariance, spread @ self.mean[K:]

    def residuals(self, theta: Array) -> tuple[Array, Array]:
        """Normalised residuals (B, K) of parameter vectors (B, P) and their Jacobian (B, K, P)."""
        mean, covariance, slope = self.at(theta[:, 0])
        size = np.sqrt(np.einsum("bkk->bk", covariance))
        correlation = covariance / (size[:, :, None] * size[:, None, :])
        values, vectors = np.linalg.eigh(correlation)
        root = np.swapaxes(vectors / np.sqrt(np.maximum(values, 1e-12))[:, None, :], 1, 2) / size[:, None, :]
        jacobian = np.zeros((*root.shape[:2], len(PARAMETERS)))
        jacobian[..., self.indices] = root
        jacobian[..., 0] = -(root @ slope)
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

    def scaled(self, factor: float) -> SharedPrior:
        """The same for pictures that are ``factor`` times as wide."""
        size = np.array([factor if name in _IN_PIXELS else 1.0 for name in (*self.parameters, *self.zoomed)])
        return replace(
            self,
            log_focal=self.log_focal + float(np.log(factor)),
            mean=self.mean * size,
            covariance=self.covariance * np.outer(size, size),
            deviation_sd=self.deviation_sd * size[: len(self.parameters)],
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

    def model_post_init(self, context: object) -> None:
        """Check names, sizes and that the covariance is one.

        Raises
        ------
        ValueError
            Where they do not fit.
        """
        names = [name for name in self.parameters if not name.endswith(_BY_ZOOM)]
        zoomed = [name.removesuffix(_BY_ZOOM) for name in self.parameters[len(names) :]]
        if set(names) - set(SHARED) or len(set(names)) != len(names) or set(zoomed) - set(names) & set(ZOOMED):
            raise ValueError(f"parameters must be different ones of {', '.join(SHARED)}, then changes by zoom")
        K = len(self.parameters)
        if len(self.mean) != K or {len(self.covariance), *map(len, self.covariance)} != {K}:
            raise ValueError(f"mean and covariance must have the size of parameters, {K}")
        if len(self.deviation_sd) != len(names) or min(self.deviation_sd) < 0:
            raise ValueError(f"deviation_sd needs {len(names)} standard deviations")
        matrix = np.array(self.covariance)
        if not np.allclose(matrix, matrix.T, rtol=1e-6) or (np.diag(matrix) <= 0).any():
            raise ValueError("covariance must be symmetric with a positive diagonal")

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
        )
        return prior if width == self.width else prior.scaled(width / self.width)

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
        )
