"""Many cameras at once, and those before which a circle of the field looks as one does in the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.picture import Scaling
from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera, pan_tilt_roll
from circlecal.geometry.circular_sections import circular_sections
from circlecal.geometry.homography import SIDES
from circlecal.geometry.projective import Array, Mask

Pixels = NDArray[np.float32]
"""Coordinates in pictures, and what is computed from them for thousands of cameras."""
FOCAL_WIDTHS, FOCALS = (0.6, 8.0), 16
"""Range of the focal length, picture widths, and how many between, at equal ratios."""
TURN_DEG = 2.5
"""Between two turns of the field about a circle."""
LARGEST_ROLL_DEG = 8.0
"""Of the cameras that are tried."""
HEIGHT_M = (0.3, 80.0)
"""Of the cameras that are tried above the ground."""
LENS = 0.025
"""Radial distortion with which cameras start, in half widths of the picture: the middle of what 18 reference cameras of
other sports have, -0.02 to 0.09, which moves far lines by up to 30 px of the searched picture."""
LARGEST_LENS, FURTHEST_LENS = 0.15, 4.0
"""Largest distortion of the lens, and the squared distance from the middle, half widths, up to which it grows."""
AHEAD = 1e-6
"""Least depth, metres, of what lies before a camera."""


@dataclass(frozen=True, slots=True)
class Projection:
    """Where points lie before B cameras, in single precision, which is a hundredth of a pixel.

    Attributes
    ----------
    pixels : (2, B, P) float32
        x and y of the picture.
    ahead : (B, P) array of bool
        Which lie before the camera.
    local : (3, B, P) float32
        In the camera's frame, metres.
    offset : (2, B, P) float32
        From the middle of the picture before the lens bends it, half widths.
    square, factor : (B, P) float32
        Of its length, no more than :data:`FURTHEST_LENS`, and by what the lens multiplies it.
    """

    pixels: Pixels
    ahead: Mask
    local: Pixels
    offset: Pixels
    square: Pixels
    factor: Pixels

    def derive(self, cameras: CameraBatch, directions: Pixels) -> Pixels:
        """How far a step of :meth:`CameraBatch.move` carries each point along directions (2, B, P), per unit of each of
        its eight parts: (8, B, P).
        """
        along = np.einsum("xbp,xbp->bp", directions, self.offset)
        bend = np.where(self.square < FURTHEST_LENS, 2 * cameras.lens.astype(np.float32)[:, None] * along, 0.0)
        half_width = np.float32(cameras.half_width)
        # of the pixel by the offset: half_width (factor I + 2 lens offset offset^T)
        by_offset = half_width * (self.factor * directions + bend * self.offset)
        depth = np.where(self.ahead, self.local[2], np.float32(1.0))
        focal = (np.exp(cameras.log_focal) / cameras.half_width).astype(np.float32)[:, None]
        by_x, by_y = by_offset * (focal / depth)
        by_z = -(by_x * self.local[0] + by_y * self.local[1]) / depth
        x, y, z = self.local
        distance = np.linalg.norm(cameras.shift, axis=1).astype(np.float32)[:, None]
        return np.stack(
            [
                y * by_z - z * by_y,
                z * by_x - x * by_z,
                x * by_y - y * by_x,
                distance * by_x,
                distance * by_y,
                distance * by_z,
                np.einsum("xbp,xbp->bp", by_offset, self.offset),
                half_width * along * self.square,
            ]
        )


@dataclass(frozen=True, slots=True)
class CameraBatch:
    """Cameras before a field, all with the same picture.

    Attributes
    ----------
    rotation, shift : (B, 3, 3), (B, 3) arrays
        From the field to the camera.
    log_focal, lens : (B,) arrays
        Logarithm of the focal length in pixels, and radial distortion in half widths.
    own, seen : (B,) arrays
        Index of the template's circle and of the picture's that each came from.
    middle : (2,) array
        Of the picture, pixels.
    """

    rotation: Array
    shift: Array
    log_focal: Array
    lens: Array
    own: NDArray[np.intp]
    seen: NDArray[np.intp]
    middle: Array

    @classmethod
    def of_view(cls, view: FieldView, own: int, scaling: Scaling) -> CameraBatch | None:
        """The one camera of a view, about the template's circle of index ``own``, in a reduced picture; None where the
        view has none.
        """
        camera = view.camera
        if not isinstance(camera, Camera):
            return None
        size = np.array([camera.width, camera.height])
        focal = float(np.mean(camera.focal_px / scaling.factor))
        return cls(
            camera.R[None],
            camera.t[None],
            np.log([focal]),
            np.array([float(camera.kappa[0])]),
            np.array([own]),
            np.array([0]),
            scaling.reduce((size - 1) / 2),
        )

    def __len__(self) -> int:
        return len(self.own)

    def take(self, index: NDArray[np.intp] | slice) -> CameraBatch:
        """Some of them."""
        return CameraBatch(
            self.rotation[index],
            self.shift[index],
            self.log_focal[index],
            self.lens[index],
            self.own[index],
            self.seen[index],
            self.middle,
        )

    @property
    def half_width(self) -> float:
        """Half the width of the picture, pixels."""
        return float(self.middle[0]) + 0.5

    def project(self, points: Array) -> Projection:
        """Where field points (P, 2), or (B, P, 2) for each camera its own, lie in the picture."""
        columns = np.stack([self.rotation[:, :, 0], self.rotation[:, :, 1], self.shift]).astype(np.float32)
        first, second, origin = columns.transpose(0, 2, 1)[..., None]  # (3, B, 1) each
        flat = np.asarray(points, np.float32)
        local = first * flat[..., 0] + second * flat[..., 1] + origin
        ahead = local[2] > AHEAD
        depth = np.where(ahead, local[2], np.float32(1.0))
        offset = local[:2] / depth
        offset *= (np.exp(self.log_focal) / self.half_width).astype(np.float32)[:, None]
        square = np.minimum(offset[0] * offset[0] + offset[1] * offset[1], np.float32(FURTHEST_LENS))
        factor = square * self.lens.astype(np.float32)[:, None]
        factor += 1.0
        pixels = offset * factor
        pixels *= np.float32(self.half_width)
        pixels += self.middle.astype(np.float32)[:, None, None]
        return Projection(pixels, ahead, local, offset, square, factor)

    def move(self, step: Array) -> CameraBatch:
        """Cameras after a step (8,) or (B, 8): turn, shift as a share of the distance, log focal length, lens."""
        step = np.broadcast_to(step, (len(self), 8))
        size = np.linalg.norm(step[:, :3], axis=1)
        axis = step[:, :3] / np.maximum(size, 1e-15)[:, None]
        cross = np.zeros((len(step), 3, 3))
        cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
        cross -= cross.swapaxes(1, 2)
        # Rodrigues' formula
        turn = np.eye(3) + np.sin(size)[:, None, None] * cross + (1 - np.cos(size))[:, None, None] * (cross @ cross)
        distance = np.linalg.norm(self.shift, axis=1, keepdims=True)
        return replace(
            self,
            rotation=turn @ self.rotation,
            shift=(turn @ self.shift[..., None])[..., 0] + distance * step[:, 3:6],
            log_focal=self.log_focal + step[:, 6],
            lens=np.clip(self.lens + step[:, 7], -LARGEST_LENS, LARGEST_LENS),
        )

    def suit(self, template: FieldTemplate, other: FieldTemplate) -> CameraBatch:
        """Cameras before a template as they stand before another one of other sizes: each sees the circle that lies
        nearest to its own one there.
        """
        here, there = (field.round_ones for field in (template, other))
        old, new = (np.array([circle.center for circle in circles], np.float64) for circles in (here, there))
        match = np.linalg.norm(old[:, None] - new, axis=-1).argmin(axis=1)
        radii = [
            other.radius(there[k], "center") / template.radius(circle, "center")
            for circle, k in zip(here, match.tolist(), strict=True)
        ]
        own = match[self.own]
        axes = self.rotation[:, :, :2]
        center = self.shift + np.einsum("bij,bj->bi", axes, old[self.own])
        scale = np.array(radii)[self.own, None]
        return replace(self, shift=scale * center - np.einsum("bij,bj->bi", axes, new[own]), own=own)

    def view(self, index: int, size: tuple[int, int], factor: Array) -> FieldView:
        """What one of them shows in the full picture of ``size`` (width, height), ``factor`` (2,) times as large."""
        camera = Camera(
            *size,
            focal_px=np.exp(self.log_focal[index]) * factor,
            principal_point_px=(np.array(size) - 1) / 2,
            angles_rad=np.array(pan_tilt_roll(self.rotation[index])),
            position_m=-self.rotation[index].T @ self.shift[index],
            kappa=np.array([self.lens[index], 0.0]),
        )
        return FieldView(camera)


def cameras_before_circles(
    conics: Sequence[Array], template: FieldTemplate, width: int, middle: Array, side: str, are_rims: bool = False
) -> CameraBatch | None:
    """Every seen circle as every circle and arc of the field, for all focal lengths and turns of upright cameras.

    Parameters
    ----------
    conics : sequence of (3, 3) arrays
        Circles that were seen.
    template : FieldTemplate
        The field.
    width, middle : int, (2,) array
        Of the picture, pixels.
    side : str
        Side of the field from which the cameras look.
    are_rims : bool
        Whether what was seen are rims, which only a circle that may be filled has.
    """
    focal = width * np.geomspace(*FOCAL_WIDTHS, FOCALS)
    turns = np.radians(np.arange(0.0, 360.0, TURN_DEG))
    parts = []
    for seen, conic in enumerate(conics):
        normal, unit_center, log_focal = _sections_of_upright(conic, focal, middle)
        right = np.array([1.0, 0.0, 0.0]) - normal * normal[:, :1]
        right /= np.linalg.norm(right, axis=1, keepdims=True)
        near = np.cross(normal, right)
        for own, circle in enumerate(template.round_ones):
            if are_rims and circle.fill == "none":
                continue
            center_m = np.asarray(circle.center)
            place = unit_center * template.radius(circle, "center")
            x = np.cos(turns)[:, None, None] * right + np.sin(turns)[:, None, None] * near
            y = -np.sin(turns)[:, None, None] * right + np.cos(turns)[:, None, None] * near
            rotation = np.stack([x, y, np.broadcast_to(normal, x.shape)], axis=-1).reshape(-1, 3, 3)
            shift = (place - center_m[0] * x - center_m[1] * y).reshape(-1, 3)
            stands = -np.einsum("bij,bi->bj", rotation, shift)
            kept = (stands[:, :2] @ np.array(SIDES[side]) >= 0) & (-stands[:, 2] > HEIGHT_M[0])
            kept &= -stands[:, 2] < HEIGHT_M[1]
            kept = np.flatnonzero(kept)
            index = np.full(len(kept), own), np.full(len(kept), seen)
            lens = np.full(len(kept), LENS)
            focals = np.tile(log_focal, len(turns))[kept]
            parts.append(CameraBatch(rotation[kept], shift[kept], focals, lens, *index, middle))
    return join_cameras(parts) if sum(map(len, parts)) else None


def join_cameras(parts: Sequence[CameraBatch]) -> CameraBatch:
    """All cameras of several batches before one picture."""
    return CameraBatch(
        np.concatenate([part.rotation for part in parts]),
        np.concatenate([part.shift for part in parts]),
        np.concatenate([part.log_focal for part in parts]),
        np.concatenate([part.lens for part in parts]),
        np.concatenate([part.own for part in parts]),
        np.concatenate([part.seen for part in parts]),
        parts[0].middle,
    )


def _sections_of_upright(conic: Array, focal: Array, middle: Array) -> tuple[Array, Array, Array]:
    """Planes on which an ellipse is the image of a circle, for upright cameras above them.

    Returns
    -------
    normal, center : (N, 3) arrays
        Unit normal away from the camera, and the centre of a circle of radius 1, in the camera's frame.
    log_focal : (N,) array
    """
    sections = circular_sections(conic, focal, middle, 1.0)
    normal, center = (part.swapaxes(0, 1).reshape(-1, 3) for part in (sections.normals, sections.centers))
    is_upright = np.abs(np.degrees(np.arctan2(normal[:, 0], normal[:, 1]))) < LARGEST_ROLL_DEG
    is_upright &= np.isfinite(center).all(axis=1)
    return normal[is_upright], center[is_upright], np.tile(np.log(focal), 2)[is_upright]
