"""The centre mark where its place is known to a hundredth of a pixel: a circle seen without perspective."""

from functools import lru_cache

import cv2
import numpy as np
import pytest

from circlecal.geometry.ellipses import Ellipse, conic_from_ellipse
from circlecal.paint.centre_mark import SeenMark, _response, find_centre_mark
from circlecal.paint.rectified_line import RectifiedLine

MIDDLE = np.array([200.0, 150.0])
AXES_PX = np.array([180.0, 90.0])
RADIUS, WIDTH = 0.05, 0.02
"""Of the disc, and of the line's paint, in radii of the circle."""
BLUR_PX = 1.0
FINE = 8
"""Places at which each pixel is painted, along each axis."""


@lru_cache(maxsize=1)
def paint_softly(offset_px: tuple[float, float], bend_px: float) -> np.ndarray:
    """A vertical halfway line with a disc so far from its middle, bent sideways by so much there, softened by blur."""
    x, y = (np.arange(0.0, size, 1.0 / FINE) + 0.5 / FINE - 0.5 for size in (400, 300))
    x, y = x[None], y[:, None]
    middle = MIDDLE[0] + bend_px * (1.0 - ((y - MIDDLE[1]) / AXES_PX[1]) ** 2)
    on_line = np.abs(x - middle) < 0.5 * WIDTH * AXES_PX[0]
    aside = (x - MIDDLE[0] - offset_px[0]) / (RADIUS * AXES_PX[0])
    along = (y - MIDDLE[1] - offset_px[1]) / (RADIUS * AXES_PX[1])
    fine = 90.0 + 60.0 * (on_line | (aside**2 + along**2 < 1.0))
    return cv2.GaussianBlur(fine, (0, 0), BLUR_PX * FINE).reshape(300, FINE, 400, FINE).mean(axis=(1, 3))


