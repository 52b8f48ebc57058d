"""Frames of one camera in the benchmarks: row 10 beside its bound, and matches of annotated sets."""

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.evaluation.bench.accuracy import all_row_names, run_rig_row
from circlecal.evaluation.bench.many_frames import select_rigs
from circlecal.evaluation.bench.other_frames import LEAST_FRAMES, calibrate_with_other_frames, matches
from circlecal.observations import Observations
from circlecal.pipeline import field_of
from circlecal.synthetic.cameras import sample_camera
from circlecal.synthetic.markings import circle_points, line_points


def test_row_names():
    assert {"10", "10w", "10d"} <= set(all_row_names())
    assert [s.row for s in select_rigs(["10"])] == ["10", "10w", "10t", "10d"]
    assert [s.row for s in select_rigs(["10d", "5"])] == ["10d"]
    assert select_rigs(["5"]) == []


def test_frames_together_reach_the_bound():
    row = run_rig_row(select_rigs(["10w"])[0], 2, 0)
    assert row.failed == row.wrong == 0.0
    assert row.median_px < 3 * row.bound_median_px
    assert 0.2 < row.efficiency < 2.5
    assert row.bound_median_px < 0.5


def test_matches_end_where_the_camera_changes():
    rng = np.random.default_rng(0)
    stands = [(np.array([0.0, 70.0, -13.0]), 9), (np.array([0.0, 92.0, -17.0]), 6), (np.array([0.0, 66.0, -14.5]), 8)]
    positions = {}
    for stand, count in stands:
        for _ in range(count):
            # the peers err along the viewing ray
            positions[str(len(positions))] = stand * (1 + 0.03 * rng.normal(size=(2, 1)))
    positions["4"] = np.zeros((0, 3))
    names = [name for name in positions if name != "4"]
    assert matches(positions) == [names[:8], names[8:14], names[14:]]


def test_frames_of_many_games_are_no_match():
    rng = np.random.default_rng(1)
    positions = {str(k): np.array([[rng.normal(0, 5), rng.uniform(45, 95), -rng.uniform(6, 25)]]) for k in range(20)}
    assert matches(positions) == []
    assert matches({str(k): np.array([[0.0, 70.0, -13.0]]) for k in range(LEAST_FRAMES - 1)}) == []
    assert matches({}) == []


def test_other_frames_tell_the_camera():
    config = load_config("annotations", ["camera.starts=2", "camera.iterations=30"])
    template, circle = field_of(config)
    rng = np.random.default_rng(2)
    first = sample_camera("broadcast", rng, kappa=0.033)
    views = [first] + [sample_camera("broadcast", rng, kappa=0.033, like=first) for _ in range(3)]
    everything, targets = {}, {}
    for k, camera in enumerate(views):
        circles = (circle_points(camera, template, "outer", 30, 0.7, rng),)
        named = [line.name for line in template.lines]
        seen = [line_points(camera, template, name, 12, 0.7, rng) for name in named]
        lines = tuple(line for line in seen if len(line.points_px) >= 4)
        everything[str(k)] = Observations(1920, 1080, circles, lines)
        targets[str(k)] = Observations(1920, 1080, circles, tuple(s for s in lines if s.line == "halfway_line"))
    found = calibrate_with_other_frames({"0": targets["0"]}, everything, [list(everything)], template, circle, config)
    camera = found["0"].camera
    assert camera.position_m == pytest.approx(first.position_m, abs=2.5)
    assert calibrate_with_other_frames({"0": targets["0"]}, everything, [], template, circle, config).keys() == {"0"}
