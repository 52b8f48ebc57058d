"""How many clicks a refused or doubtful frame needs in the workbench until it is calibrated and good, and how long a
change takes: a person who knows the truth and whose hand trembles, without a browser.

Everything that such a person does is what the page does: an offered interpretation is accepted (one click); the lines
that fit an accepted camera are accepted together (one click); a line that was measured gets its name (two clicks: on
it, and on its marking on the field); a marking is chosen on the field and clicked in the picture (one click, and two or
more on its paint, each off by some pixels, which snap). Of these the one is done that helps with the fewest clicks.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from circlecal.config import Config
from circlecal.errors import InputError
from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.formats.annotation import AnnotatedMarking, Annotation
from circlecal.geometry.projective import Array
from circlecal.pictures.files import PICTURE_SUFFIXES, PictureFile, read_image
from circlecal.pipeline import field_of
from circlecal.synthetic.sampling import SceneProfile, render_frame
from circlecal.workbench.answers import Answer, answer, describe, distance_to_polyline, see_markings, suggest_names
from circlecal.workbench.frames import state_of
from circlecal.workbench.interpretations import interpret, name_marking
from circlecal.workbench.measuring import (
    MeasuredPicture,
    Snapped,
    begin_annotation,
    complete_circle,
    follow_path,
    measure_picture,
    snap_click,
)

PROFILES: tuple[SceneProfile, ...] = ("worn", "no_halfway", "short_arc")
"""Rendered frames that the chain alone finds hard."""
HAND_PX = 2.0
"""Standard deviation of a click, pixels of the picture."""
MOST_CLICKS = 12
"""Whoever needs more gives up."""
CURVE_GOOD_PX, OTHERS_GOOD_PX = 4.0, 15.0
"""A good frame has circle and halfway line so near to their truth, and the median of its other markings, pixels at 1920
px width: hand-made truth is about 1.5 px off, and 15 px are a quarter of a metre on the far touchline.
"""
NEAR_PX = 4.0
"""A measured line whose points lie so near to a true marking is that marking, pixels at 1920 px width."""
LEAST_WIDTHS = 0.04
"""Shorter pieces of a marking, picture widths, are not worth a click."""
WIDEST_CLICKS = 5
"""On a curve, of which no ellipse was seen."""
REPEATS = 3
"""A change is timed so often; the fastest counts."""

Truth = dict[str, Array]
"""Points (N, 2) of the markings in view by their names in the template, pixels."""


@dataclass(frozen=True, slots=True)
class ClickRow:
    """One frame: where it is from, what the chain said, how many clicks it took (None: given up), what was done, the
    time from a change to its answer, ms, and the width of the picture, pixels.
    """

    group: str
    frame: str
    state: str
    clicks: int | None
    steps: tuple[str, ...]
    update_ms: float
    width: int


@dataclass(frozen=True, slots=True)
class _Try:
    """One thing to do next: the annotation after it, how many clicks it takes, and words for it."""

    annotation: Annotation
    clicks: int
    words: str


def count_clicks(
    folder: Path | None,
    rendered: int,
    seed: int,
    advance: Callable[[str], None],
    config: Config | None = None,
) -> list[ClickRow]:
    """Click frames until they are good.

    Parameters
    ----------
    folder : path or None
        With ``images`` and ``truth``: a JSON file per picture with ``elements`` (points by SoccerNet class). Frames of
        other sports (``field``), and those without ``elements``, are left out.
    rendered : int
        How many frames of each of :data:`PROFILES`.
    seed : int
        Of rendered frames and of the hand.
    advance : callable
        Called with the name of each frame that was looked at.
    config : Config, optional
        Options of every stage.

    Returns
    -------
    list of ClickRow
        Of frames that the chain refuses or doubts.

    Raises
    ------
    InputError
        The folder has no such files.
    """
    cv2.setNumThreads(1)
    chosen = config or Config()
    rows: list[ClickRow] = []
    for group, name, measured, truth, file in _frames(folder, rendered, seed, chosen):
        advance(name)
        begun = begin_annotation(measured, chosen, file)
        first = answer(begun, chosen, nameless=True)
        sigma = None if measured.found.attempt.camera is None else measured.found.attempt.camera.max_sigma_px
        state = state_of(measured.found.status, sigma, begun.width)
        if state != "calibrated":
            rng = np.random.default_rng([seed, len(rows)])
            rows.append(_click_frame(group, name, state, begun, first, measured, truth, chosen, rng))
    return rows


def _frames(
    folder: Path | None, rendered: int, seed: int, config: Config
) -> Iterator[tuple[str, str, MeasuredPicture, Truth, PictureFile]]:
    template, _ = field_of(config)
    for path, truth in () if folder is None else _real_frames(folder, template):
        file = PictureFile(path.stem, path, path.stem)
        yield "real", path.stem, measure_picture(read_image(path), config, file), truth, file
    for number, profile in enumerate(PROFILES):
        for index in range(rendered):
            rendering = render_frame(profile, np.random.default_rng([seed, index, number]), 1920, 1080)
            name = f"{profile}-{index}"
            file = PictureFile(name, Path(name), name)
            if rendering.truth.expect != "refuse":
                view = FieldView(rendering.truth.camera, rendering.truth.surface)
                measured = measure_picture(rendering.image, config, file)
                yield profile, name, measured, _project_truth(view, rendering.truth.template), file


def _real_frames(folder: Path, template: FieldTemplate) -> Iterator[tuple[Path, Truth]]:
    files = sorted((folder / "truth").glob("*.json"))
    if not files:
        raise InputError(f"{folder}: has no truth/*.json; give a folder with images and truth")
    classes = {e.class_name: e.name for e in (*template.round_ones, *template.lines) if e.class_name}
    for file in files:
        content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        usable = content.get("usable") is not False and content.get("field", template.name) == template.name
        elements = content.get("elements") or {}
        if not usable or not elements:
            continue
        path = next((p for s in PICTURE_SUFFIXES if (p := folder / "images" / f"{file.stem}{s}").is_file()), None)
        if path is not None:
            named = {classes[key.strip()]: np.array(v, float) for key, v in elements.items() if key.strip() in classes}
            yield path, {name: points for name, points in named.items() if len(points) > 1}


def _project_truth(view: FieldView, template: FieldTemplate) -> Truth:
    """The markings in view of a rendered frame."""
    found = {}
    for name, places in template.polylines(0.5).items():
        pixels = view.project(places)
        inside = view.shows(np.nan_to_num(pixels, nan=-1.0))
        if inside.sum() > 1:
            found[name] = pixels[inside]
    return found


def is_good(told: Answer, truth: Truth, template: FieldTemplate) -> bool:
    """Whether a calibrated frame is good, its field as it is or turned by 180 degrees."""
    view = told.found.view
    if view is None or not told.is_calibrated:
        return False
    unit = 1920.0 / told.annotation.width
    central = (template.default_circle, template.halfway_line)
    for turn in (1.0, -1.0):
        off = {
            name: unit * float(np.minimum(distance_to_polyline(points, view.project(turn * places)), 1e4).mean())
            for name, points in truth.items()
            if (places := template.polylines(0.5).get(name)) is not None
        }
        others = [v for name, v in off.items() if name not in central]
        near = all(off[name] <= CURVE_GOOD_PX for name in central if name is not None and name in off)
        if near and (not others or float(np.median(others)) <= OTHERS_GOOD_PX):
            return True
    return False


def _click_frame(
    group: str,
    name: str,
    state: str,
    annotation: Annotation,
    told: Answer,
    measured: MeasuredPicture,
    truth: Truth,
    config: Config,
    rng: np.random.Generator,
) -> ClickRow:
    template, _ = field_of(config)
    clicks = 0
    steps: list[str] = []
    update_ms = _time_change(annotation, config)
    while not is_good(told, truth, template):
        tries = list(_tries(annotation, told, measured, truth, config, rng))
        chosen = next(
            (one for one in tries if is_good(answer(one.annotation, config, nameless=True), truth, template)),
            next((one for one in tries if one.clicks > 1), None),
        )
        if chosen is None or clicks + chosen.clicks > MOST_CLICKS:
            return ClickRow(group, name, state, None, tuple(steps), update_ms, annotation.width)
        clicks, annotation = clicks + chosen.clicks, chosen.annotation
        steps.append(chosen.words)
        told = answer(annotation, config, nameless=True)
        update_ms = max(update_ms, _time_change(annotation, config))
    return ClickRow(group, name, state, clicks, tuple(steps), update_ms, annotation.width)


def _time_change(annotation: Annotation, config: Config) -> float:
    """From a change to what the page is told: the time of one thread, ms."""
    spent = []
    for _ in range(REPEATS):
        start = time.process_time()
        describe(answer(annotation, config, nameless=False))
        spent.append((time.process_time() - start) * 1e3)
    return min(spent)


def _tries(
    annotation: Annotation,
    told: Answer,
    measured: MeasuredPicture,
    truth: Truth,
    config: Config,
    rng: np.random.Generator,
) -> Iterator[_Try]:
    """What can be done next, the fewest clicks first."""
    template, _ = field_of(config)
    if told.is_calibrated:
        fitting = suggest_names(told, see_markings(told.found.view, template))
        if fitting:
            named = annotation
            for index, name in fitting.items():
                named = name_marking(named, index, name)
            yield _Try(named, 1, "accept the lines that fit")
    else:
        for one in interpret(annotation, measured, config):
            named = annotation
            for index, name in one.names.items():
                named = name_marking(named, index, name)
            yield _Try(named, 1, f"accept {', '.join(dict.fromkeys(one.names.values()))}")
    yield from _names(annotation, truth, template)
    yield from _marks(annotation, measured, truth, template, rng)


def _names(annotation: Annotation, truth: Truth, template: FieldTemplate) -> Iterator[_Try]:
    """Names for what was measured, the longest first."""
    near_px = NEAR_PX * annotation.width / 1920.0
    taken = {m.name for m in annotation.markings if m.used}
    order = sorted(range(len(annotation.markings)), key=lambda k: -len(annotation.markings[k].points_px))
    for index in order:
        marking = annotation.markings[index]
        if marking.name is not None or marking.kind == "point":
            continue
        for name, points in truth.items():
            is_curve = _is_curve(name, template)
            if name in taken or is_curve != (marking.kind == "curve"):
                continue
            if np.median(distance_to_polyline(marking.points, points)) < near_px:
                yield _Try(name_marking(annotation, index, name), 2, f"name {name}")
                break


def _is_curve(name: str, template: FieldTemplate) -> bool:
    return any(name == element.name for element in template.round_ones)


def _marks(
    annotation: Annotation, measured: MeasuredPicture, truth: Truth, template: FieldTemplate, rng: np.random.Generator
) -> Iterator[_Try]:
    """Markings that are clicked in the picture, the longest first."""
    taken = {m.name for m in annotation.markings if m.used}
    lengths = {name: float(np.hypot(*np.ptp(points, axis=0))) for name, points in truth.items() if name not in taken}
    for name in sorted(lengths, key=lambda key: -lengths[key]):
        if lengths[name] < LEAST_WIDTHS * annotation.width:
            continue
        is_curve = _is_curve(name, template)
        for count in (2, WIDEST_CLICKS) if is_curve else (2,):
            seen = _click_marking(measured, truth[name], count, is_curve, rng)
            if seen is None:
                continue
            marking = AnnotatedMarking(
                name=name,
                kind="curve" if is_curve else "line",
                points_px=np.round(seen.points, 3).tolist(),
                sigma_px=np.round(seen.sigma, 4).tolist(),
                source="clicked",
            )
            changed = annotation.model_copy(update={"markings": [*annotation.markings, marking]})
            yield _Try(changed, 1 + count, f"mark {name}")
            break


def _click_marking(
    measured: MeasuredPicture, points: Array, count: int, is_curve: bool, rng: np.random.Generator
) -> Snapped | None:
    """Clicks spread over a marking; None where those on a curve do not make one."""
    at = np.linspace(0.06, 0.94, count) * (len(points) - 1)
    last = np.array(measured.picture.shape[1::-1]) - 1.0
    clicks = np.stack([np.interp(at, np.arange(len(points)), points[:, k]) for k in (0, 1)], axis=-1)
    clicks = np.clip(clicks + rng.normal(0.0, HAND_PX, clicks.shape), 0.0, last)
    snapped = [snap_click(measured, click) for click in clicks]
    places = np.concatenate([one.points for one in snapped])
    if not is_curve:
        between = follow_path(measured, np.clip(places, 0.0, last))
        return between if between.on_paint else Snapped(places, np.concatenate([s.sigma for s in snapped]), True)
    return complete_circle(measured, places)


@dataclass(frozen=True, slots=True)
class ClickGroup:
    """Frames of one kind: how many were refused or doubtful, how many of them good without a click (doubtful ones), the
    clicks of the others (a frame that was given up counts as infinitely many), and the slowest change, ms.
    """

    name: str
    frames: int
    good_already: int
    median_clicks: float
    p90_clicks: float
    given_up: int
    slowest_ms: float


def summarise_clicks(rows: list[ClickRow]) -> list[ClickGroup]:
    """Each kind of frames, and all together."""
    names = list(dict.fromkeys(row.group for row in rows))
    groups = [(name, [row for row in rows if row.group == name]) for name in names]
    return [_summarise_group(name, found) for name, found in [*groups, ("all", rows)] if found]


def _summarise_group(name: str, rows: list[ClickRow]) -> ClickGroup:
    clicks = np.array([np.inf if row.clicks is None else row.clicks for row in rows if row.clicks != 0], np.float64)
    middle, high = np.quantile(clicks, (0.5, 0.9), method="higher") if len(clicks) else (np.nan, np.nan)
    return ClickGroup(
        name,
        len(rows),
        sum(row.clicks == 0 for row in rows),
        float(middle),
        float(high),
        sum(row.clicks is None for row in rows),
        max(row.update_ms for row in rows),
    )
