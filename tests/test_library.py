"""What a user types on a result: every call answers, for calibrated and refused frames, and for results read back."""

import copy
import json
import pickle
from collections.abc import Sequence
from typing import get_args, get_type_hints

import cv2
import numpy as np
import pytest

import circlecal
from circlecal.camera.observed import points_from_observations
from circlecal.config import config_names, load_config
from circlecal.errors import ConfigError, InputError
from circlecal.field import field_folder, load_field
from circlecal.formats.registry import calibration_formats

CENTRE_AND_RIM = np.array([[0.0, 0.0], [9.15, 0.0], [0.0, -9.15]])
CALLS = {
    "c.id": "good",
    "c.source": None,
    "c.time_s": None,
    "c.size": (960, 540),
    "c.ok": True,
    "c.status": "calibrated",
    "c.code": None,
    "c.reason": None,
    "c.help": None,
    "c.checks[0].passed": True,
    "c.to_image([[0, 0], [9.15, 0]]).shape": (2, 2),
    "c.to_image([0, 0]).shape": (2,),
    "c.to_image([[0, 0]], sigma=True).sigma.shape": (1,),
    "c.to_field([[480, 270]]).shape": (1, 2),
    "c.to_field([[480, 270]], sigma=True).sigma.shape": (1,),
    "c.to_image([[52.5, 0, -2.44]]).shape": (1, 2),
    "c.image_covariance([[0, 0]]).shape": (1, 2, 2),
    "c.field_covariance([480, 270]).shape": (2, 2),
    "[path.name for path in c.export('soccernet', folder)]": ["camera_good.json"],
    "c.attempt.ellipses.primary.conic.shape": (3, 3),
    "len(c.attempt.correspondences.points), len(c.attempt.correspondences.tangents)": (8, 8),
    "c.checks[0].measures != ''": True,
    "c.transformer().transform_points([[480, 270]]).shape": (1, 2),
    "c.H_image_field.shape": (3, 3),
    "c.H_field_image.shape": (3, 3),
    "c.camera.focal_px.shape": (2,),
    "c.K.shape": (3, 3),
    "c.R.shape": (3, 3),
    "c.t.shape": (3,),
    "len(c.dist)": 4,
    "c.position_m.shape": (3,),
    "type(c.sigma_px)": float,
    "type(c.sigma_m)": float,
    "c.field.name": "soccer",
    "c.view.to_field([480, 270]).shape": (2,),
    "c.attempt.ellipses.primary.edge in ('outer', 'inner', 'center')": True,
    "c.overlay(image).shape": (540, 960, 3),
    "c.top_view(image).ndim": 3,
    "c.save(folder / 'x.json').name": "x.json",
    "c.save(folder).name": "good.json",
    "c.to_dict()['id']": "good",
    "'calibrated' in repr(c)": True,
    "'<table>' in c._repr_html_()": True,
    "c == circlecal.load(c.save(folder))": True,
    "len({c, circlecal.load(c.save(folder))})": 1,
    "len(pickle.dumps(c)) < 300_000": True,
}
"""More than the thirty calls that users type, and what they answer."""


@pytest.fixture(scope="module")
def good(frame_image):
    """A calibrated frame."""
    return circlecal.calibrate(frame_image, id="good")


@pytest.fixture(scope="module")
def refused():
    """A refused one."""
    return circlecal.calibrate(np.full((120, 160, 3), (60, 130, 70), np.uint8))


@pytest.mark.parametrize("source", ["calibrated", "loaded", "pickled"])
@pytest.mark.parametrize("call", CALLS)
def test_call(good, frame_image, tmp_path, call, source):
    c = good
    if source == "loaded":
        c = circlecal.load(good.save(tmp_path / "stored.json"))
    elif source == "pickled":
        c = pickle.loads(pickle.dumps(good))
    known = {"c": c, "image": frame_image, "folder": tmp_path, "circlecal": circlecal, "pickle": pickle}
    assert eval(call, known) == CALLS[call]  # the calls stand above


def test_loaded_results_answer_the_same(good, tmp_path):
    loaded = circlecal.load(good.save(tmp_path))
    for name in ("K", "R", "t", "dist", "position_m", "H_image_field", "H_field_image"):
        assert np.allclose(getattr(loaded, name), getattr(good, name), rtol=1e-9, atol=1e-9), name
    for ours, theirs in zip(*(frame.to_image(CENTRE_AND_RIM, sigma=True) for frame in (good, loaded)), strict=True):
        assert np.allclose(ours, theirs, rtol=1e-6, atol=1e-6)
    assert loaded.checks == good.checks
    assert loaded.to_dict() == good.to_dict()


def test_a_loaded_result_draws_the_same_overlay(good, frame_image, tmp_path):
    loaded = circlecal.load(good.save(tmp_path))
    difference = cv2.absdiff(loaded.overlay(frame_image), good.overlay(frame_image))
    assert np.count_nonzero(difference.max(axis=2) > 40) < 200
    assert np.abs(loaded.top_view(frame_image).astype(int) - good.top_view(frame_image)).mean() < 0.1


# --- both ways between picture and field


def test_both_ways(good, frame_camera):
    pixels = good.to_image(CENTRE_AND_RIM)
    assert np.abs(pixels - frame_camera.project(CENTRE_AND_RIM)).max() < 1.5
    assert np.allclose(good.to_field(pixels), CENTRE_AND_RIM, atol=1e-6)
    spread = good.to_field(pixels, sigma=True).sigma
    assert ((spread > 0.001) & (spread < 2.0)).all()
    grid = np.stack([pixels, pixels])
    assert good.to_field(grid).shape == grid.shape


