"""The notebook of recipes runs from its first cell to its last, and is kept with what it shows."""

import re
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOK = ROOT / "samples" / "recipes.ipynb"

nbformat = pytest.importorskip("nbformat", reason="nbformat and nbclient come with the extra dev")
nbclient = pytest.importorskip("nbclient", reason="nbformat and nbclient come with the extra dev")


def kinds(cell):
    """What a cell shows: text, however many pieces it came in, or the richest form of a value."""
    shown = [next(iter(sorted(output.get("data", {"stream": ""})))) for output in cell.get("outputs", ())]
    return [kind for kind, before in zip(shown, [None, *shown], strict=False) if kind != "stream" or before != "stream"]


def verdicts(cell):
    """Words for what became of frames, in the order in which a cell prints them."""
    text = " ".join(
        "".join(output.get("text") or output["data"].get("text/plain", "")) for output in cell.get("outputs", ())
    )
    return re.findall(r"calibrated|refused", text)


def test_recipes_run_and_show_what_was_kept(tmp_path):
    kept = nbformat.read(NOTEBOOK, 4)
    ran = nbformat.read(NOTEBOOK, 4)
    shutil.copytree(ROOT / "samples", tmp_path / "samples")
    nbclient.NotebookClient(ran, timeout=300, resources={"metadata": {"path": str(tmp_path / "samples")}}).execute()
    assert len(kept.cells) > 20
    for before, after in zip(kept.cells, ran.cells, strict=True):
        # without pandas the last table is a list
        assert [kind for kind in kinds(before) if kind != "text/html"] == [
            kind for kind in kinds(after) if kind != "text/html"
        ] or "pandas" in before.source, before.source
        assert verdicts(before) == verdicts(after), before.source
    assert any("refused = " in cell.source and "refused" in verdicts(cell) for cell in ran.cells)


def test_the_notebook_is_small_and_says_nothing_of_a_machine():
    text = NOTEBOOK.read_text(encoding="utf-8")
    assert len(text) < 500_000
    assert "/tmp" not in text and "Traceback" not in text
