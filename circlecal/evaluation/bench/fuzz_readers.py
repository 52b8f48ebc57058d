"""Every reader and every command of circlecal, each with sound files to damage."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.api import Calibration, load
from circlecal.config import Config, config_digest, config_folder, load_config
from circlecal.errors import CirclecalError
from circlecal.field import FieldTemplate, field_folder, load_field
from circlecal.formats.cameras import CalibratedFrame
from circlecal.formats.format import AnnotationFormat, CameraFormat
from circlecal.formats.meaning import observe, understand
from circlecal.formats.registry import annotation_formats, camera_formats, open_file, parse_annotations
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.geometry.camera import Camera
from circlecal.geometry.surface import Surface
from circlecal.pictures.files import read_image
from circlecal.pictures.inputs import expand_inputs
from circlecal.pictures.limits import DEFAULT_LIMITS
from circlecal.pictures.masks import read_mask
from circlecal.pictures.remote import is_url, require_url, url_names
from circlecal.pictures.video import Sampling, Video
from circlecal.pictures.video_writer import write_video
from circlecal.pipeline import field_of, run_observations
from circlecal.records.camera_prior import prior_settings
from circlecal.records.json_text import result_line
from circlecal.records.log import ResultLog, read_records
from circlecal.records.record import ResultRecord
from circlecal.records.writing import result_record
from circlecal.rig.run import read_cameras
from circlecal.rig.tripod import COMMON, TripodEstimate, Venue
from circlecal.rig.venue import read_venue, write_venue
from circlecal.synthetic.cameras import aim_camera

SIZE = (1280, 720)
QUICK = ("camera.starts=2", "camera.iterations=10")
"""Settings under which a frame of a few points takes little time."""
_SIDE = 96

Command = Callable[[Sequence[str]], tuple[int, str]]
"""Runs a command line in this process: its exit code, and what it said on stderr."""


@dataclass(frozen=True, slots=True)
class Seed:
    """A sound file: its suffix and content."""

    suffix: str
    content: bytes


class WrongExitError(Exception):
    """A command ended as none may: with another exit code than 0, 1 or 2, or with 2 and no line that says why."""


@dataclass(frozen=True)
class Reader:
    """Something that reads a file.

    Attributes
    ----------
    name : str
        For the table.
    seeds : callable
        Sound files that it reads.
    read : callable
        Reads a file; a second path is an empty folder to write to.
    every : int
        It has one of so many turns: commands take longer than readers.
    """

    name: str
    seeds: Callable[[], Sequence[Seed]]
    read: Callable[[Path, Path], object]
    every: int = 1


def readers(command: Command | None) -> list[Reader]:
    """All of them; without commands where None is given."""
    found = [
        Reader("picture", _pictures, lambda path, _: read_image(path)),
        Reader("mask", _masks, lambda path, _: read_mask(path, _SIDE, _SIDE)),
        Reader("video", _videos, _read_video, 4),
        Reader("list of files", _lists, lambda path, _: expand_inputs([f"@{path}"])),
        Reader("URL", _urls, _read_urls),
        Reader("configuration", _configs, lambda path, _: load_config(path)),
        Reader("--set", _settings, lambda path, _: load_config(None, _lines(path))),
        Reader("field template", _fields, lambda path, _: load_field(path)),
        Reader("camera prior", _priors, lambda path, _: load_config(None, prior_settings(path))),
        Reader("venue", _venues, lambda path, _: read_venue(path, _field())),
        Reader("result file", _results, _read_result),
        Reader("results.jsonl", _logs, _read_log),
        Reader("cameras.csv", _camera_lists, lambda path, _: read_cameras(path)),
        Reader("times", _times, lambda path, _: [Sampling.parse(*line.split(" ")[:3]) for line in _lines(path)]),
    ]
    for known in annotation_formats().values():
        if known.write is not None:
            found.append(Reader(f"{known.name} annotation", _seeds_of(known), _read_format))
    for format_ in camera_formats().values():
        found.append(Reader(f"{format_.name} camera", _seeds_of(format_), _read_format))
    return found if command is None else [*found, *_commands(command)]


def _commands(run: Command) -> Iterator[Reader]:
    quick = [word for setting in QUICK for word in ("--set", setting)]
    size = ["--size", "{}x{}".format(*SIZE)]
    given: dict[str, tuple[Callable[[], Sequence[Seed]], Callable[[Path, Path], list[str]]]] = {
        "calibrate": (
            _all_annotations,
            lambda path, out: [str(path), *size, "--out", str(out), "--to", "soccernet", *quick],
        ),
        "calibrate PICTURE": (_pictures, lambda path, out: [str(path), "--out", str(out), "--no-overlay"]),
        "calibrate --camera-prior": (_priors, lambda path, out: [*_small(out), "--camera-prior", str(path)]),
        "calibrate --venue": (_venues, lambda path, out: [*_small(out), "--venue", str(path)]),
        "calibrate --config": (_configs, lambda path, out: [*_small(out), "--config", str(path)]),
        "calibrate --field": (_fields, lambda path, out: [*_small(out), "--field", str(path)]),
        "config": (_configs, lambda path, out: ["--config", str(path)]),
        "project": (_results, lambda path, out: [str(path), "--to", "field", "640", "360", "10", "10"]),
        "convert": (_all_annotations, lambda path, out: [str(path), *size, "--to", "coco", "--out", str(out)]),
        "convert to cameras": (_camera_files, lambda path, out: [str(path), "--to", "tvcalib", "--out", str(out)]),
        "report": (_logs, lambda path, out: [str(path), "--out", str(out / "report")]),
        "rig": (_logs, lambda path, out: [str(path), "--out", str(out), "--workers", "1"]),
        "audit": (_keypoints, lambda path, out: [str(path), *size]),
        "debug": (_pictures, lambda path, out: [str(path), "--out", str(out)]),
        "track": (_videos, lambda path, out: [str(path), "--out", str(out), "--workers", "1"]),
        "project --points": (_points, lambda path, out: [_results_log(out), "--to", "field", "--points", str(path)]),
    }
    for name, (seeds, arguments) in given.items():
        yield Reader(f"circlecal {name}", seeds, _command_reader(run, name.split()[0], arguments), 4)


def _command_reader(
    run: Command, name: str, arguments: Callable[[Path, Path], list[str]]
) -> Callable[[Path, Path], object]:
    def read(path: Path, out: Path) -> object:
        code, said = run([name, *arguments(path, out)])
        if code not in (0, 1, 2):
            raise WrongExitError(f"exit code {code}")
        if "Traceback" in said:
            raise WrongExitError("a traceback on stderr")
        if code == 2 and "circlecal: error: " not in said:
            raise WrongExitError(f"exit code 2 without a line that says why: {said[:200]!r}")
        if "internal_error" in said or "internal error" in said:
            raise WrongExitError(f"an internal error: {said[:200]!r}")
        if code == 2:
            raise CirclecalError(said)
        return code

    return read


def _small(out: Path) -> list[str]:
    """Arguments that calibrate a small picture without a field."""
    path = out / "small.png"
    if not path.exists():
        out.mkdir(parents=True, exist_ok=True)
        path.write_bytes(_encode(".png", np.full((_SIDE, _SIDE, 3), (60, 130, 70), np.uint8)))
    return [str(path), "--out", str(out), "--no-overlay"]


def _results_log(out: Path) -> str:
    """Results of the frames a, b and c."""
    path = out / "results.jsonl"
    out.mkdir(parents=True, exist_ok=True)
    path.write_bytes(_logs()[0].content)
    return str(path)


def _lines(path: Path) -> list[str]:
    return path.read_bytes().decode("utf-8", "surrogateescape").split("\n")


def _read_urls(path: Path, out: Path) -> list[str]:
    urls = [line for line in _lines(path) if is_url(line)]
    for url in urls:
        require_url(url)
    return url_names(urls)


def _read_video(path: Path, out: Path) -> object:
    video = Video.open(path, path.stem, DEFAULT_LIMITS)
    return list(islice(video.frames(Sampling.parse("1"), lambda _: None), 20))


def _read_result(path: Path, out: Path) -> object:
    found = load(path)
    for frame in [found] if isinstance(found, Calibration) else found:
        frame.to_field([[640.0, 360.0]])
    return repr(found)


def _read_log(path: Path, out: Path) -> object:
    records = list(read_records(path))
    out.mkdir(exist_ok=True)
    (out / "results.jsonl").write_bytes(path.read_bytes())
    with ResultLog(out) as log:
        log.take_up(config_digest(_config()))
    return records


def _read_format(path: Path, out: Path) -> object:
    known, content = open_file(path)
    if isinstance(known, AnnotationFormat):
        frames = parse_annotations(known, content, SIZE)[:20]
        return [observe(frame, _field(), _config().sources, known.name, str(path)) for frame in frames]
    return known.read(path, content.raw, SIZE) if isinstance(known, CameraFormat) else None


@cache
def _config() -> Config:
    return load_config("annotations", QUICK)


def _field() -> FieldTemplate:
    return field_of(_config())[0]


@cache
def _camera() -> Camera:
    return aim_camera(np.array([3.0, 62.0, -17.0]), np.zeros(3), 2600.0, 0.01, *SIZE)


@cache
def _frame() -> AnnotatedFrame:
    """What a camera sees of the middle of a pitch."""
    shapes = []
    for name, polyline in _field().polylines(2.0).items():
        pixels = _camera().project(polyline)
        pixels = pixels[((pixels > 0) & (pixels < np.array(SIZE) - 1)).all(axis=1)]
        if len(pixels) > 1:
            line = _field().line_by_name.get(name)
            label = (line or _field().circle_by_name[name]).class_name
            shapes.append(Shape(label or name, "line", pixels if line is None else pixels[[0, -1]]))
    shapes.append(Shape("kp_51", "points", _camera().project(np.zeros((1, 2)))))
    return AnnotatedFrame("f", *SIZE, tuple(shapes), "f.jpg")


@cache
def _record() -> ResultRecord:
    seen = observe(_frame(), _field(), _config().sources, "labelme", "f.json").observations
    return result_record(run_observations(seen, _config(), frame_id="f", source="f.json"), _field())


def _encode(suffix: str, picture: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    return bytes(cv2.imencode(suffix, picture)[1].tobytes())


def _ellipse_picture() -> NDArray[np.uint8]:
    picture = np.full((_SIDE, _SIDE, 3), (60, 130, 70), np.uint8)
    cv2.ellipse(picture, (48, 48), (40, 16), 0, 0, 360, (240, 240, 240), 2)
    return np.asarray(cv2.line(picture, (40, 0), (52, 95), (240, 240, 240), 2), np.uint8)


@cache
def _pictures() -> list[Seed]:
    suffixes = (".jpg", ".png", ".bmp", ".tiff", ".webp")
    deep = [Seed(s, _encode(s, _ellipse_picture().astype(np.uint16) * 257)) for s in (".png", ".tiff")]
    return [*(Seed(suffix, _encode(suffix, _ellipse_picture())) for suffix in suffixes), *deep]


@cache
def _masks() -> list[Seed]:
    mask = np.where(_ellipse_picture()[:, :, 0] > 200, np.uint8(255), np.uint8(0))
    return [*(Seed(s, _encode(s, mask)) for s in (".png", ".bmp", ".tiff")), *_pictures()[:1]]


@cache
def _videos() -> list[Seed]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "v.mp4"
        with write_video(path, 25.0) as writer:
            for number in range(6):
                writer.write(np.roll(_ellipse_picture(), number, axis=1), number / 25.0)
        return [Seed(".mp4", path.read_bytes()), Seed(".mkv", path.read_bytes()), *_pictures()[:1]]


def _lists() -> list[Seed]:
    return [Seed(".txt", b"# frames\n.\n*\nhttps://server/a.jpg\n")]


def _urls() -> list[Seed]:
    return [Seed(".txt", b"http://127.0.0.1:1/a.jpg?x=1\nhttps://[::1]:80/x.png\ns3://bucket/a/b.jpg\nfile:///x.jpg\n")]


@cache
def _configs() -> list[Seed]:
    paths = [config_folder() / f"{name}.yaml" for name in ("broadcast", "annotations", "default")]
    return [Seed(".yaml", path.read_bytes()) for path in paths if path.is_file()]


def _settings() -> list[Seed]:
    lines = ("camera.position_m=[1, 60, -15]", "field.sizes={length: 100}", "edges.smoothing_px=1.5", "seed=1")
    return [Seed(".txt", line.encode()) for line in (*lines, "\n".join(lines))]


def _fields() -> list[Seed]:
    return [Seed(".yaml", (field_folder() / f"{name}.yaml").read_bytes()) for name in ("soccer", "futsal")]


@cache
def _priors() -> list[Seed]:
    text = b"position_m: [1, 60, -15]\nposition_sd_m: [0.1, 0.1, 0.2]\nroll_sd_deg: 1\nk1_mean: 0.02\nk1_sd: 0.01\n"
    return [Seed(".yaml", text), Seed(".json", b'{"position_m": [1, 60, -15]}'), *_results()]


@cache
def _venues() -> list[Seed]:
    mean, sd = np.zeros(len(COMMON)), np.full(len(COMMON), 0.1)
    mean[:3] = 0.0, 60.0, -15.0
    low, high = np.array([7.0, -0.5, 1.3]), np.array([8.5, 0.5, 1.5])
    surface = Surface("roof", 9.15, 0.05)
    tripod = TripodEstimate("main", SIZE, 7.6, surface, mean, np.diag(sd**2), low, high, ("a", "b"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "venue.yaml"
        write_venue(path, Venue("soccer", (tripod,)), _field())
        return [Seed(".yaml", path.read_bytes())]


@cache
def _results() -> list[Seed]:
    return [Seed(".json", result_line(_record()).encode())]


@cache
def _logs() -> list[Seed]:
    digest = config_digest(_config())
    lines = [
        result_line(_record().model_copy(update={"id": name, "config_digest": digest})) for name in ("a", "b", "c")
    ]
    return [Seed(".jsonl", ("\n".join(lines) + "\n").encode())]


def _camera_lists() -> list[Seed]:
    return [Seed(".csv", b"id,camera\na,main\nb,main\nc,left\n")]


def _points() -> list[Seed]:
    return [Seed(".csv", b"frame,x,y\na,640,360\na,10.5,-3\nb,1e3,0\n")]


def _times() -> list[Seed]:
    return [Seed(".txt", b"1s 0:10 0:20\n25 12:00 57:30\n500ms 0 1")]


def _seeds_of(known: AnnotationFormat | CameraFormat) -> Callable[[], Sequence[Seed]]:
    @cache
    def seeds() -> list[Seed]:
        suffix = Path(known.file_name).suffix
        if isinstance(known, AnnotationFormat):
            frame = understand(_frame(), known.name) if known.writes_observations else _frame()
            return [] if known.write is None else [Seed(suffix, known.write([frame]))]
        circle = _field().circle_by_name[_field().default_circle]
        stored = CalibratedFrame.of(_record(), _field(), circle)
        return [] if stored is None else [Seed(suffix, known.write([stored.reduce(known.holds, SIZE)]))]

    return seeds


@cache
def _all_annotations() -> list[Seed]:
    return [seed for known in annotation_formats().values() for seed in _seeds_of(known)()]


def _keypoints() -> Sequence[Seed]:
    return _seeds_of(annotation_formats()["pnlcalib"])()


@cache
def _camera_files() -> list[Seed]:
    found = [seed for known in camera_formats().values() for seed in _seeds_of(known)()]
    return [*found, *_results()]
