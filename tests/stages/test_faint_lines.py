"""Markings that no single place shows, looked for along the one direction in which a camera is uncertain."""

import cv2
import numpy as np
import pytest

from circlecal.geometry.camera_parameters import PARAMETERS, ProjectionModel, theta_of
from circlecal.geometry.surface import Surface
from circlecal.stages.faint_lines import find_faint_lines, main_modes

from .conftest import CIRCLE, SOCCER, view
from .test_verdict import camera_fit

TRUE = view(position=(3.0, 60.0, -16.0), target=(0.0, -8.0, 0.0), focal=1500.0)
FURTHER = view(position=(3.0, 70.0, -19.5), target=(0.0, -7.2, 0.0), focal=1750.0)
FAR_TOUCHLINE = np.stack([np.linspace(-52.5, 52.5, 400), np.full(400, -34.0 + 0.06)], axis=-1)


def fit_of(camera=FURTHER, other=TRUE):
    """A fit that is one standard deviation from another camera, and knows hardly anything else less well."""
    theta, truth = (
        theta_of(c, ProjectionModel(c.width, c.height, Surface("flat", CIRCLE.radius_m))) for c in (camera, other)
    )
    covariance = np.outer(theta - truth, theta - truth) + np.diag(np.where(np.arange(len(PARAMETERS)) < 4, 1e-9, 0.0))
    return camera_fit(camera, theta=theta, covariance=covariance, parameters=PARAMETERS)


def picture(contrast=0.0, step=0.0, noise=6.0):
    """Noise, with the far touchline, or with a surface that is darker from there on."""
    pixels = TRUE.project(FAR_TOUCHLINE)
    drawn = np.full((TRUE.height, TRUE.width), 90.0)
    if contrast:
        fixed = np.round(16 * pixels).astype(np.int32)[:, None]
        cv2.polylines(drawn, [fixed], False, (90.0 + contrast,), 2, cv2.LINE_AA, 4)
    border = np.interp(np.arange(TRUE.width), pixels[:, 0], pixels[:, 1])
    drawn -= step * (np.arange(TRUE.height)[:, None] < border)
    drawn = cv2.GaussianBlur(drawn, (0, 0), 0.8)
    drawn += np.random.default_rng(3).normal(0, noise, drawn.shape)
    return drawn.clip(0, 255).astype(np.uint8)


def test_a_touchline_that_single_places_do_not_show():
    (found,) = find_faint_lines(picture(contrast=5.0), fit_of(), SOCCER)
    assert found.name is None
    truth = TRUE.project(FAR_TOUCHLINE)
    off = found.points_px[:, 1] - np.interp(found.points_px[:, 0], truth[:, 0], truth[:, 1])
    assert abs(off.mean()) < 0.3
    assert np.abs(off).max() < 2.0
    assert np.ptp(found.points_px[:, 0]) > 0.8 * TRUE.width
    predicted = FURTHER.project(FAR_TOUCHLINE)
    moved = found.points_px[:, 1] - np.interp(found.points_px[:, 0], predicted[:, 0], predicted[:, 1])
    assert np.abs(np.median(moved)) > 5.0


@pytest.mark.parametrize("shown", [{}, {"step": 12.0}])
def test_noise_and_the_border_between_two_surfaces_are_no_marking(shown):
    assert find_faint_lines(picture(**shown), fit_of(), SOCCER) == ()


def test_two_lines_that_may_each_be_the_one_say_nothing():
    upper, lower = picture(contrast=5.0), picture(contrast=5.0)
    twice = lower.copy()
    twice[:255] = upper[24:279]  # the same line 24 px higher, on a surface of its own
    assert find_faint_lines(twice, fit_of(), SOCCER) == ()


def test_a_touchline_before_a_crowd_stands_out_of_the_surface():
    """The crowd's rows are lighter than the touchline, and as long."""
    shown = picture(contrast=5.0)
    border = np.rint(np.interp(np.arange(TRUE.width), *TRUE.project(FAR_TOUCHLINE).T)).astype(int) - 12
    rows = np.arange(TRUE.height)[:, None] - border
    crowd = np.where(rows % 24 < 3, 220, 90).astype(np.uint8)
    shown = np.where(rows < 0, crowd, shown)
    assert find_faint_lines(shown, fit_of(), SOCCER) == ()
    (found,) = find_faint_lines(shown, fit_of(), SOCCER, surface=(rows >= 0)[::2, ::2])
    truth = TRUE.project(FAR_TOUCHLINE)
    off = found.points_px[:, 1] - np.interp(found.points_px[:, 0], truth[:, 0], truth[:, 1])
    assert abs(off.mean()) < 0.5


def test_the_main_modes_are_those_of_the_shifts_covariance():
    rng = np.random.default_rng(5)
    by_theta = rng.normal(size=(17, 60))
    root = rng.normal(size=(17, 17)) * 10.0 ** rng.uniform(-4, 2, (17, 1))
    root[3] = 0.0  # a parameter that is fixed
    covariance = root @ root.T
    values, vectors = np.linalg.eigh(by_theta.T @ covariance @ by_theta)
    modes = main_modes(by_theta, covariance)
    for mode, value, vector in zip(modes.T, values[:-3:-1], vectors.T[:-3:-1], strict=True):
        np.testing.assert_allclose(np.outer(mode, mode), value * np.outer(vector, vector), rtol=0, atol=1e-9 * value)
