"""Pixels to metres and back, with lens and crown, and their standard deviation."""

import numpy as np
import pytest

from circlecal.camera.parameters import INDEX, PARAMETERS
from circlecal.geometry.camera import Camera, image_center
from circlecal.records.record import StoredResult
from circlecal.view import field_to_image, image_to_field

WIDTH, HEIGHT = 1280, 720
FIELD = np.array([[0.0, 0.0], [9.15, 0.0], [-20.0, -30.0], [12.0, 20.0]])


def camera() -> Camera:
    return Camera(
        width=WIDTH,
        height=HEIGHT,
        focal_px=np.array([1500.0, 1500.0]),
        principal_point_px=image_center(WIDTH, HEIGHT) + 3,
        angles_rad=np.radians([3.0, 77.0, 1.0]),
        position_m=np.array([2.0, 60.0, -14.0]),
        kappa=np.array([0.03, 0.002]),
    )


def stored(**changes) -> StoredResult:
    content = {
        "id": "a",
        "status": "calibrated",
        "reason": None,
        "width": WIDTH,
        "height": HEIGHT,
        "H_image_field": camera().homography,
        "camera": camera(),
        "crown_m": 0.0,
        "crown_shape": "flat",
        "crown_radius_m": 9.15,
        "covariance": None,
    }
    return StoredResult(**{**content, **changes})


@pytest.mark.parametrize(
    "result",
    [
        stored(),
        stored(crown_m=0.08, crown_shape="parabola"),
        stored(crown_m=0.08, crown_shape="roof"),
        stored(camera=None),
        stored(camera=None, H_image_field=-2 * camera().homography),
    ],
)
def test_there_and_back(result):
    there = field_to_image(result, FIELD)
    assert np.allclose(image_to_field(result, there.points).points, FIELD, atol=1e-9)
    assert there.sigma is None


def test_there_and_back_from_a_low_camera_over_a_steep_crown():
    low = Camera(
        **{name: getattr(camera(), name) for name in Camera.__slots__ if name not in ("position_m", "angles_rad")},
        position_m=np.array([0.0, 45.0, -3.0]),
        angles_rad=np.radians([0.0, 86.0, 0.0]),
    )
    result = stored(camera=low, crown_m=0.1, crown_shape="parabola")
    field = np.array([[0.0, 0.0], [3.0, 20.0], [-5.0, -10.0]])
    assert np.allclose(image_to_field(result, field_to_image(result, field).points).points, field, atol=1e-6)


def test_lens_and_crown_are_in_the_answer():
    plain = field_to_image(stored(camera=None), FIELD).points
    assert np.abs(field_to_image(stored(), FIELD).points - plain).max() > 1
    crowned = field_to_image(stored(crown_m=0.1, crown_shape="parabola"), FIELD).points
    flat = field_to_image(stored(), FIELD).points
    assert np.array_equal(crowned[0], flat[0])
    assert crowned[2, 1] > flat[2, 1] + 1  # the far side lies lower, so lower in the picture


@pytest.mark.parametrize("result", [stored(), stored(camera=None), stored(crown_m=0.1, crown_shape="roof")])
def test_sky_and_points_behind_the_camera_have_no_answer(result):
    assert np.isnan(image_to_field(result, [[640.0, -2000.0]]).points).all()
    assert np.isnan(field_to_image(result, [[0.0, 200.0]]).points).all()


def test_sigma_follows_from_the_covariance():
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[INDEX["x"], INDEX["x"]] = 0.25  # half a metre along x
    result = stored(covariance=covariance)
    there = field_to_image(result, FIELD)
    moved = Camera(
        **{name: getattr(camera(), name) for name in Camera.__slots__ if name != "position_m"},
        position_m=np.array([2.5, 60.0, -14.0]),
    )
    shift = np.linalg.norm(field_to_image(stored(camera=moved), FIELD).points - there.points, axis=1)
    assert np.allclose(there.sigma, shift, rtol=0.02)
    back = image_to_field(result, np.vstack([there.points, [[640.0, -2000.0]]]))
    assert np.isfinite(back.sigma[:4]).all()
    assert np.isnan(back.sigma[4])
    assert back.sigma[0] == pytest.approx(0.5, rel=0.05)


def test_a_result_without_geometry_is_a_mistake_of_the_caller():
    with pytest.raises(ValueError, match="neither"):
        field_to_image(stored(camera=None, H_image_field=None), FIELD)
