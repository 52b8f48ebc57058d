import numpy as np

from circlecal.detection.sides import painted_on_one_surface

SEGMENTS = np.array([[[20.0, 100.0], [620.0, 100.0]], [[20.0, 200.0], [620.0, 210.0]]])


def picture(below: tuple[int, int, int]) -> np.ndarray:
    """Grass with a white line at y = 100; another surface from y = 200 ... 210 on, with a white line above it."""
    image = np.full((360, 640, 3), (60, 130, 70), np.uint8)
    x = np.arange(640)
    border = np.rint(200 + (x - 20) / 60.0).astype(int)
    image[np.arange(360)[:, None] > border] = below
    image[np.abs(np.arange(360)[:, None] - border) <= 1] = 230
    image[99:102] = 230
    return image


def test_the_foot_of_a_board_is_no_marking() -> None:
    assert painted_on_one_surface(picture((150, 60, 200)), SEGMENTS).tolist() == [True, False]


def test_shade_beside_a_line_changes_nothing() -> None:
    assert painted_on_one_surface(picture((30, 65, 35)), SEGMENTS).all()


def test_no_segments() -> None:
    assert painted_on_one_surface(picture((0, 0, 0)), np.zeros((0, 2, 2))).shape == (0,)