def test_how_well_pixels_are_known_enters_where_it_is_told(good):
    """The scatter of places of pixels that are off by so much, beside what the camera leaves open."""
    pixels = np.array([[480.0, 270.0], [600.0, 150.0]])
    alone, clicked = (good.field_covariance(pixels, point_sigma_px=px) for px in (0.0, 2.0))
    drawn = good.to_field(pixels + np.random.default_rng(3).normal(0.0, 2.0, (4000, 2, 2)))
    for point in range(2):
        scatter = np.cov(drawn[:, point].T)
        assert np.abs(clicked[point] - alone[point] - scatter).max() < 0.1 * np.trace(scatter)
    spread = good.to_field(pixels, sigma=True, point_sigma_px=2.0).sigma
    assert np.allclose(spread, np.sqrt(np.trace(clicked, axis1=1, axis2=2)))
    each = good.to_field(pixels, sigma=True, point_sigma_px=[0.0, 2.0]).sigma
    assert np.allclose(each, [good.to_field(pixels, sigma=True).sigma[0], spread[1]])
    for wrong in (-1.0, np.nan, np.inf, [1.0, 2.0, 3.0]):
        with pytest.raises(ValueError, match="point_sigma_px"):
            good.to_field(pixels, sigma=True, point_sigma_px=wrong)


def test_nan_where_the_field_is_not_seen(good):
    above = good.to_field([[480, -3000], [480, 270]], sigma=True)
    assert np.isnan(above.points[0]).all() and np.isnan(above.sigma[0])
    assert np.isfinite(above.points[1]).all() and np.isfinite(above.sigma[1])
    behind = good.to_image([[0.0, 400.0]], sigma=True)
    assert np.isnan(behind.points).all() and np.isnan(behind.sigma).all()


@pytest.mark.parametrize("points", [3.0, [1.0, 2.0, 3.0, 4.0], [[1.0], [2.0]]])
def test_points_of_another_shape(good, points):
    for convert in (good.to_image, good.to_field, good.image_covariance, good.field_covariance):
        with pytest.raises(ValueError, match="shape"):
            convert(points)
    with pytest.raises(ValueError, match=r"\(\.\.\., 2\), not \(3,\)"):
        good.to_field([1.0, 2.0, 3.0])


def test_points_in_space_are_seen_where_opencv_projects_them(good):
    crossbar = np.array([[52.5, -3.66, -2.44], [10.0, 5.0, -8.0]])
    drawn, _ = cv2.projectPoints(crossbar, cv2.Rodrigues(good.R)[0], good.t, good.K, good.dist)
    found = good.to_image(crossbar, sigma=True)
    assert np.allclose(found.points, drawn[:, 0], atol=1e-6)
    assert np.isnan(found.sigma).all()


def test_covariances_have_the_variance_that_sigma_tells(good):
    seen, placed = good.to_image(CENTRE_AND_RIM, sigma=True), good.to_field([[480, 270], [480, -3000]], sigma=True)
    own = (good.image_covariance(CENTRE_AND_RIM), good.field_covariance([[480, 270], [480, -3000]]))
    for sigma, covariances in zip((seen.sigma, placed.sigma), own, strict=True):
        assert np.allclose(np.sqrt(np.trace(covariances, axis1=-2, axis2=-1)), sigma, equal_nan=True)
    assert np.isnan(own[1][1]).all()


def test_an_export_of_a_refused_frame_and_an_unknown_format(good, refused, tmp_path):
    assert refused.export("soccernet", tmp_path) == []
    with pytest.raises(InputError, match=r"^format colmap: .*known: .*soccernet"):
        good.export("colmap", tmp_path)


ONE_FILE = sorted(name for name, form in calibration_formats().items() if not form.per_frame)


@pytest.mark.parametrize("form", ONE_FILE)
def test_formats_of_one_file_hold_all_frames(good, refused, frame_image, tmp_path, form):
    """A single frame replaces its own export alone; several are written at once."""
    other = circlecal.calibrate(frame_image, id="day 1/other.v2")
    file = tmp_path / calibration_formats()[form].file_name
    assert other.export(form, tmp_path) == other.export(form, tmp_path) == [file]
    one = file.read_bytes()
    for frame in (good, refused):
        with pytest.raises(
            InputError, match=rf"{file.name}: holds other.v2.*circlecal.export\(frames, '{form}', folder"
        ):
            frame.export(form, tmp_path)
    assert file.read_bytes() == one
    assert circlecal.export([good, other, refused], form, tmp_path) == [file]
    held = calibration_formats()[form].read(file, file.read_bytes(), good.size)
    assert {good.id, "other.v2"} <= {frame.id for frame in held}
    file.write_bytes(b"notes of somebody")
    with pytest.raises(InputError, match=f"{file.name}: is there already and is no {form} file; choose another folder"):
        good.export(form, tmp_path)


def test_a_refused_frame_takes_its_own_camera_away(good, refused, tmp_path):
    again = copy.copy(refused)
    again._record = refused._record.model_copy(update={"id": good.id})
    file = good.export("tvcalib", tmp_path)[0]
    assert again.export("tvcalib", tmp_path) == [] and not file.exists()


def test_exports_of_several_frames_need_ids(good, frame_image, tmp_path):
    twin = circlecal.calibrate(frame_image, id=good.id.upper())
    with pytest.raises(InputError, match=rf"^{twin.id}: two frames have this id; .*calibrate\(image, id=\.\.\.\)"):
        circlecal.export([good, twin], "soccernet", tmp_path)
    with pytest.raises(InputError, match=r"^format colmap"):
        circlecal.export([good], "colmap", tmp_path)
    written = circlecal.export((frame for frame in [good]), "soccernet", tmp_path / "new")
    assert [path.name for path in written] == [f"camera_{good.id}.json"]


