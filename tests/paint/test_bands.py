"""Where the middle and the edges of a thin band are, from its profile; and which bands are a marking."""

import ast
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from scipy.special import erf, ndtr

import circlecal
from circlecal.paint.bands import (
    SIGMA_FLOOR_PX,
    Bands,
    MeasuredCurve,
    local_width,
    measure_bands,
    measure_curve,
    rise_above_noise,
    stand_out,
)
from circlecal.paint.profiles import sample_profiles, to_gray

OFFSETS = np.arange(-14.0, 14.25, 0.5)


def band(center, width, blur, contrast=100.0, background=80.0, tilt=0.0, offsets=OFFSETS):
    """Exact profile (S,) of a band of some width, as a pixel with Gaussian blur sees it."""
    spread = np.sqrt(2) * blur
    inside = 0.5 * (erf((offsets - center + width / 2) / spread) - erf((offsets - center - width / 2) / spread))
    return background + tilt * offsets + contrast * inside


def picture_of(center_y, width, blur, noise=0.0, seed=0, size=(200, 60)):
    """Picture (H, W) float32 of a horizontal band about ``y = center_y``."""
    columns, rows = size
    profile = band(center_y, width, blur, offsets=np.arange(rows, dtype=float))
    picture = np.repeat(profile[:, None], columns, axis=1)
    return (picture + np.random.default_rng(seed).normal(0, noise, picture.shape)).astype(np.float32)


def across(picture, y, count=100):
    """Profiles down through the band about row ``y``."""
    points = np.stack([np.linspace(40.0, 160.0, count), np.full(count, y)], axis=-1)
    return sample_profiles(picture, points, np.broadcast_to([0.0, 1.0], points.shape), OFFSETS)


@pytest.mark.parametrize("width", [0.8, 1.5, 3.0, 6.0])
@pytest.mark.parametrize("blur", [0.8, 1.3, 2.0])
def test_middle_of_a_band_is_unbiased(width, blur):
    shifts = np.linspace(-1.9, 2.05, 80)
    bands = measure_bands(np.array([band(s, width, blur) for s in shifts]), OFFSETS, 6.0)
    assert rise_above_noise(bands, 1.0).all()
    error = bands.center - shifts
    # the samples leave a ripple of the period of their spacing
    assert np.abs(error).max() < 0.03
    assert np.abs(error[:40].mean()) < 0.003
    assert np.sqrt(np.mean(error**2)) < 0.02
    np.testing.assert_allclose(0.5 * (bands.left + bands.right), shifts, atol=0.05)


def test_middle_is_unbiased_through_a_picture():
    shifts = np.linspace(-0.45, 0.55, 21)
    measured = [measure_bands(across(picture_of(30.0 + s, 3.0, 1.0, 0.0), 30.0), OFFSETS, 6.0) for s in shifts]
    error = np.array([bands.center.mean() for bands in measured]) - shifts
    assert np.abs(error).max() < 0.03
    assert abs(error.mean()) < 0.005


@pytest.mark.parametrize("tilt", [-1.0, 1.0])
def test_a_sloping_background_hardly_pulls(tilt):
    bands = measure_bands(band(0.3, 3.0, 1.0, tilt=tilt)[None], OFFSETS, 6.0)
    assert rise_above_noise(bands, 1.0).all()
    assert abs(bands.center[0] - 0.3) < 0.05
    assert np.sign(bands.step[0]) == tilt


def test_width_and_contrast():
    bands = measure_bands(band(0.0, 6.0, 0.7)[None], OFFSETS, 6.0)
    assert bands.width[0] == pytest.approx(6.0, abs=0.1)
    assert bands.contrast[0] == pytest.approx(100.0, rel=0.02)
    assert -bands.left[0] == pytest.approx(bands.right[0], abs=1e-6)


@pytest.mark.parametrize(
    ("width", "blur", "noise"), [(2.0, 1.0, 8.0), (4.0, 1.0, 10.0), (1.0, 1.5, 5.0), (6.0, 2.0, 8.0)]
)
def test_predicted_sigma_is_the_scatter(width, blur, noise):
    picture = picture_of(30.2, width, blur, noise, size=(4000, 60))
    points = np.stack([np.arange(30.0, 3970.0, 3.0), np.full(1314, 30.0)], axis=-1)
    profiles = sample_profiles(picture, points, np.broadcast_to([0.0, 1.0], points.shape), OFFSETS)
    bands = measure_bands(profiles, OFFSETS, 6.0)
    found = rise_above_noise(bands, noise)
    assert found.mean() > 0.95
    scatter, sigma = bands.center[found].std(), np.median(bands.sigma(noise)[found])
    assert 1 / 1.5 < scatter / sigma < 1.5, (scatter, sigma)


