"""What is reported of a fit."""

import numpy as np

from circlecal.camera_fit.model import Frame, theta_of
from circlecal.camera_fit.report import visible_field
from circlecal.field import load_field
from circlecal.synthetic.cameras import aimed_camera
from circlecal.synthetic.surface import seen_pixels

SOCCER = load_field("soccer")
FRAME = Frame(1920, 1080, "flat")


def test_the_field_that_a_barrel_lens_folds_back_is_not_visible():
    camera = aimed_camera(np.array([-10.0, 56.0, -9.0]), np.zeros(3), 5700.0, 0.0, 1920, 1080, kappa=-0.1)
    grid = np.stack(np.meshgrid(np.arange(-52.0, 53.0), np.arange(-34.0, 35.0)), axis=-1).reshape(-1, 2)
    pixels = camera.project(grid)
    inside = ((pixels >= 0) & (pixels <= (1919, 1079))).all(axis=1)
    folded = inside & ~np.isfinite(seen_pixels(camera, grid)).all(axis=1)
    assert folded.any()
    found = visible_field(theta_of(camera, FRAME), FRAME, SOCCER, np.zeros(2), 60.0)
    whole = {tuple(np.round(p).astype(int)) for p in found}
    assert whole.isdisjoint({tuple(p.astype(int)) for p in grid[folded]})
    assert len(whole & {tuple(p.astype(int)) for p in grid[inside & ~folded]}) > 100
