"""BroadTrack, TVCalib and WorldCup files: conventions, round trips, and our camera over a flat field without a lens."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from circlecal.errors import InputError
from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.formats import broadtrack, exports, gamestate_camera, soccernet_camera, tvcalib, worldcup
from circlecal.formats.cameras import CalibratedFrame, CameraFrame, center_camera, resize_camera
from circlecal.formats.format import json_bytes
from circlecal.formats.soccernet_camera import camera_keys
from circlecal.geometry.camera import PlaneCamera, camera_from_homography, image_center
from circlecal.geometry.surface import Surface
from circlecal.synthetic.cameras import aim_camera

POINTS = np.array([[0.0, 0.0], [9.0, 3.0], [-9.0, -3.0], [3.0, 8.0]])
FILE = Path("00007.json")


@pytest.fixture
def centred(frame_camera):
    return replace(frame_camera, kappa=np.array([0.03, 0.0]))


def test_a_principal_point_half_a_pixel_beside_the_centre_is_not_centred(centred):
    """Formats without one mean the centre of the picture, ((W - 1) / 2, (H - 1) / 2)."""
    beside = replace(centred, principal_point_px=centred.principal_point_px + 0.5)
    moved = center_camera(beside, load_field("soccer"))
    np.testing.assert_allclose(moved.principal_point_px, image_center(960, 540), atol=1e-9)
    assert np.abs(moved.project(POINTS) - beside.project(POINTS)).max() < 0.05
    assert center_camera(centred, load_field("soccer")) is centred


def test_broadtrack_round_trip(centred):
    content = broadtrack.write([CameraFrame("000001", 960, 540, centred, image="/a/000001.jpg")])
    (again,) = broadtrack.read(FILE, content, None)
    assert (again.id, again.image, again.width) == ("000001", "/a/000001.jpg", 960)
    assert np.abs(again.camera.project(POINTS) - centred.project(POINTS)).max() < 1e-9


def test_broadtrack_has_the_field_of_view_and_distortion_per_height(centred):
    entry = json.loads(broadtrack.write([CameraFrame("a", 960, 540, centred)]))["/a.jpg"]["cp"]
    focal = centred.focal_px[0]
    assert np.tan(np.radians(entry["horizontalFieldOfViewDegrees"] / 2)) == pytest.approx(480 / focal)
    k1 = camera_keys(centred)["radial_distortion"][0]
    assert entry["normalizedRadialDistortionCoefficients"][0] == pytest.approx(k1 * (540 / focal) ** 2)


def test_broadtracks_second_coefficient_goes_with_the_fourth_power_of_heights(centred):
    record = json.loads(broadtrack.write([CameraFrame("a", 960, 540, centred)]))
    record["/a.jpg"]["cp"]["normalizedRadialDistortionCoefficients"] = [0.0, 0.02, 0.0]
    (found,) = broadtrack.read(FILE, json_bytes(record), None)
    x, y = found.camera.principal_point_px
    # one height from the middle
    assert found.camera.distort([x + 540.0, y]) == pytest.approx([x + 540.0 * 1.02, y])


def test_a_third_coefficient_is_an_error(centred):
    record = json.loads(broadtrack.write([CameraFrame("a", 960, 540, centred)]))
    record["/a.jpg"]["cp"]["normalizedRadialDistortionCoefficients"][2] = 0.1
    with pytest.raises(InputError, match="third"):
        broadtrack.read(FILE, json_bytes(record), None)


def test_the_nearest_center_camera(centred, soccer):
    assert center_camera(centred, soccer) is centred
    shifted = replace(centred, principal_point_px=centred.principal_point_px + np.array([8.0, -5.0]))
    near = center_camera(shifted, soccer)
    assert near.principal_point_px == pytest.approx(centred.principal_point_px)
    assert np.abs(near.project(POINTS) - shifted.project(POINTS)).max() < 0.5


def test_tvcalib_round_trip(frame_camera):
    camera = replace(frame_camera, kappa=np.array([0.02, 0.01]), principal_point_px=np.array([470.0, 280.0]))
    frames = [CameraFrame("a", 960, 540, camera, image="a.jpg"), CameraFrame("b", 960, 540, camera)]
    again = tvcalib.read(FILE, tvcalib.write(frames), None)
    assert [(f.id, f.image, f.width) for f in again] == [("a", "a.jpg", 960), ("b", "b.jpg", 960)]
    assert np.abs(again[0].camera.project(POINTS) - camera.project(POINTS)).max() < 1e-9
    assert np.allclose(again[0].H_image_field, camera.homography)


def test_tvcalib_homography_goes_from_the_picture_to_metres(frame_camera):
    record = json.loads(tvcalib.write([CameraFrame("a", 960, 540, frame_camera)]))
    x, y, w = np.array(record["homography"]) @ [*frame_camera.project([[9.0, 3.0]])[0], 1.0]
    assert (x / w, y / w) == pytest.approx((9.0, 3.0))
    assert record["aov_radian"] == pytest.approx(2 * np.arctan(480 / frame_camera.focal_px[0]))


def test_tvcalib_lists_of_one_and_bad_lines(frame_camera):
    record = json.loads(tvcalib.write([CameraFrame("a", 960, 540, frame_camera)]))
    listed = {key: [value] if isinstance(value, float | str) else value for key, value in record.items()}
    (again,) = tvcalib.read(FILE, json.dumps(listed).encode(), None)
    assert again.id == "a"
    content = (json.dumps(record) + "\n\n" + json.dumps({**record, "x_focal_length": "2300"})).encode()
    with pytest.raises(InputError, match="line 3: x_focal_length"):
        tvcalib.read(FILE, content, None)


@pytest.mark.parametrize("size", [(1280, 720), (1920, 1080)])
def test_worldcup_round_trip(frame_camera, size):
    H = frame_camera.homography
    again = worldcup.read_matrix(FILE, worldcup.matrix_bytes(H, size))
    factor = np.array([1280, 720]) / np.array(size)
    for point in POINTS:
        x, y, w = again.H_image_field @ [*point, 1.0]
        u, v, s = H @ [*point, 1.0]
        assert (x / w, y / w) == pytest.approx(tuple((np.array([u / s, v / s]) + 0.5) * factor - 0.5))


def test_worldcup_is_picture_to_yards_from_the_top_left_corner(frame_camera):
    camera = replace(frame_camera, width=1280, height=720)
    matrix = worldcup.parse_matrix(FILE, worldcup.matrix_bytes(camera.homography, (1280, 720)))
    x, y, w = matrix @ [*camera.project([[0.0, 9.15]])[0], 1.0]
    assert (x / w, y / w) == pytest.approx((57.5, 37 + 9.15 / 0.9144))


def see_as_soccernet(keys, points):
    """Pixels (N, 2) of points on the ground by the formulas of SoccerNet's camera, with nothing of circlecal."""
    pan, tilt, roll = np.radians([keys[f"{name}_degrees"] for name in ("pan", "tilt", "roll")])

    def about_z(angle):
        return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])

    about_x = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    rotation = (about_z(pan) @ about_x @ about_z(roll)).T
    seen = (np.column_stack([points, np.zeros(len(points))]) - keys["position_meters"]) @ rotation.T
    plane = seen[:, :2] / seen[:, 2:]
    square = np.sum(plane**2, axis=1)[:, None]
    k1, k2 = keys["radial_distortion"][:2]
    focal = np.array([keys["x_focal_length"], keys["y_focal_length"]])
    return plane * (1 + k1 * square + k2 * square**2) * focal + keys["principal_point"]


