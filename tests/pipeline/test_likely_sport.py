"""Which sport a refused frame looks like: each kind of evidence by itself, and frames that show a field."""

import numpy as np
import pytest

from circlecal.config import Config
from circlecal.field import load_field
from circlecal.geometry.conics import circle_conic
from circlecal.pipeline import likely_sport
from circlecal.pipeline.likely_sport import Trial, is_rink_paint, tell_sport
from circlecal.results import Attempt, FieldCandidate, FrameCalibration, MarkingMask, Segment, Verdict

PICTURE = np.zeros((36, 64, 3), np.uint8)
GRASS = ("soccer", "robocup", "futsal")
FLOOR = ("soccer", "ice-hockey-nhl", "basketball", "futsal", "handball")


def trial(name, lines=0, paint_share=None, evidence=None, explained=0.0):
    """A refused trial of a template: so many lines, and a circle whose paint is such a share of its radius."""
    template = load_field(name)
    segment = Segment(np.zeros(2), np.ones(2))
    conic = None if paint_share is None else circle_conic((32.0, 18.0), 400.0)
    band = 0.0 if paint_share is None else 400.0 * paint_share
    mask = MarkingMask(PICTURE[..., 0], "detector", conic=conic, lines=(segment,) * lines, band_px=band)
    attempt = Attempt(mask=mask, verdict=Verdict("refused", "no_circle_found", None, None))
    found = FrameCalibration("x", 64, 36, name, template.default_circle, attempt, 0, "", template=template)
    return Trial(found, FieldCandidate(name, template.sport, "refused", "x", evidence, 0.6, explained))


def told(grounds, trials):
    return tell_sport(PICTURE, Config(), grounds, trials).name


def test_a_lawn_or_a_floor_without_paint_tells_nothing():
    assert told(("grass",), [trial(name) for name in GRASS]) is None
    assert told(("floor",), [trial(name, lines=4) for name in FLOOR]) is None


def test_lines_on_grass_are_those_of_the_usual_sport():
    assert told(("grass",), [trial(name, lines=4) for name in GRASS]) == "soccer"


@pytest.mark.parametrize(
    ("paint_share", "sport"), [(0.05 / 0.75, "robot soccer"), (0.12 / 9.15, "soccer")], ids=["robots", "soccer"]
)
def test_the_width_of_a_circles_paint_tells_a_small_circle_from_a_large_one(paint_share, sport):
    assert told(("grass",), [trial(name, 3, paint_share) for name in GRASS]) == sport


def test_a_court_of_another_size_is_told_by_the_paint_that_it_explains():
    trials = {name: trial(name, lines=4) for name in FLOOR}
    assert (
        told(("floor",), [*{**trials, "basketball": trial("basketball", 4, None, 0.7, 0.5)}.values()]) == "basketball"
    )
    # what explains a fifth of the paint lies on it by chance
    assert told(("floor",), [*{**trials, "basketball": trial("basketball", 4, None, 2.0, 0.2)}.values()]) is None


def test_red_blue_or_yellow_on_what_looks_like_ice_tells_a_rink(monkeypatch):
    trials = [trial(name, lines=4) for name in FLOOR]
    for added, sport in (((-79.0, -8.0, 2.0), "ice hockey"), ((-43.0, -45.0, -43.0), None)):
        monkeypatch.setattr(likely_sport, "tell_paints", lambda *_, added=added: (np.array(added),))
        assert told(("ice", "floor"), trials) == sport


@pytest.mark.parametrize(
    ("added", "is_rink"),
    [
        ((8, -28, -43), True),
        ((-64, -65, -19), True),
        ((23, 18, 17), False),
        ((-52, -88, -83), False),
        ((-8, 2, 2), False),
    ],
    ids=["blue", "red", "white", "black", "faint"],
)
def test_paint_of_a_rink_has_a_hue(added, is_rink):
    assert is_rink_paint(np.array(added, float)) is is_rink


def test_probabilities_add_up_over_the_sports_and_none_of_them():
    sure = tell_sport(PICTURE, Config(), ("grass",), [trial(name, 4, 0.12 / 9.15) for name in GRASS])
    assert 0.5 < sure.probability < 1.0
    open_one = tell_sport(PICTURE, Config(), ("grass",), [trial(name) for name in GRASS])
    assert 0.0 < open_one.probability < 1.0
