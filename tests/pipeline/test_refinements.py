"""What is measured again within one attempt."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

import circlecal
from circlecal.observations import LinePoints, Observations
from circlecal.pipeline import curves, refinements
from circlecal.pipeline.refinements import MOST_ROUNDS, remeasure_wide_paint
from circlecal.results import Attempt, Cues, LineCue, Segment
from circlecal.synthetic.sampling import SCENE_PROFILES, render_frame


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
    monkeypatch.setattr(curves, "mean_distance_px", lambda before, after, template: moved_px)
    setting = SimpleNamespace(width=1920, template=None)
    last = list(remeasure_wide_paint(setting, None, SimpleNamespace(camera=SimpleNamespace(view=None))))
    assert len(made) == rounds
    assert last == made[-1:]


def test_what_was_fitted_is_asked_by_name_where_all_of_it_was_reached():
    """One more stage among these results moves no other."""
    reached = {name: SimpleNamespace() for name in ("mask", "edges", "cues", "observations", "camera", "verdict")}
    fitted = Attempt(**reached).fitted
    assert all(getattr(fitted, name) is result for name, result in reached.items())
    with pytest.raises(TypeError, match="unpack"):
        _, *_ = fitted
    assert all(Attempt(**(reached | {name: None})).fitted is None for name in reached)


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
    fitted = SimpleNamespace(edges=SimpleNamespace(blur_px=1.2), cues=attempt.cues, camera=camera)
    monkeypatch.setattr(Attempt, "fitted", property(lambda self: fitted))
    monkeypatch.setattr(refinements, "predict_line_widths", lambda *_: np.array([1.0, 1.0]))
    monkeypatch.setattr(refinements, "estimate", lambda setting, attempt: attempt)
    (left,) = refinements.leave_out_broad_lines(SimpleNamespace(template=None), None, attempt)
    assert left.cues.lines == (thin,)
    assert left.observations.lines == (seen[0], seen[2])


@pytest.mark.parametrize(
    ("row", "are_apart", "is_yellow", "is_taken"),
    [(60.0, False, False, True), (41.0, False, False, False), (41.0, True, False, False), (60.0, False, True, False)],
)
def test_a_faint_line_that_is_yellow_or_was_measured_before_in_pieces_is_none(
    monkeypatch, row, are_apart, is_yellow, is_taken
):
    """The pieces may be markings, or were set apart for their colour; so is the faint line where it is yellow."""

    def cue(first, last, y, count):
        points = np.stack([np.linspace(first, last, count), np.full(count, y)], axis=-1)
        return LineCue(None, np.ones(3), points, np.ones(count), Segment(points[0], points[-1]), 0.3)

    pieces, faint = (cue(0, 500, 40.0, 200), cue(700, 1270, 40.0, 200)), cue(0, 1270, row, 32)
    lines = ((), pieces) if are_apart else (pieces, ())
    attempt = Attempt(cues=Cues(cue(0, 9, 99.0, 9), None, *lines), observations=Observations(1280, 720, (), ()))
    mask = SimpleNamespace(field_region=None)
    edges, seen = SimpleNamespace(blur_px=1.2), attempt.observations
    fitted = SimpleNamespace(mask=mask, edges=edges, cues=attempt.cues, observations=seen, camera=None)
    monkeypatch.setattr(Attempt, "fitted", property(lambda self: fitted))
    monkeypatch.setattr(refinements, "lighten_markings", lambda *_: None)
    monkeypatch.setattr(refinements, "find_faint_lines", lambda *_: (faint,))
    monkeypatch.setattr(refinements, "estimate", lambda setting, attempt: attempt)
    told = Cues(None, None, (), (faint,)) if is_yellow else Cues(None, None, (faint,))
    monkeypatch.setattr(refinements, "set_apart_other_sports", lambda *_: told)
    setting = SimpleNamespace(circle=None, template=None, width=1280, clock=lambda stage: nullcontext())
    taken = list(refinements.add_faint_lines(setting, SimpleNamespace(marked=None, clear_lines=tuple), attempt))
    assert [attempt.cues.lines[2:] for attempt in taken] == ([(faint,)] if is_taken else [])


@pytest.mark.parametrize(
    ("status", "mark", "lines", "width", "is_taken"),
    [
        ("calibrated", "centre_mark", ("side_line_top",), (72.0, 2.0), True),
        ("refused", "centre_mark", ("side_line_top",), (68.2, 0.6), False),
        ("calibrated", None, ("side_line_top",), (72.0, 2.0), False),
        ("calibrated", "centre_mark", (), (68.2, 0.6), False),
        ("calibrated", None, ("side_line_top",), (68.2, 0.6), True),
        ("calibrated", None, ("side_line_top",), (72.0, 0.6), False),
        ("calibrated", None, ("side_line_top",), (68.2, 2.0), False),
        ("calibrated", None, ("side_line_top",), None, False),
    ],
)
def test_a_field_of_another_size_is_taken_where_mark_and_line_carry_its_camera_or_its_width_is_the_usual_one(
    status, mark, lines, width, is_taken
):
    cues = Cues(None, None if mark is None else SimpleNamespace(name=mark))
    size = None if width is None else SimpleNamespace(width_m=width[0], width_sd_m=width[1])
    camera = SimpleNamespace(named_lines=lines, rejected=(), field_size=size)
    resized = SimpleNamespace(is_calibrated=status == "calibrated", camera=camera, cues=cues)
    first = SimpleNamespace(camera=SimpleNamespace(named_lines=lines))
    setting = SimpleNamespace(template=SimpleNamespace(width_m=68.0))
    assert refinements.RESIZE.accept(setting, first, resized) == is_taken


@pytest.mark.parametrize(
    ("status", "sigma_px", "names", "is_taken"),
    [
        ("calibrated", 2.0, ("side_line_top", "big_rect_left_main"), True),
        ("refused", 2.0, ("side_line_top", "big_rect_left_main"), False),
        ("calibrated", 9.0, ("side_line_top", "big_rect_left_main"), False),
        ("calibrated", 2.0, ("side_line_top",), False),
    ],
)
def test_short_lines_are_taken_where_they_have_names_and_make_the_camera_surer(status, sigma_px, names, is_taken):
    first = SimpleNamespace(camera=SimpleNamespace(named_lines=("side_line_top",), max_sigma_px=8.0))
    camera = SimpleNamespace(named_lines=names, max_sigma_px=sigma_px)
    refined = SimpleNamespace(camera=camera, is_calibrated=status == "calibrated")
    assert refinements.is_told_more(None, first, refined) == is_taken


@pytest.mark.parametrize(
    ("sigma_px", "size_sd_m", "code", "is_wanted", "is_tried"),
    [
        (4.0, (1.0, 0.3), None, True, True),
        (4.0, (0.3, 0.7), None, True, True),
        (4.0, (0.3, 0.3), None, True, False),
        (4.0, None, None, True, False),
        (1.0, (1.0, 0.7), None, True, False),
        (4.0, (1.0, 0.7), "too_uncertain", True, True),
        (4.0, (1.0, 0.7), "circle_unconfirmed", True, True),
        (4.0, (1.0, 0.7), "markings_missing", True, False),
        (4.0, (1.0, 0.7), None, False, False),
    ],
)
def test_short_lines_are_looked_for_where_a_usable_camera_leaves_a_size_open(
    sigma_px, size_sd_m, code, is_wanted, is_tried
):
    size = None if size_sd_m is None else SimpleNamespace(length_sd_m=size_sd_m[0], width_sd_m=size_sd_m[1])
    attempt = SimpleNamespace(
        camera=SimpleNamespace(max_sigma_px=sigma_px, field_size=size),
        cues=Cues("a halfway line", None),
        is_calibrated=code is None,
        code=code,
    )
    cues = SimpleNamespace(further_lines=is_wanted)
    setting = SimpleNamespace(width=1920, config=SimpleNamespace(cues=cues))
    assert refinements.may_show_short_lines(setting, attempt) == is_tried


def test_a_corner_of_the_penalty_area_settles_the_size_of_the_field():
    """A circle, a halfway line and a touchline leave the width open; the corner is 0.06 of the picture long."""
    truth = render_frame(
        "world_part", np.random.default_rng([9934, 158, SCENE_PROFILES.index("world_part")]), 1280, 720
    )
    frame = circlecal.calibrate(truth.image)
    assert frame.status == "calibrated"
    assert {"big_rect_left_main", "big_rect_left_top"} <= set(frame.attempt.camera.named_lines)
    assert frame.attempt.camera.field_size.width_m == pytest.approx(truth.truth.painted.width_m, abs=1.0)
