import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from circlecal.detection import ridges
from circlecal.detection.options import RidgeConfig
from circlecal.detection.ridges import RidgePoints, find_ridges

ANGLE = np.radians(23.0)
NORMAL = np.array([-np.sin(ANGLE), np.cos(ANGLE)])
OFFSET = 61.37


def banded(width_px: float, contrast: float = 60.0, noise: float = 1.0) -> np.ndarray:
    """A straight light band at ``NORMAL . p = OFFSET``: (200, 300) float32."""
    x, y = np.meshgrid(np.arange(300), np.arange(200))
    d = NORMAL[0] * x + NORMAL[1] * y - OFFSET
    band = ndtr((d + width_px / 2) / 0.7) - ndtr((d - width_px / 2) / 0.7)
    return (80 + contrast * band + np.random.default_rng(0).normal(0, noise, band.shape)).astype(np.float32)


def ridges_of(gray: np.ndarray, sign: float) -> RidgePoints:
    return find_ridges(gray, np.full(gray.shape, 255, np.uint8), sign, RidgeConfig())


@pytest.mark.parametrize("width_px", [1.5, 3.0, 6.0, 11.0])
def test_points_are_on_the_middle_of_the_band_at_every_width(width_px: float) -> None:
    found = ridges_of(banded(width_px), 1.0)
    distance = found.points @ NORMAL - OFFSET
    assert len(found) > 200
    assert abs(distance.mean()) < 0.05
    assert np.abs(distance).max() < 0.25 + 0.12 * width_px
    assert np.median(np.abs(found.normals @ NORMAL)) > 0.99


def test_density_does_not_depend_on_the_width() -> None:
    counts = [len(ridges_of(banded(width), 1.0)) for width in (1.5, 6.0, 12.0)]
    assert max(counts) < 1.6 * min(counts)


def test_polarity_chooses_light_or_dark() -> None:
    dark = banded(3.0, contrast=-60.0)
    near = np.abs(ridges_of(dark, 1.0).points @ NORMAL - OFFSET) < 1.0
    assert np.count_nonzero(near) == 0
    assert len(ridges_of(dark, -1.0)) > 200


def test_only_the_region_is_searched_and_rows_are_not_shifted() -> None:
    gray = banded(3.0)
    region = np.zeros(gray.shape, np.uint8)
    region[90:150] = 255
    found = find_ridges(gray, region, 1.0, RidgeConfig())
    assert 86 < found.points[:, 1].min() < 95
    assert 145 < found.points[:, 1].max() < 154
    assert np.abs(found.points @ NORMAL - OFFSET).max() < 0.5


def test_short_chains_are_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    gray = np.random.default_rng(1).normal(80, 1.0, (200, 640)).astype(np.float32)
    cv2.line(gray, (300, 100), (302, 100), 160.0, 1)
    cv2.line(gray, (100, 50), (160, 50), 160.0, 1)

    def count(row: int, chain_px: float) -> int:
        monkeypatch.setattr(ridges, "SHORTEST_CHAIN_PX", chain_px)
        rows = find_ridges(gray, np.full(gray.shape, 255, np.uint8), 1.0, RidgeConfig()).points[:, 1]
        return int(np.count_nonzero(np.abs(rows - row) < 1))

    assert count(100, 3.0) > 2
    assert count(100, 90.0) == 0
    assert count(50, 90.0) > 50


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_middle_of_a_round_dot_has_no_direction_and_is_no_ridge_point(sign: float) -> None:
    gray = np.random.default_rng(0).normal(80, 1.0, (200, 300)).round()
    gray[50:71, 50:71] = 80
    gray[60, 60] = 80 + sign * 60
    gray[120, 40:260] = 80 + sign * 60
    with np.errstate(all="raise"):
        found = ridges_of(gray.astype(np.uint8), sign)
    assert np.isfinite(found.normals).all()
    assert len(found) > 150
    assert not (np.abs(found.points - 60.0) < 0.1).all(axis=1).any()
