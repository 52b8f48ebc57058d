"""Exactly painted pictures and exact stage results that the tests of the stages share."""

from dataclasses import dataclass

import cv2
import numpy as np

from circlecal.field import load_field
from circlecal.geometry.camera import Camera
from circlecal.geometry.conics import circle_conic, normalise_conic, transform_conic
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import transform_lines
from circlecal.geometry.surface import FLAT
from circlecal.results import EllipseFit, EllipseFits, LineCue, MarkingMask, Segment
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.paint import paint_layers

SOCCER = load_field("soccer")
CIRCLE = SOCCER.circle_by_name["centre_circle"]
WIDTH_M = SOCCER.marking_width_m
TURF, PAINT = 90.0, 210.0


def view(position=(4.0, 58.0, -16.0), target=(0.5, 0.0, 0.0), focal=3000.0, size=(1280, 720), roll=0.005) -> Camera:
    """A camera that has the centre circle in the middle of its picture."""
    return aim_camera(np.array(position), np.array(target), focal, roll, *size)


def back_projected(camera: Camera) -> np.ndarray:
    """Field position (H, W, 2) of every pixel."""
    x, y = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    H = np.linalg.inv(camera.homography)
    w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
    return np.stack([(H[k, 0] * x + H[k, 1] * y + H[k, 2]) / w for k in range(2)], axis=-1)


def step_px(values: np.ndarray, level: float) -> np.ndarray:
    """Share (H, W) of each pixel on which ``values`` is below ``level``: signed distance in pixels, to first order."""
    gy, gx = np.gradient(values)
    return np.clip(0.5 + (level - values) / np.maximum(np.hypot(gx, gy), 1e-9), 0.0, 1.0)


def developed(coverage: np.ndarray, blur=0.7, noise=0.0, seed=0, turf=TURF, paint=PAINT) -> np.ndarray:
    """Picture (H, W, 3) uint8 of a paint coverage."""
    light = turf + (paint - turf) * coverage
    if blur:
        light = cv2.GaussianBlur(light, (0, 0), blur)
    if noise:
        light = light + np.random.default_rng(seed).normal(0, noise, light.shape)
    return np.repeat(np.clip(np.round(light), 0, 255).astype(np.uint8)[..., None], 3, axis=-1)


@dataclass(frozen=True)
class Painted:
    """A picture and its truth."""

    image: np.ndarray
    camera: Camera
    coverage: np.ndarray

    def conic(self, edge: str = "center") -> np.ndarray:
        """Conic of one edge of the circle."""
        return true_conic(self.camera, edge)

    def marking(self, **changes) -> MarkingMask:
        """What the stage ``mask`` would hand on."""
        given = {
            "drawn": np.where(self.coverage > 0.3, 7, 0).astype(np.uint8),
            "source": "file",
            "conic": self.conic(),
        }
        return MarkingMask(**{**given, **changes})


def paint(
    camera: Camera, *, line=True, mark=True, circle=True, width_m=WIDTH_M, blur=0.7, noise=0.0, seed=0, **look
) -> Painted:
    """Circle, halfway line and centre mark of a camera without lens over flat ground."""
    field = back_projected(camera)
    coverage = np.zeros(field.shape[:2])
    if circle:
        r = np.hypot(field[..., 0], field[..., 1])
        coverage = step_px(r, CIRCLE.radius_m) - step_px(r, CIRCLE.radius_m - width_m)
    if line:
        x = field[..., 0]
        inside = (np.abs(field[..., 1]) < 34.0) * (step_px(x, width_m / 2) - step_px(x, -width_m / 2))
        coverage = np.maximum(coverage, inside)
    if mark:
        coverage = np.maximum(coverage, disc(camera, 0.12))
    return Painted(developed(coverage, blur, noise, seed, **look), camera, coverage)


def disc(camera: Camera, radius_m: float) -> np.ndarray:
    """Coverage (H, W) of a spot at the field's origin, supersampled."""
    coverage = np.zeros((camera.height, camera.width))
    u, v = np.round(camera.project(np.zeros(2))).astype(int)
    rows, columns = np.arange(v - 20, v + 21), np.arange(u - 20, u + 21)
    fine = (np.arange(41 * 16) + 0.5) / 16 - 0.5
    x, y = np.meshgrid(columns[0] + fine, rows[0] + fine)
    field = camera.back_project(np.stack([x, y], axis=-1))
    inside = (np.hypot(field[..., 0], field[..., 1]) < radius_m).astype(float)
    coverage[np.ix_(rows, columns)] = inside.reshape(41, 16, 41, 16).mean(axis=(1, 3))
    return coverage


def true_conic(camera: Camera, edge: str = "outer", circle=CIRCLE, template=SOCCER) -> np.ndarray:
    """Normalised conic of one edge of a circle."""
    return normalise_conic(
        transform_conic(camera.homography, circle_conic(circle.center, template.radius(circle, edge)))
    )


def fit_of(conic: np.ndarray, edge: str = "outer", points=None, arc_deg=360.0, rms_px=0.1) -> EllipseFit:
    """An ellipse fit that holds a conic."""
    ellipse = ellipse_from_conic(conic)
    points = ellipse.points(np.linspace(0, 2 * np.pi, 60)) if points is None else points
    return EllipseFit(
        edge=edge,
        conic=conic,
        covariance=np.eye(6) * 1e-12,
        ellipse=ellipse,
        method="direct",
        points_px=points,
        sigma_px=np.full(len(points), 0.2),
        inliers=np.ones(len(points), dtype=bool),
        rms_px=rms_px,
        arc_deg=arc_deg,
        hypotheses=1000,
    )


def fits_of(camera: Camera, edges=("outer", "inner"), circle=CIRCLE, template=SOCCER) -> EllipseFits:
    """Exact fits of some edges of a circle."""
    found = {edge: fit_of(true_conic(camera, edge, circle, template), edge) for edge in edges}
    return EllipseFits(found.get("outer"), found.get("inner"), found.get("center"))


def line_cue(camera: Camera, name="halfway_line", template=SOCCER, sigma_px=0.1) -> LineCue:
    """Exact cue of a straight marking of the template."""
    drawn = template.line_by_name[name]
    ends = template.line_ends(drawn)
    pixels = camera.project(np.linspace(ends[0], ends[1], 200))
    seen = pixels[np.isfinite(pixels).all(axis=1)]
    line = transform_lines(camera.homography, template.line_coordinates(drawn))
    line = line / np.hypot(line[0], line[1])
    return LineCue(name, line, seen, np.full(len(seen), sigma_px), Segment(seen[0], seen[-1]), 0.0)


def paint_field(camera, field):
    """Picture (H, W, 3) of all markings of a field."""
    coverage = np.zeros((camera.height, camera.width))
    for layer in paint_layers(camera, field, FLAT, field.marking_width_m):
        coverage[layer.rows, layer.columns] = np.maximum(coverage[layer.rows, layer.columns], layer.coverage)
    return developed(coverage, noise=1.5)
