"""Clips: truth lies on the paint, one tripod carries all main frames, and the world stands still."""

import json
from dataclasses import replace
from typing import get_args

import av
import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from circlecal.camera.options import BROADCAST_ZOOM
from circlecal.cli.synth import Clips, Shape
from circlecal.errors import InputError
from circlecal.field import load_field
from circlecal.geometry.camera import camera_from_soccernet, rotation_matrix
from circlecal.geometry.surface import Surface, SurfaceShape
from circlecal.pictures.limits import DEFAULT_LIMITS
from circlecal.pictures.video import Sampling, Video
from circlecal.synthetic import video
from circlecal.synthetic.clip_files import write_clip
from circlecal.synthetic.clip_plans import kinds_of, plan_clip
from circlecal.synthetic.renderer import render
from circlecal.synthetic.tripod import WIDEST_FOCAL, Tripod, sample_tripod
from circlecal.synthetic.video import CLIP_KINDS, ClipSpec

SIZE = (640, 360)


def planned(kind, seed, seconds=10.0, *, clean=True, **options):
    spec = ClipSpec(kind, *SIZE, seconds=seconds, **options)
    clip = plan_clip(spec, np.random.default_rng(seed))
    if clean:  # no noise, and nobody in the way
        clip = replace(clip, config=clip.config.clean(), runs=())
    return clip


def main_cameras(clip):
    times = np.arange(clip.count) / clip.spec.rate
    shots = [next(s for s in clip.shots if t < s.end_s or s is clip.shots[-1]) for t in times]
    return [(t, shot, clip.camera_at(t, shot)) for t, shot in zip(times, shots, strict=True) if shot.kind == "main"]


def line_offsets(picture, record, clip_record, rows=slice(None)):
    """Signed distances in pixels from the projected halves of all lines in view to the paint in the picture."""
    pitch = clip_record["pitch"]
    template = load_field("soccer", {"length": pitch["length_m"], "width": pitch["width_m"]})
    surface = Surface(pitch["crown_shape"], pitch["crown_reference_m"], pitch["crown_m"])
    height, width = picture.shape[:2]
    camera = camera_from_soccernet(record["camera"], width, height)
    bright = picture[..., 2].astype(float)
    found = []
    for line in template.lines:
        start, end = template.line_ends(line, pitch["marking_width_m"])
        along = camera.project(surface.lift(start + np.linspace(0.02, 0.98, 240)[:, None] * (end - start)))
        tangent = np.gradient(along, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1)[:, None]
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
        reach = np.linspace(-4, 4, 81)
        inside = ((along > 8) & (along < (width - 9, height - 9))).all(axis=1)
        if inside.sum() < 30:
            continue
        grid = along[inside, None] + reach[:, None] * normal[inside, None]
        profile = map_coordinates(bright, [grid[..., 1], grid[..., 0]], order=1)
        profile = np.clip(profile - np.median(profile, axis=1, keepdims=True), 0, None)
        strong = profile.max(axis=1) > 25
        found += list((profile * reach).sum(axis=1)[strong] / profile.sum(axis=1)[strong])
    return np.array(found)


@pytest.mark.parametrize(
    ("kind", "seed", "index", "surface"),
    [("still", 1, 20, None), ("attack", 2, 190, None), ("attack", 2, 190, "hip"), ("cuts", 3, 230, None)],
)
def test_truth_lies_on_the_paint(kind, seed, index, surface):
    clip = planned(kind, seed, surface=surface)
    assert surface in (None, clip.surface.shape)
    picture, truth = clip.frame(index)
    assert truth.shot in ("main", "replay")
    record = json.loads(json.dumps(truth.to_json()))
    offsets = line_offsets(picture, record, clip.to_json())
    assert len(offsets) > 60
    assert abs(np.median(offsets)) < 0.05
    assert np.median(np.abs(offsets)) < 0.12


