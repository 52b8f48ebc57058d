"""Two runs against each other: counts, distances, the page; and the cameras of a run with its pitch."""

import json
import re

import pytest

from circlecal.field import load_field
from circlecal.report import read_run, write_report
from circlecal.report.comparison import Change, compare, distance_px
from circlecal.report.drawings import scene_of
from circlecal.report.tripods import plan_of
from circlecal.rig.tripod import Venue
from circlecal.rig.venue import write_venue
from tests.report.conftest import refused, sound, write_run
from tests.tracking import scripted


@pytest.fixture
def changed(named):
    """The calibrated record with another camera: turned, and with another sigma."""

    def change(name, degrees=0.0, sigma_px=5.0):
        record = named(name, sigma_px)
        record["camera"]["pan_degrees"] += degrees
        return record

    return change


def rows(folder, records):
    run = read_run(write_run(folder, records))
    return {row.id: (row, scene_of(run.record(row))) for row in run.rows}


@pytest.mark.parametrize(
    ("before", "after", "change"),
    [
        (5.0, 5.5, Change.ALIKE),
        (5.0, 3.0, Change.SURER),
        (5.0, 8.0, Change.LESS_SURE),
        (None, 5.0, Change.GAINED),
        (5.0, None, Change.LOST),
        (None, None, Change.ALIKE),
    ],
)
def test_what_became_of_a_frame(tmp_path, changed, before, after, change):
    def record(sigma):
        return refused("a") if sigma is None else changed("a", sigma_px=sigma)

    own, other = rows(tmp_path / "own", [record(after)])["a"], rows(tmp_path / "other", [record(before)])["a"]
    assert compare(*own, *other).change == change


def test_a_frame_that_the_other_run_does_not_have(tmp_path, changed):
    found = compare(*rows(tmp_path, [changed("a")])["a"], None, None)
    assert (found.change, found.apart_px) == (Change.ABSENT, None)


def test_cameras_that_contradict_each_other(tmp_path, changed):
    own = rows(tmp_path / "own", [changed("a", sigma_px=1.0)])["a"]
    other = rows(tmp_path / "other", [changed("a", degrees=0.5, sigma_px=1.0)])["a"]
    found = compare(*own, *other)
    assert found.change == Change.MOVED
    # half a degree of pan moves what is seen by nearly as many pixels everywhere; the picture is 960 px wide
    focal = own[1].view.camera.focal_px[0] * 1920 / 960
    assert found.apart_px == pytest.approx(focal * 0.00873, rel=0.1)
    assert distance_px(own[1], own[1]) == pytest.approx(0.0, abs=1e-9)


def test_the_page_tells_what_got_better_and_what_worse(tmp_path, changed):
    run = read_run(write_run(tmp_path / "now", [changed("a"), refused("b"), changed("c", sigma_px=2.0)]))
    other = read_run(write_run(tmp_path / "<b>then", [refused("a"), changed("b"), changed("c", sigma_px=4.0)]))
    report = write_report(run, None, against=other).page.parent
    page = (report / "index.html").read_text()
    words = " ".join(re.sub(r"<[^>]+>", " ", page).split())
    assert "Against &lt;b&gt;then" in page
    for said in (
        "calibrated now, refused there 1 frame",
        "refused now, calibrated there 1",
        "sigma below 80 % of what",
    ):
        assert said in words
    text = (report / "frames.js").read_text()
    columns = json.loads(text.removeprefix("circlecalFrames(").removesuffix(");\n"))["columns"]
    assert columns["change"] == [Change.GAINED, Change.LOST, Change.SURER]
    assert len(list((report / "other").rglob("*.svg"))) == 2


def test_against_nothing_is_no_run(tmp_path, changed, run_circlecal):
    folder = write_run(tmp_path / "now", [changed("a")])
    outcome = run_circlecal("report", folder, "--against", tmp_path / "absent")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)


def test_cameras_of_the_frames_and_of_the_venue(tmp_path, named):
    records = [named("a", rig={"camera": "camera-1"}), named("b", rig={"camera": "camera-1"}), refused("c")]
    run = read_run(write_run(tmp_path, records))
    plan = plan_of(tmp_path, run.rows, "soccer")
    x, y, _ = sound(records[0]).camera.position_meters
    (tripod,) = plan.tripods
    assert (tripod.name, tripod.x_m, tripod.y_m) == ("camera-1", pytest.approx(x), pytest.approx(y))
    assert len(plan.dots) == 2
    left, top, width, height = plan.box
    assert left < x < left + width and top < y < top + height
    (tmp_path / "venue.yaml").write_text("broken: [")  # the rest of the report stands
    assert plan_of(tmp_path, run.rows, "soccer").tripods == plan.tripods
    assert plan_of(tmp_path, run.rows, "unheard-of") is None


def test_the_pitch_is_drawn_as_large_as_its_venue_tells(tmp_path):
    soccer = load_field("soccer")
    write_venue(tmp_path / "venue.yaml", Venue("soccer", (scripted.tripod(),)), soccer, "0" * 12)
    plan = plan_of(tmp_path, [], "soccer")
    assert plan.tripods[0].pitch_m == pytest.approx((103.5, 68.7))
    assert "51.8 34.3" in " ".join(plan.markings) and "52.5" not in " ".join(plan.markings)
    text = (tmp_path / "venue.yaml").read_text()
    (tmp_path / "venue.yaml").write_text(text.replace("pitch_length_m: {mean: 103.5", "pitch_length_m: {mean: -103.5"))
    assert "52.5" in " ".join(plan_of(tmp_path, [], "soccer").markings)
