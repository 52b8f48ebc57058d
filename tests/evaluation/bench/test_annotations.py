"""``circlecal bench annotations`` on a set that the test makes."""

import json

import pytest

from evaluation.scenes import annotation_of, look_at_circle


@pytest.fixture
def material(tmp_path):
    truth, peer = tmp_path / "made" / "ground_truth", tmp_path / "made" / "peer_camera"
    for folder in (truth, peer):
        folder.mkdir(parents=True)
    for k, x in enumerate((-1.0, 0.5)):
        camera = look_at_circle(x=x, pan=-1.0, focal=3400.0, kappa=0.03, size=(1920, 1080))
        (truth / f"{k}.json").write_text(json.dumps(annotation_of(camera, (1920, 1080))))
    off = look_at_circle(x=0.0, pan=-1.0, focal=1650.0)
    (peer / "camera_0.json").write_text(json.dumps(off.soccernet()))
    return tmp_path


def test_peers_first_then_ours(run_circlecal, material):
    outcome = run_circlecal("bench", "annotations", material, "--json")
    assert outcome.code == 0, outcome
    rows = json.loads(outcome.out)
    assert rows[0]["method"] == "peer"
    assert (rows[0]["answered"], rows[0]["frames"]) == (1, 2)
    ours = {row["input_name"]: row for row in rows if row["method"] == "circlecal" and row["set_name"] == "made"}
    assert ours["all lines"]["jac_5"] > 0.9
    assert ours["circle and halfway line"]["held_out_px"] < 5
    assert any(row["method"] == "great axis" for row in rows)


def test_table_and_wrong_folder(run_circlecal, material, tmp_path):
    outcome = run_circlecal("bench", "annotations", material, "--sets", "made", "--set", "camera.starts=4")
    assert outcome.code == 0, outcome
    assert "JaC5" in outcome.out
    assert run_circlecal("bench", "annotations", tmp_path / "none").code == 2
    assert run_circlecal("bench", "annotations", material, "--sets", "other").code == 2
