"""A camera on its tripod: what its frames share, and the frame's camera from pan, tilt and zoom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from circlecal.geometry.camera import Camera, image_center, pan_tilt_roll, rotation_matrix
from circlecal.geometry.projective import Array

WIDEST_FOCAL = 0.75
"""Focal length, widths of the picture, from which on the distortion of a lens does not fall any more: broadcast zooms
were measured down to 0.8, and lenses of wider views are others.
"""


@dataclass(frozen=True, slots=True)
class Tripod:
    """Where a standing camera turns, and how its lens changes with the zoom.

    The lever arm is linear in ``z = log(f / reference_focal)``, and the first radial coefficient is
    ``kappa - kappa_by_focal (1 / f^2 - 1 / reference_focal^2)``, as that of zoom lenses, with the focal length f in
    widths of the picture, so that they hold at any size of it.

    Attributes
    ----------
    position_m : (3,) array
        Where pan axis and tilt axis meet; z is negative above the ground.
    lean_rad : (2,) array
        Turn of the pan axis out of the vertical, about the field's x axis and then about its y axis. The first one
        makes roll grow with the sine of pan, by as much, the second one with its cosine.
    roll_rad : float
        Roll of the camera on the head.
    lever_m, lever_per_zoom_m : float
        How far the entrance pupil lies before the axes along the optical axis.
    kappa, kappa_by_focal : float
        First radial coefficient at the reference, half-widths, and how it follows the focal length.
    reference_focal : float
        Focal length at which lever and lens are quoted, widths of the picture.
    """

    position_m: Array
    lean_rad: Array
    roll_rad: float
    lever_m: float
    lever_per_zoom_m: float
    kappa: float
    kappa_by_focal: float
    reference_focal: float = 1.5

    @property
    def lean(self) -> Array:
        """Rotation (3, 3) from the head's axes to the field's."""
        (cx, cy), (sx, sy) = np.cos(self.lean_rad), np.sin(self.lean_rad)
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
        about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
        return about_x @ about_y

    def kappa_at(self, focal: float) -> float:
        """First radial coefficient at a focal length in widths of the picture, half-widths."""
        seen, quoted = (max(f, WIDEST_FOCAL) ** -2 for f in (focal, self.reference_focal))
        return self.kappa - self.kappa_by_focal * (seen - quoted)

    def aim(self, target_m: Array) -> tuple[float, float]:
        """Pan and tilt on the head that bring a point (3,) of the field onto the optical axis, radians."""
        dx, dy, dz = (target_m - self.position_m) @ self.lean
        return float(np.arctan2(dx, -dy)), float(np.arctan2(np.hypot(dx, dy), dz))

    def camera(self, pan_rad: float, tilt_rad: float, focal: float, width: int, height: int) -> Camera:
        """The frame's camera at angles of the head and a focal length in widths of the picture."""
        R = rotation_matrix(pan_rad, tilt_rad, self.roll_rad) @ self.lean.T
        zoom = float(np.log(focal / self.reference_focal))
        return Camera(
            width=width,
            height=height,
            focal_px=np.full(2, focal * width),
            principal_point_px=image_center(width, height),
            angles_rad=np.array(pan_tilt_roll(R)),
            position_m=self.position_m + (self.lever_m + self.lever_per_zoom_m * zoom) * R[2],
            kappa=np.array([self.kappa_at(focal), 0.0]),
        )

    def to_json(self) -> dict[str, Any]:
        """JSON-ready mapping; angles in degrees."""
        return {
            "position_m": [float(v) for v in self.position_m],
            "lean_deg": [float(v) for v in np.degrees(self.lean_rad)],
            "roll_deg": float(np.degrees(self.roll_rad)),
            "lever_m": self.lever_m,
            "lever_per_zoom_m": self.lever_per_zoom_m,
            "kappa": self.kappa,
            "kappa_by_focal": self.kappa_by_focal,
            "reference_focal_widths": self.reference_focal,
        }


def sample_tripod(field_width_m: float, rng: np.random.Generator) -> Tripod:
    """A random main camera behind the near touchline.

    Lever arm and leaning axis have the ranges that standing broadcast cameras show: 0.1 to 1.3 m, and a roll that
    changes by -0.8 to 0.7 degrees per unit of the sine of pan. So has the lens: the distortion of real zooms grows by
    0.04 times the change of ``-(1 / focal length)^2``, and differs from that between wide and tele by 0.007.
    """
    distance, elevation = rng.uniform(22.0, 55.0), rng.uniform(9.0, 25.0)
    return Tripod(
        position_m=np.array([rng.uniform(-4.0, 4.0), field_width_m / 2 + distance, -elevation]),
        lean_rad=np.radians([rng.uniform(-0.8, 0.7), rng.normal(0.0, 0.3)]),
        roll_rad=float(np.radians(rng.normal(0.0, 0.3))),
        lever_m=float(rng.uniform(0.3, 1.1)),
        lever_per_zoom_m=float(rng.uniform(-0.2, 0.2)),
        kappa=float(rng.uniform(0.0, 0.035)),
        kappa_by_focal=float(rng.uniform(0.025, 0.055)),
    )
