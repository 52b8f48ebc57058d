"""The circle without an old coat: rounds, and which one of two that are alike is the old one."""

from contextlib import nullcontext
from types import MappingProxyType, SimpleNamespace

import numpy as np

from circlecal.observations import CirclePoints, Observations
from circlecal.pipeline import curves, old_coats
from circlecal.results import Attempt


def clean_coats(monkeypatch, first_noise, rounds, moved_px=9.0, rejected=MappingProxyType({})):
    """What is left of an attempt whose camera has a noise. Each round names the coats that are told, alike or not, and
    the noise of the camera without each of them; the circles that are left are numbered by round and coat. Also whether
    coats that may be alike were asked for, each time, and which circles cameras were estimated from, drafts or not.
    """
    attempts = {}

    def make_attempt(number, noise):
        circle = CirclePoints("centre_circle", "center", np.full((9, 2), number), np.ones(9))
        camera = SimpleNamespace(noise_scale=noise, view=number, rejected=rejected.get(number, ()))
        seen, edges = Observations(1280, 720, (circle,), ()), SimpleNamespace(noise=1.0)
        attempts[number] = Attempt(observations=seen, camera=camera)
        return SimpleNamespace(mask=None, edges=edges, observations=seen, camera=camera)

    fits = {0.0: make_attempt(0.0, first_noise)}
    for k, (_, noises) in enumerate(rounds, start=1):
        fits |= {k + 0.1 * coat: make_attempt(k + 0.1 * coat, noise) for coat, noise in enumerate(noises)}
    asked, drafts = [], []

    def find(profiles, width_m, may_be_alike):
        asked.append(may_be_alike)
        left = iter(rounds)
        number = 1 + int(profiles)
        is_alike, noises = next((r for k, r in enumerate(left, start=1) if k == number), (False, ()))
        if is_alike and not may_be_alike:
            return ()
        return tuple(number + 0.1 * coat for coat in range(len(noises)))

    def measure(setting, seen, *_):
        return {"centre_circle": CirclePoints("centre_circle", "center", np.full((9, 2), seen), np.ones(9))}

    def estimate(setting, attempt, is_draft=False):
        number = float(attempt.observations.circles[0].points_px[0, 0])
        drafts.append((number, is_draft))
        return attempts[number]

    template = SimpleNamespace(marking_width_m=0.12, radius=lambda circle, edge: 9.09)
    monkeypatch.setattr(
        Attempt, "fitted", property(lambda self: fits[float(self.observations.circles[0].points_px[0, 0])])
    )
    monkeypatch.setattr(old_coats, "lighten_markings", lambda *_: None)
    monkeypatch.setattr(old_coats, "sample_coats", lambda picture, view, *_: view)
    monkeypatch.setattr(old_coats, "find_old_coats", find)
    monkeypatch.setattr(old_coats, "remove_old_coat", lambda picture, view, circle, radius_m, coat: coat)
    monkeypatch.setattr(old_coats, "measure_curves", measure)
    monkeypatch.setattr(curves, "mean_distance_px", lambda *_: moved_px)
    monkeypatch.setattr(old_coats, "estimate", estimate)
    circle = SimpleNamespace(name="centre_circle", fill="ring")
    setting = SimpleNamespace(circle=circle, template=template, width=1280, clock=lambda stage: nullcontext())
    left = list(old_coats.leave_out_old_coat(setting, SimpleNamespace(marked=None, covered=None), attempts[0.0]))
    return [float(attempt.observations.circles[0].points_px[0, 0]) for attempt in left], asked, drafts


def test_the_circle_is_measured_without_an_old_coat(monkeypatch):
    assert clean_coats(monkeypatch, 3.0, [(False, (3.2,))])[0] == [1.0]
    assert clean_coats(monkeypatch, 3.0, [])[:2] == ([], [False])


def test_without_an_old_coat_the_circle_is_measured_again_along_the_new_camera(monkeypatch):
    """As long as that explains what was seen as well, and moves the markings, and leaves something to be explained."""
    assert clean_coats(monkeypatch, 5.0, [(False, (4.0,)), (False, (2.0,)), (False, (1.5,)), (False, (1.3,))])[0] == [
        3.0
    ]
    assert clean_coats(monkeypatch, 5.0, [(False, (4.0,)), (False, (4.5,))])[0] == [1.0]
    assert clean_coats(monkeypatch, 5.0, [(False, (1.1,)), (False, (1.0,))])[0] == [1.0]
    assert clean_coats(monkeypatch, 5.0, [(False, (4.0,)), (False, (2.0,))], moved_px=0.1)[0] == [1.0]


def test_of_two_coats_that_are_alike_that_one_is_old_without_which_the_camera_explains_more(monkeypatch):
    assert clean_coats(monkeypatch, 9.0, [(True, (6.0, 1.1))])[:2] == ([1.1], [False, True])
    assert clean_coats(monkeypatch, 9.0, [(True, (1.1, 6.0))])[0] == [1.0]
    assert clean_coats(monkeypatch, 9.0, [(True, (1.1, 1.2))])[0] == []


def test_of_two_coats_that_are_alike_that_one_is_new_which_the_centre_mark_agrees_with(monkeypatch):
    assert clean_coats(monkeypatch, 9.0, [(True, (1.7, 1.6))], rejected={1.1: ("centre_mark",)})[0] == [1.0]


def test_coats_that_are_alike_are_believed_only_where_they_explain_much(monkeypatch):
    assert clean_coats(monkeypatch, 9.0, [(True, (8.0, 7.0))])[0] == []
    assert clean_coats(monkeypatch, 4.9, [(True, (1.1, 6.0))])[:2] == ([], [False])
    assert clean_coats(monkeypatch, 5.1, [(True, (1.1, 6.0))])[:2] == ([1.0], [False, True])


def test_of_coats_that_may_be_alike_only_the_one_that_is_believed_is_more_than_a_draft(monkeypatch):
    assert clean_coats(monkeypatch, 9.0, [(True, (6.0, 1.1))])[2] == [(1.0, True), (1.1, True), (1.1, False)]
    assert clean_coats(monkeypatch, 9.0, [(True, (8.0, 7.0))])[2] == [(1.0, True), (1.1, True)]
    assert clean_coats(monkeypatch, 3.0, [(False, (3.2,))])[2] == [(1.0, False)]