@pytest.mark.parametrize("seed", range(3))
def test_tripod(seed):
    """Pupil on the optical axis through the head, roll by the lean of the axis, lens by the zoom."""
    clip = planned("sweep", seed)
    tripod = clip.tripod
    cameras = main_cameras(clip)
    for time_s, shot, camera in cameras[::7]:
        pan, tilt, focal = shot.path.at(time_s)
        zoom = np.log(focal / tripod.reference_focal)
        lever = camera.position_m - tripod.position_m
        np.testing.assert_allclose(lever, (tripod.lever_m + tripod.lever_per_zoom_m * zoom) * camera.R[2], atol=1e-9)
        wider = focal**-2 - tripod.reference_focal**-2
        assert camera.kappa[0] == pytest.approx(tripod.kappa - tripod.kappa_by_focal * wider)
        head = rotation_matrix(pan, tilt, tripod.roll_rad) @ tripod.lean.T
        np.testing.assert_allclose(camera.R, head, atol=1e-9)
    pans, rolls = np.array([camera.angles_rad[[0, 2]] for _, _, camera in cameras]).T
    terms = np.stack([np.sin(pans), np.cos(pans), np.ones_like(pans)], axis=-1)
    assert np.ptp(pans) > np.radians(30)
    slope = np.linalg.lstsq(terms, rolls, rcond=None)[0][0]
    assert slope == pytest.approx(tripod.lean_rad[0], abs=np.radians(0.1))


def test_lenses_of_clips_change_with_the_zoom_as_those_of_broadcasts():
    """On the average: their law is that which single frames are calibrated by, and their offsets are about 0."""
    tripods = [sample_tripod(68.0, np.random.default_rng(seed)) for seed in range(200)]
    for widths in (0.8, 1.2, 2.0, 4.0):
        kappas = [tripod.kappa_at(widths) for tripod in tripods]
        assert np.mean(kappas) == pytest.approx(BROADCAST_ZOOM.kappa(np.log(widths)), abs=0.003)
    wide, wider = tripods[0].kappa_at(WIDEST_FOCAL), tripods[0].kappa_at(0.5 * WIDEST_FOCAL)
    assert wider == wide < tripods[0].kappa_at(0.8)


def test_a_tripod_that_stands_straight_does_not_roll():
    tripod = Tripod(np.array([0.0, 60.0, -15.0]), np.zeros(2), 0.0, 0.8, 0.0, 0.02, 0.0)
    for pan in np.radians([-40, 0, 35]):
        camera = tripod.camera(pan, 1.3, 1.8, *SIZE)
        np.testing.assert_allclose(camera.angles_rad, [pan, 1.3, 0.0], atol=1e-12)
        assert camera.position_m[0] == pytest.approx(0.8 * np.sin(pan) * np.sin(1.3))
    leaning = sample_tripod(68.0, np.random.default_rng(2))
    target = np.array([20.0, -5.0, 0.0])
    camera = leaning.camera(*leaning.aim(target), 1.5, *SIZE)
    np.testing.assert_allclose(camera.project(target), camera.principal_point_px, atol=1e-9)


@pytest.mark.parametrize("kind", CLIP_KINDS)
def test_the_camera_moves_smoothly(kind):
    clip = planned(kind, 4)
    for shot in (shot for shot in clip.shots if shot.path is not None):
        times = np.arange(shot.start_s, shot.end_s, 0.01)
        path = np.array([shot.path.at(t) for t in times]) * (1, 1, 1)
        path[:, 2] = np.log(path[:, 2])
        speed = np.diff(path, axis=0) / 0.01
        assert np.abs(np.diff(speed, axis=0) / 0.01).max() < 15.0  # rad/s^2, or e-folds of the focal length
        assert np.abs(speed).max() < 1.6
        assert kind != "still" or np.abs(speed).max() < 0.05


def test_cuts_are_marked_and_end_in_a_penalty_area():
    clip = planned("cuts", 6, clean=False)
    assert [shot.kind for shot in clip.shots] == ["main", "cut", "main", "replay", "main"]
    assert clip.shots[-1].end_s == clip.spec.seconds
    assert all(a.end_s == b.start_s for a, b in zip(clip.shots, clip.shots[1:], strict=False))
    after = [round(shot.start_s * clip.spec.rate + 0.5) for shot in clip.shots]
    _, cut = clip.frame(after[1])
    assert (cut.shot, cut.truth, cut.pan_rad) == ("cut", None, None)
    assert set(cut.to_json()) == {"time_s", "shot"}
    for index in (after[2], after[4]):
        _, back = clip.frame(index)
        assert back.shot == "main"
        assert back.truth.visible_circle_deg < 60
        assert len(back.truth.others_px) >= 2
    _, replay = clip.frame(after[3])
    assert (replay.shot, replay.pan_rad) == ("replay", None)
    assert np.linalg.norm(replay.truth.camera.position_m - clip.tripod.position_m) > 20


