"""An end of a line is left out where a player hid the real one, and kept where another sport's line is crossed."""

import numpy as np
import pytest

from circlecal.geometry.projective import fit_line
from circlecal.observations import LineEnd
from circlecal.paint.hidden_ends import leave_out_hidden_ends
from circlecal.results import LineCue, Segment

BORDER_ROW, BOARDS_ROW = 195.0, 165.0


def line_through(start, end, *ends):
    points = np.linspace(start, end, 100)
    seen_ends = tuple(LineEnd(np.array(point), True) for point in ends)
    return LineCue(None, fit_line(points), points, np.full(100, 0.2), Segment(points[0], points[-1]), 0.2, seen_ends)


def halfway_line(last_row, *end_rows):
    return line_through((800.0, 700.0), (780.0, last_row), *((779.0, row) for row in end_rows))


def test_an_end_on_the_boards_behind_a_player_is_left_out():
    border = line_through((100.0, BORDER_ROW - 10.0), (1500.0, BORDER_ROW + 10.0))
    told = leave_out_hidden_ends(halfway_line(202.0, BOARDS_ROW, 900.0), [border], 1.0)
    assert [end.point_px[1] for end in told.ends] == [900.0]


@pytest.mark.parametrize(
    ("last_row", "end_row", "columns"),
    [
        (168.0, BOARDS_ROW, (100.0, 1500.0)),  # its paint was measured beyond the other line
        (230.0, BOARDS_ROW, (100.0, 1500.0)),  # it stops before that line
        (202.0, BORDER_ROW - 3.0, (100.0, 1500.0)),  # it ends on that line
        (202.0, BORDER_ROW - 12.0, (100.0, 1500.0)),  # it ends on a border right behind another sport's
        (202.0, BOARDS_ROW, (100.0, 790.0)),  # the other line is seen on one side only
    ],
)
def test_other_ends_are_kept(last_row, end_row, columns):
    border = line_through((columns[0], BORDER_ROW), (columns[1], BORDER_ROW))
    line = halfway_line(last_row, end_row)
    assert leave_out_hidden_ends(line, [border], 1.0) is line


def test_a_line_that_runs_alongside_hides_no_end():
    line = halfway_line(202.0, BOARDS_ROW)
    assert leave_out_hidden_ends(line, [line_through((770.0, 700.0), (778.0, 190.0))], 1.0) is line
