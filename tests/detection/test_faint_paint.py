"""Paint that shows in sums only."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.detection import DetectorConfig, detect
from circlecal.detection.circle import TENTATIVE_PAINTED_SHARE, TENTATIVE_SHARE, CircleHypothesis, may_be_faint
from circlecal.detection.options import AcceptanceConfig
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.ellipses import Ellipse, ellipse_from_conic
from circlecal.paint.matched_filter import SECTORS, measure_painted_share
from circlecal.refusals import Confidence

from .conftest import HALFWAY_AND_CIRCLE, RADIUS_M, Scene, paint_scene, ring

FAINT = {"contrast": 8.0, "noise": 6.0}


def true_ellipse(scene: Scene, shift: float = 0.0) -> Ellipse:
    ellipse = ellipse_from_conic(scene.conic)
    assert ellipse is not None
    return replace(ellipse, center=ellipse.center + np.array([0.0, shift]))


def gray(scene: Scene) -> np.ndarray:
    return scene.image.mean(axis=-1).astype(np.uint8)


def test_faint_paint_stands_out_in_the_sectors_that_it_fills() -> None:
    whole = paint_scene(**FAINT)
    share, sectors = measure_painted_share(gray(whole), true_ellipse(whole), 1.0)
    assert sectors == SECTORS
    assert share > 0.8
    half = paint_scene(markings=(ring(0.0, RADIUS_M, 0.0),), **FAINT)
    assert measure_painted_share(gray(half), true_ellipse(half), 1.0)[0] == pytest.approx(0.5, abs=0.12)
    assert measure_painted_share(gray(whole), true_ellipse(whole), -1.0)[0] < 0.1
    assert measure_painted_share(gray(whole), true_ellipse(whole, 12.0), 1.0)[0] < 0.2


def test_an_ellipse_outside_the_picture_has_no_sectors() -> None:
    scene = paint_scene()
    assert measure_painted_share(gray(scene), true_ellipse(scene, 5000.0), 1.0) == (0.0, 0)


def test_a_circle_too_faint_for_single_places_is_tentative_with_its_line() -> None:
    scene = paint_scene(**FAINT)
    found = detect(scene.image, DetectorConfig(), np.random.default_rng(0))
    assert found.circle is not None
    assert np.abs(sampson_distance(found.circle.conic, scene.circle_points())).mean() < 1.0
    assert found.circle.least_share < TENTATIVE_SHARE
    assert found.circle.painted_share > TENTATIVE_PAINTED_SHARE
    assert found.confidence is Confidence.TENTATIVE
    without = paint_scene(markings=HALFWAY_AND_CIRCLE[:1], **FAINT)
    assert detect(without.image, DetectorConfig(), np.random.default_rng(0)).circle is None


@pytest.mark.parametrize(("share", "is_worth_a_look"), [(0.2, False), (0.4, True), (0.6, False)])
def test_faint_paint_is_looked_for_where_single_places_show_some_but_too_little(share, is_worth_a_look) -> None:
    conic = paint_scene().conic
    circle = CircleHypothesis(conic, 1.0, share, share, share, share, 0.5, np.zeros((0, 2)))
    assert may_be_faint(circle, 1280, AcceptanceConfig()) is is_worth_a_look
    assert not may_be_faint(replace(circle, rms_px=9.0), 1280, AcceptanceConfig())
