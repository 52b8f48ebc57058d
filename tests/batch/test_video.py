"""`circlecal batch` on videos."""

import json
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from videos import numbered_picture, write_h264, write_video

from circlecal.cli import main
from circlecal.pictures.limits import DEFAULT_LIMITS
from circlecal.pictures.video import Sampling, Video
from circlecal.records.log import INDEX_NAME, RESULTS_NAME

from .runs import records


@pytest.fixture
def match(tmp_path: Path, frame_image: np.ndarray) -> Path:
    """Three seconds: a field, a cut to something else, the field again."""
    path = tmp_path / "match.avi"
    height, width = frame_image.shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 5.0, (width, height))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no MJPG into .avi")
    for number in range(15):
        writer.write(numbered_picture(number, width, height) if 5 <= number < 10 else frame_image)
    writer.release()
    return path


def test_a_match_with_a_cut(run_circlecal, in_this_process, match, tmp_path):
    out = tmp_path / "out"
    outcome = run_circlecal("batch", match, "--every", "1s", "--out", out, "--workers", 1, "--files", "--to", "coco")
    assert outcome.code == 1
    assert outcome.out.startswith("3 frames: 2 calibrated, 1 refused")
    found = {record["id"]: record for record in records(out)}
    assert [found[name]["status"] for name in sorted(found)] == ["calibrated", "refused", "calibrated"]
    assert [found[name]["source"] for name in sorted(found)] == [
        {"path": str(match), "time_s": float(time), "bytes": match.stat().st_size} for time in range(3)
    ]
    names = {path.name for path in out.iterdir()}
    assert {"match_00-00-02.000.json", "match_00-00-02.000.overlay.jpg", "coco.json"} <= names
    assert "match_00-00-02.000.jpg" in (out / "coco.json").read_text()

    again = run_circlecal("batch", match, "--every", "1s", "--out", out, "--workers", 1, "--files")
    assert "3/3 frames" in again.err
    assert "(3 from before)" in again.err
    more = run_circlecal("batch", match, "--every", "3", "--start", "1", "--end", "0:02", "--out", out, "--workers", 1)
    assert more.out.startswith("2 frames: 0 calibrated, 2 refused")
    assert len(records(out)) == 4


def test_masks_of_a_video_are_named_like_its_frames(run_circlecal, in_this_process, match, frame_image, tmp_path):
    masks, out = tmp_path / "given", tmp_path / "out"
    masks.mkdir()
    mask = (frame_image.min(axis=2) > 170).astype(np.uint8) * 255
    cv2.imwrite(str(masks / "match_00-00-00.000.png"), mask)
    run_circlecal("batch", match, "--every", "2s", "--out", out, "--workers", 1, "--mask", masks)
    found = {record["id"]: record for record in records(out)}
    assert found["match_00-00-00.000"]["status"] == "calibrated"
    assert "no mask for match_00-00-02.000" in found["match_00-00-02.000"]["reason"]
    assert found["match_00-00-02.000"]["source"]["time_s"] == 2.0
    one = run_circlecal("batch", match, "--out", out, "--mask", masks / "match_00-00-00.000.png")
    assert one.code == 2
    assert "one file for all frames of a video" in one.err


def test_pixels_that_are_not_square(run_circlecal, in_this_process, frame_image, tmp_path):
    match = write_h264(tmp_path / "match.mp4", [frame_image] * 3, aspect=Fraction(16, 15))
    run_circlecal("batch", match, "--every", "1s", "--out", tmp_path / "out", "--workers", 1)
    [record] = records(tmp_path / "out")
    camera = record["camera"] or record["rejected_estimate"]["camera"]
    assert camera["y_focal_length"] / camera["x_focal_length"] == pytest.approx(16 / 15)


def test_pictures_and_videos_together(run_circlecal, tmp_path):
    folder = tmp_path / "day"
    folder.mkdir()
    write_video(folder / "a.avi", "MJPG", 50)
    write_video(folder / "b.avi", "MJPG", 25)
    cv2.imwrite(str(folder / "c.png"), numbered_picture(0))
    out = tmp_path / "out"
    assert run_circlecal("batch", folder, "--out", out, "--workers", 2, "-q").code == 1
    expected = ["a_00-00-00.000", "a_00-00-01.000", "b_00-00-00.000", "c"]
    assert sorted(record["id"] for record in records(out)) == expected


def test_annotations_and_truth_in_a_folder_of_videos_are_no_frames_unless_their_format_is_named(
    run_circlecal, in_this_process, tmp_path
):
    folder = tmp_path / "clips"
    (folder / "truth").mkdir(parents=True)
    write_video(folder / "a.avi", "MJPG", 25)
    (folder / "truth" / "a.json").write_text('{"shots": [], "tripod": {}, "frames": []}')
    alone = run_circlecal("batch", folder, "--out", tmp_path / "alone", "--workers", 1)
    assert alone.code == 1 and "error" not in alone.err, alone
    assert [record["id"] for record in records(tmp_path / "alone")] == ["a_00-00-00.000"]
    named = run_circlecal("batch", folder, "--from", "coco", "--out", tmp_path / "named", "--workers", 1)
    assert named.code == 2 and "a.json" in named.err


