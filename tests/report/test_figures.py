"""Histograms and timelines add up."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from circlecal.report.figures import COLUMNS, clock, histogram, short, timelines
from circlecal.report.reading import FrameRow


def row(code: str | None = None, sigma: float | None = None, path: str | None = None, time: float | None = None):
    return FrameRow(
        id="x", status="refused" if code else "calibrated", code=code, stage=None, reason=None, case=None,
        sigma_px=sigma, sigma_m=None, rms_px=None, time_ms=None, path=path, time_s=time,
    )  # fmt: skip


@given(
    st.lists(st.floats(0, 1e6), max_size=30),
    st.lists(st.floats(0, 1e6), max_size=30),
)
def test_every_value_is_in_one_bar(calibrated, refused):
    drawn = histogram(calibrated, refused)
    if not calibrated and not refused:
        assert drawn is None
        return
    assert sum(bar.calibrated for bar in drawn.bars) == len(calibrated)
    assert sum(bar.refused for bar in drawn.bars) == len(refused)
    assert drawn.highest == max(bar.calibrated + bar.refused for bar in drawn.bars)
    assert 0 <= drawn.median_at <= drawn.p90_at <= 1
    assert all(-1e-9 <= tick.at <= 1 + 1e-9 for tick in drawn.ticks)


def test_wide_values_get_a_logarithmic_axis():
    drawn = histogram([0.5, 5.0, 50.0], [500.0])
    assert drawn.logarithmic
    assert {"1", "10", "100"} <= {tick.label for tick in drawn.ticks}
    narrow = histogram([2.0, 3.0, 4.0], [])
    assert not narrow.logarithmic
    assert narrow.bars[0].low == 2.0


def test_refused_stretches_with_their_reasons():
    rows = [row(), row("a"), row("b"), row("b"), row(), row("a"), row()]
    (timeline,) = timelines(rows)
    assert [(s.first, s.last, s.codes) for s in timeline.stretches] == [
        (1, 3, (("b", 2), ("a", 1))),
        (5, 5, (("a", 1),)),
    ]
    assert [column.refused for column in timeline.columns] == [0, 1, 1, 1, 0, 1, 0]


def test_each_video_has_its_own_timeline():
    rows = [row("a"), row(path="a.mp4", time=0.0), row("a", path="a.mp4", time=1.0), row("a", path="b.mp4", time=0.0)]
    assert [(t.name, t.first, t.last, t.stretch_count) for t in timelines(rows)] == [
        ("", 0, 0, 1), ("a.mp4", 1, 2, 1), ("b.mp4", 3, 3, 1),
    ]  # fmt: skip


@pytest.mark.parametrize("count", [1, 7, COLUMNS, COLUMNS + 1, 10_000])
def test_columns_cover_every_frame_once(count):
    rng = np.random.default_rng(count)
    rows = [row("a") if refused else row(sigma=2.0) for refused in rng.random(count) < 0.3]
    (timeline,) = timelines(rows)
    assert len(timeline.columns) == min(count, COLUMNS)
    covered = [k for column in timeline.columns for k in range(column.first, column.last + 1)]
    assert covered == list(range(count))
    assert sum(column.refused for column in timeline.columns) == sum(not r.calibrated for r in rows)


def test_sigma_stands_on_a_logarithmic_scale():
    (timeline,) = timelines([row(sigma=1.0), row(sigma=10.0), row(sigma=100.0), row("a")])
    assert [timeline.sigma_share(column) for column in timeline.columns[:3]] == pytest.approx([0.0, 0.5, 1.0])
    assert timeline.columns[3].sigma_px is None


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "-"), (0.0, "0"), (0.1234, "0.123"), (12.34, "12.3"), (1234.5, "1234"), (1e-7, "1.00e-07")],
)
def test_short_numbers(value, text):
    assert short(value) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0, "0:00"),
        (63.5, "1:03.5"),
        (59.997, "1:00"),
        (3723.0, "1:02:03"),
        (3600.04, "1:00:00.04"),
        (1.02, "0:01.02"),
    ],
)
def test_clock(seconds, text):
    assert clock(seconds) == text


def clip_row(k: int, shot: int, pan: float | None, focal: float | None):
    return replace(row(path="a.mp4", time=k / 25.0), pan_deg=pan, focal_px=focal, shot=shot)


def test_a_tracked_clip_shows_how_its_camera_moves_and_where_it_was_cut():
    rows = [clip_row(0, 0, -10.0, 1000.0), clip_row(1, 0, 0.0, 2000.0), clip_row(2, 0, None, None)]
    rows += [clip_row(3, 1, 30.0, 4000.0)]
    (timeline,) = timelines(rows)
    assert [column.place for column in timeline.cuts] == [3]
    pan, focal = timeline.curves
    assert (pan.low, pan.high, focal.unit) == (-10.0, 30.0, "px")
    assert [share for _, _, share in pan.heights] == pytest.approx([0.0, 0.25, 1.0])
    assert [share for _, _, share in focal.heights] == pytest.approx([0.0, 0.5, 1.0])
    assert [column.place for column, _, _ in pan.heights] == [0, 1, 3]


def test_pictures_and_still_cameras_have_no_misleading_curves():
    (pictures,) = timelines([replace(row(), pan_deg=1.0), replace(row(), pan_deg=2.0)])
    assert pictures.curves == () and pictures.cuts == ()
    (still,) = timelines([clip_row(0, 0, 5.0, 1000.0), clip_row(1, 0, 5.0, 1000.0)])
    assert [share for _, _, share in still.curves[0].heights] == [0.5, 0.5]
