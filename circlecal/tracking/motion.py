"""How the head turned and the lens zoomed from one frame to the next, from corners of the still background.

Corners are followed by the pyramidal method of Lucas and Kanade, there and back again, in a reduced gray picture. Three
numbers explain how all of them move; what moves otherwise is a player, a ball, or a graphic that stands still on the
screen.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.camera import Camera
from circlecal.geometry.camera_parameters import camera_of
from circlecal.geometry.projective import Array
from circlecal.paint.profiles import median_of_rows
from circlecal.rig.tripod import TripodModel

WIDTH_PX = 640
"""Width of the reduced picture. With 480 fast pans lose a third of their corners, with 960 it takes twice the time."""
CORNERS = 220
QUALITY, APART_PX = 0.002, 9.0
"""Of the corners: share of the best one's strength, and distance between neighbours, reduced pixels. The score on the
screen stays sharp while a pan smears everything else: of one with 34 reduced pixels a frame, 26 corners had 0.01 of its
strength, and 220 have 0.003.
"""
WINDOW, LEVELS = (15, 15), 4
THERE_AND_BACK_PX = 0.5
"""A corner that does not come back to where it was is lost, reduced pixels."""
INLIER_PX = 0.8
"""How far a still corner may end from where the motion puts it, reduced pixels: their scatter is 0.1 to 0.2."""
HYPOTHESES = 64
LEAST_INLIERS, LEAST_SHARE = 12, 0.25
STILL_PX, MOVING_PX = 0.15, 0.8
"""Corners that stand still on the screen, while the others move more than the second, belong to a graphic."""
BACKGROUND_M = 110.0
"""How far the stands are taken to be away, where a corner is not on the ground, metres."""
BIAS_SHARE = 0.004
"""Of the motion by which it is wrong: the distance of the stands is not known, and the pupil moves on its lever."""
SHUTTER = 0.5
"""Share of the time between neighbouring frames of the video, all of which need not be looked at, during which the
shutter is open.
"""
FLOOR_PX = 0.01
"""What no number of corners lowers of the motion's standard deviation, reduced pixels."""


@dataclass(frozen=True, slots=True)
class SmallPicture:
    """A reduced gray picture (h, w), and by what its coordinates are multiplied for those of the whole one."""

    gray: NDArray[np.uint8]
    factor: float

    @classmethod
    def of(cls, gray: NDArray[np.uint8]) -> SmallPicture:
        """Reduce a gray picture."""
        height, width = gray.shape
        if width <= WIDTH_PX:
            return cls(gray, 1.0)
        factor = width / WIDTH_PX
        size = (WIDTH_PX, round(height / factor))
        return cls(np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), np.uint8), factor)

    def enlarge(self, points: Array) -> Array:
        """Coordinates (N, 2) in the whole picture."""
        return (points + 0.5) * self.factor - 0.5


@dataclass(frozen=True, slots=True)
class Flow:
    """Corners (N, 2) of a frame and where they are in the next one, in pixels of the whole picture."""

    before: Array
    after: Array

    @property
    def median_px(self) -> float:
        """Median length of the way."""
        return float(np.median(np.hypot(*(self.after - self.before).T))) if len(self.before) else 0.0


