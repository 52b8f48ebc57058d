"""A calibrated record of a small painted frame, and folders of results made from it."""

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import pytest

from circlecal.config import Config
from circlecal.field import load_field
from circlecal.pipeline import run
from circlecal.records.json_text import parse_sound_parts, result_line
from circlecal.records.log import RESULTS_NAME
from circlecal.records.record import ResultRecord
from circlecal.records.writing import failure_record, result_record
from circlecal.results import Verdict

Record = dict[str, Any]


@pytest.fixture(scope="session")
def good_record(frame_image) -> Record:
    calibration = run(frame_image, Config(), frame_id="good")
    assert calibration.status == "calibrated"
    return json.loads(result_line(result_record(calibration, load_field("soccer"))))


@pytest.fixture(scope="session")
def light_record(good_record) -> Record:
    """The same without the observations, as long as records of thousands of frames may be in a test."""
    return good_record | {"observations": None, "inliers": None}


@pytest.fixture(scope="session")
def named(light_record) -> Callable[..., Record]:
    """A calibrated record under another id, with changes."""

    def change(name: str, sigma_px: float | None = None, path: str = "gone.png", **changes: Any) -> Record:
        record = copy.deepcopy(light_record) | {"id": name, "source": {"path": path, "time_s": None}} | changes
        if sigma_px is not None:
            record["camera"]["max_sigma_px"] = sigma_px
        return record

    return change


def refused(name: str, code: str = "no_field", reason: str = "no playing field", stage: str = "mask") -> Record:
    record = json.loads(
        result_line(failure_record(name, "gone.png", Verdict("refused", code, reason, stage), 0, "abc"))
    )
    return record | {"image": {"width": 960, "height": 540}, "timings_ms": {"mask": 12.5}}


def sound(record: Record) -> ResultRecord:
    """The record as the report has it, without what is damaged in it."""
    return parse_sound_parts(json.dumps(record).encode())


def write_run(folder: Path, records: list[Record]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / RESULTS_NAME).write_text("".join(json.dumps(record) + "\n" for record in records))
    return folder


@pytest.fixture
def picture_file(tmp_path, frame_image) -> Path:
    path = tmp_path / "pictures" / "good.png"
    path.parent.mkdir()
    cv2.imwrite(str(path), frame_image)
    return path