def test_a_run_in_the_folder_of_its_videos_goes_on(run_circlecal, in_this_process, tmp_path):
    write_video(tmp_path / "a.avi", "MJPG", 50)
    command = "batch", tmp_path, "--out", tmp_path, "--workers", 1, "--files"
    assert run_circlecal(*command).code == 1
    outcome = run_circlecal(*command)
    assert outcome.code == 1 and "(2 from before)" in outcome.err, outcome
    assert len(records(tmp_path)) == 2


def test_a_video_that_was_replaced_is_not_gone_on_with(run_circlecal, in_this_process, tmp_path):
    """Also where other times of it are asked for than before, after a picture, and behind frames of other videos."""
    cv2.imwrite(str(tmp_path / "c.png"), numbered_picture(0))
    first, path = write_video(tmp_path / "a.avi", "MJPG", 50), write_video(tmp_path / "b.avi", "MJPG", 50)
    out = tmp_path / "out"
    assert run_circlecal("batch", first, path, tmp_path / "c.png", "--out", out, "--workers", 1, "--end", "1").code == 1
    before = (out / RESULTS_NAME).read_bytes()
    write_video(path, "MJPG", 75)
    outcome = run_circlecal("batch", tmp_path / "c.png", path, "--out", out, "--workers", 1, "--start", "1")
    assert outcome.code == 2
    assert f"error: {out}: holds frames of {path}, which has changed since; use another --out" in outcome.err
    assert (out / RESULTS_NAME).read_bytes() == before
    assert run_circlecal("batch", first, "--out", out, "--workers", 1, "--start", "1").code == 1


def test_frames_of_earlier_versions_without_the_size_of_their_video_are_gone_on_with(
    run_circlecal, in_this_process, tmp_path
):
    path, out = write_video(tmp_path / "a.avi", "MJPG", 50), tmp_path / "out"
    run_circlecal("batch", path, "--out", out, "--workers", 1, "--end", "1")
    [record] = records(out)
    del record["source"]["bytes"]
    (out / RESULTS_NAME).write_text(json.dumps(record) + "\n")
    (out / INDEX_NAME).unlink()
    outcome = run_circlecal("batch", path, "--out", out, "--workers", 1)
    assert outcome.code == 1 and "(1 from before)" in outcome.err, outcome


def test_the_size_is_that_of_the_video_when_it_was_opened(tmp_path):
    """One that is still written to is known as another one at the next start."""
    path = write_video(tmp_path / "a.avi", "MJPG", 50)
    video, size = Video.open(path, "a", DEFAULT_LIMITS), path.stat().st_size
    with path.open("ab") as file:
        file.write(bytes(100))
    assert [frame.bytes for frame in video.frames(Sampling.parse("1s"))] == [size, size]


def test_a_truncated_video_is_one_line_and_the_rest_goes_on(run_circlecal, in_this_process, tmp_path):
    path = write_video(tmp_path / "a.avi", "MJPG", 200)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    other = write_video(tmp_path / "b.avi", "MJPG", 50)
    outcome = run_circlecal("batch", path, other, "--out", tmp_path / "out", "--workers", 1)
    assert outcome.code == 1
    assert len([line for line in outcome.err.splitlines() if "a.avi: ends at 00:00:0" in line]) == 1
    assert "error" not in outcome.err
    assert sum(record["id"].startswith("b_") for record in records(tmp_path / "out")) == 2


@pytest.mark.parametrize("content", [b"", b"no video", b"\0\0\0\x18ftypmp42" + bytes(500)])
def test_no_video_is_one_line(capfd, tmp_path, content):
    """Of the libraries that decode, too, which write where Python's streams do not lead."""
    path = tmp_path / "match.mp4"
    path.write_bytes(content)
    with pytest.raises(SystemExit) as ended:
        main(["batch", str(path), "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    told = capfd.readouterr().err
    assert len(told.splitlines()) == 1
    assert f"{path}: is no video" in told
    assert not (tmp_path / "out" / RESULTS_NAME).exists()


def test_a_video_that_cannot_be_read_leaves_the_other_inputs(run_circlecal, in_this_process, frame_file, tmp_path):
    (tmp_path / "match.mp4").write_bytes(b"no video")
    command = "batch", tmp_path / "match.mp4", frame_file, "--out", tmp_path / "out", "--workers", 1
    outcome = run_circlecal(*command)
    assert outcome.code == 2 and "match.mp4: is no video" in outcome.err
    assert "1 calibrated" in outcome.out and (tmp_path / "out" / RESULTS_NAME).is_file()


def test_a_video_in_calibrate_and_choices_without_one(run_circlecal, match, frame_file, tmp_path):
    outcome = run_circlecal("calibrate", match, "--out", tmp_path / "out")
    assert outcome.code == 2
    assert "is a video; circlecal batch takes it" in outcome.err
    outcome = run_circlecal("calibrate", "http://127.0.0.1:1/picture.jpg", "--out", tmp_path / "out")
    assert outcome.code == 2
    assert "http://127.0.0.1:1/picture.jpg: is a URL; circlecal batch takes it" in outcome.err
    outcome = run_circlecal("batch", frame_file, "--every", "2s", "--out", tmp_path / "out")
    assert outcome.code == 2
    assert "no video is given" in outcome.err