def test_intermediates_print_short(good):
    for found in (good.attempt, good.attempt.ellipses.primary, good.attempt.correspondences, good.view):
        assert len(repr(found)) < 2500
        assert repr(found).startswith(f"{type(found).__name__}(")
    assert "points_px=<array (" in repr(good.attempt.ellipses.primary)


def test_opencv_takes_the_camera(good, frame_image):
    on_plane = np.column_stack([CENTRE_AND_RIM, np.zeros(3)])
    drawn, _ = cv2.projectPoints(on_plane, cv2.Rodrigues(good.R)[0], good.t, good.K, good.dist)
    assert np.allclose(drawn[:, 0], good.camera.project(CENTRE_AND_RIM), atol=1e-6)
    straight = cv2.undistort(frame_image, good.K, good.dist)
    assert straight.shape == frame_image.shape
    undistorted = cv2.undistortPoints(drawn, good.K, good.dist, P=good.K)[:, 0]
    lifted = np.column_stack([CENTRE_AND_RIM, np.ones(3)]) @ good.H_image_field.T
    assert np.allclose(lifted[:, :2] / lifted[:, 2:], undistorted, atol=1e-3)


def test_a_map_of_other_units_and_origin(good):
    pixels = good.to_image([[0.0, 0.0]])
    assert np.allclose(good.transformer().transform_points(pixels), 0.0, atol=1e-6)
    assert np.allclose(good.transformer((12000, 7000)).transform_points(pixels), [[6000, 3500]], atol=1e-3)
    assert good.transformer().transform_points(np.empty((0, 2))).shape == (0, 2)


def test_pictures_of_16_bit_and_gray_are_at_hand_while_somebody_holds_them(frame_image):
    deep, gray = frame_image.astype(np.uint16) * 257, frame_image[:, :, 1].copy()
    for held in (deep, deep.astype(">u2"), gray):
        frame = circlecal.calibrate(held)
        assert frame.ok and frame.image.dtype == np.uint8 and frame.image.shape == (540, 960, 3)
        assert frame.overlay().shape == (540, 960, 3) and frame.top_view() is not None


def test_options_may_be_arrays_and_numbers_of_numpy(frame_image):
    settings = {"camera.position_m": np.array([0.0, 66.0, -15.0]), "camera.position_sd_m": np.full(3, 9.0, np.float32)}
    assert circlecal.calibrate(frame_image, set={**settings, "seed": np.int64(3)}).ok


@pytest.mark.parametrize("given", [{"size": (np.nan, 480)}, {"size": (np.inf, 480)}, {"sigma_px": np.ones(3)}])
def test_sizes_and_sigmas_that_are_none(given):
    with pytest.raises(InputError):
        circlecal.calibrate_points(**{"size": (640, 480), "circle": np.zeros((8, 2)), **given})


# --- refused frames


def test_a_frame_without_players(good, refused):
    for frame in (good, refused):
        assert frame.to_field([]).shape == (0, 2)
        assert frame.to_field([], sigma=True).sigma.shape == (0,)


@pytest.mark.parametrize("points", [3.0, [1.0, 2.0, 3.0, 4.0], np.zeros((2, 3))])
def test_a_map_of_points_of_another_shape(good, points):
    with pytest.raises(ValueError, match=r"must be \(N, 2\)"):
        good.transformer().transform_points(points)


@pytest.mark.parametrize("size", [(0, 7000), (-1, 1), (1, 2, 3), (np.inf, 68), (np.nan, 68), (105, "a"), "105"])
def test_a_map_without_a_size(good, size):
    with pytest.raises(ValueError, match="both positive"):
        good.transformer(size)


def test_arguments_of_another_kind(frame_image):
    with pytest.raises(TypeError, match="an array or a path, not NoneType"):
        circlecal.calibrate(None)
    with pytest.raises(TypeError, match=r"^mask must be an array or a path, not list$"):
        circlecal.calibrate(frame_image, mask=[[0, 1]])
    with pytest.raises(TypeError, match=r"^path must be that of a video, not ndarray$"):
        circlecal.calibrate_video(frame_image)
    with pytest.raises(TypeError, match=r"^id must be a text, not 7; give str\(7\)$"):
        circlecal.calibrate(frame_image, id=7)
    with pytest.raises(TypeError, match=r"^id must be a text, not 7; give str\(7\)$"):
        circlecal.calibrate_points(size=(960, 540), keypoints={"centre_mark": [480, 270]}, id=7)
    with pytest.raises(TypeError, match="config takes a Config, a name or a file"):
        circlecal.calibrate(frame_image, {"camera": {}})
    with pytest.raises(TypeError, match="set takes a mapping"):
        circlecal.calibrate(frame_image, set="seed=3")
    with pytest.raises(InputError, match="points: takes pixels by the name of what they show, or a file, not list"):
        circlecal.calibrate(frame_image, points=[[1, 2]])
    with pytest.raises(ConfigError, match=r"set 1=2: 1 is no name of an option, such as 'camera\.roll_sd_deg'"):
        circlecal.calibrate(frame_image, set={1: 2})


@pytest.mark.parametrize("size", [(0, 720), 1280, None, ("a", "b"), (960.5, 540), (960,), (np.inf, 540), "12"])
def test_sizes_that_are_none(size, good, tmp_path):
    with pytest.raises(InputError, match=r"^size must be the width and height of the picture in pixels, not "):
        circlecal.calibrate_points(size=size, circle=[[1, 1]])
    if size is not None:
        with pytest.raises(InputError, match=r"^size must be the width and height of the picture in pixels, not "):
            good.export("worldcup", tmp_path, size=size)


def test_a_refused_frame_says_why_and_what_helps(refused):
    assert (refused.ok, refused.status) == (False, "refused")
    assert refused.code and refused.reason and refused.help
    assert refused.code in repr(refused)
    assert refused.reason in refused._repr_html_()