@pytest.mark.parametrize("size", [(960, 540), (1920, 1080)])
def test_cameras_show_the_field_by_the_formulas_of_their_programs(frame_camera, size):
    """A barrel lens, a principal point off the centre, and pixels that are not quite square, at two sizes."""
    camera = replace(
        frame_camera, kappa=np.array([-0.06, 0.01]), principal_point_px=np.array([470.0, 281.0]),
        focal_px=np.array([2300.0, 2304.0]),
    )  # fmt: skip
    frame = CameraFrame("a", 960, 540, camera).resize(size)
    expected = camera.project(POINTS) * (np.array(size) - 1) / (959, 539)
    labels = json.loads(gamestate_camera.write([frame]))
    files = {
        "soccernet": json.loads(soccernet_camera.write([frame])),
        "tvcalib": json.loads(tvcalib.write([frame])),
        "gamestate": labels["annotations"][0]["parameters"],
    }
    assert (labels["images"][0]["width"], labels["images"][0]["height"]) == size
    for name, keys in files.items():
        assert np.abs(see_as_soccernet(keys, POINTS) - expected).max() < 1e-6, name
    x, y, w = (
        np.array(files["tvcalib"]["homography"])
        @ np.column_stack([seen_by(frame.camera.homography, POINTS), np.ones(4)]).T
    )
    np.testing.assert_allclose(np.column_stack([x / w, y / w]), POINTS, atol=1e-6)


