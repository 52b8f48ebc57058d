"""What is measured again within one attempt."""

from types import SimpleNamespace

import pytest

from circlecal.pipeline import refinements
from circlecal.pipeline.refinements import MOST_ROUNDS, remeasure_wide_paint


@pytest.mark.parametrize(("moved_px", "rounds"), [(100.0, MOST_ROUNDS), (0.1, 1), (900.0, 1)])
def test_wide_paint_is_measured_again_until_cameras_settle_or_leave_it(monkeypatch, moved_px, rounds):
    made = []

    def remeasure(setting, scene, attempt):
        made.append(SimpleNamespace(camera=SimpleNamespace(view=None)))
        yield made[-1]

    monkeypatch.setattr(refinements, "remeasure_along_camera", remeasure)
    monkeypatch.setattr(refinements, "_is_wide", lambda setting, camera: True)
    monkeypatch.setattr(refinements, "mean_distance_px", lambda before, after, template: moved_px)
    setting = SimpleNamespace(width=1920, template=None)
    last = list(remeasure_wide_paint(setting, None, SimpleNamespace(camera=SimpleNamespace(view=None))))
    assert len(made) == rounds
    assert last == made[-1:]