def test_a_refused_frame_answers_every_question(refused):
    for name in ("view", "camera", "K", "R", "t", "dist", "H_image_field", "position_m", "sigma_px", "sigma_m"):
        assert getattr(refused, name) is None, name
    for convert in (refused.to_image, refused.to_field, refused.transformer().transform_points):
        assert np.isnan(convert([[1.0, 2.0]])).all()
    assert np.isnan(refused.to_image([[1.0, 2.0]], sigma=True).sigma).all()
    picture = np.full((120, 160, 3), (60, 130, 70), np.uint8)
    assert refused.top_view(picture) is None
    assert refused.overlay(picture).shape == picture.shape
    assert pickle.loads(pickle.dumps(refused)) == refused


# --- as a value


def test_repr_is_one_short_line(good, refused):
    for calibration in (good, refused):
        assert len(repr(calibration)) < 120
        assert "\n" not in repr(calibration)


def test_what_rounds_to_nothing_has_no_sign(good, tmp_path):
    record = good.to_dict()
    record["camera"] |= {"position_meters": [-0.01, 62.0, -15.5], "pan_degrees": -0.001}
    path = tmp_path / "good.json"
    path.write_text(json.dumps(record))
    nearly = circlecal.load(path)
    assert "at (0.0, 62.0, -15.5) m" in repr(nearly)
    assert "0.0, 62.0 m from the centre mark, 15.5 m high" in nearly._repr_html_()
    assert "0.00, " in nearly._repr_html_() and "-0.00" not in nearly._repr_html_()


def test_html_has_the_picture_while_somebody_holds_it(frame_image):
    image = frame_image.copy()
    calibration = circlecal.calibrate(image)
    assert "data:image/jpeg" in calibration._repr_html_()
    del image
    assert "data:image/jpeg" not in calibration._repr_html_()
    with pytest.raises(InputError, match="not at hand"):
        calibration.overlay()


def test_html_escapes_names(frame_image):
    assert "<script>" not in circlecal.calibrate(frame_image, id="<script>&")._repr_html_()


@pytest.mark.parametrize("is_loaded", [False, True])
def test_nobody_changes_a_result_by_its_arrays(good, tmp_path, is_loaded):
    frame = circlecal.load(good.save(tmp_path)) if is_loaded else good
    fit = frame.attempt.camera
    held = (
        frame.position_m, frame.camera.kappa, frame.camera.focal_px, frame.camera.angles_rad, frame.region.covariance,
        frame.camera.principal_point_px, fit.theta, fit.covariance, fit.H_image_field, fit.imaged_center_px,
    )  # fmt: skip
    for values in held:
        with pytest.raises(ValueError, match="read-only"):
            values += 1.0
    before = frame.to_image([9.15, 0.0])
    for own in (frame.K, frame.R, frame.t, frame.H_image_field, frame.H_field_image):
        own += 1.0
    assert np.array_equal(frame.to_image([9.15, 0.0]), before)
    assert not np.array_equal(frame.K, frame.K + 1.0) and np.array_equal(frame.K, good.K)


def test_equal_by_content_and_not_by_time(frame_image, good):
    again = circlecal.calibrate(frame_image, id="good")
    assert again == good and hash(again) == hash(good)
    other = circlecal.calibrate(frame_image, id="good", set={"seed": 1})
    assert other != good
    assert good != "good"


def test_a_picture_in_a_file_is_read_again(frame_file):
    calibration = circlecal.calibrate(frame_file)
    assert calibration.source == str(frame_file)
    assert calibration.overlay().shape == (540, 960, 3)
    assert calibration.top_view(px_per_m=4).shape[1] < calibration.top_view().shape[1]
    frame_file.unlink()
    assert calibration.image is None


class _Path:
    """A path of somebody else's class."""

    def __init__(self, path):
        self._path = path

    def __fspath__(self):
        return str(self._path)


def test_paths_of_other_classes_are_paths(frame_file, good):
    found = circlecal.calibrate(_Path(frame_file))
    assert found == circlecal.calibrate(frame_file) and found.source == str(frame_file)
    drawn = found.overlay()
    for path in (frame_file, str(frame_file), _Path(frame_file)):
        assert np.array_equal(found.overlay(path), drawn)
        assert np.array_equal(found.top_view(path), found.top_view())
    with pytest.raises(InputError, match="nowhere"):
        good.overlay("nowhere.jpg")
    with pytest.raises(TypeError, match=r"^image must be an array or a path, not list$"):
        good.overlay([1])


def test_points_without_a_name_are_called_points(tmp_path):
    found = circlecal.calibrate_points(size=(960, 540), keypoints={"centre_mark": [480, 270]}, id=None)
    assert found.id == "points" and circlecal.load(found.save(tmp_path)) == found


def test_what_a_masked_array_hides_is_nowhere(good):
    pixels = np.ma.masked_array([[480, 270], [300, 300]], mask=[[False, False], [True, True]])
    for answer in (good.to_field(pixels), good.transformer().transform_points(pixels)):
        assert np.isfinite(answer[0]).all() and np.isnan(answer[1]).all()
    hidden = np.ma.masked_array([[0.0, 0.0], [9.15, 0.0]], mask=[[False, False], [True, False]])
    assert np.isfinite(good.to_image(hidden)).all(axis=1).tolist() == [True, False]


def test_parts_of_a_result_are_themselves_and_can_be_kept_in_sets(good, frame_image):
    other = circlecal.calibrate(frame_image, id="good")
    for part in ("camera", "view", "attempt", "found", "region"):
        mine = getattr(good, part)
        assert getattr(other, part) != mine and mine in {mine}