def test_the_world_stands_still():
    """The stands of one frame, turned by the rotation between them, are those of another."""
    clip = planned("attack", 7)
    (first, a), (second, b) = clip.frame(20), clip.frame(60)
    old, new = a.truth.camera, b.truth.camera
    assert abs(b.pan_rad - a.pan_rad) * old.focal_px[0] > 10
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].astype(np.float64)
    pixels = np.stack([x, y], axis=-1).reshape(-1, 2)
    rays = (new.undistort(pixels) - new.principal_point_px) / new.focal_px
    world = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) @ new.R
    seen = old.project(old.position_m + 150.0 * world).reshape(*x.shape, 2).astype(np.float32)
    warped = cv2.remap(first, seen[..., 0], seen[..., 1], cv2.INTER_LINEAR)
    horizon = int(new.project(np.array([[0.0, -clip.template.width_m / 2 - 8.0, -4.0]]))[0, 1])
    part = (slice(5, max(30, horizon)), slice(60, SIZE[0] - 60))
    blurred = [cv2.GaussianBlur(p, (0, 0), 1.5)[part].astype(float).ravel() for p in (warped, second, first)]
    assert np.corrcoef(blurred[0], blurred[1])[0, 1] > 0.85
    assert np.corrcoef(blurred[2], blurred[1])[0, 1] < 0.6


def test_a_fast_pan_smears_by_its_way_while_the_shutter_is_open(monkeypatch):
    clip = planned("sweep", 9, seconds=1.0, pitch_m=(105.0, 68.0))
    scenes = []

    def note_scene(scene, chance):
        scenes.append(scene)
        return render(scene, chance)

    monkeypatch.setattr(video, "render", note_scene)
    index = 15  # on the way from one penalty area to the other
    clip.frame(index)
    pans = [clip.shots[0].path.at((index + half) / clip.spec.rate)[0] for half in (-0.25, 0.25)]
    way = abs(pans[1] - pans[0]) * scenes[0].camera.focal_px[0]
    assert way > 66.0
    assert scenes[0].config.motion_px == pytest.approx(way, rel=0.05)


def test_players_move_and_the_score_does_not():
    clip = planned("still", 8, clean=False)
    clip = replace(clip, config=clip.config.clean().model_copy(update={"scorebug": True}))
    (first, _), (second, _) = clip.frame(0), clip.frame(60)
    changed = np.abs(first.astype(int) - second).max(axis=2)
    score = changed[round(0.055 * SIZE[1]) : round(0.088 * SIZE[1])]
    assert (score == 0).all(axis=0).sum() > 0.2 * SIZE[0]
    assert (changed > 60).sum() > 50
    again, truth = clip.frame(60)
    np.testing.assert_array_equal(again, second)
    assert truth.time_s == 60 / 25


def test_interlaced_fields_lie_on_both_sides_of_the_truth():
    clip = planned("sweep", 9, interlaced=True, pitch_m=(105.0, 68.0))
    fast = replace(clip, spec=replace(clip.spec, interlaced=False, rate=4 * clip.spec.rate))
    index = 62  # between two penalty areas
    assert abs(clip.frame(index)[1].pan_rad - clip.frame(index + 1)[1].pan_rad) > np.radians(0.4)
    picture, truth = clip.frame(index)
    earlier, later = (fast.frame(4 * index + step) for step in (-1, 1))
    assert earlier[1].time_s < truth.time_s < later[1].time_s
    for field, own, other in ((0, earlier, later), (1, later, earlier)):
        near, far = (np.abs(picture[field::2].astype(int) - frame[0][field::2]).mean() for frame in (own, other))
        assert near < 0.4 * far


