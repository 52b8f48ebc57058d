"""The index of results: its rows, in pages, and what is left open where somebody stops reading them."""

from __future__ import annotations

import gc
from pathlib import Path

import pytest

from circlecal.records import index as index_module
from circlecal.records.index import ResultIndex
from circlecal.records.summary import FrameSummary


def _index(path: Path, count: int) -> ResultIndex:
    """An index of so many frames, entered from the last one to the first."""
    index = ResultIndex(path)
    rows = (FrameSummary(f"{k:03d}", "refused", "lost", None, None, None, None, None) for k in range(count))
    index.add(reversed(list(rows)), 1, "digest")
    return index


@pytest.mark.parametrize("page", [1, 4, 10, 1000])
def test_all_rows_come_in_order_whatever_the_pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, page: int) -> None:
    monkeypatch.setattr(index_module, "_PAGE", page)
    index = _index(tmp_path / "results.index", 12)
    assert [row.id for row in index.rows()] == [f"{k:03d}" for k in range(12)]
    index.close()


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_a_database_is_closed_while_somebody_stands_among_its_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Ctrl-C leaves it while tables are written: nothing is printed of a cursor that cannot be closed any more."""
    found: list[object] = []
    monkeypatch.setattr("sys.unraisablehook", found.append)
    index = _index(tmp_path / "results.index", 12)
    rows = index.rows()
    assert next(rows).id == "000"
    index.close()
    del rows
    gc.collect()
    assert not found
