"""``circlecal audit``."""

import builtins
import json

import pytest
from evaluation.scenes import look_at_circle
from evaluation.test_audit import detected


@pytest.fixture
def keypoints(tmp_path):
    """Two frames; in the second, 50 and 52 are 6 px too low at 1920 x 1080."""
    folder = tmp_path / "keypoints"
    folder.mkdir()
    camera = look_at_circle(x=0.0, pan=0.0, size=(1920, 1080), focal=3400.0)
    for name, moved in (("a", {}), ("b", {50: (0, 6), 52: (0, 6)})):
        kp = {}
        for shape in detected(camera, moved).shapes:
            x, y = shape.points_px[0]
            kp[shape.label.removeprefix("kp_")] = {"x": x / 1920, "y": y / 1080, "p": 0.9}
        (folder / f"{name}.json").write_text(json.dumps({"kp": kp, "lines": {}}))
    return folder


def test_injected_error(run_circlecal, keypoints):
    outcome = run_circlecal("audit", keypoints, "--json")
    assert outcome.code == 0, outcome
    first, second = (json.loads(line) for line in outcome.out.splitlines())
    assert max(first["distances_px"].values()) < 1e-3
    assert second["distances_px"]["50-52"] == pytest.approx(6.0, abs=1e-3)
    half = run_circlecal("audit", keypoints / "b.json", "--size", "960x540", "--json")
    assert json.loads(half.out)["distances_px"]["50-52"] == pytest.approx(3.0, abs=1e-3)


def test_tables_with_either_center(run_circlecal, keypoints):
    for center in ("kp", "ours"):
        outcome = run_circlecal("audit", keypoints, "--center", center)
        assert outcome.code == 0, outcome
        assert "50-52" in outcome.out
        assert "median px" in outcome.out
        assert outcome.out.count(f"(centre: {center}, 1920x1080)") == 2
        assert "all\t12\t" in outcome.out  # six opposed pairs of two frames
        assert "distances\tmean px" in outcome.out
        assert run_circlecal("audit", keypoints, "--center", center, "--no-frames").out in outcome.out
    assert "Leave out the table of the frames" in run_circlecal("audit", "--help").out


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_plot(run_circlecal, keypoints, tmp_path, suffix):
    pytest.importorskip("matplotlib")
    target = tmp_path / "plots" / f"audit{suffix}"
    assert run_circlecal("audit", keypoints, "--plot", target, "--no-frames").code == 0
    assert target.read_bytes()[:5] in (b"\x89PNG\r", b"<?xml")


def test_without_the_extra(run_circlecal, keypoints, tmp_path, monkeypatch):
    imported = builtins.__import__

    def refuse(name, *arguments, **named):
        if name.split(".")[0] == "matplotlib":
            raise ImportError(name)
        return imported(name, *arguments, **named)

    monkeypatch.setattr(builtins, "__import__", refuse)
    outcome = run_circlecal("audit", keypoints, "--plot", tmp_path / "a.png")
    assert outcome.code == 2
    assert len(outcome.err.splitlines()) == 1
    assert ".[plot]" in outcome.err


def test_wrong_input(run_circlecal, keypoints, tmp_path):
    assert "png" in run_circlecal("audit", keypoints, "--plot", tmp_path / "a.gif").err
    assert run_circlecal("audit", tmp_path / "none").code == 2
    (keypoints / "a.json").write_text('{"kp": {"51": {"x": "left", "y": 0.1}}}')
    outcome = run_circlecal("audit", keypoints)
    assert outcome.code == 2
    assert "a.json" in outcome.err
    assert "kp.51.x" in outcome.err