@pytest.mark.parametrize("content", [b"1 2 3", b"1 0 0 0 1 0 0 0 nan", b"1 0 0 0 1 0 0 0 x", b"0 0 0 0 0 0 0 0 0"])
def test_no_homography(content):
    with pytest.raises(InputError, match=r"00007\.json"):
        worldcup.read_matrix(FILE, content)


def test_a_crowned_field_becomes_the_nearest_camera_over_a_flat_one(calibrated, frame_camera):
    assert calibrated.flat is frame_camera
    crowned = replace(calibrated, view=FieldView(frame_camera, Surface("roof", crown_m=0.05)))
    points, pixels = crowned.visible_field
    before = np.linalg.norm(frame_camera.project(points) - pixels, axis=1)
    after = np.linalg.norm(crowned.flat.project(points) - pixels, axis=1)
    assert after.mean() < 0.5 * before.mean()


def test_a_lens_becomes_the_nearest_homography(calibrated, centred):
    frame = replace(calibrated, view=FieldView(centred))
    points, pixels = frame.visible_field

    def errors(H):
        lifted = np.column_stack([points, np.ones(len(points))]) @ H.T
        return np.linalg.norm(lifted[:, :2] / lifted[:, 2:] - pixels, axis=1)

    assert errors(frame.picture_homography).mean() < 0.6 * errors(centred.homography).mean()
    assert np.allclose(calibrated.picture_homography, calibrated.H_image_field)


def seen_by(H, points):
    lifted = np.column_stack([points, np.ones(len(points))]) @ H.T
    return lifted[:, :2] / lifted[:, 2:]


def test_pixels_that_are_not_square_become_square_in_pictures_of_another_shape(calibrated, frame_camera):
    """Of a picture that is stored 720 x 540 and shown 960 x 540; a field of view across tells one focal length."""
    stored = resize_camera(frame_camera, (720, 540))
    frame = replace(calibrated, width=720, view=FieldView(stored))
    converted = CameraFrame("f", 720, 540, stored).with_square_pixels().reduce("centred camera", load_field("soccer"))
    for told in (frame.reduce("centred camera", (960, 540)), frame.reduce("centred camera"), converted):
        (entry,) = json.loads(broadtrack.write([told])).values()
        again = broadtrack.read(FILE, json_bytes({"a.jpg": entry}), None)[0].camera
        assert (again.width, again.height) == (960, 540)
        np.testing.assert_allclose(again.project(POINTS), frame_camera.project(POINTS), atol=0.5)
    assert frame.reduce("camera").camera.width == 720


def test_a_format_of_square_pixels_says_that_others_become_another_camera(centred, soccer, tmp_path, caplog):
    wide = replace(centred, focal_px=centred.focal_px * (0.75, 1.0))
    for camera, is_told in ((centred, False), (wide, True)):
        frame = CameraFrame("a", 960, 540, camera).reduce("centred camera", soccer)
        assert frame.is_stretched is is_told
        exports._camera_files([frame, frame], broadtrack.FORMAT, tmp_path)
        assert caplog.text.count("cannot say that pixels are not square") == int(is_told)


