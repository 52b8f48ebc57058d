import numpy as np

from circlecal.detection.lines import StraightRun, find_straight_runs
from circlecal.detection.ridges import RidgePoints

SIZE = (960, 540)


def ridge_points(*curves: np.ndarray) -> RidgePoints:
    """Ridge points along polylines with one point per pixel, 0.2 px noise, and 300 stray ones."""
    random = np.random.default_rng(5)
    points = [curve + random.normal(0, 0.2, curve.shape) for curve in curves]
    normals = [_normals(curve, random) for curve in curves]
    stray = random.uniform((0, 0), SIZE, (300, 2))
    turn = random.uniform(0, np.pi, 300)
    all_points = np.concatenate([*points, stray])
    all_normals = np.concatenate([*normals, np.stack([np.cos(turn), np.sin(turn)], axis=-1)])
    return RidgePoints(all_points, all_normals, np.full(len(all_points), 50))


def _normals(curve: np.ndarray, random: np.random.Generator) -> np.ndarray:
    tangent = np.gradient(curve, axis=0)
    angle = np.arctan2(tangent[:, 0], -tangent[:, 1]) + random.normal(0, 0.05, len(curve))
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def straight(start: tuple[float, float], end: tuple[float, float]) -> np.ndarray:
    return np.linspace(start, end, int(np.hypot(end[0] - start[0], end[1] - start[1])))


def found(ridges: RidgePoints, minimum: float = 100.0) -> list[StraightRun]:
    return find_straight_runs(ridges, SIZE, minimum)


def test_two_crossing_lines_longest_first() -> None:
    ridges = ridge_points(straight((100, 50), (900, 480)), straight((500, 20), (420, 520)))
    runs = found(ridges)
    assert len(runs) == 2
    for run, (start, end) in zip(runs, [((100, 50), (900, 480)), ((500, 20), (420, 520))], strict=True):
        ends = np.array(sorted([run.start.tolist(), run.end.tolist()], key=lambda p: abs(p[0] - start[0])))
        np.testing.assert_allclose(ends, [start, end], atol=3.0)
        assert run.support > 0.9


def test_every_point_belongs_to_one_line_at_most() -> None:
    runs = found(ridge_points(straight((100, 50), (900, 480)), straight((500, 20), (420, 520))))
    members = np.concatenate([run.members for run in runs])
    assert len(members) == len(np.unique(members))


def test_small_gaps_are_bridged_and_large_ones_are_not() -> None:
    bridged = found(ridge_points(straight((100, 300), (400, 300)), straight((420, 300), (700, 300))))
    assert [round(run.length, -1) for run in bridged] == [600]
    apart = found(ridge_points(straight((100, 300), (400, 300)), straight((480, 300), (700, 300))))
    assert [round(run.length, -1) for run in apart] == [300, 220]


def test_a_curve_is_not_a_long_line() -> None:
    angle = np.linspace(0, 2 * np.pi, 1400)
    circle = np.stack([480 + 250 * np.cos(angle), 270 + 90 * np.sin(angle)], axis=-1)
    assert all(run.length < 0.16 * SIZE[0] for run in found(ridge_points(circle), minimum=60.0))


def test_stray_points_are_no_line() -> None:
    assert found(ridge_points()) == []
