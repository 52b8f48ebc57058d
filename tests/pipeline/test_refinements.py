"""What is measured again within one attempt."""

from contextlib import nullcontext
from types import MappingProxyType, SimpleNamespace

import numpy as np
import pytest

from circlecal.observations import CirclePoints, LinePoints, Observations
from circlecal.pipeline import refinements
from circlecal.pipeline.refinements import MOST_ROUNDS, remeasure_wide_paint
from circlecal.results import Attempt, Cues, LineCue, Segment
from tests.stages.conftest import CIRCLE, SOCCER, view
from tests.stages.test_faint_lines import fit_of


@pytest.mark.parametrize(
    ("moved_px", "code", "rounds"),
    [
        (100.0, None, MOST_ROUNDS),
        (100.0, "residual_too_large", MOST_ROUNDS),
        (0.1, None, 1),
        (900.0, None, 1),
        (100.0, "too_uncertain", 1),
    ],
)
def test_wide_paint_is_measured_again_until_cameras_settle_or_leave_it(monkeypatch, moved_px, code, rounds):
    made = []

    def remeasure(setting, scene, attempt):
        made.append(SimpleNamespace(camera=SimpleNamespace(view=None), code=code))
        yield made[-1]

    monkeypatch.setattr(refinements, "remeasure_along_camera", remeasure)
    monkeypatch.setattr(refinements, "_is_wide", lambda setting, camera: True)
    monkeypatch.setattr(refinements, "mean_distance_px", lambda before, after, template: moved_px)
    setting = SimpleNamespace(width=1920, template=None)
    last = list(remeasure_wide_paint(setting, None, SimpleNamespace(camera=SimpleNamespace(view=None))))
    assert len(made) == rounds
    assert last == made[-1:]


def test_lines_far_broader_than_their_paint_are_left_out(monkeypatch):
    """A kerb along the far touchline was named with it, 8 px wide where the paint would be one and the blur three."""
    nowhere, sure = np.zeros((9, 2)), np.ones(9)
    rows = [Segment(np.array([9.0, y]), np.array([99.0, y])) for y in (40.0, 60.0)]
    broad, thin = (
        LineCue(None, np.ones(3), nowhere, sure, row, 0.3, width_px=width)
        for row, width in zip(rows, (8.0, 3.0), strict=True)
    )
    seen = [LinePoints(name, nowhere, sure) for name in ("halfway_line", None, None)]
    attempt = Attempt(
        cues=Cues(
            LineCue("halfway_line", np.ones(3), np.zeros((9, 2)), np.ones(9), broad.segment, 0.1), None, (broad, thin)
        ),
        observations=Observations(1280, 720, (), tuple(seen)),
    )
    camera = SimpleNamespace(names_by_line={1: "side_line_top", 2: "side_line_top"}, view=SimpleNamespace(project=None))
    fitted = (None, SimpleNamespace(blur_px=1.2), attempt.cues, attempt.observations, camera, None)
    monkeypatch.setattr(Attempt, "fitted", property(lambda self: fitted))
    monkeypatch.setattr(refinements, "predict_line_widths", lambda *_: np.array([1.0, 1.0]))
    monkeypatch.setattr(refinements, "estimate", lambda setting, attempt: attempt)
    (left,) = refinements.leave_out_broad_lines(SimpleNamespace(template=None), None, attempt)
    assert left.cues.lines == (thin,)
    assert left.observations.lines == (seen[0], seen[2])


def clean_coats(monkeypatch, first_noise, rounds, moved_px=9.0, rejected=MappingProxyType({})):
    """What is left of an attempt whose camera has a noise. Each round names the coats that are told, alike or not, and
    the noise of the camera without each of them; the circles that are left are numbered by round and coat.
    """
    attempts = {}

    def make_attempt(number, noise):
        circle = CirclePoints("centre_circle", "center", np.full((9, 2), number), np.ones(9))
        camera = SimpleNamespace(noise_scale=noise, view=number, rejected=rejected.get(number, ()))
        fitted = (None, SimpleNamespace(noise=1.0), None, Observations(1280, 720, (circle,), ()), camera, None)
        attempts[number] = Attempt(observations=fitted[3], camera=camera)
        return fitted

    fits = {0.0: make_attempt(0.0, first_noise)}
    for k, (_, noises) in enumerate(rounds, start=1):
        fits |= {k + 0.1 * coat: make_attempt(k + 0.1 * coat, noise) for coat, noise in enumerate(noises)}
    asked = []

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

    template = SimpleNamespace(marking_width_m=0.12, radius=lambda circle, edge: 9.09)
    monkeypatch.setattr(
        Attempt, "fitted", property(lambda self: fits[float(self.observations.circles[0].points_px[0, 0])])
    )
    monkeypatch.setattr(refinements, "lighten_markings", lambda *_: None)
    monkeypatch.setattr(refinements, "sample_coats", lambda picture, view, *_: view)
    monkeypatch.setattr(refinements, "find_old_coats", find)
    monkeypatch.setattr(refinements, "remove_old_coat", lambda picture, view, circle, radius_m, coat: coat)
    monkeypatch.setattr(refinements, "measure_curves", measure)
    monkeypatch.setattr(refinements, "mean_distance_px", lambda *_: moved_px)
    monkeypatch.setattr(
        refinements,
        "estimate",
        lambda setting, attempt: attempts[float(attempt.observations.circles[0].points_px[0, 0])],
    )
    circle = SimpleNamespace(name="centre_circle", fill="ring")
    setting = SimpleNamespace(circle=circle, template=template, width=1280, clock=lambda stage: nullcontext())
    left = list(refinements.leave_out_old_coat(setting, SimpleNamespace(marked=None), attempts[0.0]))
    return [float(attempt.observations.circles[0].points_px[0, 0]) for attempt in left], asked


