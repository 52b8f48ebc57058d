"""One conic from both edges of the marking and the imaged centre."""

import numpy as np

from circlecal.evaluation.bench.joint_conic import joint_conic, scaling_homology
from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.conic_fits import fit_conic
from circlecal.geometry.conics import circle_conic, sampson_distance, transform_conic
from circlecal.geometry.projective import apply_homography

CAMERA = Camera(
    1920,
    1080,
    np.array([3600.0, 3600.0]),
    image_center(1920, 1080),
    np.radians([3.0, 76.0, 0.5]),
    np.array([4.0, 60.0, -15.0]),
    np.zeros(2),
)
H = CAMERA.homography
OUTER, INNER = 9.15, 9.07
CONIC = transform_conic(H, circle_conic([0.0, 0.0], OUTER))


def _edge(radius, count, phase=0.1):
    angle = phase + np.linspace(0, 2 * np.pi, count, endpoint=False)
    return apply_homography(H, radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def test_homology_scales_about_the_centre():
    moved = apply_homography(scaling_homology(CONIC, H[:, 2], OUTER / INNER), _edge(INNER, 12))
    np.testing.assert_allclose(moved, _edge(OUTER, 12), atol=1e-8)


def test_exact_without_noise():
    found = joint_conic(_edge(OUTER, 8), _edge(INNER, 8), H[:, 2], OUTER, INNER)
    assert np.abs(sampson_distance(found, _edge(OUTER, 50))).max() < 1e-8


def test_both_edges_beat_one():
    rng = np.random.default_rng(0)
    truth, one, both = _edge(OUTER, 90), [], []
    for _ in range(60):
        outer, inner = (_edge(r, 8) + rng.normal(0, 1, (8, 2)) for r in (OUTER, INNER))
        one.append(np.std(sampson_distance(fit_conic(outer), truth)))
        both.append(np.std(sampson_distance(joint_conic(outer, inner, H[:, 2], OUTER, INNER), truth)))
    # twice the points: 0.71 without bias
    assert 0.55 < np.mean(both) / np.mean(one) < 0.85


def test_points_on_a_line_give_none():
    line = np.stack([np.arange(8.0), 2 * np.arange(8.0)], axis=-1)
    assert joint_conic(line, line, H[:, 2], OUTER, INNER) is None
