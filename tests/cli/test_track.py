"""``circlecal track``: what it writes and prints, its exit codes, and what it says about wrong use."""

from __future__ import annotations

import json

import av
import pytest

import circlecal
from circlecal.evaluation.reading import read_predictions
from circlecal.formats.annotation import AnnotatedMarking, Annotation, annotation_bytes
from circlecal.results.numbers import show_with_sigma
from circlecal.tracking import stretches
from tests.tracking import scripted

SIZES = ("length", "breadth")


@pytest.fixture
def clip(tmp_path, monkeypatch):
    monkeypatch.setattr(stretches, "survey_clip", scripted.survey_clip)
    monkeypatch.setattr(stretches, "track_frames", scripted.track_frames)
    return scripted.write_clip(tmp_path / "clip.mp4")


def test_everything_that_can_come_out(clip, tmp_path, run_circlecal):
    out = tmp_path / "out"
    outcome = run_circlecal("track", clip, "--out", out, "--video", "--to", "broadtrack", "--to", "gamestate")
    assert outcome.code == 1, outcome.err
    assert "30 frames: 28 calibrated, 2 refused" in outcome.out and "camera-1" in outcome.out
    assert "30/30 frames" in outcome.err
    assert len(json.loads((out / "broadtrack.json").read_text())) == 28
    state = json.loads((out / "Labels-GameState.json").read_text())
    assert len(state["annotations"]) == 28
    with av.open(str(out / "overlay.mp4")) as video:
        codec, frames = video.streams.video[0].codec_context.name, list(video.decode(video=0))
    assert len(frames) == 30 and codec == "h264"
    assert [float(frame.time) for frame in frames] == pytest.approx([k / scripted.RATE for k in range(30)])
    calibrated, refused = (frames[k].to_ndarray(format="bgr24") for k in (3, 7))
    assert calibrated[:150].max() > 150 > refused[:150].max(), "the template is drawn over answered frames alone"
    run = circlecal.load(out)
    assert len(run) == 30 and run[3].time_s == pytest.approx(0.3) and not run[7].ok
    assert run_circlecal("track", clip, "--out", out).code == 1


def test_other_commands_read_the_results(clip, tmp_path, run_circlecal):
    out = tmp_path / "out"
    run_circlecal("track", clip, "--out", out, "--quiet")
    assert run_circlecal("convert", out / "results.jsonl", "--to", "gamestate", "--out", tmp_path / "given").code == 0
    assert (tmp_path / "given" / "Labels-GameState.json").is_file()
    run_circlecal("track", clip, "--out", out, "--quiet", "--to", "soccernet", "--to", "broadtrack", "--to", "worldcup")
    assert run_circlecal("convert", out, "--to", "tvcalib", "--out", tmp_path / "once").code == 0
    assert len((tmp_path / "once" / "per_sample_output.json").read_text().splitlines()) == 28
    (tmp_path / "none").mkdir()
    (tmp_path / "none" / "results.jsonl").touch()
    again = run_circlecal("convert", tmp_path / "none", out, "--to", "tvcalib", "--out", tmp_path / "both")
    assert again.code == 0, "a run without frames hinders no other"
    assert run_circlecal("report", out).code == 0
    first = circlecal.load(out)[0].save(tmp_path / "first.json")
    outcome = run_circlecal("project", first, "--to", "image", "0", "0")
    assert outcome.code == 0, outcome.err


def test_counts_and_cameras_as_json(clip, tmp_path, run_circlecal):
    outcome = run_circlecal("track", clip, "--out", tmp_path / "out", "--every", "10", "--json", "--quiet")
    told = json.loads(outcome.out)
    assert outcome.code == 0 and told["total"] == 3 and told["cameras"][0]["camera"] == "camera-1"
    assert told["cameras"][0]["pitch_m"] == pytest.approx([103.5, 68.7])
    assert told["cameras"][0]["pitch_sd_m"] == pytest.approx([scripted.tripod().sigma(n) for n in SIZES])


def test_the_size_of_the_pitch_is_told_with_its_deviations(clip, tmp_path, run_circlecal):
    length, width = (
        show_with_sigma(*pair) for pair in zip((103.5, 68.7), map(scripted.tripod().sigma, SIZES), strict=True)
    )
    outcome = run_circlecal("track", clip, "--out", tmp_path / "out", "--every", "10", "--start", "1")
    assert f"{length} x {width}" in " ".join(outcome.out.split())


def test_the_overlay_of_each_nth_frame_shows_the_last_one_as_long_as_the_others(clip, tmp_path, run_circlecal):
    run_circlecal("track", clip, "--out", tmp_path / "out", "--quiet", "--every", "5", "--video")
    with av.open(str(tmp_path / "out" / "overlay.mp4")) as video:
        stream = video.streams.video[0]
        assert stream.frames == 6 and float(stream.duration * stream.time_base) == pytest.approx(3.0)
        assert float(stream.average_rate) == pytest.approx(2.0)


def test_several_clips_have_a_video_and_a_venue_each(clip, tmp_path, run_circlecal):
    scripted.write_clip(tmp_path / "other.mp4", 12)
    run_circlecal("track", clip, tmp_path / "other.mp4", "--out", tmp_path / "out", "--video", "--workers", "1")
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"clip.overlay.mp4", "other.overlay.mp4", "clip.venue.yaml", "other.venue.yaml"} <= written


