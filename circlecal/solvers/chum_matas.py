"""Homography from two or more ellipses by its first-order expansion (Chum and Matas 2012), iterated.

With A the affinity from the unit circle to a circle of the field and B that to its ellipse, ``M = B^-1 H A`` keeps the
unit circle. To first order about the centre M is a rotation (times w): ``M02 = M12 = 0``, ``M00 = M11`` and
``M01 = -M10``, four linear equations in H per ellipse. That is exact for an affine H; otherwise its error grows
with the perspective and with the square of the ellipses' size. The iteration expands the image of each circle about
the current H instead and weighs it with the information of the fitted ellipse, so it ends at the maximum of the
likelihood of the ellipses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.conic_fits import refine_conic
from circlecal.geometry.conics import coefficients_from_conic, normalise_conic, sampson_distance
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.least_squares import DenseProblem, NormalState, StoppingRule, minimise
from circlecal.geometry.projective import Array, apply_homography, similarity_normalisation
from circlecal.observations import Observations
from circlecal.solvers.interface import failure, solver
from circlecal.solvers.primitives import SeenCircle, separate_circles

RULE = StoppingRule(1e-12)
"""Of the iteration: so that exact ellipses give an exact homography."""
OUTLIER_SIGMAS = 6.0
"""Points farther than this from the given ellipse are left out of its refinement."""
UNIT_CIRCLE = np.diag([1.0, 1.0, -1.0])
RANK_TOLERANCE = 1e-9
"""Least eighth singular value in shares of the first: below it the constraints leave more than one homography."""
_BASIS = np.eye(9)[:8].reshape(8, 3, 3)


@dataclass(frozen=True, slots=True)
class EllipseMatch:
    """A circle of the field and its ellipse.

    ``A`` and ``B`` (3, 3) are the affinities from the unit circle; ``root`` whitens the change of the conic's
    six coefficients (K, 6) in the frame in which the ellipse is the unit circle.
    """

    A: Array
    B: Array
    root: Array


@solver
def solve(observations: Observations, template: FieldTemplate, circle: Circle, rng: np.random.Generator) -> Array:
    """First-order solution of all separate circles, then the iteration."""
    matches = [ellipse_match(seen) for seen in separate_circles(observations, template, rng)]
    return iterate(first_order_homography(matches), matches)


def ellipse_match(seen: SeenCircle) -> EllipseMatch:
    """Refine the ellipse geometrically and keep how well its points determine it."""
    kept = np.abs(sampson_distance(seen.conic, seen.points_px)) < OUTLIER_SIGMAS * seen.sigma_px
    points, sigma = (seen.points_px[kept], seen.sigma_px[kept]) if kept.sum() > 5 else (seen.points_px, seen.sigma_px)
    refined = refine_conic(points, seen.conic, sigma)
    conic = seen.conic if refined is None else refined[0]
    ellipse = ellipse_from_conic(conic)
    if ellipse is None:
        raise failure("no_circle", "the circle's points fit no ellipse")
    x, y = seen.center_m
    A = np.array([[seen.radius_m, 0.0, x], [0.0, seen.radius_m, y], [0.0, 0.0, 1.0]])
    B = ellipse.frame()
    local = apply_homography(np.linalg.inv(B), points)
    local = local / np.linalg.norm(local, axis=1, keepdims=True)
    u, v = local.T
    # the first-order distance of the unit circle in pixels: the gradient goes through the frame to the picture
    gradient = 2.0 * local @ np.linalg.inv(B[:2, :2])
    weight = 1.0 / (np.linalg.norm(gradient, axis=1) * sigma)
    rows = np.stack([u * u, u * v, v * v, u, v, np.ones_like(u)], axis=-1) * weight[:, None]
    root = np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)
    return EllipseMatch(A, B, root)


def first_order_homography(matches: list[EllipseMatch]) -> Array:
    """Four linear equations per ellipse in the entries of H; least squares (Chum and Matas 2012)."""
    corners = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    T_field = similarity_normalisation(np.concatenate([apply_homography(m.A, corners) for m in matches]))
    T_image = similarity_normalisation(np.concatenate([apply_homography(m.B, corners) for m in matches]))
    rows = []
    for match in matches:
        left, right = np.linalg.inv(T_image @ match.B), T_field @ match.A
        entry = np.einsum("ia,bj->ijab", left, right).reshape(3, 3, 9)
        rows += [entry[0, 2], entry[1, 2], entry[0, 0] - entry[1, 1], entry[0, 1] + entry[1, 0]]
    system = np.array(rows)
    _, singular, vectors = np.linalg.svd(system / np.linalg.norm(system, axis=1, keepdims=True))
    if singular[7] <= RANK_TOLERANCE * singular[0]:
        raise failure("degenerate", "the ellipses leave the homography undetermined")
    return np.asarray(np.linalg.inv(T_image) @ vectors[8].reshape(3, 3) @ T_field)


@dataclass(frozen=True, slots=True)
class WhitenedConics(DenseProblem):
    """Whitened differences of the predicted conics from the ellipses, re-expanded about each homography (1, 9).

    Steps are changes D, but for its last entry, of ``H N (I + D) N^-1``.
    """

    matches: tuple[EllipseMatch, ...]
    N: Array

    def evaluate(self, parameters: Array) -> NormalState:
        """State at a homography; one that maps a circle to no ellipse costs inf."""
        H = parameters.reshape(3, 3)
        residuals, jacobians = [], []
        for match in self.matches:
            M = np.linalg.solve(match.B, H @ match.A)
            inverse = np.linalg.inv(M)
            P = normalise_conic(inverse.T @ UNIT_CIRCLE @ inverse)
            if not np.isfinite(P).all() or ellipse_from_conic(P) is None:
                return NormalState(parameters, np.full(1, np.inf), np.zeros((1, 8)), np.eye(8)[None])
            # P = M^-T C M^-1 changes with M by -(P dM M^-1) - (P dM M^-1)^T; the fixed determinant takes back its scale
            dM = np.linalg.solve(match.B, H @ self.N) @ _BASIS @ np.linalg.solve(self.N, match.A)
            half = P @ dM @ inverse
            dP = -(half + np.swapaxes(half, 1, 2))
            trace = np.einsum("ij,kji->k", np.linalg.inv(P), dP)
            dP = dP - P * (trace / 3.0)[:, None, None]
            residuals.append(match.root @ coefficients_from_conic(P - UNIT_CIRCLE))
            jacobians.append(match.root @ coefficients_from_conic(dP).T)
        residual, jacobian = np.concatenate(residuals), np.concatenate(jacobians)
        return NormalState(
            parameters, (residual @ residual)[None], (jacobian.T @ residual)[None], (jacobian.T @ jacobian)[None]
        )

    def move(self, parameters: Array, change: Array) -> Array:
        """The homography after a change D (1, 8)."""
        D = np.tensordot(change[0], _BASIS, axes=1)
        moved = parameters.reshape(3, 3) @ self.N @ (np.eye(3) + D) @ np.linalg.inv(self.N)
        return np.asarray(moved.reshape(1, 9))


def iterate(H: Array, matches: list[EllipseMatch]) -> Array:
    """The homography (3, 3) of the greatest likelihood of the ellipses, from a start."""
    centers = np.concatenate(
        [apply_homography(m.A, [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]) for m in matches]
    )
    N: Array = np.asarray(np.linalg.inv(similarity_normalisation(centers)), dtype=np.float64)
    problem = WhitenedConics(tuple(matches), N)
    start = problem.evaluate(H.reshape(1, 9))
    if not np.isfinite(start.cost[0]):
        raise failure("no_convergence", "the first-order homography maps a circle to no ellipse")
    return minimise(problem, start, RULE).state.parameters.reshape(3, 3)