def test_a_template_of_soccer_holds_no_rink(frame_image, tmp_path):
    given = circlecal.calibrate_points(size=(960, 540), keypoints={"centre_mark": [480, 270]}, field="ice-hockey")
    with pytest.raises(InputError, match="soccer pitch; the field 'ice-hockey' has no side_line_right"):
        given.export("worldcup", tmp_path)
    with pytest.raises(InputError, match="soccer pitch; the field 'ice-hockey' has no side_line_right"):
        circlecal.export([given], "worldcup", tmp_path)


def test_a_picture_of_another_size_is_refused(good):
    with pytest.raises(InputError, match="960 x 540"):
        good.overlay(np.zeros((100, 100, 3), np.uint8))


def test_a_changed_dictionary_changes_nothing(good):
    content = good.to_dict()
    content["H_image_field"][0][0] = 7.0
    assert good.to_dict() != content
    json.dumps(good.to_dict(), allow_nan=False)


# --- options


def test_configurations_by_name_by_file_and_ready(frame_image, tmp_path):
    (tmp_path / "mine.yaml").write_text("seed: 7\n")
    for config in (tmp_path / "mine.yaml", str(tmp_path / "mine.yaml"), circlecal.load_config(None, ["seed=7"])):
        assert circlecal.calibrate(frame_image, config).to_dict()["seed"] == 7
    assert circlecal.calibrate(frame_image, "broadcast").ok
    overridden = circlecal.calibrate(frame_image, circlecal.load_config("broadcast"), set={"seed": 3})
    assert overridden.to_dict()["seed"] == 3


def test_a_wrong_option_names_itself(frame_image):
    with pytest.raises(ConfigError, match=r"camera\.rol_sd_deg"):
        circlecal.calibrate(frame_image, set={"camera.rol_sd_deg": 1})
    with pytest.raises(ConfigError, match="moon"):
        circlecal.calibrate(frame_image, "moon")
    with pytest.raises(ConfigError, match="quidditch"):
        circlecal.calibrate(frame_image, field="quidditch")


def test_field_and_sizes(frame_image):
    calibration = circlecal.calibrate(frame_image, field="soccer", set={"field.sizes.length": 100})
    assert calibration.field.length_m == 100


# --- points


def test_calibrate_points(frame_camera):
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    rim = 9.15 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    calibration = circlecal.calibrate_points(
        size=(960, 540),
        circle=frame_camera.project(rim),
        lines={"halfway_line": frame_camera.project([[0.0, -12.0], [0.0, 12.0]])},
        keypoints={
            (0.0, 0.0): frame_camera.project([0.0, 0.0]),
            "centre_circle top": frame_camera.project([0.0, -9.15]),
        },
        set={"verdict.max_sigma_px": 100},
    )
    assert calibration.ok, calibration.reason
    assert np.abs(calibration.to_image(CENTRE_AND_RIM) - frame_camera.project(CENTRE_AND_RIM)).max() < 1.0
    assert calibration.image is None


@pytest.mark.parametrize(
    ("points", "part"),
    [
        ({"lines": {"moon_line": [[1, 2], [3, 4]]}}, "moon_line"),
        ({"circle": [[1, 2, 3]]}, "centre_circle"),
        ({"keypoints": {"centre_mark": [1, float("nan")]}}, "finite"),
        ({"keypoints": {"centre_mark": "here"}}, "centre_mark"),
        ({"keypoints": {(0.0, 0.0, 0.0): [1, 2]}}, "point .x, y. of the field"),
        ({"keypoints": {(float("nan"), 0.0): [1, 2]}}, "point of the field that is not finite"),
        (
            {"keypoints": {(500.0, 0.0): [1, 2]}},
            r"^\(500.0, 0.0\): lies more than 3 lengths of the field \(105 m\) from",
        ),
        ({"keypoints": {(9.15, 0.0): [1e9, 2]}}, r"^\(9.15, 0.0\): its pixel lies more than 20 pictures away$"),
        ({"sigma_px": -1.0}, "sigma_px"),
        ({"sigma_px": float("nan")}, "sigma_px"),
        ({"convention": "pain"}, "neither 'official' nor 'paint'"),
        ({"circle": np.zeros((3, 4))}, r"\(N, 2\), column and row of each, not 3 x 4"),
        ({"circle": np.zeros((2, 7))}, "not 2 x 7"),
        ({"circle": 3.0}, "not a single number"),
        ({"size": (960.5, 540)}, "size"),
        ({"lines": {"halfway_line": [[1, 2]]}}, "^halfway_line: is a line of one point; give two or more$"),
        ({"lines": [[1, 2]]}, "^lines: takes pixels by the name of what they show, not list$"),
        ({"keypoints": 3}, "^keypoints: takes pixels by the name of what they show, not int$"),
        ({"sigma_px": "wide"}, "sigma_px must be a standard deviation in pixels above 0, not 'wide'"),
        ({"keypoints": {"centre_mark": [[640, 360], [9, 9]]}}, "^centre_mark: is one point of the field, and 2 pixels"),
        (
            {"keypoints": {(0.0, -34.0): [[640, 360], [9, 9]]}},
            r"^\(0.0, -34.0\): is one point of the field, and 2 pixels",
        ),
        ({"keypoints": {"centre_circle top": np.ones((3, 2))}}, "^centre_circle top: is one point of the field, and 3"),
        ({"keypoints": {"halfway_line x side_line_top": np.ones((2, 2))}}, "is one point of the field, and 2 pixels"),
        (
            {"circle": [[1, 2]], "keypoints": {"centre_circle": [3, 4]}},
            "^centre_circle: is given in circle and in keypoints; give all its pixels in one$",
        ),
        (
            {"lines": {"halfway_line": [[1, 2], [3, 4]]}, "keypoints": {"halfway_line": [5, 6]}},
            "^halfway_line: is given in lines and in keypoints; give all its pixels in one$",
        ),
    ],
)
def test_points_that_are_none(points, part):
    with pytest.raises(InputError, match=part):
        circlecal.calibrate_points(**{"size": (960, 540), **points})