def test_nothing_after_the_end_of_a_clip_is_said(clip, tmp_path, run_circlecal):
    for command in ("track", "batch"):
        outcome = run_circlecal(command, clip, "--out", tmp_path / command, "--start", "1:39:00")
        assert (outcome.code, "0 frames: 0 calibrated" in outcome.out) == (2, True)
        assert "as its header says, and --start asks for 5940 s" in outcome.err


def test_a_venue_starts_the_next_run(clip, tmp_path, run_circlecal):
    run_circlecal("track", clip, "--out", tmp_path / "out", "--quiet")
    again = run_circlecal("track", clip, "--out", tmp_path / "again", "--venue", tmp_path / "out" / "venue.yaml")
    assert again.code == 1 and "28 calibrated" in again.out


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["missing.mp4"], "missing.mp4"),
        (["--every", "soon"], "--every soon: must be a time"),
        (["--venue", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["--to", "nothing"], "--to nothing: is no format"),
        (["--field", "chess"], "chess"),
    ],
)
def test_wrong_use_is_one_line(clip, tmp_path, run_circlecal, arguments, told):
    given = arguments if arguments[0].endswith(".mp4") else [clip, *arguments]
    outcome = run_circlecal("track", *given, "--out", tmp_path / "out")
    assert outcome.code == 2 and told in outcome.err and len(outcome.err.strip().splitlines()) == 1


def test_pictures_are_no_clips(frame_file, tmp_path, run_circlecal):
    outcome = run_circlecal("track", frame_file, "--out", tmp_path / "out")
    assert outcome.code == 2 and "holds no video" in outcome.err
    outcome = run_circlecal("track", tmp_path / "nothing", "--out", tmp_path / "out")
    assert outcome.code == 2 and "nothing: no such file or folder" in outcome.err


def test_pictures_and_animations_are_told_how_they_become_a_video(run_circlecal, tmp_path):
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "0001.jpg").write_bytes(b"")
    outcome = run_circlecal("track", tmp_path / "frames", "--out", tmp_path / "out")
    assert outcome.code == 2
    assert f"as ffmpeg -framerate 25 -pattern_type glob -i '{tmp_path / 'frames' / '*.jpg'}'" in outcome.err
    (tmp_path / "clip.gif").write_bytes(b"GIF89a")
    outcome = run_circlecal("track", tmp_path / "clip.gif", "--out", tmp_path / "out")
    assert outcome.code == 2 and "as ffmpeg -i clip.gif -pix_fmt yuv420p clip.mp4 does" in outcome.err
    assert "calibrate" not in outcome.err


def test_a_clip_that_cannot_be_read_does_not_stop_the_others(clip, tmp_path, run_circlecal):
    (tmp_path / "broken.mp4").write_bytes(b"no video")
    outcome = run_circlecal("track", tmp_path / "broken.mp4", clip, "--out", tmp_path / "out")
    assert outcome.code == 2 and "broken.mp4" in outcome.err and "28 calibrated" in outcome.out


@pytest.mark.parametrize(("command", "default"), [("track", "1, every frame"), ("batch", "1s")])
def test_help_tells_the_default_of_every(run_circlecal, command, default):
    shown = " ".join(run_circlecal(command, "--help").out.replace("│", " ").split())
    assert f"(default: {default})" in shown


def test_annotations_that_came_later_are_told_with_what_takes_them(clip, tmp_path, run_circlecal):
    out, command = tmp_path / "out", ("track", clip, "--out", tmp_path / "out", "--every", "10")
    assert run_circlecal(*command).code == 0
    other = run_circlecal(*command, "--seed", "1").err
    assert "holds results of another configuration" in other and "count too" not in other
    name = next(iter(circlecal.load(out))).id
    marking = AnnotatedMarking(name="halfway_line", kind="line", points_px=[[9, 20], [90, 22]], sigma_px=[0.5, 0.5])
    width, height = scripted.SIZE
    made = Annotation(id=name, source=str(clip), width=width, height=height, touched=True, markings=[marking])
    (out / "annotations").mkdir()
    (out / "annotations" / f"{name}.json").write_bytes(annotation_bytes(made))
    told = run_circlecal(*command)
    assert (told.code, told.err.count("\n")) == (2, 1)
    assert f"annotations in {out / 'annotations'} count too: if some were saved since, --restart takes them" in told.err
    assert run_circlecal(*command, "--restart").code == 0 and list((out / "annotations").glob("*.json"))


def test_evaluate_reads_the_run(clip, tmp_path, run_circlecal):
    run_circlecal("track", clip, "--out", tmp_path / "out", "--quiet", "--every", "10")
    names = {frame.id for frame in circlecal.load(tmp_path / "out")}
    found = read_predictions(tmp_path / "out", (960, 540))
    assert found.keys() == names and len(names) == 3


def test_the_limit_of_pixels_is_the_users(clip, tmp_path, run_circlecal):
    """It was not read here, and the message named an option that the command does not have."""
    width, height = scripted.SIZE
    limited = ("--set", f"limits.max_pixels={width * height - 1}")
    told = run_circlecal("track", clip, "--out", tmp_path / "out", *limited)
    mend = f"scale it down or raise limits.max_pixels (--set limits.max_pixels={width * height})"
    assert told.code == 2 and mend in " ".join(told.err.split()), told
    assert run_circlecal("track", clip, "--out", tmp_path / "out", *limited[:1], mend.split()[-1].rstrip(")")).code == 1
