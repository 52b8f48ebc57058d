"""Circles and arcs measured where a camera puts them."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np

from circlecal.pipeline import curves
from tests.stages.conftest import CIRCLE, SOCCER, view
from tests.stages.test_faint_lines import fit_of


def test_points_of_an_arc_that_lie_on_the_line_at_its_end_are_left_out(monkeypatch):
    arc = next(arc for arc in SOCCER.arcs if arc.name == "penalty_arc_left")
    angle = np.radians(np.linspace(arc.start_deg, arc.end_deg, 30))
    ring_m = np.asarray(arc.center) + SOCCER.radius(arc, "center") * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    line_m = np.array([[-36.0, y] for y in np.linspace(-6.0, 6.0, 30)])
    camera = view(position=(-4.0, 46.0, -19.0), target=(-32.0, -2.0, 0.0), focal=1200.0)
    fit = fit_of(camera, camera)
    points_px = fit.view.project(np.concatenate([ring_m, line_m]))
    monkeypatch.setattr(curves, "measure_along_model", lambda *_: (points_px, np.arange(60.0)))
    config = SimpleNamespace(ellipse=SimpleNamespace(minimum_points=6), rays=None)
    setting = SimpleNamespace(config=config, template=SOCCER, clock=lambda stage: nullcontext())
    (found,) = curves.measure_curves(setting, None, fit, (arc,), 1.0).values()
    assert 15 < len(found.points_px) < 30
    assert found.sigma_px.max() < 30
    (circle,) = curves.measure_curves(setting, None, fit, (CIRCLE,), 1.0).values()
    assert len(circle.points_px) == 60
