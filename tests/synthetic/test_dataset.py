"""Folders of frames: complete, repeatable, and refused when asked for nonsense."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from circlecal.cli.synth import Profile
from circlecal.errors import InputError
from circlecal.pictures.files import find_frames
from circlecal.pictures.masks import find_mask
from circlecal.synthetic.dataset import write_dataset
from circlecal.synthetic.samples import write_samples
from circlecal.synthetic.sampling import SCENE_PROFILES

SIZE = (480, 270)
SAMPLES = Path(__file__).parents[2] / "samples"


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_files(tmp_path):
    ids = write_dataset(tmp_path, 3, 5, ("easy", "negative"), SIZE)
    assert ids == ["easy_00000", "negative_00001", "easy_00002"]
    for frame_id in ids:
        image = cv2.imread(str(tmp_path / f"{frame_id}.jpg"))
        assert image.shape == (270, 480, 3)
        record = json.loads((tmp_path / "truth" / f"{frame_id}.json").read_text())
        assert record["id"] == frame_id
        assert (record["width"], record["height"]) == SIZE
        mask_file = tmp_path / f"{frame_id}.mask.png"
        if mask_file.exists():
            mask = cv2.imread(str(mask_file), cv2.IMREAD_UNCHANGED)
            assert mask.shape == (270, 480)
            assert np.sum(mask == 7) == record["circle_pixels"]
        else:
            assert record["circle_pixels"] == 0


def test_a_frame_depends_on_seed_and_number_only(tmp_path):
    write_dataset(tmp_path / "one", 1, 5, ("hard",), SIZE)
    write_dataset(tmp_path / "two", 2, 5, ("hard",), SIZE)
    write_dataset(tmp_path / "other", 1, 6, ("hard",), SIZE)
    one, two, other = (contents(tmp_path / name) for name in ("one", "two", "other"))
    assert one.items() <= two.items()
    assert one["hard_00000.jpg"] != other["hard_00000.jpg"]


def test_without_masks_and_with_progress(tmp_path):
    finished = []
    write_dataset(tmp_path, 2, 0, ("easy",), SIZE, masks=False, report=finished.append)
    assert finished == [1, 2]
    assert not list(tmp_path.glob("*.mask.png"))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"count": 0}, "count"),
        ({"seed": -1}, "seed"),
        ({"profiles": ()}, "profile"),
        ({"profiles": ("moon",)}, "moon"),
        ({"size": (10, 10)}, "size 10x10"),
        ({"size": (1920, 99999)}, "size"),
    ],
)
def test_nonsense_is_refused(tmp_path, change, reason):
    arguments = {"count": 1, "seed": 0, "profiles": ("easy",), "size": SIZE, **change}
    with pytest.raises(InputError, match=reason):
        write_dataset(tmp_path / "out", **arguments)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("wrong", [["--seconds", "nan"], ["--seconds", "inf"], ["--rate", "nan"]])
def test_clips_of_no_length(tmp_path, run_circlecal, wrong):
    outcome = run_circlecal("synth", tmp_path / "out", "--video", "still", *wrong)
    assert (outcome.code, len(outcome.err.splitlines())) == (2, 1)
    assert "is out of range; up to 600 s at 1 to 120 can be rendered" in outcome.err


def test_a_clip_of_a_hipped_pitch(tmp_path, run_circlecal):
    size = ("--size", "320x180", "--seconds", 0.2, "--rate", 5)
    assert run_circlecal("synth", tmp_path, "--video", "still", *size, "--surface", "hip").code == 0
    (truth,) = (tmp_path / "truth").glob("*.json")
    pitch = json.loads(truth.read_text())["pitch"]
    assert (pitch["crown_shape"], pitch["crown_m"] > 0.0) == ("hip", True)


@pytest.mark.parametrize("arguments", [["synth", "FILE"], ["synth", "FILE", "--video", "still"]])
def test_a_file_in_place_of_the_folder(tmp_path, run_circlecal, arguments):
    path = tmp_path / "file"
    path.touch()
    outcome = run_circlecal(*(path if word == "FILE" else word for word in arguments))
    told = f"circlecal: error: {path}: is a file, not a folder; choose another OUT\n"
    assert (outcome.code, outcome.err) == (2, told)


def test_command(tmp_path, run_circlecal):
    out = tmp_path / "frames"
    outcome = run_circlecal("synth", out, "--count", 2, "--profile", "easy", "--size", "480x270", "--no-masks")
    assert outcome.code == 0
    assert len(list(out.glob("*.jpg"))) == 2
    assert len(list((out / "truth").glob("*.json"))) == 2
    assert outcome.err == ""
    assert "2 frames" in outcome.out


@pytest.mark.parametrize(
    "arguments",
    [
        ("--size", "large"),
        ("--size", "1x"),
        ("--count", "0"),
        ("--profile", "moon"),
        ("--count", "1", "--interlaced"),
        ("--count", "1", "--surface", "hip"),
        ("--video", "still", "--profile", "rink", "--surface", "hip"),
    ],
)
def test_command_refuses(tmp_path, run_circlecal, arguments):
    assert run_circlecal("synth", tmp_path / "out", *arguments).code == 2
    assert not (tmp_path / "out").exists()


def test_command_knows_every_profile():
    assert [profile.value for profile in Profile] == list(SCENE_PROFILES)


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """The folder of the samples, written anew, and their ids."""
    folder = tmp_path_factory.mktemp("samples")
    return folder, write_samples(folder)


def test_samples(samples):
    folder, ids = samples
    files = contents(folder)
    assert sum(map(len, files.values())) < 2_500_000
    truth = {i: json.loads(files[f"truth/{i}.json"]) for i in ids}
    assert truth["full_circle"]["center_mark"] == "visible"
    assert truth["hidden_mark"]["center_mark"] == "hidden"
    assert {i for i, t in truth.items() if t["expect"] == "refuse"} == {"penalty_area", "touchline_only"}
    assert truth["penalty_area"]["circle_pixels"] == 0


def test_the_committed_truth_of_the_samples_is_that_of_their_cameras(samples):
    """Pixels are counted in the committed pictures, whose players stand elsewhere; everything else is geometry."""
    folder, ids = samples
    for name in ids:
        written, kept = (json.loads((root / "truth" / f"{name}.json").read_text()) for root in (folder, SAMPLES))
        assert written.keys() == kept.keys()
        for key in written.keys() - {"circle_pixels", "halfway_pixels"}:
            assert flat(written[key]) == pytest.approx(flat(kept[key])), f"{name}: {key}"


def flat(value):
    """All numbers and words of a JSON value in one list."""
    if isinstance(value, dict):
        return [one for key in value for one in flat(value[key])]
    return [one for item in value for one in flat(item)] if isinstance(value, list) else [value]


def test_samples_show_the_detector(samples):
    """A mask beside a picture would be taken instead."""
    folder, ids = samples
    frames = find_frames([folder])
    for frame in frames:
        assert find_mask(frame, None) is None
        assert find_mask(frame, folder / "segmentation").name == f"{frame.id}.mask.png"
    assert sorted(frame.id for frame in frames) == sorted(ids)