def test_only_of_an_unknown_name_the_known_ones_are_told():
    with pytest.raises(InputError, match=r"moon: is no marking of the field 'soccer'; known: centre_circle, "):
        circlecal.calibrate_points(size=(960, 540), keypoints={"moon": [480, 270]})
    with pytest.raises(
        InputError, match=r"centre_mark: point 1 of 1 at \(1000000, 270\) lies more than 20 pictures away$"
    ):
        circlecal.calibrate_points(size=(960, 540), keypoints={"centre_mark": [1e6, 270]})


def test_too_few_points_are_refused():
    calibration = circlecal.calibrate_points(size=(960, 540), keypoints={"centre_mark": [480, 270]})
    assert not calibration.ok and calibration.help


def test_keypoints_go_with_the_markings_that_they_are_of():
    """Corners of a penalty area say nothing of the length of the field, nor do points of the centre circle."""
    field = load_field("soccer")
    names = {
        "side_line_right x big_rect_right_top": field.place_shift((52.5, -20.16)),
        "halfway_line x side_line_top": field.place_shift((0.0, -34.0)),
        "centre_circle right": np.zeros((3, 2)),
        (9.15, 0.0): None,
    }
    found = circlecal.calibrate_points(
        size=(960, 540), keypoints={name: (100.0 + 50.0 * k, 200.0) for k, name in enumerate(names)}, convention="paint"
    )
    points = found.attempt.observations.keypoints
    assert len(points) == len(names)
    for point, shift in zip(sorted(points, key=lambda p: p.point_px[0]), names.values(), strict=True):
        assert (point.shift is None) if shift is None else np.array_equal(point.shift, shift)
    assert np.any(points_from_observations(found.attempt.observations, field).shift != 0.0)


CLICKS = {
    "size": (1280, 720),
    "circle": [[961, 412], [834, 466], [603, 474], [410, 400], [452, 362], [616, 330], [716, 328], [909, 357]],
    "lines": {"halfway_line": [[731, 262], [648, 501]], "side_line_top": [[538, 208], [955, 213], [1114, 214]]},
    "convention": "paint",
}
"""Points that somebody clicked in a picture whose centre mark is at (685, 391)."""


@pytest.mark.parametrize("place", [(52.5, 0.0), (300.0, 0.0), (0.0, -34.0), (-30.0, 60.0)])
def test_one_wrong_keypoint_among_clicks_is_left_out(place):
    """A lens that folds back would put any point of the field at any pixel, and a point far away passes at first."""
    right = circlecal.calibrate_points(**CLICKS)
    found = circlecal.calibrate_points(**CLICKS, keypoints={place: (685, 391)})
    assert [str(key) for key in found.attempt.camera.left_out] == [f"({place[0]:g}, {place[1]:g}) m"]
    assert np.linalg.norm(found.position_m - right.position_m) < 0.05
    assert found.sigma_px == pytest.approx(right.sigma_px, rel=0.01)


def test_a_line_under_a_wrong_name_that_the_last_fit_misses_is_left_out():
    """The far touchline under the name of a goal line, which bends the camera, and grows its own noise."""
    circle = [[727, 378], [187, 352], [754, 364], [200, 333], [247, 313], [199, 335], [612, 402], [346, 292],
              [435, 413], [748, 318], [298, 299], [686, 299]]  # fmt: skip
    halfway = [[459, 367], [555, 258], [508, 310], [482, 343], [547, 268]]
    touchline = [[1164, 182], [1039, 179], [841, 178], [395, 169], [937, 179], [1201, 182], [963, 179], [989, 178],
                 [280, 166], [819, 178], [969, 180], [1062, 182]]  # fmt: skip
    lines = {"halfway_line": halfway, "side_line_left": touchline}
    options = {"camera.crown_shape": "flat"}
    found = circlecal.calibrate_points(size=(1280, 720), circle=circle, lines=lines, sigma_px=1.0, set=options)
    assert [str(key) for key in found.attempt.camera.left_out] == ["side_line_left"]


def test_good_keypoints_stay_beside_a_wrong_one_that_bends_the_camera():
    given = {
        (0, 0): (551, 373), (0, 9.15): (605, 408), (0, -9.15): (507, 343), (9.15, 0): (742, 361),
        (-9.15, 0): (343, 382), (0, -34): (430, 288), (0, 34): (881, 593), (6.47, 6.47): (738, 387),
        (-6.47, -6.47): (385, 355), (6.47, -6.47): (647, 345), (36, -20.16): (724, 242),
    }  # fmt: skip
    options = {"camera.crown_shape": "flat"}
    found = circlecal.calibrate_points(size=(1280, 720), keypoints=given, sigma_px=1.0, set=options)
    assert found.ok and [str(key) for key in found.attempt.camera.left_out] == ["(36, -20.16) m"]


def test_residuals_of_keypoints_are_those_of_the_camera():
    rim = circlecal.calibrate_points(**CLICKS).to_image((9.15, 0.0)) + 1.0
    given = {(0.0, 0.0): (687, 391), (52.5, 0.0): (685, 391), (9.15, 0.0): rim}
    found = circlecal.calibrate_points(**CLICKS, keypoints=given)
    seen = {f"({x:g}, {y:g}) m": np.linalg.norm(found.to_image((x, y)) - pixel) for (x, y), pixel in given.items()}
    residuals = {str(key): px for key, px in found.attempt.camera.all_residuals_px.items() if str(key) in seen}
    assert len(residuals) == 2
    for name, px in residuals.items():
        assert px == pytest.approx(seen[name], abs=0.05)


