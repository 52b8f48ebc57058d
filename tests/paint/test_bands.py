import numpy as np
import pytest
from scipy.special import ndtr

from circlecal.paint.bands import BandProfile, RefinementConfig, local_width, measure_band

ROW = 60.3


def level_band(width_px: float, contrast: float = 50.0, noise: float = 1.0) -> np.ndarray:
    """A level band whose middle is at y = ROW: (120, 400) uint8."""
    d = np.arange(120)[:, None] - ROW
    band = ndtr((d + width_px / 2) / 0.8) - ndtr((d - width_px / 2) / 0.8)
    values = 90 + contrast * np.repeat(band, 400, axis=1)
    return np.clip(values + np.random.default_rng(0).normal(0, noise, values.shape), 0, 255).astype(np.uint8)


def measured(grey: np.ndarray, row: float, sign: float = 1.0, reach: float = 8.0) -> BandProfile:
    x = np.arange(10.0, 390.0, 3.0)
    points = np.stack([x, np.full_like(x, row)], axis=-1)
    normals = np.tile([0.0, 1.0], (len(x), 1))
    pieces = np.zeros(len(x), np.int64)
    return measure_band(grey, points, normals, np.full(len(x), reach), pieces, sign, RefinementConfig())


@pytest.mark.parametrize("shift", [-2.0, 0.0, 1.6])
def test_offset_is_the_distance_to_the_middle(shift: float) -> None:
    band = measured(level_band(3.0), ROW + shift)
    assert band.supported.mean() > 0.97
    assert abs(np.mean(band.offset[band.supported]) + shift) < 0.06


@pytest.mark.parametrize("width_px", [3.0, 5.0, 8.0])
def test_width_and_contrast(width_px: float) -> None:
    band = measured(level_band(width_px), ROW, reach=12.0)
    assert abs(np.median(local_width(band)) - width_px) < 0.9
    assert abs(np.median(band.contrast) - 50.0) < 8.0


def test_wrong_polarity_has_no_support() -> None:
    assert measured(level_band(3.0), ROW, sign=-1.0).supported.mean() < 0.1


def test_plain_noise_has_no_support() -> None:
    assert measured(level_band(3.0, contrast=0.0, noise=6.0), ROW).supported.mean() < 0.1


def test_a_hidden_part_is_not_supported() -> None:
    grey = level_band(3.0)
    grey[40:80, 150:210] = 230
    band = measured(grey, ROW)
    x = np.arange(10.0, 390.0, 3.0)
    hidden = (x > 154) & (x < 206)
    assert not band.supported[hidden].any()
    assert band.supported[(x < 140) | (x > 220)].mean() > 0.95


def test_samples_outside_the_picture_are_not_inside() -> None:
    band = measured(level_band(3.0), -5.0)
    assert not band.inside.any()
    assert not band.supported.any()
