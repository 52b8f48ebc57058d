"""Paint so faint that single profiles do not show it."""

import cv2
import numpy as np

from circlecal.paint.matched_filter import CLEAR, SECTORS
from circlecal.stages.evidence import painted_all_round, painted_sectors

from .conftest import CIRCLE, SOCCER, view
from .test_agreement import fit_of

CAMERA = view()


def picture(contrast=0.0, noise=6.0, first=0.0, last=360.0, camera=CAMERA):
    angle = np.radians(np.linspace(first, last, 400))
    points = camera.project(SOCCER.radius(CIRCLE, "center") * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    drawn = np.full((camera.height, camera.width), 90.0)
    cv2.polylines(
        drawn, [np.round(16 * points).astype(np.int32)[:, None]], False, (90.0 + contrast,), 3, cv2.LINE_AA, 4
    )
    drawn += np.random.default_rng(1).normal(0, noise, drawn.shape)
    return drawn.clip(0, 255).astype(np.uint8)


def test_faint_paint_shows_in_every_sector():
    sectors = painted_sectors(picture(contrast=10.0), fit_of(CAMERA), SOCCER, CIRCLE)
    assert len(sectors) == SECTORS
    assert (sectors > CLEAR).mean() > 0.8
    assert painted_all_round(picture(contrast=10.0), fit_of(CAMERA), SOCCER, CIRCLE)


def test_bare_grass_an_arc_and_a_wrong_camera_are_not_painted_all_round():
    assert (painted_sectors(picture(), fit_of(CAMERA), SOCCER, CIRCLE) > CLEAR).mean() < 0.2
    assert not painted_all_round(picture(), fit_of(CAMERA), SOCCER, CIRCLE)
    assert not painted_all_round(picture(30.0, 2.0, 40.0, 160.0), fit_of(CAMERA), SOCCER, CIRCLE)
    other = view(position=(4.0, 50.0, -16.0))
    assert not painted_all_round(picture(30.0, 2.0), fit_of(other), SOCCER, CIRCLE)


def test_a_circle_that_is_mostly_out_of_view_says_nothing():
    near = view(target=(9.0, 0.0, 0.0), focal=6000.0)
    assert len(painted_sectors(picture(30.0, 2.0, camera=near), fit_of(near), SOCCER, CIRCLE)) < SECTORS // 2
    assert not painted_all_round(picture(30.0, 2.0, camera=near), fit_of(near), SOCCER, CIRCLE)
    away = view(target=(0.0, 400.0, 0.0))
    assert len(painted_sectors(picture(camera=near), fit_of(away), SOCCER, CIRCLE)) == 0
    assert not painted_all_round(picture(camera=near), fit_of(away), SOCCER, CIRCLE)