def test_sigma_has_a_floor():
    bands = measure_bands(band(0.0, 3.0, 1.0, contrast=150.0)[None], OFFSETS, 6.0)
    assert bands.sigma(1e-3)[0] == pytest.approx(SIGMA_FLOOR_PX, rel=0.01)


def test_what_is_no_band_is_not_valid():
    flat = np.full(len(OFFSETS), 80.0)
    step = 80.0 + 100.0 * (OFFSETS > 0)
    missing = band(0.0, 3.0, 1.0)
    missing[3] = np.nan
    faint = band(0.0, 3.0, 1.0, contrast=2.0)
    dark = band(0.0, 3.0, 1.0, contrast=-100.0)
    wide = band(0.0, 60.0, 1.0)
    good = band(0.0, 3.0, 1.0)
    found = measure_bands(np.array([flat, step, missing, faint, dark, wide, good]), OFFSETS, 6.0)
    assert rise_above_noise(found, 1.0).tolist() == [False] * 6 + [True]


def test_the_search_is_limited_and_takes_the_band_near_the_middle():
    two = band(0.5, 2.0, 0.8) + band(9.0, 2.0, 0.8, contrast=140.0, background=0.0)
    near = measure_bands(two[None], OFFSETS, 4.0)
    assert near.center[0] == pytest.approx(0.5, abs=0.1)
    far = measure_bands(band(8.0, 2.0, 0.8)[None], OFFSETS, 4.0)
    assert not rise_above_noise(far, 1.0)[0] or abs(far.center[0]) <= 5.0


def test_a_search_narrower_than_the_samples_looks_at_the_nearest_one():
    """On a small picture the search is a fraction of a pixel, and no sample need lie within it."""
    offsets = np.arange(-13.7, 13.9, 1.0)
    bands = measure_bands(band(0.3, 3.0, 1.0, offsets=offsets)[None], offsets, 0.2)
    assert rise_above_noise(bands, 1.0).all() and bands.center[0] == pytest.approx(0.3, abs=0.1)


def test_paint_stands_out_above_a_strip_of_light_ground():
    """The strip's rim is lighter than one side only; the paint on it is lighter than both."""
    offsets = np.arange(-12.0, 12.25, 0.5)
    ground = np.where((offsets > -1.5) & (offsets < 7.0), 100.0, 70.0)
    paint = 30.0 * np.exp(-0.5 * offsets**2)
    standing = stand_out((ground + paint)[None].astype(np.float32), offsets, (3.0, 5.0))[0]
    assert offsets[np.argmax(standing)] == pytest.approx(0.0, abs=0.5)
    assert standing[np.abs(offsets) > 3.0].max() < 0.5 * standing.max()
    gap = ground.copy()
    gap[3] = np.nan
    assert np.isnan(stand_out(gap[None].astype(np.float32), offsets, (3.0, 5.0))[0, 3])


def test_dark_markings_are_light_ones_of_the_negative():
    image = np.full((20, 30, 3), 200, np.uint8)
    image[8:11] = 40
    dark = ~to_gray(image)
    np.testing.assert_array_equal(dark, to_gray(~image))
    assert dark[9, 5] > dark[2, 5]
    points = np.array([[15.0, 9.0]])
    offsets = np.arange(-8.0, 8.25, 0.5)
    found = measure_bands(sample_profiles(dark, points, np.array([[0.0, 1.0]]), offsets), offsets, 3.0)
    assert rise_above_noise(found, 1.0)[0]
    assert found.center[0] == pytest.approx(0.0, abs=0.02)


ROW = 60.3


def level_band(width_px: float, contrast: float = 50.0, noise: float = 1.0) -> np.ndarray:
    """A level band whose middle is at y = ROW: (120, 400) uint8."""
    d = np.arange(120)[:, None] - ROW
    band = ndtr((d + width_px / 2) / 0.8) - ndtr((d - width_px / 2) / 0.8)
    values = 90 + contrast * np.repeat(band, 400, axis=1)
    return np.clip(values + np.random.default_rng(0).normal(0, noise, values.shape), 0, 255).astype(np.uint8)