def test_the_file_of_an_interlaced_clip_says_so(tmp_path):
    for interlaced in (True, False):
        path = write_clip(tmp_path, "clip", planned("sweep", 9, seconds=0.08, interlaced=interlaced))
        with av.open(str(path)) as container:
            assert {frame.interlaced_frame for frame in container.decode(video=0)} == {interlaced}


def test_pitches_of_any_size():
    sizes = [planned("still", seed).template for seed in range(40)]
    lengths, widths = ([getattr(t, name) for t in sizes] for name in ("length_m", "width_m"))
    assert 90 <= min(lengths) < 95 < 115 < max(lengths) <= 120
    assert 45 <= min(widths) < 52 < 83 < max(widths) <= 90


def test_a_clip_is_repeatable():
    spec = ClipSpec("attack", 320, 180, seconds=0.12)
    first, second = (list(plan_clip(spec, np.random.default_rng(1)).frames()) for _ in range(2))
    assert len(first) == 3
    for (a, truth), (b, other) in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)
        assert truth.to_json() == other.to_json()


def test_command(tmp_path, run_circlecal):
    outcome = run_circlecal("synth", tmp_path, "--video", "cuts", "--size", "320x180", "--seconds", 0.4, "--rate", 50)
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("1 clip written")
    record = json.loads((tmp_path / "truth" / "cuts_00000.json").read_text())
    frames = list(Video.open(tmp_path / "cuts_00000.mp4", "x", DEFAULT_LIMITS).frames(Sampling.parse("1")))
    assert [frame["time_s"] for frame in record["frames"]] == pytest.approx([f.time_s for f in frames], abs=1e-5)
    assert [k / 50 for k in range(20)] == pytest.approx([f.time_s for f in frames], abs=1e-5)
    assert {frame["shot"] for frame in record["frames"]} == {"main", "cut", "replay"}
    camera = camera_from_soccernet(record["frames"][0]["camera"], record["width"], record["height"])
    assert np.linalg.norm(camera.position_m - record["tripod"]["position_m"]) < 1.5


def test_all_kinds(tmp_path, run_circlecal):
    size = ("--size", "320x180", "--seconds", 0.1, "--rate", 10, "--profile", "rink")
    assert run_circlecal("synth", tmp_path, "--video", "all", *size).code == 0
    assert sorted(path.name.partition("_")[0] for path in tmp_path.glob("*.mp4")) == sorted(kinds_of("rink"))


@pytest.mark.parametrize(
    "arguments",
    [("--size", "321x180"), ("--seconds", "0"), ("--rate", "500"), ("--count", "0"), ("-p", "easy", "-p", "haze")],
)
def test_command_refuses(tmp_path, run_circlecal, arguments):
    assert run_circlecal("synth", tmp_path / "out", "--video", "attack", *arguments).code == 2
    assert not (tmp_path / "out").exists()


def test_command_knows_every_kind():
    assert [kind.value for kind in Clips] == [*CLIP_KINDS, "all"]


def test_command_knows_every_surface():
    assert {shape.value for shape in Shape} == set(get_args(SurfaceShape))


@pytest.mark.parametrize("look", ["rink", "court"])
def test_a_clip_of_another_sport_shows_its_field_as_its_truth_says(look):
    clip = planned("sweep", 5, look=look)
    assert clip.template.name == {"rink": "ice-hockey-nhl", "court": "basketball-nba"}[look]
    first, last = clip.frame(0)[1], clip.frame(clip.count // 3)[1]
    assert abs(last.pan_rad - first.pan_rad) > np.radians(5.0)
    for told in (first, last):
        camera = told.truth.camera
        apart = clip.tripod.position_m + clip.tripod.lever_m * camera.R[2] - camera.position_m
        assert np.abs(apart).max() < 0.05
    assert clip.to_json()["field"] == clip.template.name


def test_clips_of_other_sports_have_no_cuts():
    assert "cuts" not in kinds_of("rink") and kinds_of("broadcast") == CLIP_KINDS
    with pytest.raises(InputError, match="cuts"):
        planned("cuts", 5, look="rink")