def test_the_circle_is_measured_without_an_old_coat(monkeypatch):
    assert clean_coats(monkeypatch, 3.0, [(False, (3.2,))])[0] == [1.0]
    assert clean_coats(monkeypatch, 3.0, []) == ([], [False])


def test_without_an_old_coat_the_circle_is_measured_again_along_the_new_camera(monkeypatch):
    """As long as that explains what was seen as well, and moves the markings, and leaves something to be explained."""
    assert clean_coats(monkeypatch, 5.0, [(False, (4.0,)), (False, (2.0,)), (False, (1.5,)), (False, (1.3,))])[0] == [
        3.0
    ]
    assert clean_coats(monkeypatch, 5.0, [(False, (4.0,)), (False, (4.5,))])[0] == [1.0]
    assert clean_coats(monkeypatch, 5.0, [(False, (1.1,)), (False, (1.0,))])[0] == [1.0]
    assert clean_coats(monkeypatch, 5.0, [(False, (4.0,)), (False, (2.0,))], moved_px=0.1)[0] == [1.0]


def test_of_two_coats_that_are_alike_that_one_is_old_without_which_the_camera_explains_more(monkeypatch):
    assert clean_coats(monkeypatch, 9.0, [(True, (6.0, 1.1))]) == ([1.1], [False, True])
    assert clean_coats(monkeypatch, 9.0, [(True, (1.1, 6.0))])[0] == [1.0]
    assert clean_coats(monkeypatch, 9.0, [(True, (1.1, 1.2))])[0] == []


def test_of_two_coats_that_are_alike_that_one_is_new_which_the_centre_mark_agrees_with(monkeypatch):
    assert clean_coats(monkeypatch, 9.0, [(True, (1.7, 1.6))], rejected={1.1: ("centre_mark",)})[0] == [1.0]


def test_coats_that_are_alike_are_believed_only_where_they_explain_much(monkeypatch):
    assert clean_coats(monkeypatch, 9.0, [(True, (8.0, 7.0))])[0] == []
    assert clean_coats(monkeypatch, 4.0, [(True, (1.1, 6.0))]) == ([], [False])


def test_points_of_an_arc_that_lie_on_the_line_at_its_end_are_left_out(monkeypatch):
    arc = next(arc for arc in SOCCER.arcs if arc.name == "penalty_arc_left")
    angle = np.radians(np.linspace(arc.start_deg, arc.end_deg, 30))
    ring_m = np.asarray(arc.center) + SOCCER.radius(arc, "center") * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    line_m = np.array([[-36.0, y] for y in np.linspace(-6.0, 6.0, 30)])
    camera = view(position=(-4.0, 46.0, -19.0), target=(-32.0, -2.0, 0.0), focal=1200.0)
    fit = fit_of(camera, camera)
    points_px = fit.view.project(np.concatenate([ring_m, line_m]))
    monkeypatch.setattr(refinements, "measure_along_model", lambda *_: (points_px, np.arange(60.0)))
    config = SimpleNamespace(ellipse=SimpleNamespace(minimum_points=6), rays=None)
    setting = SimpleNamespace(config=config, template=SOCCER, clock=lambda stage: nullcontext())
    (found,) = refinements.measure_curves(setting, None, fit, (arc,), 1.0).values()
    assert 15 < len(found.points_px) < 30
    assert found.sigma_px.max() < 30
    (circle,) = refinements.measure_curves(setting, None, fit, (CIRCLE,), 1.0).values()
    assert len(circle.points_px) == 60


@pytest.mark.parametrize(("row", "is_taken"), [(60.0, True), (41.0, False)])
def test_a_faint_line_that_was_measured_before_in_pieces_is_no_other_one(monkeypatch, row, is_taken):
    def cue(first, last, y, count):
        points = np.stack([np.linspace(first, last, count), np.full(count, y)], axis=-1)
        return LineCue(None, np.ones(3), points, np.ones(count), Segment(points[0], points[-1]), 0.3)

    pieces, faint = (cue(0, 500, 40.0, 200), cue(700, 1270, 40.0, 200)), cue(0, 1270, row, 32)
    attempt = Attempt(cues=Cues(cue(0, 9, 99.0, 9), None, pieces), observations=Observations(1280, 720, (), ()))
    mask = SimpleNamespace(field_region=None)
    fitted = (mask, None, attempt.cues, attempt.observations, None, None)
    monkeypatch.setattr(Attempt, "fitted", property(lambda self: fitted))
    monkeypatch.setattr(refinements, "lighten_markings", lambda *_: None)
    monkeypatch.setattr(refinements, "find_faint_lines", lambda *_: (faint,))
    monkeypatch.setattr(refinements, "estimate", lambda setting, attempt: attempt)
    setting = SimpleNamespace(circle=None, template=None, width=1280, clock=lambda stage: nullcontext())
    taken = list(refinements.add_faint_lines(setting, SimpleNamespace(marked=None), attempt))
    assert [attempt.cues.lines[2:] for attempt in taken] == ([(faint,)] if is_taken else [])
