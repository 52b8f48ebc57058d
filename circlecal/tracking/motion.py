"""How the head turned and the lens zoomed from one frame to the next, from corners of the still background.

Corners are followed by the pyramidal method of Lucas and Kanade, there and back again, in a reduced gray picture. Three
numbers explain how all of them move; what moves otherwise is a player, a ball, or a graphic that stands still on the
screen.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array
from circlecal.rig.tripod import TripodModel

WIDTH_PX = 640
"""Width of the reduced picture. With 480 fast pans lose a third of their corners, with 960 it takes twice the time."""
CORNERS = 150
QUALITY, APART_PX = 0.002, 9.0
"""Of the corners: share of the best one's strength, and distance between neighbours, reduced pixels. The score on the
screen stays sharp while a pan smears everything else: of one with 34 reduced pixels a frame, 26 corners had 0.01 of its
strength, and 220 have 0.003. With 150 corners rendered clips tremble as with 220.
"""
SEARCH_FRAMES, LEAST_KEPT, LARGEST_WAY_PX = 4, 0.7, 40.0
"""Corners are looked for again after so many frames, where less than this share of them is left, and where the picture
has moved so far, reduced pixels, that a strip of it has none. To look for them takes twice the time of following them.
"""
WINDOW, LEVELS = (15, 15), 4
THERE_AND_BACK_PX = 0.5
"""A corner that does not come back to where it was is lost, reduced pixels."""
INLIER_PX = 0.8
"""How far a still corner may end from where the motion puts it, reduced pixels: their scatter is 0.1 to 0.2."""
HYPOTHESES = 64
POLISHES, WEIGHTINGS = 2, 3
"""How often the motion is linearised about what was found, and how often all corners are weighed in between."""
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
FLOOR_PX, ZOOM_LEVER_PX = 0.01, 250.0
"""What no number of corners lowers of the motion's standard deviation, reduced pixels, and how far from the middle of
the picture so much tells the zoom, pixels at 1920 px width.
"""


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
        # halving takes a tenth of the time of any other mean over areas, and less than a halving needs none
        while gray.shape[1] >= 2 * WIDTH_PX:
            half = gray.shape[1] // 2, gray.shape[0] // 2
            gray = np.asarray(cv2.resize(gray, half, interpolation=cv2.INTER_AREA), np.uint8)
        return cls(np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_LINEAR), np.uint8), factor)

    def enlarge(self, points: Array) -> Array:
        """Coordinates (N, 2) in the whole picture."""
        return (points + 0.5) * self.factor - 0.5

    def reduce(self, points: Array) -> Array:
        """Coordinates (N, 2) in the reduced picture."""
        return (points + 0.5) / self.factor - 0.5


@dataclass(frozen=True, slots=True)
class Flow:
    """Corners (N, 2) of a frame and where they are in the next one, in pixels of the whole picture."""

    before: Array
    after: Array

    @property
    def median_px(self) -> float:
        """Median length of the way."""
        return float(median_of_rows(np.hypot(*(self.after - self.before).T))) if len(self.before) else 0.0


NO_FLOW = Flow(np.zeros((0, 2)), np.zeros((0, 2)))
"""Where nothing can be followed."""


def find_corners(picture: SmallPicture) -> NDArray[np.float32]:
    """Corners (N, 2) that can be followed, reduced pixels."""
    corners = cv2.goodFeaturesToTrack(picture.gray, CORNERS, QUALITY, APART_PX, blockSize=5)
    return np.zeros((0, 2), np.float32) if corners is None else np.asarray(corners, np.float32).reshape(-1, 2)


def follow_corners(
    first: SmallPicture,
    second: SmallPicture,
    corners: NDArray[np.float32],
    expected: Array | None = None,
    window: tuple[int, int] = WINDOW,
    levels: int = LEVELS,
) -> Flow:
    """Follow corners from one picture to the next.

    Parameters
    ----------
    first, second : SmallPicture
        Neighbouring frames.
    corners : (N, 2) float32
        Corners of the first one, reduced pixels.
    expected : (2,) array, optional
        How far the picture is expected to move, pixels of the whole one.
    window, levels : (int, int), int
        Size of what is compared about a corner, reduced pixels, and how often the pictures are halved to find it.
    """
    if len(corners) < LEAST_INLIERS:
        return NO_FLOW
    start = corners.reshape(-1, 1, 2)
    moved = np.zeros(2) if expected is None else expected / first.factor
    guess = np.asarray(start + moved, np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.02)
    end, there, _ = cv2.calcOpticalFlowPyrLK(
        first.gray,
        second.gray,
        start,
        guess,
        winSize=window,
        maxLevel=levels,
        criteria=criteria,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    back, again, _ = cv2.calcOpticalFlowPyrLK(
        second.gray, first.gray, end, start.copy(), winSize=window, maxLevel=0, criteria=criteria,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    size = np.array(second.gray.shape[::-1], np.float32) - 1
    kept = (there[:, 0] > 0) & (again[:, 0] > 0) & (np.hypot(*(back - start)[:, 0].T) < THERE_AND_BACK_PX)
    kept &= ((end[:, 0] >= 0) & (end[:, 0] <= size)).all(axis=1)
    before, after = (first.enlarge(p[kept, 0].astype(np.float64)) for p in (start, end))
    return Flow(before, after)


@dataclass(slots=True)
class CornerTrail:
    """Corners that are followed through neighbouring pictures, until others are looked for.

    Attributes
    ----------
    corners : (N, 2) float32
        Where they are in the last picture, reduced pixels.
    found, frames, way_px : int, int, float
        How many were found, how many frames ago, and how far the picture has moved since, reduced pixels.
    """

    corners: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    found: int = 0
    frames: int = 0
    way_px: float = 0.0

    def follow(self, first: SmallPicture, second: SmallPicture, expected: Array) -> Flow:
        """How corners move from the picture that was followed into last to the next one."""
        is_worn = self.frames >= SEARCH_FRAMES or self.way_px > LARGEST_WAY_PX
        if is_worn or len(self.corners) < max(LEAST_KEPT * self.found, LEAST_INLIERS):
            self.corners = find_corners(first)
            self.found, self.frames, self.way_px = len(self.corners), 0, 0.0
        flow = follow_corners(first, second, self.corners, expected)
        self.corners = np.asarray(second.reduce(flow.after), np.float32)
        self.frames += 1
        self.way_px += flow.median_px / first.factor
        return flow

    def forget(self) -> None:
        """Look for corners in the next picture, which is no neighbour of the last one."""
        self.corners = self.corners[:0]


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
    step = 1e-3

    def pixels_after(changes: Array) -> Array:
        """Pixels (B, 2 N) after changes (B, 3)."""
        return model.project_world(head + changes, common, world).reshape(len(changes), -1)

    here, *beside = pixels_after(np.concatenate([np.zeros((1, 3)), step * np.eye(3)]))
    by = (np.stack(beside, axis=-1) - here[:, None]) / step
    # corners move from where they are, which the world that they are taken to be in shows within a few pixels
    wanted = here + away.ravel()
    pairs = rng.integers(0, count, (HYPOTHESES, 2))
    rows = by.reshape(count, 2, 3)[pairs].reshape(HYPOTHESES, 4, 3)
    normal = np.swapaxes(rows, 1, 2) @ rows
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    asked = (wanted - here).reshape(count, 2)[pairs].reshape(HYPOTHESES, 4, 1)
    tried = np.linalg.solve(normal, np.swapaxes(rows, 1, 2) @ asked)[..., 0]
    tried = np.clip(tried, -0.3, 0.3)
    limit = INLIER_PX * factor
    score = np.minimum(_lengths(tried @ by.T + (here - wanted)) / limit, 1.0).sum(axis=1)
    change = tried[int(np.argmin(score))]
    for _ in range(POLISHES):
        rest = wanted - pixels_after(change[None])[0]
        for _ in range(WEIGHTINGS):
            size = _lengths(rest)
            near = size < limit * 2
            if np.count_nonzero(near) < LEAST_INLIERS:
                return None
            scale = max(1.4826 * float(median_of_rows(size[near])), 0.05 * factor)
            weight = np.where(near, 1.0 / (1.0 + (size / (1.5 * scale)) ** 2), 0.0)
            weighted = by * np.repeat(weight, 2)[:, None]
            normal = weighted.T @ by
            moved = np.linalg.solve(normal, weighted.T @ rest)
            change, rest = change + moved, rest - by @ moved
    inliers = int(np.count_nonzero(_lengths(rest) < limit))
    if inliers < LEAST_INLIERS or inliers < LEAST_SHARE * count:
        return None
    covariance = np.linalg.inv(normal) * scale**2
    unit, focal_px = model.projection.width / 1920.0, float(np.exp(head[0]))
    floors = FLOOR_PX * factor / np.array([ZOOM_LEVER_PX * unit, focal_px, focal_px])
    covariance = 2.0 * covariance + np.diag(floors**2)
    covariance += np.diag((BIAS_SHARE * change) ** 2)
    return HeadMotion(change, covariance, inliers / count, inliers)


def _lengths(vectors: Array) -> Array:
    """Lengths (..., N) of vectors (..., 2 N)."""
    squared = vectors * vectors
    return np.sqrt(squared[..., ::2] + squared[..., 1::2])


def move_of_middle(change: Array, head: Array, model: TripodModel, common: Array) -> Array:
    """How far (2,) what is seen in the middle of a picture moves, pixels, while the head (3,) changes (3,)."""
    return model.shift_of_axis(np.stack([head, head + change]), common)


def _background(pixels: Array, head: Array, model: TripodModel, common: Array) -> Array:
    """Where corners (N, 2) are taken to be in the world (N, 3), metres: on the ground, or in the stands.

    Within a few pixels: what counts is how they move from where they are.
    """
    position, rays = model.rays_about(head, common, pixels)
    length = np.linalg.norm(rays, axis=1)
    with np.errstate(divide="ignore"):
        ground = np.where(rays[:, 2] > 0, -position[2] / rays[:, 2], np.inf)
    depth = np.minimum(ground, BACKGROUND_M / length)
    return np.asarray(position + depth[:, None] * rays)