def measured(gray: np.ndarray, row: float, sign: float = 1.0, reach: float = 8.0) -> MeasuredCurve:
    x = np.arange(10.0, 390.0, 3.0)
    points = np.stack([x, np.full_like(x, row)], axis=-1)
    normals = np.tile([0.0, 1.0], (len(x), 1))
    pieces = np.zeros(len(x), np.int64)
    return measure_curve(gray, points, normals, np.full(len(x), reach), pieces, sign)


@pytest.mark.parametrize("shift", [-2.0, 0.0, 1.6])
def test_offset_is_the_distance_to_the_middle(shift: float) -> None:
    curve = measured(level_band(3.0), ROW + shift)
    assert curve.supported.mean() > 0.97
    assert abs(np.mean(curve.offset[curve.supported]) + shift) < 0.06


@pytest.mark.parametrize("width_px", [3.0, 5.0, 8.0])
def test_width_and_contrast_along_a_curve(width_px: float) -> None:
    curve = measured(level_band(width_px), ROW, reach=12.0)
    assert abs(np.median(local_width(curve)) - width_px) < 0.9
    assert abs(np.median(curve.contrast) - 50.0) < 8.0


def test_wrong_polarity_has_no_support() -> None:
    assert measured(level_band(3.0), ROW, sign=-1.0).supported.mean() < 0.1


def test_plain_noise_has_no_support() -> None:
    assert measured(level_band(3.0, contrast=0.0, noise=6.0), ROW).supported.mean() < 0.1


def test_a_hidden_part_is_not_supported() -> None:
    gray = level_band(3.0)
    gray[40:80, 150:210] = 230
    curve = measured(gray, ROW)
    x = np.arange(10.0, 390.0, 3.0)
    hidden = (x > 154) & (x < 206)
    assert not curve.supported[hidden].any()
    assert curve.supported[(x < 140) | (x > 220)].mean() > 0.95


def test_samples_outside_the_picture_are_not_inside() -> None:
    curve = measured(level_band(3.0), -5.0)
    assert not curve.inside.any()
    assert not curve.supported.any()


def test_both_gates_read_the_same_band_off_a_profile():
    picture = picture_of(30.3, 3.0, 1.0, noise=2.0, seed=3, size=(400, 60))
    # the samples leave a ripple of the period of their spacing, which even shifts average out
    points = np.stack([np.linspace(40.0, 360.0, 160), np.linspace(29.0, 31.0, 160)], axis=-1)
    normals = np.tile([0.0, 1.0], (160, 1))
    bands = measure_bands(sample_profiles(picture, points, normals, OFFSETS), OFFSETS, 6.0)
    curve = measure_curve(picture, points, normals, np.full(160, 14.0), np.zeros(160, np.int64))
    assert rise_above_noise(bands, 2.0).all() and curve.supported.all()
    assert abs(np.mean(bands.center - curve.offset)) < 0.01
    assert abs(np.mean(bands.width - curve.width)) < 0.05
    assert np.mean(bands.contrast) == pytest.approx(np.mean(curve.contrast), rel=0.03)


def test_there_is_one_instrument():
    """One function reads bands off profiles; nothing else makes what it returns, or measures contrast and width."""
    wrong = []
    names = {field.name for field in fields(Bands)}
    for file in sorted(Path(circlecal.__file__).parent.rglob("*.py")):
        own = file.name == "bands.py" and file.parent.name == "paint"
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and node.name.startswith("measure_bands") and not own:
                wrong.append(f"{file}:{node.lineno} defines {node.name}")
            if (
                isinstance(node, ast.Call)
                and ast.unparse(node.func).split(".")[-1] in {"Bands", "MeasuredCurve"}
                and not own
            ):
                wrong.append(f"{file}:{node.lineno} makes {ast.unparse(node.func)}")
            if isinstance(node, ast.ClassDef) and not own:
                declared = {ast.unparse(item.target) for item in node.body if isinstance(item, ast.AnnAssign)}
                if {"contrast", "width"} <= declared or {"center", "left", "right"} <= declared or declared >= names:
                    wrong.append(f"{file}:{node.lineno} {node.name} holds measured bands")
    assert not wrong, "\n".join(wrong)