def test_a_result_is_saved_in_a_folder_whatever_its_name(tmp_path):
    found = circlecal.calibrate_points(size=(960.0, 540.0), keypoints={"centre_mark": [480, 270]}, id="../evil")
    folder = tmp_path / "run.v2"
    folder.mkdir()
    saved = found.save(folder)
    assert saved.parent == folder and circlecal.load(saved) == found
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize(
    ("name", "where"),
    [
        ("runs/results.2024/", "runs/results.2024/good.json"),
        ("runs/results.2024", "runs/results.2024/good.json"),
        ("runs/x.json/", "runs/x.json/good.json"),
        ("runs/x.json", "runs/x.json"),
        ("runs/x.v2.JSON", "runs/x.v2.JSON"),
    ],
)
def test_what_does_not_exist_is_a_file_where_its_name_ends_in_json(good, tmp_path, name, where):
    saved = good.save(f"{tmp_path}/{name}")
    assert saved == tmp_path / where.replace("good", good.id) and circlecal.load(saved) == good


def test_sizes_of_a_result_count_for_a_field_of_ones_own(frame_image, tmp_path):
    own = tmp_path / "mine.yaml"
    own.write_bytes((field_folder() / "soccer.yaml").read_bytes())
    found = circlecal.calibrate(frame_image, field=own, set={"field.sizes.length": 100})
    found.save(tmp_path / "run")
    assert found.field.length_m == circlecal.load(tmp_path / "run" / f"{found.id}.json", own).field.length_m == 100
    (again,) = circlecal.load(tmp_path / "run", own)
    assert again.field.sizes == found.field.sizes


def test_a_result_of_a_field_of_ones_own_says_how_to_give_its_file(good, tmp_path):
    path = good.save(tmp_path / "stored.json")
    stored = json.loads(path.read_text())
    stored["field"]["template"] = "mine"
    path.write_text(json.dumps(stored))
    mine = tmp_path / "mine.yaml"
    mine.write_text((field_folder() / "soccer.yaml").read_text().replace("name: soccer", "name: mine"))
    with pytest.raises(ConfigError, match=r"'mine', a template of your own; give its file: circlecal\.load\(.*field="):
        _ = circlecal.load(path).field
    assert circlecal.load(path, field=mine).field.name == "mine"


def test_a_notebook_shows_a_result_of_a_field_of_ones_own_without_its_picture(frame_file, tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.write_text((field_folder() / "soccer.yaml").read_text().replace("name: soccer", "name: mine", 1))
    found = circlecal.calibrate(frame_file, field=mine)
    stored = circlecal.load(found.save(tmp_path / "stored.json"))
    assert "<img" in found._repr_html_()
    assert "<table" in stored._repr_html_() and "<img" not in stored._repr_html_()


def test_cameras_are_written_for_pictures_of_some_size(frame_image, tmp_path):
    with pytest.raises(InputError, match="size"):
        circlecal.calibrate(frame_image).export("soccernet", tmp_path, size=(0, 540))


@pytest.mark.parametrize("config", [None, *config_names()])
def test_points_go_with_every_configuration(config):
    """Points of a call come in no format of a file; whether they suffice is another question."""
    field = "soccer" if config is None else load_config(config).field.template
    halfway = load_field(field).halfway_line
    points = [[963, 412], [840, 466], [602, 475], [430, 432], [429, 373], [564, 335], [750, 329], [911, 357]]
    found = circlecal.calibrate_points(
        size=(1280, 720), circle=points, lines={halfway: [[749, 210], [607, 623]]}, config=config
    )
    assert found.ok or found.reason
    assert found.attempt.observations.circles


@pytest.mark.parametrize(("convention", "radius_m", "half_m"), [("official", 9.15, 34.0), ("paint", 9.09, 33.94)])
def test_keypoints_lie_where_the_convention_puts_them(frame_camera, convention, radius_m, half_m):
    names = {"centre_circle top": (0.0, -radius_m), "halfway_line x side_line_top": (0.0, -half_m)}
    found = circlecal.calibrate_points(
        size=(960, 540),
        keypoints={name: frame_camera.project(np.array(place)) for name, place in names.items()},
        convention=convention,
    )
    told = {point.name: point.field_m.tolist() for point in found.attempt.observations.keypoints}
    assert told == {name: pytest.approx(place) for name, place in names.items()}


@pytest.mark.parametrize(("convention", "radius_m"), [("official", 9.15), ("paint", 9.09)])
def test_a_result_from_points_keeps_its_convention(frame_camera, convention, radius_m, tmp_path):
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    rim = radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    made = circlecal.calibrate_points(
        size=(960, 540),
        circle=frame_camera.project(rim),
        lines={"halfway_line": frame_camera.project([[0.0, -12.0], [0.0, 12.0]])},
        keypoints={(0.0, 0.0): frame_camera.project([0.0, 0.0])},
        convention=convention,
        set={"verdict.max_sigma_px": 100},
    )
    kept = circlecal.load(made.save(tmp_path / "points.json"))
    assert kept.field.marking_width_m == pytest.approx(2 * (9.15 - radius_m), abs=1e-6)
    first, again = (each.export("labelme", tmp_path / name)[0] for each, name in ((made, "a"), (kept, "b")))
    assert first.read_text() == again.read_text()


def test_points_beside_a_picture(frame_image, frame_camera):
    wrong = frame_camera.project([0.0, -9.15]) + 40.0
    right = circlecal.calibrate(frame_image, points={"centre_circle top": frame_camera.project([0.0, -9.09])})
    assert right.ok
    assert "centre_circle top" in json.dumps(right.to_dict()["observations"])
    assert circlecal.calibrate(frame_image, points={"centre_circle top": wrong}) != right


# --- videos and runs


@pytest.fixture(scope="module")
def video(frame_image, tmp_path_factory):
    """A video of two seconds that shows the frame."""
    path = tmp_path_factory.mktemp("video") / "match.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 5.0, (960, 540))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no MJPG")
    for _ in range(10):
        writer.write(frame_image)
    writer.release()
    return path


