"""Straight markings alone: the same ones are not tried twice."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from circlecal.observations import CirclePoints, Observations
from circlecal.pipeline import field_lines, other_circles
from circlecal.pipeline.setting import Looks
from circlecal.results import Attempt, Check, MarkingMask, Segment, Verdict


def see_lines(shift=0.0):
    """Four straight markings, seen in one more look at the picture."""
    ends = np.array([[[0.0, 0.0], [9.0, 1.0]], [[0, 5], [9, 6]], [[1, 0], [1, 9]], [[7, 0], [8, 9]]]) + shift
    lines = tuple(Segment(start, end) for start, end in ends)
    return MarkingMask(np.zeros((10, 10), np.uint8), "detector", lines=lines, field_region=np.ones((5, 5), bool))


@pytest.fixture
def tries(monkeypatch):
    """What was tried, each of which leads to an attempt of its own."""
    tried = []

    def try_namings(setting, scene, mask):
        tried.append(mask)
        yield Attempt(mask=mask)

    monkeypatch.setattr(field_lines, "_try_namings", try_namings)
    return tried


def test_lines_that_were_tried_are_not_tried_again(tries):
    setting, scene = SimpleNamespace(), SimpleNamespace(looks=Looks(), image=np.zeros((9, 9, 3), np.uint8))
    first = field_lines.calibrate_by_lines(setting, scene, see_lines())
    assert field_lines.calibrate_by_lines(setting, scene, see_lines()) is first
    again = see_lines()
    (taken,) = field_lines.take_field_lines(setting, scene, Attempt(mask=again))
    assert taken.mask is again
    assert len(tries) == 1


def test_other_lines_and_other_fields_are_tried(tries):
    setting, scene = SimpleNamespace(), SimpleNamespace(looks=Looks(), image=np.zeros((9, 9, 3), np.uint8))
    for tried in ((setting, see_lines()), (setting, see_lines(0.5)), (SimpleNamespace(), see_lines(0.5))):
        field_lines.calibrate_by_lines(tried[0], scene, tried[1])
    assert len(tries) == 3


CAMERA, ROUGH = SimpleNamespace(residuals_px={}), np.ones(17)


def fit_naming(monkeypatch, answers, arcs):
    """What is fitted, as names of arcs and whether it is a draft, where the fits lead to some attempts."""
    fits, answers = [], iter(answers)

    def calibrate(setting, scene, mask, observations, earlier=None, *, is_draft=False):
        assert not is_draft or earlier.theta is ROUGH
        fits.append(([seen.circle for seen in observations.circles], is_draft))
        return next(answers)

    found = {name: CirclePoints(name, "center", np.zeros((3, 2)), np.ones(3)) for name in arcs}
    monkeypatch.setattr(field_lines, "_calibrate_field_lines", calibrate)
    monkeypatch.setattr(field_lines, "measure_curves", lambda *_: found)
    setting = SimpleNamespace(template=SimpleNamespace(arcs=()), circle=SimpleNamespace(name="centre_circle"))
    scene = SimpleNamespace(covered=None)
    attempts = field_lines._fit_naming(
        setting, scene, see_lines(), np.zeros((9, 9), np.uint8), Observations(9, 9), ROUGH, 1.0
    )
    return list(attempts), fits


def answer(code, *checks):
    return Attempt(camera=CAMERA, verdict=Verdict("refused" if code else "calibrated", code, None, "verdict", checks))


def test_names_that_fail_by_far_are_not_fitted_in_earnest(monkeypatch):
    far = answer("too_uncertain", Check.of("sigma_px", 250.0, 64.0))
    attempts, fits = fit_naming(monkeypatch, [far], ["penalty_arc_left"])
    assert attempts == []
    assert fits == [([], True)]


def test_arcs_are_measured_along_a_draft_and_left_out_where_they_do_not_calibrate(monkeypatch):
    near = answer("too_uncertain", Check.of("sigma_px", 80.0, 64.0))
    right = answer(None)
    attempts, fits = fit_naming(monkeypatch, [near, right], ["penalty_arc_left"])
    assert attempts == [right]
    assert fits == [([], True), (["penalty_arc_left"], False)]
    attempts, fits = fit_naming(monkeypatch, [near, near, right], ["penalty_arc_left"])
    assert attempts == [right]
    assert fits[1:] == [(["penalty_arc_left"], False), ([], False)]
    off = answer("residual_too_large")
    attempts, fits = fit_naming(monkeypatch, [near, off, right], [])
    assert attempts == [right]
    assert len(fits) == 3


def test_the_circle_is_measured_along_a_draft_where_lines_and_arcs_are_too_few(monkeypatch):
    near, few, right = answer("too_uncertain"), answer(None), answer(None)
    attempts, fits = fit_naming(monkeypatch, [near, few, right], ["centre_circle", "penalty_arc_left"])
    assert attempts == [few, right]
    assert fits[1:] == [(["penalty_arc_left"], False), (["centre_circle", "penalty_arc_left"], False)]


def test_a_camera_that_misses_a_circle_in_plain_view_is_no_answer(monkeypatch):
    calibrated = Verdict("calibrated", None, None, None)
    attempts = iter(
        Attempt(camera=SimpleNamespace(name=name), observations=Observations(9, 9), verdict=calibrated)
        for name in ("missing", "right")
    )
    setting = SimpleNamespace(
        template=None,
        circle=None,
        config=SimpleNamespace(
            correspondences=SimpleNamespace(camera_side="main"), cues=SimpleNamespace(search_px=9.0, spacing_px=2.0)
        ),
        clock=lambda stage: nullcontext(),
    )
    scene = SimpleNamespace(
        marked=np.zeros((9, 9), np.uint8), covered=None, unseen=None, image=np.zeros((9, 9, 3), np.uint8)
    )
    for name in ("lighten_markings", "estimate_noise", "look_for_markings", "measure_evidence", "measure_surroundings"):
        monkeypatch.setattr(field_lines, name, lambda *given: None)
    monkeypatch.setattr(field_lines, "carriers", lambda seen, camera: frozenset())
    monkeypatch.setattr(field_lines, "observe_field_lines", lambda *given: [(Observations(9, 9), ROUGH)] * 2)
    monkeypatch.setattr(field_lines, "_fit_naming", lambda *given: iter([next(attempts)]))
    monkeypatch.setattr(field_lines, "confirm_field_lines", lambda verdict, *given: verdict)
    monkeypatch.setattr(field_lines, "weigh_evidence", lambda verdict, *given: verdict)
    monkeypatch.setattr(field_lines, "_add_curves", lambda *given: None)
    monkeypatch.setattr(field_lines, "misses_circle", lambda camera, *given: camera.name == "missing")
    assert [taken.camera.name for taken in field_lines._try_namings(setting, scene, see_lines())] == ["right"]


def test_lines_are_read_anew_where_a_refused_circle_had_taken_some(tries, monkeypatch):
    """Nothing is taken for a circle then."""
    setting, scene = SimpleNamespace(), SimpleNamespace(looks=Looks(), image=np.zeros((9, 9, 3), np.uint8))
    one, other = np.diag([1.0, 1.0, -1.0]), np.diag([1.0, 2.0, -1.0])
    masks = iter([replace(see_lines(0.1), conic=other), see_lines(0.2)])
    asked = []

    def find(setting, scene, ruled_out):
        asked.append(len(ruled_out))
        return next(masks), None

    monkeypatch.setattr(other_circles, "find_marking_once", find)
    refused = Verdict("refused", "mirrored", "the field would be seen mirrored", "verdict")
    first = Attempt(mask=replace(see_lines(), conic=one), verdict=refused)
    taken = [attempt.mask for attempt in field_lines.take_field_lines(setting, scene, first)]
    assert asked == [1, 2]
    assert [mask.conic is None for mask in taken] == [False, True]
    sure = replace(first, verdict=Verdict("refused", "too_uncertain", "", "verdict"))
    assert len([*field_lines.take_field_lines(setting, scene, sure)]) == 1


def test_lines_in_the_sun_and_in_the_shade_are_tried_together_at_last(tries, monkeypatch):
    joined = see_lines(0.3)
    monkeypatch.setattr(field_lines, "join_lights", lambda mask, image: joined)
    scene = SimpleNamespace(looks=Looks(), image=np.zeros((9, 9, 3), np.uint8))
    first = Attempt(mask=see_lines())
    taken = [attempt.mask for attempt in field_lines.take_field_lines(SimpleNamespace(), scene, first)]
    assert [mask is other for mask, other in zip(taken, (first.mask, joined), strict=True)] == [True, True]
