"""The page about the pipeline tells what is tried again as the code has it."""

import re
from pathlib import Path

import circlecal.pipeline
from circlecal.pipeline.placed_view import ALL_MARKINGS
from circlecal.pipeline.refinements import REFINEMENTS, RESIZE
from circlecal.pipeline.run import OTHER_INTERPRETATIONS

PAGE = (Path(circlecal.pipeline.__file__).parent / "README.md").read_text()


def test_every_retry_has_its_row_in_the_order_in_which_it_is_tried():
    rows = re.findall(r"^\| `(\w+)` \|", PAGE, flags=re.MULTILINE)
    retries = (*REFINEMENTS, RESIZE, *OTHER_INTERPRETATIONS, ALL_MARKINGS)
    assert rows == [retry.how.__name__ for retry in retries]


def test_what_the_drawing_names_exists():
    drawing = PAGE.partition("```text")[2].partition("```")[0]
    files = {path.stem: path.read_text() for path in Path(circlecal.pipeline.__file__).parent.glob("*.py")}
    named = re.findall(r"\b(\w+)\.(\w+)", drawing)
    assert len(named) > 5
    for module, name in named:
        assert re.search(rf"^def {name}\(", files[module], flags=re.MULTILINE), f"{module}.{name}"
    everything = "\n".join(files.values())
    for name in re.findall(r"\b([A-Z]+(?:_[A-Z]+)*)\b", drawing):
        assert re.search(rf"^{name} = ", everything, flags=re.MULTILINE), name