def follow_corners(first: SmallPicture, second: SmallPicture, expected: Array | None = None) -> Flow:
    """Follow corners from one picture to the next.

    Parameters
    ----------
    first, second : SmallPicture
        Neighbouring frames.
    expected : (2,) array, optional
        How far the picture is expected to move, pixels of the whole one.
    """
    corners = cv2.goodFeaturesToTrack(first.gray, CORNERS, QUALITY, APART_PX, blockSize=5)
    if corners is None or len(corners) < LEAST_INLIERS:
        return Flow(np.zeros((0, 2)), np.zeros((0, 2)))
    start = np.asarray(corners, np.float32).reshape(-1, 1, 2)
    moved = np.zeros(2) if expected is None else expected / first.factor
    guess = np.asarray(start + moved, np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.02)
    end, there, _ = cv2.calcOpticalFlowPyrLK(
        first.gray,
        second.gray,
        start,
        guess,
        winSize=WINDOW,
        maxLevel=LEVELS,
        criteria=criteria,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    back, again, _ = cv2.calcOpticalFlowPyrLK(
        second.gray, first.gray, end, start.copy(), winSize=WINDOW, maxLevel=0, criteria=criteria,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    size = np.array(second.gray.shape[::-1], np.float32) - 1
    kept = (there[:, 0] > 0) & (again[:, 0] > 0) & (np.hypot(*(back - start)[:, 0].T) < THERE_AND_BACK_PX)
    kept &= ((end[:, 0] >= 0) & (end[:, 0] <= size)).all(axis=1)
    before, after = (first.enlarge(p[kept, 0].astype(np.float64)) for p in (start, end))
    return Flow(before, after)


@dataclass(frozen=True, slots=True)
class HeadMotion:
    """Change of the head between neighbouring frames.

    Attributes
    ----------
    change : (3,) array
        Of the logarithm of the focal length, pan and tilt.
    covariance : (3, 3) array
        Of it.
    share : float
        Share of the corners that it explains.
    inliers : int
        Their number.
    """

    change: Array
    covariance: Array
    share: float
    inliers: int


def estimate_motion(
    flow: Flow, head: Array, model: TripodModel, common: Array, rng: np.random.Generator, factor: float
) -> HeadMotion | None:
    """The change of the head that explains how most corners moved; None where none does.

    Hypotheses from two corners each are compared by how many corners they explain; the best one is polished by least
    squares with Cauchy weights.

    Parameters
    ----------
    flow : Flow
        Corners in both frames.
    head : (3,) array
        Of the first frame.
    model, common : TripodModel, (K,) array
        The tripod.
    rng : numpy.random.Generator
        For the draws.
    factor : float
        Whole pixels per reduced one.
    """
    count = len(flow.before)
    if count < LEAST_INLIERS:
        return None
    away = flow.after - flow.before
    length = np.hypot(*away.T)
    if median_of_rows(length) > MOVING_PX * factor:
        keep = length > STILL_PX * factor
        if np.count_nonzero(keep) >= LEAST_INLIERS:
            flow, away = Flow(flow.before[keep], flow.after[keep]), away[keep]
            count = len(away)
    world = _background(flow.before, head, model, common)
    steps = np.array([1e-3, 1e-3, 1e-3])

    def pixels_after(change: Array) -> Array:
        """Pixels (B, N, 2) after changes (B, 3)."""
        return model.project_world(head + change, common, world)

    here = pixels_after(np.zeros((1, 3)))[0]
    by = np.stack([(p - here) / s for p, s in zip(pixels_after(np.diag(steps)), steps, strict=True)], axis=-1)
    pairs = rng.integers(0, count, (HYPOTHESES, 2))
    rows = by[pairs].reshape(HYPOTHESES, 4, 3)
    wanted = (flow.after - here)[pairs].reshape(HYPOTHESES, 4, 1)
    normal = np.swapaxes(rows, 1, 2) @ rows
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    tried = np.linalg.solve(normal, np.swapaxes(rows, 1, 2) @ wanted)[..., 0]
    tried = np.clip(tried, -0.3, 0.3)
    limit = INLIER_PX * factor
    error = np.hypot(*np.moveaxis((here + np.einsum("nij,bj->bni", by, tried)) - flow.after, -1, 0))
    score = np.minimum(error / limit, 1.0).sum(axis=1)
    change = tried[int(np.argmin(score))]
    scale = limit
    for _ in range(5):
        at = pixels_after(change[None])[0]
        rest = flow.after - at
        size = np.hypot(*rest.T)
        near = size < limit * 2
        if np.count_nonzero(near) < LEAST_INLIERS:
            return None
        scale = max(1.4826 * float(median_of_rows(size[near])), 0.05 * factor)
        weight = np.where(near, 1.0 / (1.0 + (size / (1.5 * scale)) ** 2), 0.0)
        normal = np.einsum("n,nij,nik->jk", weight, by, by)
        change = change + np.linalg.solve(normal, np.einsum("n,nij,ni->j", weight, by, rest))
    inliers = int(np.count_nonzero(size < limit))
    if inliers < LEAST_INLIERS or inliers < LEAST_SHARE * count:
        return None
    covariance = np.linalg.inv(normal) * scale**2
    floor = FLOOR_PX * factor / np.exp(head[0])
    covariance = 2.0 * covariance + np.diag((np.array([2.0 * floor * np.exp(head[0]) / 500.0, floor, floor])) ** 2)
    covariance += np.diag((BIAS_SHARE * change) ** 2)
    return HeadMotion(change, covariance, inliers / count, inliers)


def move_of_middle(change: Array, head: Array, model: TripodModel, common: Array) -> Array:
    """How far (2,) what is seen in the middle of a picture moves, pixels, while the head (3,) changes (3,)."""
    camera = camera_of(model.thetas(head[None], common)[0], model.projection)
    # what lies on the optical axis is seen in the middle, but for a few pixels
    world = _place_in_world(camera, camera.R[2:])
    before, after = model.project_world(np.stack([head, head + change]), common, world)[:, 0]
    return np.asarray(after - before)


def _background(pixels: Array, head: Array, model: TripodModel, common: Array) -> Array:
    """Where corners (N, 2) are taken to be in the world (N, 3), metres: on the ground, or in the stands."""
    camera = camera_of(model.thetas(head[None], common)[0], model.projection)
    return _place_in_world(camera, camera.rays(pixels))


def _place_in_world(camera: Camera, rays: Array) -> Array:
    """Where rays (N, 3) of a camera meet the ground or the stands (N, 3), metres."""
    length = np.linalg.norm(rays, axis=1)
    with np.errstate(divide="ignore"):
        ground = np.where(rays[:, 2] > 0, -camera.position_m[2] / rays[:, 2], np.inf)
    depth = np.minimum(ground, BACKGROUND_M / length)
    return np.asarray(camera.position_m + depth[:, None] * rays)