def test_a_video_frame_by_frame(video):
    frames = circlecal.calibrate_video(video, every="1s")
    first = next(frames)
    assert (first.time_s, first.ok) == (0.0, True)
    assert first.image.shape == (540, 960, 3)
    second = next(frames)
    assert second.time_s == pytest.approx(1.0)
    assert second.id.startswith("match_")
    assert next(frames, None) is None
    assert second.image.shape == (540, 960, 3), "decoded again"


def test_wrong_videos_are_told_at_once(tmp_path, video):
    with pytest.raises(InputError, match="no such file"):
        circlecal.calibrate_video(tmp_path / "none.mp4")
    with pytest.raises(InputError, match="every"):
        circlecal.calibrate_video(video, every="often")


@pytest.fixture(scope="module")
def run_folder(frame_image, module_in_this_process, tmp_path_factory):
    """A run over one good and one blank frame."""
    from circlecal.cli import main

    folder = tmp_path_factory.mktemp("run")
    cv2.imwrite(str(folder / "good.png"), frame_image)
    cv2.imwrite(str(folder / "blank.png"), np.full((120, 160, 3), (60, 130, 70), np.uint8))
    (folder / "broken.png").write_bytes(b"")
    with pytest.raises(SystemExit):
        main(["batch", str(folder), "--out", str(folder / "out"), "--workers", "1", "--quiet"])
    return folder / "out"


def test_a_run_is_a_lazy_sequence(run_folder):
    run = circlecal.load(run_folder)
    assert len(run) == 3
    assert {c.id for c in run} == {"good", "blank", "broken"}
    assert run["good"].ok and run[-1] == list(run)[-1]
    assert [c.id for c in run[:2]] == [run[0].id, run[1].id]
    assert "good" in run and "moon" not in run
    assert run["good"].overlay().shape == (540, 960, 3)
    assert list(run) == list(circlecal.load(run_folder / "results.jsonl"))
    assert "3 frames" in repr(run)
    with pytest.raises(IndexError):
        run[3]
    with pytest.raises(KeyError):
        run["moon"]


def test_unreadable_frames_of_a_run_answer_too(run_folder):
    broken = circlecal.load(run_folder)["broken"]
    assert (broken.ok, broken.size, broken.view) == (False, None, None)
    assert np.isnan(broken.to_field([1.0, 2.0])).all()
    assert broken.help and broken.reason in broken._repr_html_()
    with pytest.raises(InputError):
        broken.overlay()


def test_a_run_as_a_table(run_folder):
    rows = {row["id"]: row for row in circlecal.load(run_folder).table()}
    assert rows["good"]["max_sigma_px"] > 0
    assert rows["blank"]["status"] == "refused"


@pytest.mark.parametrize("name", ["none.json", "none.jsonl", "folder", "others"])
def test_nothing_to_load(tmp_path, name):
    (tmp_path / "folder").mkdir()
    (tmp_path / "others").mkdir()
    (tmp_path / "others" / "x.json").write_text("{}")
    with pytest.raises(InputError, match="give"):
        circlecal.load(tmp_path / name)


def test_types_are_those_of_what_users_write():
    """A list of lists of which some hold whole numbers is one of objects, and a loop over a run needs no cast."""
    taken = {
        circlecal.Calibration.to_field: "points_px",
        circlecal.Calibration.to_image: "points_m",
        circlecal.calibrate_points: "circle",
    }
    for call, name in taken.items():
        assert Sequence[object] in get_args(get_type_hints(call)[name])
    assert get_type_hints(circlecal.load)["return"] == circlecal.Calibration | circlecal.Run


def test_a_damaged_result(tmp_path):
    (tmp_path / "x.json").write_text("{}")
    with pytest.raises(InputError, match=r"x\.json"):
        circlecal.load(tmp_path / "x.json")


@pytest.mark.parametrize("content", [b"\xff\xd8\xff\xe0", b'{"shapes": []}', b""])
def test_a_result_replaces_nothing_but_a_result(content, good, tmp_path):
    file = tmp_path / "frame.jpg"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"frame\.jpg: exists and is no result of circlecal; choose another name"):
        good.save(file)
    assert file.read_bytes() == content
    assert good.save(tmp_path) == good.save(tmp_path)


def test_a_homography_without_a_camera_is_ok_and_has_none_of_its_values(frame_image):
    found = circlecal.calibrate(frame_image, set={"camera.enabled": False})
    assert found.ok and found.H_image_field is not None
    values = ("camera", "K", "R", "t", "dist", "position_m", "sigma_px", "sigma_m")
    assert [name for name in values if getattr(found, name) is not None] == []
    assert isinstance(found.to_field([480, 270], sigma=True), circlecal.SurePoints)


def test_every_public_name_is_there():
    assert [name for name in circlecal.__all__ if not hasattr(circlecal, name)] == []
    assert issubclass(circlecal.MissingExtraError, circlecal.CirclecalError)


def test_coordinates_in_two_lists_are_no_points(good):
    """The second list was taken for the wish for standard deviations."""
    for convert in (good.to_field, good.to_image):
        with pytest.raises(TypeError, match="positional"):
            convert([640.0, 685.0], [360.0, 391.0])
