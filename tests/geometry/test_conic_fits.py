"""Fits of conics: the closed forms, the minimal solver and the geometric refinement."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2
from skimage.measure import EllipseModel

from circlecal.geometry import conic_fits, conics
from circlecal.geometry.ellipses import Ellipse, conic_from_ellipse, ellipse_from_conic, orthogonal_distance
from circlecal.geometry.projective import similarity_normalisation

SHORT = Ellipse(np.array([900.0, 500.0]), (600.0, 160.0), 0.1)


@st.composite
def ellipses(draw):
    major = draw(st.floats(50.0, 2000.0))
    center = np.array([draw(st.floats(-500.0, 4000.0)), draw(st.floats(-500.0, 2500.0))])
    return Ellipse(center, (major, major * draw(st.floats(0.08, 1.0))), draw(st.floats(0.0, np.pi)))


def _noisy(ellipse, rng, t, sigma):
    return ellipse.points(t) + rng.normal(0, sigma, (len(t), 1)) * ellipse.normals(t)


def _largest_departure(conic, ellipse):
    return np.abs(conics.sampson_distance(conic, ellipse.points(np.linspace(0, 2 * np.pi, 200)))).max()


@pytest.mark.parametrize("method", conic_fits.FIT_METHODS)
@given(ellipse=ellipses(), start=st.floats(0, 6), span=st.floats(2.0, 6.28))
def test_closed_forms_are_exact_on_clean_points(method, ellipse, start, span):
    conic = conic_fits.fit_conic(ellipse.points(np.linspace(start, start + span, 40)), method)
    found = ellipse_from_conic(conic)
    np.testing.assert_allclose(found.center, ellipse.center, atol=1e-4 * ellipse.semi_axes[0])
    np.testing.assert_allclose(found.semi_axes, ellipse.semi_axes, rtol=1e-3)
    assert np.linalg.det(conic) == pytest.approx(-1.0)


@pytest.mark.parametrize("method", conic_fits.FIT_METHODS)
def test_fits_do_not_depend_on_the_position_and_scale_of_the_points(method):
    rng = np.random.default_rng(1)
    points = _noisy(SHORT, rng, rng.uniform(0, 4, 300), 1.0)
    shift, scale = np.array([5000.0, -300.0]), 0.01
    first = ellipse_from_conic(conic_fits.fit_conic(points, method))
    second = ellipse_from_conic(conic_fits.fit_conic(scale * (points + shift), method))
    np.testing.assert_allclose(second.center / scale - shift, first.center, atol=1e-6)
    np.testing.assert_allclose(np.array(second.semi_axes) / scale, first.semi_axes, atol=1e-6)


def test_direct_fit_against_opencv_and_scikit_image():
    rng = np.random.default_rng(2)
    points = _noisy(SHORT, rng, rng.uniform(0, 2 * np.pi, 500), 1.0)
    ours = ellipse_from_conic(conic_fits.fit_conic(points, "direct"))
    center, full_axes, _ = cv2.fitEllipseDirect(points.astype(np.float32))
    np.testing.assert_allclose(ours.center, center, atol=0.1)
    np.testing.assert_allclose(ours.semi_axes, np.sort(full_axes)[::-1] / 2, atol=0.1)
    peer = EllipseModel.from_estimate(points)
    np.testing.assert_allclose(ours.center, peer.center, atol=0.05)
    np.testing.assert_allclose(ours.semi_axes, np.sort(peer.axis_lengths)[::-1], atol=0.05)


def test_taubin_is_less_biased_than_the_direct_fit_on_a_quarter_arc():
    rng = np.random.default_rng(3)
    major = {"direct": [], "taubin": []}
    for _ in range(60):
        points = _noisy(SHORT, rng, rng.uniform(0.3, 0.3 + np.pi / 2, 200), 1.0)
        for method, found in major.items():
            ellipse = ellipse_from_conic(conic_fits.fit_conic(points, method))
            if ellipse is not None:
                found.append(ellipse.semi_axes[0])
    direct, taubin = (abs(np.median(major[m]) - SHORT.semi_axes[0]) for m in ("direct", "taubin"))
    assert len(major["direct"]) == 60  # always an ellipse
    assert direct > 20.0
    assert taubin < 0.6 * direct


@pytest.mark.parametrize("method", conic_fits.FIT_METHODS)
def test_weights_take_points_out_and_batched_fits_agree(method):
    rng = np.random.default_rng(4)
    points = _noisy(SHORT, rng, rng.uniform(0, 2 * np.pi, 80), 0.5)
    points[:20] += 300.0
    weights = np.r_[np.zeros(20), np.ones(60)]
    T = similarity_normalisation(points)
    local = points * T[0, 0] + T[:2, 2]
    batch = conic_fits.fit_conics(local, np.stack([weights, np.ones(80)]), method)
    taken_out, whole = (conic_fits.fit_conic(own, method) for own in (local[20:], local))
    # plain least squares depends a little on the coordinates that it is done in, the others do not
    tolerance = 0.5 * T[0, 0] if method == "algebraic" else 1e-6
    for conic, alone in zip(batch, (taken_out, whole), strict=True):
        single = ellipse_from_conic(alone)
        if single is not None:
            assert _largest_departure(conic, single) < tolerance


@pytest.mark.parametrize("method", conic_fits.FIT_METHODS)
@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 2)),
        SHORT.points(np.arange(4.0)),
        np.repeat(SHORT.points(np.arange(4.0)), 10, axis=0),
        np.full((30, 2), 5.0),
        np.where(np.arange(60).reshape(30, 2) == 7, np.nan, 1.0),
    ],
)
def test_points_that_determine_no_conic_give_none(method, points):
    assert conic_fits.fit_conic(points, method) is None


@pytest.mark.parametrize("method", conic_fits.FIT_METHODS)
@pytest.mark.parametrize("slope", [0.0, 0.3, 1.0, 5.0])
def test_collinear_points_give_none(method, slope):
    x = np.linspace(0, 1000, 30)
    assert conic_fits.fit_conic(np.column_stack([x, slope * x + 7]), method) is None


def test_unknown_method_is_refused():
    with pytest.raises(ValueError, match="method"):
        conic_fits.fit_conic(SHORT.points(np.arange(9.0)), "magic")


@pytest.mark.parametrize("degrees", [15, 30, 60])
def test_short_clean_arcs_are_still_fitted(degrees):
    points = SHORT.points(np.radians(np.linspace(80, 80 + degrees, 60)))
    found = ellipse_from_conic(conic_fits.fit_conic(points, "taubin"))
    np.testing.assert_allclose(found.semi_axes, SHORT.semi_axes, rtol=0.02)


def test_minimal_solver_is_exact_and_batched():
    rng = np.random.default_rng(7)
    unit = Ellipse(np.array([0.2, -0.1]), (1.3, 0.5), 0.4)
    # five points that are well apart: near-degenerate samples are the business of the score
    t = np.arange(5) * 2 * np.pi / 5 + rng.uniform(-0.3, 0.3, (3, 50, 5))
    batch = conic_fits.conics_through_points(unit.points(t))
    assert batch.shape == (3, 50, 3, 3)
    assert conics.is_ellipse(batch).all()
    expected = conic_from_ellipse(unit)
    np.testing.assert_allclose(conics.normalise_conic(batch), np.broadcast_to(expected, batch.shape), atol=1e-8)


def test_degenerate_minimal_samples_do_not_stop_the_others():
    good = Ellipse(np.zeros(2), (1.0, 0.6), 0.0).points(np.arange(5.0))
    repeated = good[[0, 1, 2, 3, 3]]
    same = good[[0, 0, 0, 0, 0]]
    on_a_line = np.column_stack([np.arange(5.0), np.arange(5.0)])
    on_an_axis = np.column_stack([np.arange(5.0), np.zeros(5)])
    four_on_a_line = np.vstack([on_a_line[:4], [[0.0, 3.0]]])
    batch = conic_fits.conics_through_points(np.stack([repeated, good, same, on_a_line, on_an_axis, four_on_a_line]))
    assert np.isnan(batch[[0, 2]]).all()
    assert conics.is_ellipse(batch)[1]
    assert not conics.is_ellipse(batch[[0, 2]]).any()
    alone = conic_fits.conics_through_points(good)
    np.testing.assert_allclose(conics.normalise_conic(batch[1]), conics.normalise_conic(alone))


@given(ellipse=ellipses(), seed=st.integers(0, 99))
def test_refinement_never_costs_more_than_its_start(ellipse, seed):
    rng = np.random.default_rng(seed)
    sigma = 0.002 * ellipse.semi_axes[1]
    points = _noisy(ellipse, rng, rng.uniform(0, 4.5, 120), sigma)
    start = conic_fits.fit_conic(points, "direct")
    conic, _ = conic_fits.refine_conic(points, start, sigma)
    before, after = (np.sum(orthogonal_distance(ellipse_from_conic(c), points) ** 2) for c in (start, conic))
    assert after <= before * (1 + 1e-9)


def test_refinement_improves_a_short_arc():
    rng = np.random.default_rng(8)
    errors = []
    for _ in range(25):
        points = _noisy(SHORT, rng, rng.uniform(0.3, 2.1, 200), 0.5)
        start = conic_fits.fit_conic(points, "direct")
        conic, _ = conic_fits.refine_conic(points, start, 0.5)
        errors.append([_largest_departure(c, SHORT) for c in (start, conic)])
    before, after = np.median(errors, axis=0)
    assert after < 0.7 * before


@pytest.mark.parametrize(("span", "sigma"), [(2 * np.pi, 0.5), (3.5, 0.3)])
def test_covariance_of_the_refinement_is_calibrated(span, sigma):
    rng = np.random.default_rng(9)
    true = conics.coefficients_from_conic(conic_from_ellipse(SHORT))
    draws, statistic = 150, []
    sigmas = sigma * rng.uniform(0.5, 2.0, 150)
    for _ in range(draws):
        t = rng.uniform(0, span, 150)
        points = SHORT.points(t) + (rng.normal(size=150) * sigmas)[:, None] * SHORT.normals(t)
        conic, covariance = conic_fits.refine_conic(points, conic_from_ellipse(SHORT), sigmas)
        difference = conics.coefficients_from_conic(conic) - true
        # five of the six coefficients are free: the scale is fixed by the determinant
        values, vectors = np.linalg.eigh(covariance / np.outer(*[np.sqrt(np.diag(covariance))] * 2))
        scaled = vectors[:, 1:].T @ (difference / np.sqrt(np.diag(covariance)))
        statistic.append(np.sum(scaled**2 / values[1:]))
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 5 * draws)
    assert low < np.sum(statistic) < high


def test_refinement_of_a_hyperbola_is_none():
    points = SHORT.points(np.arange(20.0))
    assert conic_fits.refine_conic(points, np.diag([1.0, -1.0, -1.0])) is None


def test_no_conic_is_refined_by_too_few_points():
    assert conic_fits.refine_conic(SHORT.points(np.arange(4.0)), conic_from_ellipse(SHORT), 0.3) is None
