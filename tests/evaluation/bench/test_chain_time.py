"""Time of the chain against decoding."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from circlecal.cli.app import app
from circlecal.config import Config
from circlecal.errors import InputError
from circlecal.evaluation.bench.chain_time import least, time_chain, time_file
from circlecal.synthetic.sampling import render_frame


@pytest.fixture(scope="module")
def jpeg():
    rendering = render_frame("easy", np.random.default_rng(3), 640, 360)
    return np.asarray(cv2.imencode(".jpg", rendering.image)[1])


def test_every_stage_has_its_time(jpeg):
    found = time_chain("easy", jpeg, Config(), runs=2)
    assert (found.frame, found.width, found.height, found.status) == ("easy", 640, 360, "calibrated")
    assert {"mask", "edges", "rays", "ellipse", "cues", "camera", "verdict"} <= set(found.stage_ms)
    assert 0 < max(found.stage_ms.values()) <= found.chain_ms
    assert found.times_decoding == found.chain_ms / found.decoding_ms
    assert found.decoding_in_turn_ms > 0


def test_what_is_no_picture_is_named():
    for contents in (np.zeros(0, np.uint8), np.arange(40, dtype=np.uint8)):
        with pytest.raises(InputError, match=r"note\.txt: not a picture"):
            time_chain("note.txt", contents, Config())
    with pytest.raises(InputError, match=r"away\.jpg: No such file"):
        time_file(Path("away.jpg"), Config())


def test_least_time_of_each_step():
    assert least([{"a": 2.0, "b": 5.0}, {"a": 3.0, "b": 1.0, "c": 4.0}]) == {"a": 2.0, "b": 1.0, "c": 4.0}
    assert least([]) == {}


def test_command_prints_one_picture(jpeg, tmp_path):
    path = tmp_path / "frame.jpg"
    path.write_bytes(jpeg.tobytes())
    shown = CliRunner().invoke(app, ["bench", "detect", "--picture", str(path)])
    assert shown.exit_code == 0
    assert "frame.jpg, 640x360, calibrated" in shown.output
    assert "cues" in shown.output
