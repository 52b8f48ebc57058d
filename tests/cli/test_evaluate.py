"""``circlecal evaluate``: from folders to figures."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from evaluation.scenes import look_at_circle, write_set  # noqa: F401

SAMPLES = Path(__file__).parents[2] / "samples"


@pytest.fixture
def folders(write_set):  # noqa: F811
    cameras = {f"{k}": look_at_circle(x=float(k), pan=0.4 * k) for k in range(4)}
    truth, exact = write_set(cameras, {k: cameras[k] for k in "012"}, "exact")
    _, off = write_set(cameras, {k: look_at_circle(x=float(k), pan=0.4 * int(k) + 0.25) for k in cameras}, "off")
    return truth, exact, off


@pytest.fixture
def run_of_samples(run_circlecal, tmp_path):
    """Results of one sample, whose picture and truth are in the folder ``samples`` beside them."""
    for name in ("full_circle.jpg", "truth/full_circle.json"):
        copy = tmp_path / "samples" / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(SAMPLES / name, copy)
    picture = tmp_path / "samples" / "full_circle.jpg"
    assert run_circlecal("calibrate", picture, "--out", tmp_path / "run", "--no-overlay").code == 0
    return tmp_path / "run"


def methods_of(outcome):
    assert outcome.code == 0, outcome
    return {m["name"]: m for m in json.loads(outcome.out)["methods"]}


def test_exact_cameras_and_a_missing_one(run_circlecal, folders):
    truth, exact, off = folders
    found = methods_of(run_circlecal("evaluate", truth, exact, "--compare", f"off={off}", "--json"))
    summary = found["exact"]["summary"]
    assert (summary["frames"], summary["answered"], summary["completeness"]) == (4, 3, 0.75)
    five = summary["accuracies"][0]
    assert five["threshold_px"] == 5
    assert five["answered"] == 1.0
    assert five["final"] == pytest.approx(0.75)
    assert summary["mean_error_px"] < 0.05
    assert found["off"]["summary"]["accuracies"][0]["final"] < 0.5
    assert found["off"]["behind_first"]["mean"] > 0
    assert found["exact"]["median_ground_m"] < 0.01


def test_a_method_of_other_frames_is_told(run_circlecal, folders):
    truth, exact, off = folders
    for path in list(off.iterdir()):
        path.rename(path.with_name(path.name.replace("camera_", "camera_other_")))
    words = f"{off}: has a camera for none of the 4 frames of {truth}; files are of one frame where"
    told = " ".join(run_circlecal("evaluate", truth, exact, "--compare", f"off={off}").err.split())
    assert words in told
    assert str(exact) not in told
    alone = run_circlecal("evaluate", truth, off)
    assert (alone.code, alone.out) == (2, "")
    assert words in alone.err
    assert run_circlecal("evaluate", exact, off).code == 2


def test_another_size_gives_the_same(run_circlecal, folders):
    truth, exact, _ = folders
    found = methods_of(run_circlecal("evaluate", truth, exact, "--size", "1920x1080", "--json"))
    assert found["exact"]["summary"]["accuracies"][0]["answered"] == 1.0
    wrong = methods_of(run_circlecal("evaluate", truth, exact, "--pred-size", "1920x1080", "--json"))
    assert wrong["exact"]["summary"]["accuracies"][0]["answered"] < 0.1


def test_tables(run_circlecal, folders):
    truth, exact, _ = folders
    outcome = run_circlecal("evaluate", truth, exact, "-t", 3, "--held-out", "Side line top")
    assert outcome.code == 0, outcome
    header = outcome.out.splitlines()[1].split("\t")
    row = dict(zip(header, outcome.out.splitlines()[2].split("\t"), strict=True))
    assert row["answered"] == "3 of 4"
    assert {"JaC3", "JaC5", "JaC10", "JaC20"} <= row.keys()
    assert row["JaC5"] == "100.0"
    assert "Circle central" in outcome.out


def test_central_views(run_circlecal, folders, tmp_path):
    truth, exact, _ = folders
    kept = json.loads((truth / "0.json").read_text())
    (truth / "0.json").write_text(json.dumps({k: kept[k] for k in ("Circle central", "Middle line")}))
    central = methods_of(run_circlecal("evaluate", truth, exact, "--central", "--json"))
    frames = central["exact"]["summary"]["frames"]
    assert 1 <= frames <= 4
    (truth / "0.json").write_text(json.dumps({"Middle line": kept["Middle line"]}))
    for k in "123":
        (truth / f"{k}.json").unlink()
    outcome = run_circlecal("evaluate", truth, exact, "--central")
    assert outcome.code == 2
    assert "fewer than three" in outcome.err


def test_true_cameras_and_homographies(run_circlecal, folders, tmp_path):
    _, exact, off = folders
    outcome = run_circlecal("evaluate", exact, off, "--compare", f"same={exact}", "--json")
    found = methods_of(outcome)
    assert found["same"]["mean"]["iou_part"] == 1.0
    assert found["same"]["ground_m"][1] < 1e-3
    assert found["off"]["ground_m"][0] > 0.05
    assert "IoU part" in run_circlecal("evaluate", exact, off).out
    matrices = tmp_path / "matrices"
    matrices.mkdir()
    for k in "012":
        H = np.linalg.inv(look_at_circle(x=float(k), pan=0.4 * int(k)).homography)
        yards = np.array([[1 / 0.9144, 0, 57.5], [0, 1 / 0.9144, 37.0], [0, 0, 1]])
        scale = np.diag([959 / 1279, 539 / 719, 1.0])
        (matrices / f"{k}.homographyMatrix").write_text(" ".join(map(repr, (yards @ H @ scale).ravel().tolist())))
    found = methods_of(run_circlecal("evaluate", matrices, exact, "--json"))
    assert found["exact"]["median"]["reprojection"] < 1e-3
    assert found["exact"]["ground_m"][0] < 0.02


def test_rendered_frames_and_results(run_circlecal, run_of_samples, tmp_path):
    samples = run_of_samples.parent / "samples"
    found = methods_of(run_circlecal("evaluate", samples / "truth", run_of_samples, "--json"))["run"]
    assert (found["frames"], found["answered"]) == (1, 1)
    assert found["ground_m"][1] < 0.05
    turned = methods_of(run_circlecal("evaluate", run_of_samples, samples / "truth", "--json"))["truth"]
    assert turned["ground_m"][1] < 0.05
    told = run_circlecal("evaluate", samples / "truth", run_of_samples, "--central")
    assert (told.code, "line annotations" in told.err) == (2, True)
    truth = json.loads((samples / "truth" / "full_circle.json").read_text())
    # of another sport it was said to hold no camera, although every file of it is one
    other_sport = "holds cameras of futsal, and the metrics are those of soccer fields; give frames of these"
    for change, words in (({"field": "futsal"}, other_sport), ({"expect": "refuse"}, "holds no camera")):
        (samples / "truth" / "full_circle.json").write_text(json.dumps(truth | change))
        outcome = run_circlecal("evaluate", samples / "truth", run_of_samples)
        assert outcome.code == 2 and words in " ".join(outcome.err.split())


def test_the_truth_of_a_clip(run_circlecal, tmp_path):
    run_circlecal("synth", tmp_path / "clips", "--video", "still", "--seconds", 0.2, "--size", "320x180")
    (path,) = (tmp_path / "clips" / "truth").iterdir()
    truth = json.loads(path.read_text())
    (tmp_path / "found").mkdir()
    # of the five frames two are answered well, and a third one metre off
    for index, off_m in {1: 0.0, 2: 0.0, 4: 1.0}.items():
        camera = truth["frames"][index]["camera"]
        camera["position_meters"][0] += off_m
        size = {"image_width": 320, "image_height": 180}
        name = f"camera_{truth['id']}_00-00-00.{40 * index:03d}.json"
        (tmp_path / "found" / name).write_text(json.dumps(camera | size))
    found = methods_of(run_circlecal("evaluate", tmp_path / "clips", tmp_path / "found", "--json"))["found"]
    assert (found["frames"], found["answered"]) == (5, 3)
    assert found["ground_m"][0] < 0.1 and 0.5 < found["ground_m"][1] < 1.5
    path.write_text(json.dumps(truth | {"pitch": {"length_m": "long"}}))
    told = run_circlecal("evaluate", tmp_path / "clips", tmp_path / "found")
    assert told.code == 2 and "pitch.length_m" in told.err and "render the clip again" in " ".join(told.err.split())
    path.write_text(json.dumps(truth | {"field": "futsal"}))
    told = run_circlecal("evaluate", tmp_path / "clips", tmp_path / "found")
    assert told.code == 2 and "holds cameras of futsal" in " ".join(told.err.split())


def test_marks_that_annotate_exports_are_passed_over(run_circlecal, folders, tmp_path):
    annotated, exact, _ = folders
    before = methods_of(run_circlecal("evaluate", annotated, exact, "--json"))
    marked = tmp_path / "marked"
    marked.mkdir()
    for path in annotated.glob("*.json"):
        content = json.loads(path.read_text())
        content["centre_mark"] = content["side_line_top x halfway_line"] = [{"x": 0.5, "y": 0.5}]
        (marked / path.name).write_text(json.dumps(content))
    assert methods_of(run_circlecal("evaluate", marked, exact, "--json")) == before
    (marked / path.name).write_text(json.dumps(content | {"Midle line": [{"x": 0.5, "y": 0.5}]}))
    told = run_circlecal("evaluate", marked, exact)
    assert told.code == 2 and "Midle line: is no class of SoccerNet" in " ".join(told.err.split())


def test_other_annotations_are_no_truth(run_circlecal, folders, tmp_path):
    _, exact, _ = folders
    (tmp_path / "keypoints").mkdir()
    (tmp_path / "keypoints" / "0.json").write_text(json.dumps({"kp": {"1": {"x": 0.5, "y": 0.5, "p": 0.9}}}))
    told = run_circlecal("evaluate", tmp_path / "keypoints", exact)
    assert (told.code, "holds no line annotation" in told.err) == (2, True)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('{"Middle line": [{"x": 0.5', ("0.json",)),
        ('{"Middle line": [{"x": "0.5", "y": 0.1}]}', ("0.json", "Middle line")),
        ('{"Middle lime": [{"x": 0.5, "y": 0.1}]}', ("0.json", "Middle lime")),
        ('{"Middle line": [{"x": NaN, "y": 0.1}]}', ("0.json",)),
    ],
)
def test_damaged_annotations(run_circlecal, folders, content, words):
    truth, exact, _ = folders
    (truth / "0.json").write_text(content)
    outcome = run_circlecal("evaluate", truth, exact)
    assert outcome.code == 2
    assert len(outcome.err.splitlines()) == 1
    assert all(word in outcome.err for word in words)


def test_damaged_cameras_and_wrong_use(run_circlecal, folders, tmp_path):
    truth, exact, _ = folders
    assert run_circlecal("evaluate", tmp_path / "none", exact).code == 2
    assert run_circlecal("evaluate", truth, exact, "--compare", "x").code == 2
    assert run_circlecal("evaluate", truth, exact, "--compare", f"exact={exact}").code == 2
    assert "class" in run_circlecal("evaluate", truth, exact, "--held-out", "Lime").err
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "camera" in run_circlecal("evaluate", truth, empty).err
    camera = json.loads((exact / "camera_0.json").read_text())
    (exact / "camera_0.json").write_text(json.dumps({**camera, "principal_point": [400.3, 290.1]}))
    assert "--pred-size" in run_circlecal("evaluate", truth, exact).err
    (exact / "camera_0.json").write_text(json.dumps({**camera, "x_focal_length": "long"}))
    outcome = run_circlecal("evaluate", truth, exact)
    assert outcome.code == 2
    assert "x_focal_length" in outcome.err


def test_frames_of_one_name_in_two_folders_are_not_mixed(run_circlecal, folders, tmp_path):
    truth, exact, _ = folders
    for folder in (truth, exact):
        first, second = folder / "clip-a", folder / "clip-b"
        first.mkdir()
        for path in list(folder.glob("*.json")):
            path.rename(first / path.name)
        shutil.copytree(first, second)
    told = run_circlecal("evaluate", truth, exact)
    assert (told.code, "as " in told.err, "one folder after the other" in told.err) == (2, True, True)
    assert "clip-b" in told.err
    told = run_circlecal("evaluate", truth / "clip-a", exact)
    assert (told.code, "camera_0.json: holds the frame 0" in " ".join(told.err.split())) == (2, True)
    assert run_circlecal("evaluate", truth / "clip-a", exact / "clip-a").code == 0


def test_a_size_and_a_threshold_that_count_for_nothing_are_refused(run_circlecal, folders, run_of_samples):
    truth, exact, _ = folders
    told = run_circlecal("evaluate", exact, exact, "--size", "1920x1080")
    assert (told.code, "leave --size out" in told.err) == (2, True)
    assert "--threshold" in run_circlecal("evaluate", truth, exact, "--threshold", "inf").err


def test_a_run_is_its_results_and_two_runs_of_a_frame_are_not_mixed(run_circlecal, run_of_samples, tmp_path):
    """``batch --rig`` writes the run of the rig below the first one: both were scored as one method, and converted
    twice.
    """
    truth, result = tmp_path / "samples" / "truth", json.loads((run_of_samples / "full_circle.json").read_text())
    outer, below = tmp_path / "both" / "results.jsonl", tmp_path / "both" / "rig" / "results.jsonl"
    below.parent.mkdir(parents=True)
    outer.write_text(json.dumps({**result, "id": "another"}) + "\n")
    below.write_text(json.dumps(result) + "\n")
    told = run_circlecal("evaluate", truth, tmp_path / "both")
    assert (told.code, "has a camera for none of the 1 frame" in " ".join(told.err.split())) == (2, True)
    assert methods_of(run_circlecal("evaluate", truth, below.parent, "--json"))["rig"]["answered"] == 1
    outer.write_text(json.dumps(result) + "\n")
    convert = ("convert", tmp_path / "both", "--to", "soccernet", "--out")
    assert run_circlecal(*convert, tmp_path / "cameras").code == 0
    assert [path.name for path in (tmp_path / "cameras").iterdir()] == ["camera_full_circle.json"]

    (tmp_path / "both" / "first").mkdir()
    outer.rename(tmp_path / "both" / "first" / "results.jsonl")
    for command in (("evaluate", truth, tmp_path / "both"), (*convert, tmp_path / "again")):
        told = run_circlecal(*command)
        words = f"{below}: holds the frame full_circle, as {tmp_path / 'both' / 'first' / 'results.jsonl'} does;"
        assert (told.code, words in " ".join(told.err.split())) == (2, True), told
    below.write_text(json.dumps({**result, "id": "another"}) + "\n")
    assert methods_of(run_circlecal("evaluate", truth, tmp_path / "both", "--json"))["both"]["answered"] == 1
    assert run_circlecal(*convert, tmp_path / "two").code == 0
    assert len(list((tmp_path / "two").iterdir())) == 2


def test_a_frame_that_another_run_refused_is_not_taken_from_the_other(run_circlecal, run_of_samples, tmp_path):
    result = json.loads((run_of_samples / "full_circle.json").read_text())
    for name, record in (("a", result), ("b", {**result, "status": "refused", "code": "no_circle"})):
        (tmp_path / "runs" / name).mkdir(parents=True)
        (tmp_path / "runs" / name / "results.jsonl").write_text(json.dumps(record) + "\n")
    told = run_circlecal("evaluate", tmp_path / "samples" / "truth", tmp_path / "runs")
    assert (told.code, "holds the frame full_circle" in " ".join(told.err.split())) == (2, True)