def test_a_homography_is_the_nearest_to_the_lens_in_every_way_to_it(calibrated, centred):
    template = load_field("soccer")
    lens = replace(centred, kappa=np.array([0.1, 0.0]))
    frame = replace(calibrated, view=FieldView(lens))
    wanted = frame.picture_homography
    assert np.abs(seen_by(wanted, POINTS) - seen_by(lens.homography, POINTS)).max() > 1.0
    converted = CameraFrame("a", 960, 540, lens).reduce("homography", template)
    np.testing.assert_allclose(seen_by(converted.H_image_field, POINTS), seen_by(wanted, POINTS), atol=0.3)
    for size in (None, (960, 540), (480, 270)):
        told = json.loads(tvcalib.write([frame.reduce("camera", size)]))["homography"]
        factor = (1.0, 1.0) if size is None else ((size[0] - 1) / 959, (size[1] - 1) / 539)
        np.testing.assert_allclose(seen_by(np.linalg.inv(told), POINTS), seen_by(wanted, POINTS) * factor, atol=1e-6)


def test_a_homography_of_a_view_away_from_the_centre_mark_is_of_a_camera_above_the_ground():
    position = np.array([10.0, 0.0, -12.0])
    away = aim_camera(position, np.array([45.0, 0.0, 0.0]), 1500.0, 0.0, 1920, 1080)
    found = CameraFrame("a", 1920, 1080, H_image_field=away.homography).require_camera()
    np.testing.assert_allclose(found.position_m, position, atol=1e-6)
    np.testing.assert_allclose(found.project([[45.0, 3.0]]), away.project([[45.0, 3.0]]), atol=1e-6)


@pytest.mark.parametrize("form", [soccernet_camera, tvcalib])
def test_the_size_that_a_file_states_counts_before_the_given_one(frame_camera, form):
    frame = CameraFrame("a", 960, 540, frame_camera)
    (found,) = form.read(FILE, form.write([frame]), (1280, 720))
    assert (found.width, found.height) == (960, 540)
    keys = {**json.loads(form.write([frame])), "image_width": None, "image_height": None}
    (found,) = form.read(FILE, json_bytes(keys), (1280, 720))
    assert (found.width, found.height) == (1280, 720)


def test_a_homography_of_a_picture_of_another_shape_is_stretched_back(frame_camera):
    stored = resize_camera(frame_camera, (960, 720))
    path = Path("a.homographyMatrix")
    content = worldcup.matrix_bytes(stored.homography, (960, 720))
    (frame,) = worldcup.FORMAT.read(path, content, (960, 720))
    assert (frame.width, frame.height) == (960, 720)
    np.testing.assert_allclose(seen_by(frame.H_image_field, POINTS), seen_by(stored.homography, POINTS), atol=1e-6)
    (frame,) = worldcup.FORMAT.read(path, content, None)
    assert (frame.width, frame.height) == (1280, 720)


@pytest.mark.parametrize("field", ["field-hockey", "beach-soccer"])
@pytest.mark.parametrize("module", [broadtrack, tvcalib, worldcup])
def test_fields_without_a_whole_circle_have_cameras_of_every_kind(frame_camera, field, module):
    template = load_field(field)
    assert not template.circles
    holds = module.FORMAT.holds
    found = CameraFrame("a", 960, 540, frame_camera).reduce(holds, template)
    assert found.H_image_field is not None


def test_the_camera_of_a_homography_shows_the_field_where_that_has_it(frame_camera):
    """A homography of a solver is that of no camera exactly; the closed form takes one, and is nearest at no place."""
    soccer = load_field("soccer")
    H = replace(frame_camera, kappa=np.zeros(2)).homography.copy()
    H[2, :2] *= 1.03
    frame = CalibratedFrame(
        "a", 960, 540, FieldView(PlaneCamera(960, 540, H)), soccer, soccer.circle_by_name["centre_circle"]
    )
    places, pixels = frame.visible_field
    closed = camera_from_homography(H, 960, 540)

    def rms(camera):
        return np.sqrt(np.mean((camera.project(places) - pixels) ** 2))

    assert rms(frame.flat) < 0.7 * rms(closed)
