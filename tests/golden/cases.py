"""The frames whose answers are kept: what is shown, how it is rendered or written, and how it is calibrated.

Everything is calibrated by the command line, and read from the result files that it writes: these are to stay what they
are, wherever the code behind them goes.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import numpy as np

from circlecal.batch import run as batch_run
from circlecal.cli import main
from circlecal.field import load_field
from circlecal.geometry.camera import Camera
from circlecal.geometry.surface import FLAT, Surface
from circlecal.synthetic.cameras import aim_camera, sample_camera
from circlecal.synthetic.negatives import negative_scene
from circlecal.synthetic.renderer import Rendering, render
from circlecal.synthetic.sampling import profile_field, render_frame
from circlecal.synthetic.scene import RenderConfig, Scene
from tests.conftest import finish_here

Records = dict[str, dict[str, Any]]
"""Result files by the id of their frame."""

SAMPLES = Path(__file__).parents[2] / "samples"
PLACED = ("--config", "annotations")
DETECTED = ("--set", "mask.source=detector")
LARGE, SMALL, QUARTER = (1280, 720), (960, 540), (640, 360)
RENDERED = {
    "easy": {0: LARGE},
    "broadcast": {0: LARGE, 1: SMALL},
    "partial": {0: LARGE, 1: SMALL},
    "hidden_mark": {0: LARGE, 1: SMALL},
    "hard": {0: LARGE, 2: SMALL},
    "shade": {0: LARGE},
    "worn": {2: LARGE, 3: SMALL},
    "graphics": {1: LARGE},
    "low_camera": {0: LARGE, 1: SMALL},
    "lens": {0: LARGE, 1: SMALL},
    "archive": {0: LARGE, 1: LARGE},
    "colours": {0: LARGE},
    "night": {0: LARGE},
    "haze": {0: LARGE},
    "blur": {0: LARGE},
    "letterbox": {0: LARGE},
    "uhd": {0: QUARTER},
    "behind_goal": {0: LARGE, 1: SMALL},
    "oblique": {0: LARGE, 1: SMALL},
    "short_arc": {1: SMALL, 2: LARGE, 3: LARGE},
    "no_halfway": {0: LARGE, 1: SMALL},
    "ice": {0: LARGE, 1: SMALL},
    "wood": {1: LARGE, 2: SMALL},
    "rink": {2: SMALL},
    "court": {1: SMALL},
    "robots": {2: SMALL},
}
"""Sizes asked for by seed; ``archive`` has its own, and ``uhd`` is twice as large."""
NEGATIVES = ("penalty_area", "goal_mouth", "crowd", "grass", "tennis", "rugby")
ROBOT_SIZE = (800, 448)
ROBOTS = {
    "towards_goal": ((-1.5, 0.3, -0.55), (0.3, 0.0, 0.0), 470.0, 0.06, *ROBOT_SIZE, -0.06),
    "aslant": ((3.3, -0.9, -1.45), (0.0, 0.1, 0.0), 435.0, 0.02, *ROBOT_SIZE, -0.08),
}
SOLVERS = ("magera_case1", "magera_case3", "alvarez_caselles", "great_axis")
ANNOTATION_SOLVERS = ("alvarez_caselles", "chum_matas", "gupta", "pnl_like", "circlecal_default")
ANNOTATED = {
    "broadcast": ("soccernet",),
    "partial": ("soccernet",),
    "oblique": ("labelme", "coco"),
    "tactical": ("cvat",),
}
"""Formats of the annotation of a view of each kind."""


@dataclass(frozen=True)
class Case:
    """A kind of input, a name, and what calibrates it in an empty folder."""

    group: str
    name: str
    calibrate: Callable[[Path], Records]

    def __str__(self) -> str:
        return f"{self.group}-{self.name}"


def command(*arguments: object) -> None:
    """A command of circlecal in this process; one that is misused is an error, refused frames are none."""
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            main([str(argument) for argument in arguments])
    except SystemExit as ended:
        if ended.code not in (None, 0, 1):
            raise RuntimeError(f"circlecal {' '.join(map(str, arguments))} ended with {ended.code}") from ended


def calibrated(inputs: Iterable[Path], arguments: Iterable[str], folder: Path) -> Records:
    command("calibrate", *inputs, *arguments, "--no-overlay", "--quiet", "--out", folder / "out")
    return {path.stem: json.loads(path.read_text()) for path in sorted((folder / "out").glob("*.json"))}


def cases() -> list[Case]:
    """All of them; nothing is rendered before it is calibrated."""
    found = []
    for path in sorted(SAMPLES.glob("*.jpg")):
        found.append(Case("samples", path.stem, partial(calibrated, [path], DETECTED)))
    for name in ("full_circle", "low_camera_night"):
        found.append(
            Case(
                "samples",
                f"{name}.mask",
                partial(calibrated, [SAMPLES / f"{name}.jpg"], ("--mask", SAMPLES / "segmentation")),
            )
        )
    found += [
        Case("rendered", f"{profile}_{seed}", partial(_rendered, profile, seed, size))
        for profile, sizes in RENDERED.items()
        for seed, size in sizes.items()
    ]
    found += [Case("rendered", f"negative_{kind}", partial(_negative, kind)) for kind in NEGATIVES]
    found += [Case("rendered", f"robot_{name}", partial(_robot, name)) for name in ROBOTS]
    for view, formats in ANNOTATED.items():
        for to in formats:
            found.append(Case("annotations", f"{view}.{to}", partial(_annotated, view, to, ())))
            found.append(Case("annotations", f"{view}.{to}.prior", partial(_annotated, view, to, PLACED)))
    found.append(Case("annotations", "full_circle.pnlcalib", _detected))
    sample = SAMPLES / "full_circle.jpg"
    found += [Case("solvers", name, partial(calibrated, [sample], ("--solver", name))) for name in SOLVERS]
    for name in ANNOTATION_SOLVERS:
        solve = ("--solver", name)
        found.append(Case("solvers", f"{name}.annotation", partial(_annotated, "tactical", "labelme", solve)))
    found.append(Case("solvers", "no_camera", partial(calibrated, [sample], ("--set", "camera.enabled=false"))))
    found.append(Case("rig", "rig", _rig))
    return found


def _pictured(rendering: Rendering, name: str, arguments: Iterable[str], folder: Path) -> Records:
    path = folder / f"{name}.png"
    cv2.imwrite(str(path), rendering.image)
    return calibrated([path], arguments, folder)


def _rendered(profile: str, seed: int, size: tuple[int, int], folder: Path) -> Records:
    rendering = render_frame(profile, np.random.default_rng([seed, *profile.encode()]), *size)
    field = profile_field(profile)
    arguments = [] if field == "soccer" else ["--field", field]
    aspect = float(np.divide(*rendering.truth.camera.focal_px[::-1]))
    if abs(aspect - 1.0) > 1e-6:
        arguments += ["--set", f"camera.aspect={aspect:.9g}"]
    return _pictured(rendering, f"{profile}_{seed}", arguments, folder)


def _negative(kind: str, folder: Path) -> Records:
    rng = np.random.default_rng([*kind.encode()])
    return _pictured(render(negative_scene(rng, SMALL, load_field("soccer"), kind), rng), kind, (), folder)


def _robot(name: str, folder: Path) -> Records:
    field = load_field("robocup")
    position, target, *rest = ROBOTS[name]
    look = RenderConfig(
        marking_width_m=field.marking_width_m,
        stripe_contrast=0.0,
        texture=0.1,
        wear=0.3,
        wear_scale_m=0.05,
        defocus_px=1.0,
        noise=2.0,
        board_distance_m=1.0,
        board_height_m=0.6,
        stand_height_m=3.0,
        shadow_count=0,
    )
    scene = Scene(aim_camera(np.array(position), np.array(target), *rest), field, FLAT, look)
    return _pictured(render(scene, np.random.default_rng(5)), name, ("--config", "robocup"), folder)


def _annotated(view: str, to: str, arguments: tuple[str, ...], folder: Path) -> Records:
    """An annotation of all markings in view, with clicks good to a pixel, in a format that circlecal writes."""
    rng = np.random.default_rng([*view.encode()])
    surface = Surface("roof", 9.15, 0.05)
    camera = sample_camera(view, rng, kappa=0.02, surface=surface)
    path = _written(camera, surface, rng, folder / f"{view}.json")
    if to != "labelme":
        command("convert", path, "--to", to, "--out", folder / "converted")
        (path,) = (folder / "converted").iterdir()
    return calibrated([path], [*arguments, "--size", "1920x1080"], folder)


def _detected(folder: Path) -> Records:
    """Keypoints of the circle, as a calibration of a picture writes them."""
    command("calibrate", SAMPLES / "full_circle.jpg", "--to", "pnlcalib", "--no-overlay", "--out", folder / "picture")
    keypoints = folder / "picture" / "full_circle.pnlcalib.json"
    return calibrated([keypoints], [*PLACED, "--size", "1920x1080"], folder)


def _written(
    camera: Camera,
    surface: Surface,
    rng: np.random.Generator,
    path: Path,
    noise_px: float = 1.0,
    left_out: tuple[str, ...] = (),
) -> Path:
    shapes = []
    for name, points in load_field("soccer").polylines(0.5).items():
        pixels = camera.project(surface.lift(points))
        with np.errstate(invalid="ignore"):
            seen = pixels[((pixels > 0) & (pixels < (camera.width - 1, camera.height - 1))).all(axis=1)]
        if len(seen) >= 9 and name not in left_out:
            chosen = seen[np.linspace(0, len(seen) - 1, 9).round().astype(int)] + rng.normal(0, 1, (9, 2)) + 0.5
            shapes.append({"label": name, "points": chosen.tolist(), "shape_type": "linestrip"})
    size = {"imageWidth": camera.width, "imageHeight": camera.height}
    path.write_text(json.dumps({"version": "5.4.1", "imagePath": f"{path.stem}.jpg", **size, "shapes": shapes}))
    return path


def _rig(folder: Path) -> Records:
    """Views of one camera, of which one shows no halfway line and is calibrated with what the others say."""
    rng = np.random.default_rng(4)
    surface = Surface("roof", 9.15, 0.05)
    first = sample_camera("broadcast", rng, kappa=0.03, surface=surface)
    views = ("broadcast", "broadcast", "broadcast", "main")
    cameras = [first, *(sample_camera(view, rng, kappa=0.03, surface=surface, like=first) for view in views)]
    paths = [
        _written(camera, surface, rng, folder / f"view_{k}.json", ("halfway_line",) if k == 4 else ())
        for k, camera in enumerate(cameras)
    ]
    alone = calibrated(paths, (), folder)
    with mock.patch.object(batch_run, "_finish_frames", finish_here):  # workers take longer to start than the frames
        command("rig", folder / "out", "--quiet", "--out", folder / "rig")
    lines = (folder / "rig" / "results.jsonl").read_text().splitlines()
    return {f"{name}.alone": record for name, record in alone.items()} | {r["id"]: r for r in map(json.loads, lines)}