def paint_mark(offset_px: tuple[float, float], bend_px: float = 0.0, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """The painted picture with noise."""
    soft = paint_softly(offset_px, bend_px)
    return (soft + np.random.default_rng(seed).normal(0.0, noise, soft.shape)).astype(np.float32)


def find(picture: np.ndarray, bend_px: float = 0.0) -> SeenMark | None:
    along = np.linspace(-0.98, 0.98, 90)
    points = MIDDLE + np.stack([bend_px * (1.0 - along**2), along * AXES_PX[1]], axis=-1)
    conic = conic_from_ellipse(Ellipse(MIDDLE, tuple(AXES_PX), 0.0))
    line = np.array([1.0, 0.0, -MIDDLE[0]])
    return find_centre_mark(picture, line, points, conic, 2.0 * RADIUS, WIDTH, BLUR_PX, (-0.2, 0.2), 4.0)


@pytest.mark.parametrize("off_px", [-0.2, -0.1, 0.1, 0.15, 0.4])
def test_a_mark_is_found_to_a_few_hundredths_of_a_pixel(off_px):
    found = find(paint_mark((0.0, off_px)))
    assert found is not None
    assert found.point_px == pytest.approx((MIDDLE[0], MIDDLE[1] + off_px), abs=0.04)


def test_a_mark_on_a_bent_line_lies_on_the_line():
    found = find(paint_mark((4.0, 0.0), bend_px=4.0), bend_px=4.0)
    assert found is not None
    assert found.point_px == pytest.approx((MIDDLE[0] + 4.0, MIDDLE[1]), abs=0.1)


@pytest.mark.parametrize(("contrast", "is_found"), [(0.2, True), (0.05, False)])
def test_no_mark_is_told_on_a_line_that_is_worn_off(contrast, is_found):
    """Paint of 60 levels over the ground, of which a share is left: 12 levels, and 3."""
    faint = 90.0 + contrast * (paint_mark((0.0, 0.0)) - 90.0)
    assert (find(faint.astype(np.float32)) is not None) is is_found


def test_a_mark_is_as_uncertain_as_noise_scatters_it():
    found = [find(paint_mark((0.0, 0.0), noise=14.0, seed=seed)) for seed in range(40)]
    off_px = [mark.point_px[1] - MIDDLE[1] for mark in found if mark is not None]
    assert len(off_px) == len(found)
    # beside the 0.3 px by which painted marks are no exact discs
    by_noise_px = np.sqrt(np.mean([mark.sigma_px**2 - 0.3**2 for mark in found if mark is not None]))
    assert 0.5 < by_noise_px / np.std(off_px) < 3.0


def test_a_mark_whose_one_half_the_picture_does_not_show_is_told_by_the_other():
    """The picture ends 4 px right of the line's middle: its paint is 1.8 px wide to each side, the disc 9 px."""
    found = find(paint_mark((0.0, 0.15))[:, : int(MIDDLE[0]) + 5])
    assert found is not None
    assert found.point_px == pytest.approx((MIDDLE[0], MIDDLE[1] + 0.15), abs=0.1)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_no_mark_is_told_where_the_picture_shows_no_ground_beside_the_line():
    """A strip of the picture from 17 px left to 4 px right of the line's middle, of which the disc takes 9 px."""
    left = int(MIDDLE[0]) - 17
    strip = np.ascontiguousarray(paint_mark((0.0, 0.0))[:, left : int(MIDDLE[0]) + 5])
    middle = MIDDLE - (left, 0.0)
    points = middle + np.stack([np.zeros(90), np.linspace(-0.98, 0.98, 90) * AXES_PX[1]], axis=-1)
    conic = conic_from_ellipse(Ellipse(middle, tuple(AXES_PX), 0.0))
    line = np.array([1.0, 0.0, -middle[0]])
    assert find_centre_mark(strip, line, points, conic, 2.0 * RADIUS, WIDTH, BLUR_PX, (-0.2, 0.2), 4.0) is None


def test_a_mark_lies_on_the_line_beyond_its_measured_points():
    """The line bends by 6 px, and is measured no further than 20 px before the mark."""
    along = np.linspace(0.22, 0.98, 40)
    points = MIDDLE + np.stack([6.0 * (1.0 - along**2), along * AXES_PX[1]], axis=-1)
    conic = conic_from_ellipse(Ellipse(MIDDLE, tuple(AXES_PX), 0.0))
    line = np.array([1.0, 0.0, -MIDDLE[0]])
    picture = paint_mark((6.0, 0.0), bend_px=6.0)
    found = find_centre_mark(picture, line, points, conic, 2.0 * RADIUS, WIDTH, BLUR_PX, (-0.2, 0.2), 4.0)
    assert found is not None
    assert found.point_px == pytest.approx((MIDDLE[0] + 6.0, MIDDLE[1]), abs=0.15)


def test_a_player_above_one_half_of_a_mark_does_not_hide_the_other():
    """A shirt as bright as the paint, right of the line, ends 4 px above the disc's middle."""
    picture = paint_mark((0.0, 0.0))
    x, y = MIDDLE.astype(int)
    picture[y - 40 : y - 4, x + 4 : x + 30] = 150.0
    found = find(picture)
    assert found is not None
    assert found.point_px == pytest.approx(MIDDLE, abs=0.3)


@pytest.mark.parametrize(("paint", "is_found"), [(60.0, True), (12.0, False)])
def test_no_mark_is_told_that_is_brighter_than_the_line_on_it(paint, is_found):
    """A light patch of a disc's shape to both sides of the line, where that has so much of its 60 levels left."""
    picture = paint_mark((0.0, 0.0))
    x, y = MIDDLE.astype(int)
    worn = picture[y - 20 : y + 21, x - 3 : x + 4]
    worn[:] = 90.0 + paint / 60.0 * (worn - 90.0)
    assert (find(picture) is not None) is is_found


def test_a_disc_too_small_to_reach_beyond_its_line_has_no_response():
    """Nothing is divided by nothing."""
    rows, across = 40, np.arange(-30.25, 30.0, 0.5)
    values, zeros = np.full((rows, len(across)), 90.0, np.float32), np.zeros(rows)
    seen = RectifiedLine(
        values=values,
        usual=values[0],
        in_view=np.ones((2, rows), np.bool_),
        position=zeros,
        across=across,
        base=np.zeros((rows, 2)),
        length=30.0,
        half_px=(0.5, 0.06),
        halves_px=np.zeros((rows, 2)),
    )
    with np.errstate(all="raise"):
        response = _response(seen, 1.0, 0.0, 1.0)
    assert not response.contrast.any() and not response.is_whole.any()


@pytest.mark.parametrize(("level", "is_found"), [(200.0, False), (255.0, False), (150.0, True)])
def test_the_rim_of_a_ball_on_the_line_is_no_mark(level, is_found):
    """A ball that is brighter than the line covers it, and ends 5 px beyond; one as bright as paint may be a mark."""
    axes, radius = (90.0, 140.0), 20.0
    y, x = np.mgrid[:300, :400].astype(float)
    line = 90.0 + 60.0 * np.clip(0.5 * WIDTH * axes[0] + 0.5 - np.abs(x - MIDDLE[0]), 0.0, 1.0)
    covered = np.clip(radius + 0.5 - np.hypot(x - MIDDLE[0] - 5.0 + radius, y - MIDDLE[1]), 0.0, 1.0)
    picture = cv2.GaussianBlur((line + (level - line) * covered).astype(np.float32), (0, 0), BLUR_PX)
    points = MIDDLE + np.linspace(-0.98, 0.98, 90)[:, None] * (0.0, axes[1])
    conic = conic_from_ellipse(Ellipse(MIDDLE, axes, 0.0))
    across = np.array([1.0, 0.0, -MIDDLE[0]])
    found = find_centre_mark(picture, across, points, conic, 2.0 * RADIUS, WIDTH, BLUR_PX, (-0.2, 0.2), 4.0)
    assert (found is not None) is is_found


FLAT_PX = np.array([100.0, 25.0])
"""Half axes of a circle that is seen from a stand."""


def find_under_ball(radius_px: float, above_px: float, level: float) -> SeenMark | None:
    """The mark of a circle seen from a stand, with a ball before it whose middle is so far above the mark's."""
    y, x = np.mgrid[:300, :400] - MIDDLE[::-1, None, None]
    paint = (np.abs(x) < 0.5 * WIDTH * FLAT_PX[0]) | (np.hypot(x / FLAT_PX[0], y / FLAT_PX[1]) < RADIUS)
    ball = np.hypot(x, y + above_px) < radius_px
    paint, ball = (cv2.GaussianBlur(shape.astype(np.float32), (0, 0), BLUR_PX) for shape in (paint, ball))
    picture = (90.0 + 60.0 * paint) * (1.0 - ball) + level * ball + np.random.default_rng(0).normal(0.0, 2.0, x.shape)
    points = MIDDLE + np.linspace(-0.98, 0.98, 90)[:, None] * (0.0, FLAT_PX[1])
    conic, line = conic_from_ellipse(Ellipse(MIDDLE, tuple(FLAT_PX), 0.0)), np.array([1.0, 0.0, -MIDDLE[0]])
    return find_centre_mark(picture, line, points, conic, 2.0 * RADIUS, WIDTH, BLUR_PX, (-0.4, 0.4), 4.0)


@pytest.mark.parametrize(("radius_px", "above_px"), [(3.5, 2.1), (3.5, 3.3), (4.5, 2.7)])
@pytest.mark.parametrize("level", [170.0, 220.0])
def test_a_ball_that_lies_on_the_mark_is_not_the_mark(radius_px, above_px, level):
    """It is round where the disc is four times as wide as it is high, and is seen above the place on which it lies."""
    assert find_under_ball(radius_px, above_px, level) is None


def test_a_mark_without_a_ball_is_found_where_it_is_flat():
    found = find_under_ball(0.0, 0.0, 150.0)
    assert found is not None
    assert found.point_px == pytest.approx(MIDDLE, abs=0.3)
